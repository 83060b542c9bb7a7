"""Conversion of GnssLogger's text log.

:mod:`spoofbench_converters.phone.gnsslogger_format` says what such a log is made of.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spoofbench.conversion import Item, Rejects, RowBatch, SourceMetadata, Used
from spoofbench.gnss_time import utc_to_gps
from spoofbench.schema import split_topic
from spoofbench.table import Column
from spoofbench_converters.phone import android, gnsslogger_format
from spoofbench_converters.phone.contract import (
    AXES,
    BODY,
    DEVICE_AXES,
    NO_POSITION,
    NO_TIME,
    Options,
    positive,
)
from spoofbench_converters.phone.files import ANOTHER, PhoneFile, only, text_parts
from spoofbench_converters.phone.gnss_chip import GnssChip
from spoofbench_converters.phone.gnsslogger_format import ELAPSED, SENSORS, UNIX, UTC, LogSchema
from spoofbench_converters.phone.merging import MergedTopic, in_file_order
from spoofbench_converters.phone.time_axis import ClockDeviation, ElapsedTimeAxis, Stamps
from spoofbench_converters.text.columns import NOT_A_NUMBER, WRONG_WIDTH, ColumnReader, Fields
from spoofbench_converters.text.lines import Lines, read_lines

_NOT_KEPT = {
    "NMEA": "NMEA sentences: not asked for, convert with --format nmea",
    "GnssAntennaInfo": "GnssAntennaInfo: nothing in the schema",
}
_BATCHING_S = 10.0  # sensors may be handed over in batches of seconds, each on its own

_VECTORS = {  # row type: kind of source, which, columns, fields
    "UncalAccel": ("imu", "uncalibrated", "UncalAccel{}Mps2", "accel_{}_mps2", "Bias{}Mps2"),
    "UncalGyro": (
        "imu",
        "uncalibrated",
        "UncalGyro{}RadPerSec",
        "gyro_{}_radps",
        "Drift{}RadPerSec",
    ),
    "UncalMag": ("mag", "uncalibrated", "UncalMag{}MicroT", "field_{}_ut", "Bias{}MicroT"),
    "Accel": ("imu", "calibrated", "Accel{}Mps2", "accel_{}_mps2", ""),
    "Gyro": ("imu", "calibrated", "Gyro{}RadPerSec", "gyro_{}_radps", ""),
    "Mag": ("mag", "calibrated", "Mag{}MicroT", "field_{}_ut", ""),
}
_PROVIDERS = {b"GPS": "GPS", b"FLP": "FLP", b"FUSED": "FLP", b"NLP": "NLP", b"NETWORK": "NLP"}
_SOLUTIONS = {
    "GPS": {"solution": "gnss", "solution_basis": "Android's GPS provider"},
    "FLP": {"solution": "fused", "solution_basis": "Android's fused location provider"},
    "NLP": {
        "solution": "fused",
        "solution_basis": "Android's network provider: cells and Wi-Fi, no satellites",
    },
}


def sniff(parts: Sequence[PhoneFile]) -> float:
    """Return how sure it is that one of the files is a log."""
    return max((gnsslogger_format.confidence(part.head) for part in parts), default=0.0)


def convert(parts: Sequence[PhoneFile], options: Options) -> Iterator[Item]:
    """Yield what a log holds, the one file of it that is one.

    Raises:
        ConversionError: there are several.
    """
    part = only(
        [part for part in text_parts(parts) if gnsslogger_format.confidence(part.head)], "logs"
    )
    assert part is not None
    log = _GnssLoggerConversion(*gnsslogger_format.survey(part), options)
    with part.open() as file:
        for lines in read_lines(file, part.origin):
            if isinstance(lines, Lines):
                yield from log.take(lines)
            else:
                yield lines
    yield from log.finish()
    yield from (other.rejected(ANOTHER) for other in parts if other is not part)


class _GnssLoggerConversion:
    """A log being converted."""

    def __init__(self, schema: LogSchema, axis: ElapsedTimeAxis, options: Options) -> None:
        self._schema, self._axis, self._options = schema, axis, options
        self._deviation = ClockDeviation()
        self._topics: dict[tuple[str, str], MergedTopic] = {}
        self._about: dict[str, dict[str, str]] = {}
        self._chip = GnssChip("gnss0", axis)
        self._by_sensors = any(kind in schema.widths for kind in SENSORS)
        self._timed: list[_Timed] = []  # rows of the piece at hand
        self._logged: list[_Timed] = []  # those that log a time beside the time since boot

    def take(self, lines: Lines) -> Iterator[Item]:
        """Yield what a piece holds."""
        headers = gnsslogger_format.first_octets(lines) == ord("#")
        described = headers | (lines.ends == lines.starts)
        if described.any():
            yield Used(int(lines.lengths[described].sum()))
        rows, start = np.flatnonzero(~described), 0
        for header in np.flatnonzero(headers).tolist():
            if self._schema.changed_by(lines.text(header)):
                yield from self._rows(lines.take(rows[(rows >= start) & (rows < header)]))
                self._schema.learn(lines.text(header))
                start = header
        yield from self._rows(lines.take(rows[rows >= start]))

    def finish(self) -> Iterator[Item]:
        """Yield what is held, and the facts."""
        yield from self._chip.finish()
        for topic in self._topics.values():
            yield from topic.finish()
        recording = {
            "clock": "sensor" if self._axis.offset_ns is not None else "gnss",
            "clock_basis": self._axis.basis,
        }
        if self._axis.offset_ns is not None:
            recording |= {
                "boot_unix_ns": str(self._axis.offset_ns),
                "gnss_minus_clock_ns": str(-self._axis.shift_ns),
            }
        if self._options.session:
            recording["session_id"] = self._options.session
        for name, reported in self._chip.about().items():
            fixes = self._about.get(name, {})
            self._about[name] = {
                **reported,
                **fixes,
                "topic": " ".join(filter(None, (fixes.get("topic"), reported["topic"]))),
            }
        about = {
            f"source/{name}": {**self._schema.device, **record}
            for name, record in self._about.items()
        }
        yield SourceMetadata({**about, "recording": {**recording, **self._deviation.about()}})

    def _rows(self, lines: Lines) -> Iterator[Item]:
        kinds = gnsslogger_format.types_of(lines)
        kept: dict[str, Lines] = {}
        for number, kind in enumerate(gnsslogger_format.TYPES):
            selected = kinds == number
            if not selected.any():
                continue
            if kind in _NOT_KEPT:
                yield from lines.rejects(selected, _NOT_KEPT[kind])
                continue
            same = lines.take(selected)
            right = self._schema.right(kind, same)
            yield from same.rejects(~right, WRONG_WIDTH)
            if right.any():
                kept[kind] = same if right.all() else same.take(right)
        yield from lines.rejects(kinds < 0, "a line of no type that GnssLogger writes")
        messages = kept.pop("Nav", None)
        yield from self._read(
            {kind: self._schema.reader(kind, same) for kind, same in kept.items()}
        )
        if messages is not None:
            widths = np.unique(messages.cells).tolist()
            same_width = (messages.take(messages.cells == width) for width in widths)
            yield from self._chip.navigation(
                [self._schema.reader("Nav", same) for same in same_width]
            )

    def _read(self, readers: dict[str, ColumnReader]) -> Iterator[Item]:
        """Yield the rows of each type: sensors first, for they tell the time of rows that do
        not.
        """
        self._timed, self._logged = [], []
        if self._options.append_clock:
            self._append(readers)
        pushes: dict[str, tuple[MergedTopic, list[RowBatch]]] = {}
        for kind in SENSORS:
            if kind in readers:
                topic, rows, refused = self._sensor(kind, readers[kind])
                yield from refused
                pushes.setdefault(topic.topic, (topic, []))[1].append(rows)
        for topic, batches in pushes.values():
            yield from topic.push(in_file_order(batches))
        logged = _joined(self._logged)
        self._deviation.watch(logged.offset, logged.logged_ns, logged.time_ns)
        if "Fix" in readers:
            yield from self._fixes(readers["Fix"])
        if "Raw" in readers:
            yield from self._chip.raw(readers["Raw"])
            if not self._by_sensors:
                self._timed.append(_Timed(*self._chip.latest, self._chip.latest[1]))
        timed = _joined(self._timed)
        self._chip.piece(timed.offset, timed.time_ns)
        if "Agc" in readers:
            yield from self._chip.agc(readers["Agc"])
        if "Status" in readers:
            yield from self._chip.status(readers["Status"])

    def _append(self, readers: dict[str, ColumnReader]) -> None:
        """Look for jumps of the clock, among the rows that tell the time."""
        parts = []
        for kind in SENSORS if self._by_sensors else ("Fix",):
            if kind in readers:
                reader = readers[kind]
                times, timed = ElapsedTimeAxis(self._axis.offset_ns).times(
                    reader.offset,
                    reader.exact(ELAPSED),
                    reader.exact(UNIX if kind == "Fix" else UTC, 6),
                )
                kept = timed & ~reader.bad
                parts.append(_Timed(reader.offset[kept], times[kept], times[kept]))
        if parts:
            rows = _joined(parts)
            self._axis.append(rows.offset, rows.time_ns)

    def _sensor(
        self, kind: str, reader: ColumnReader
    ) -> tuple[MergedTopic, RowBatch, list[Rejects]]:
        elapsed, logged = reader.exact(ELAPSED), reader.exact(UTC, 6)
        topic, fields = (
            self._vector(kind, reader) if kind in _VECTORS else self._scalar(kind, reader)
        )
        time_ns, timed = self._axis.times(reader.offset, elapsed, logged)
        refused = [
            *reader.rejects(reader.bad, NOT_A_NUMBER),
            *reader.rejects(~timed & ~reader.bad, NO_TIME),
        ]
        kept = timed & ~reader.bad
        rows = reader.batch(split_topic(topic.topic)[1], time_ns, fields, kept)
        self._timed.append(_Timed(rows.offset, rows.time_ns, logged[0][kept]))
        both = kept & elapsed[1] & logged[1]
        self._logged.append(_Timed(reader.offset[both], time_ns[both], logged[0][both]))
        return topic, rows, refused

    def _vector(self, kind: str, reader: ColumnReader) -> tuple[MergedTopic, Fields]:
        family, which, column, field, bias = _VECTORS[kind]
        fields = {field.format(axis): reader.floats(column.format(axis.upper())) for axis in AXES}
        if family == "imu":
            fields["interval_s"] = np.zeros(len(reader))
        name, topic = self._topic(family, which)
        last = reader.take(slice(len(reader) - 1, len(reader)))
        values = [last.floats(bias.format(axis.upper()))[0] for axis in AXES] if bias else []
        if values and not np.isnan(values).any():
            self._about[name][f"{column.partition('{')[0]}_last_bias"] = " ".join(
                repr(float(value)) for value in values
            )
        return topic, fields

    def _scalar(self, kind: str, reader: ColumnReader) -> tuple[MergedTopic, Fields]:
        if kind == "Pressure":
            names = (n for n in reader.index if n.lower().endswith(("hpa", "mbar", "millibar")))
            return self._topic("baro", "")[1], {"pressure_pa": reader.floats(*names) * 100}
        return self._topic("ins", "")[1], {
            "roll_deg": reader.floats("rollDeg"),
            "pitch_deg": -reader.floats("pitchDeg"),
        }

    def _topic(self, family: str, which: str) -> tuple[str, MergedTopic]:
        """Return a sensor's source and topic, made when its first row comes."""
        key = (family, which)
        same = [other for other in self._topics if other[0] == family]
        name = f"{family}{same.index(key) if key in same else len(same)}"
        if key not in self._topics:
            kind = _KINDS.get(family, family)
            self._topics[key] = MergedTopic(name, kind, joins=True, window_s=_BATCHING_S)
            self._about[name] = {**({"topic": which} if which else {}), **_ABOUT.get(family, {})}
        return name, self._topics[key]

    def _fixes(self, reader: ColumnReader) -> Iterator[Item]:
        elapsed, claimed = reader.exact(ELAPSED), reader.exact(UNIX, 6)
        provider = np.char.upper(reader.texts("Provider"))
        fields = {
            "lat_deg": reader.floats("LatitudeDegrees", "Latitude"),
            "lon_deg": reader.floats("LongitudeDegrees", "Longitude"),
            "height_m": reader.floats("AltitudeMeters", "Altitude"),
            "speed_mps": reader.floats("SpeedMps", "Speed"),
            "course_deg": reader.floats("BearingDegrees"),
            "h_acc_m": positive(reader.floats("AccuracyMeters", "Accuracy")),
            "v_acc_m": positive(reader.floats("VerticalAccuracyMeters")),
            "s_acc_mps": positive(reader.floats("SpeedAccuracyMps")),
        }
        placed = ~np.isnan(fields["lat_deg"] + fields["lon_deg"])
        yield from reader.rejects(reader.bad, NOT_A_NUMBER)
        yield from reader.rejects(~placed & ~reader.bad, NO_POSITION)
        left = placed & ~reader.bad
        for word, name in _PROVIDERS.items():
            selected = left & (provider == word)
            left &= ~selected
            if not selected.any():
                continue
            if self._options.source and self._options.source.upper() not in (word.decode(), name):
                yield from reader.rejects(selected, "fixes of another provider: not asked for")
                continue
            is_gps = name == "GPS"
            time_ns, timed = self._axis.times(reader.offset, elapsed, claimed, shift=is_gps)
            yield from reader.rejects(selected & ~timed, NO_TIME)
            whole = {**fields, **_claimed_time(claimed)} if is_gps else fields
            rows = reader.batch("gnss/pvt", time_ns, whole, selected & timed)
            if not self._by_sensors:
                self._timed.append(_Timed(rows.offset, rows.time_ns, rows.time_ns))
            yield from self._fix_topic(name).push(rows)
        yield from reader.rejects(left, "a fix of a provider that is not known")

    def _fix_topic(self, name: str) -> MergedTopic:
        key = ("gnss", name)
        if key not in self._topics:
            others = sum(family == "gnss" and which != "GPS" for family, which in self._topics)
            source = "gnss0" if name == "GPS" else f"gnss{others + 1}"
            self._topics[key] = MergedTopic(source, "gnss/pvt", window_s=_BATCHING_S)
            self._about[source] = {
                "topic": f"Fix,{name}",
                "accuracy_basis": "68 % confidence",
                **_SOLUTIONS[name],
            }
        return self._topics[key]


