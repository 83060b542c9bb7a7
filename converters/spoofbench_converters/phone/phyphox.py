"""phyphox (RWTH Aachen): a folder or zip archive of one CSV table per sensor, or one table.

Times are seconds of the experiment, which stand still while it is paused; ``meta/time.csv`` says
when it was started and paused in Unix time. Units stand behind the columns' names. Accelerations
point up at rest on every phone; heights are above mean sea level unless a column says WGS 84
(phyphox wiki, *Phyphox file format*, input modules ``sensor`` and ``location``).
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spoofbench.conversion import Item, RowBatch, SourceMetadata
from spoofbench.errors import ConversionError
from spoofbench_converters.phone import contract
from spoofbench_converters.phone.contract import NO_TIME, Options, known, positive
from spoofbench_converters.phone.files import (
    HeaderSchema,
    PhoneFile,
    read_columns,
    records,
    text_parts,
    used_whole,
)
from spoofbench_converters.phone.merging import MergedTopic, merge
from spoofbench_converters.text.columns import NOT_A_NUMBER, ColumnReader
from spoofbench_converters.text.numbers import moment_ns

_MPS2 = r"\(m/s(\^?2|²)\)"
_TIME = re.compile(r"(time|zeit|t) \(s\)", re.IGNORECASE)
_RADIANS, _DEGREES = r"\(rad/s\)", r"\((°|deg)/s\)"


class Quantity(NamedTuple):
    """A column: its name as a pattern, the kind of its source, its field, and the factor to the
    field's unit.
    """

    pattern: re.Pattern[str]
    family: str
    field: str
    factor: float = 1.0


def _quantity(pattern: str, family: str, field: str, factor: float = 1.0) -> Quantity:
    return Quantity(re.compile(pattern, re.IGNORECASE), family, field, factor)


def _vectors() -> Iterator[Quantity]:
    for axis in contract.AXES:
        yield _quantity(
            rf"linear accelerat(ion|ometer) {axis} {_MPS2}", "imu", f"linear_accel_{axis}_mps2"
        )
        yield _quantity(rf"accelerat(ion|ometer) {axis} {_MPS2}", "imu", f"accel_{axis}_mps2")
        yield _quantity(rf"gyroscope {axis} {_RADIANS}", "imu", f"gyro_{axis}_radps")
        yield _quantity(rf"gyroscope {axis} {_DEGREES}", "imu", f"gyro_{axis}_radps", np.pi / 180)
        yield _quantity(
            rf"(magnetic field|magnetometer) {axis} \([µμ]T\)", "mag", f"field_{axis}_ut"
        )


_QUANTITIES = (
    *_vectors(),
    _quantity(r"(pressure|x) \(hPa\)", "baro", "pressure_pa", 100.0),
    _quantity(r"latitude \((°|deg)\)", "gnss", "lat_deg"),
    _quantity(r"longitude \((°|deg)\)", "gnss", "lon_deg"),
    _quantity(r"(height|altitude) \(m\)", "gnss", "height_msl_m"),
    _quantity(r"(height|altitude) WGS ?84 \(m\)", "gnss", "height_m"),
    _quantity(r"(velocity|speed) \(m/s\)", "gnss", "speed_mps"),
    _quantity(r"direction \((°|deg)\)", "gnss", "course_deg"),
    _quantity(r"horizontal accuracy \((m|°)\)", "gnss", "h_acc_m"),
    _quantity(r"vertical accuracy \((m|°)\)", "gnss", "v_acc_m"),
)
_MEANT = {"speed_mps": known, "course_deg": known, "h_acc_m": positive, "v_acc_m": positive}
_KINDS = {"imu": "imu", "mag": "mag", "baro": "baro", "gnss": "gnss/pvt"}
_ABOUT = {
    "imu": {"device_axes": contract.DEVICE_AXES},
    "mag": {"device_axes": contract.DEVICE_AXES},
    "gnss": {"solution_basis": "the phone's location, of which phyphox does not say what it fuses"},
}


class PhyphoxTable(NamedTuple):
    """A table that is understood: its file, its schema, the column of time, and its quantities by
    column.
    """

    part: PhoneFile
    schema: HeaderSchema
    time: str
    quantities: Mapping[str, Quantity]

    @property
    def family(self) -> str:
        return next(iter(self.quantities.values())).family


def sniff(parts: Sequence[PhoneFile]) -> float:
    """Return 0.9 for a file of the app, 0 for others."""
    return 0.9 * any(_table(part) is not None for part in parts)


def _table(part: PhoneFile) -> PhyphoxTable | None:
    schema = HeaderSchema.of(part.head)
    time = next((name for name in schema.names if _TIME.fullmatch(name)), None)
    quantities = {
        name: quantity
        for name in schema.names
        for quantity in _QUANTITIES
        if quantity.pattern.fullmatch(name)
    }
    family = next(iter(quantities.values())).family if quantities else ""
    same = {name: quantity for name, quantity in quantities.items() if quantity.family == family}
    return PhyphoxTable(part, schema, time, same) if time and same else None


def tables(parts: Sequence[PhoneFile]) -> list[PhyphoxTable]:
    """Return the tables that are understood.

    Raises:
        ConversionError: two tell the same.
    """
    found = [table for part in text_parts(parts) if (table := _table(part))]
    owners: dict[str, PhoneFile] = {}
    for table in found:
        for quantity in table.quantities.values():
            other = owners.setdefault(quantity.field, table.part)
            if other is not table.part:
                raise ConversionError(
                    f"{other.name!r} and {table.part.name!r} tell the same; convert one "
                    "experiment at a time"
                )
    return found


def convert(parts: Sequence[PhoneFile], options: Options) -> Iterator[Item]:
    """Yield what an experiment holds.

    Raises:
        ConversionError: nothing says when it began, or there are several.
    """
    understood = tables(parts)
    times = next(
        (
            part
            for part in text_parts(parts)
            if {"event", "experiment time", "system time"} <= set(HeaderSchema.of(part.head).names)
        ),
        None,
    )
    clock = _clock(times, options)
    session = {"session_id": options.session} if options.session else {}
    yield SourceMetadata(
        {"recording": {"clock": "sensor", "clock_basis": clock.basis, **clock.about, **session}}
    )
    properties = next(
        (
            part
            for part in text_parts(parts)
            if {"property", "value"} == set(HeaderSchema.of(part.head).names)
        ),
        None,
    )
    about = _device(properties)
    for family, kind in _KINDS.items():
        same = {table.part.name: table for table in understood if table.family == family}
        if same:
            merged = MergedTopic(f"{family}0", kind, inputs=tuple(same), joins=True)
            yield from merge(merged, {name: _rows(table, clock) for name, table in same.items()})
            topic = " ".join(table.part.stem for table in same.values() if table.part.name)
            yield SourceMetadata(
                {
                    f"source/{family}0": {
                        "app": "phyphox",
                        "topic": topic,
                        **about,
                        **_ABOUT.get(family, {}),
                    }
                }
            )
    for part in parts:
        if part in (times, properties):
            yield used_whole(part)
        elif all(part is not table.part for table in understood):
            yield part.rejected()


class ExperimentClock(NamedTuple):
    """When the experiment ran: its times at each start and the Unix times then, int64 ``(n,)`` in
    nanoseconds.
    """

    started_ns: NDArray[np.int64]
    unix_ns: NDArray[np.int64]
    basis: str
    about: Mapping[str, str]

    def times(self, experiment_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the Unix times of times of the experiment; one at a pause is that of the start
        after it.
        """
        run = np.maximum(np.searchsorted(self.started_ns, experiment_ns, "right") - 1, 0)
        return experiment_ns - self.started_ns[run] + self.unix_ns[run]


def _clock(part: PhoneFile | None, options: Options) -> ExperimentClock:
    if options.date is not None:
        try:
            start_ns = moment_ns(options.date)
        except ValueError:
            raise ConversionError(
                f"the date {options.date!r} is invalid; write it as 2024-05-31 or "
                "2024-05-31T10:20:30Z"
            ) from None
        return ExperimentClock(
            np.array([0]), np.array([start_ns]), "start as given", {"reference_date": options.date}
        )
    if part is None:
        raise ConversionError(
            "the experiment does not say when it began: there is no meta/time.csv; give the start "
            "with --date"
        )
    schema = HeaderSchema.of(part.head)
    starts: list[tuple[int, int]] = []
    for row in records(part):
        if row["event"].strip().upper() == "START":
            texts = (
                row[name].replace(",", ".") if schema.decimal_comma else row[name]
                for name in ("experiment time", "system time")
            )
            try:
                experiment, system = (_decimal_ns(text) for text in texts)
            except ArithmeticError:
                continue
            starts.append((experiment, system))
    if not starts:
        raise ConversionError(
            f"{part.name!r} has no start of the experiment that can be read; give the start with "
            "--date"
        )
    begun = np.array(sorted(starts), np.int64)
    return ExperimentClock(begun[:, 0], begun[:, 1], f"starts of the experiment in {part.stem}", {})


def _decimal_ns(seconds: str) -> int:
    from decimal import Decimal

    value = Decimal(seconds.strip()) * 1_000_000_000
    if not value.is_finite() or abs(value) > 2**62:
        raise ArithmeticError(seconds)
    return int(value.to_integral_value())


def _device(part: PhoneFile | None) -> dict[str, str]:
    properties = {row["property"]: row["value"] for row in records(part)} if part else {}
    name = " ".join(
        filter(None, (properties.get(key, "") for key in ("deviceBrand", "deviceModel")))
    )
    return {"device": name} if name else {}


def _rows(table: PhyphoxTable, clock: ExperimentClock) -> Iterator[RowBatch | Item]:
    for reader in read_columns(table.part, table.schema):
        if not isinstance(reader, ColumnReader):
            yield reader
            continue
        experiment_ns, timed = reader.exact((table.time,), 9)
        fields = {}
        for name, quantity in table.quantities.items():
            values = reader.floats(name) * quantity.factor
            meant = _MEANT.get(quantity.field)
            fields[quantity.field] = meant(values) if meant else values
        if table.family == "imu":
            fields["interval_s"] = np.zeros(len(reader))
        yield from reader.rejects(reader.bad, NOT_A_NUMBER)
        yield from reader.rejects(~timed & ~reader.bad, NO_TIME)
        time_ns, kept = clock.times(experiment_ns), timed & ~reader.bad
        yield reader.batch(_KINDS[table.family], time_ns, fields, kept)