class _Timed(NamedTuple):
    """Where rows lie in the log, their times, and the times that they log; int64 ``(n,)`` each."""

    offset: NDArray[np.int64]
    time_ns: NDArray[np.int64]
    logged_ns: NDArray[np.int64]


def _joined(parts: Sequence[_Timed]) -> _Timed:
    """Return rows in the order of the log."""
    none = np.empty(0, np.int64)
    offset, time_ns, logged_ns = (
        (np.concatenate([none, *column]) for column in zip(*parts, strict=True))
        if parts
        else (none, none, none)
    )
    order = np.argsort(offset, kind="stable")
    return _Timed(offset[order], time_ns[order], logged_ns[order])


_KINDS = {"ins": "ins/pva"}
_ABOUT = {
    "imu": {"device_axes": DEVICE_AXES},
    "mag": {"device_axes": DEVICE_AXES},
    "ins": {
        "topic": "OrientationDeg",
        "body": BODY,
        "yaw_basis": "absent: the log's is from magnetic north",
        "solution_basis": "Android's rotation vector, of inertial sensors and magnetometer",
    },
}


def _claimed_time(claimed: Stamps) -> Fields:
    """Return GPS week and time of week of the Unix time that the receiver claims."""
    gps_ns = utc_to_gps(claimed[0])
    known = claimed[1] & (gps_ns > 0)
    week, tow = android.week_and_tow(np.where(known, gps_ns, 0))
    return {"gps_week": Column(week, known), "tow_s": np.where(known, tow, np.nan)}
