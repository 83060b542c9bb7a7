"""SensorLog (Bernd Thomas, iOS): one wide CSV table, a row per tick, a cell where a sensor had
something new.

Each sensor's columns have a time stamp of their own, since boot or since 1970; newer versions of
the app repeat a sensor's last values until it has new ones, and write units behind the columns'
names. Accelerations are Core Motion's: in g, -1 g on the axis that points up at rest (Apple,
``CMAccelerometerData`` and ``CMDeviceMotion``).
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spoofbench.conversion import Item, Reject, RowBatch, SourceMetadata
from spoofbench.errors import ConversionError
from spoofbench_converters.phone import contract
from spoofbench_converters.phone.contract import AXES, STANDARD_GRAVITY_MPS2, Options, known
from spoofbench_converters.phone.files import (
    ANOTHER,
    HeaderSchema,
    PhoneFile,
    only,
    read_columns,
    text_parts,
)
from spoofbench_converters.phone.merging import REPEATED, MergedTopic, in_file_order
from spoofbench_converters.text.columns import NOT_A_NUMBER, ColumnReader
from spoofbench_converters.text.numbers import unix_ns

_SURVEY_ROWS = 100
_OLDEST_FIX_NS = 2_000_000_000
_QUARTER_HOUR_S = 900
_LOGGED = "loggingTime"

_Floats = Mapping[str, NDArray[np.float64]]


class SensorColumns(NamedTuple):
    """A group of columns: its stamp, the kind of its source, which one, and how they are
    read.
    """

    stamp: str
    family: str
    which: str
    read: Callable[[ColumnReader], _Floats]


def _vector(field: str, column: str, scale: float = 1.0) -> Callable[[ColumnReader], _Floats]:
    return lambda reader: {
        field.format(axis): scale * reader.floats(column.format(axis.upper())) for axis in AXES
    }


def _motion(reader: ColumnReader) -> _Floats:
    linear = _vector("linear_accel_{}_mps2", "motionUserAcceleration{}", -STANDARD_GRAVITY_MPS2)(
        reader
    )
    gravity = _vector("{}", "motionGravity{}", -STANDARD_GRAVITY_MPS2)(reader)
    total = {
        f"accel_{axis}_mps2": linear[f"linear_accel_{axis}_mps2"] + gravity[axis] for axis in AXES
    }
    return {**total, **linear, **_vector("gyro_{}_radps", "motionRotationRate{}")(reader)}


def _calibrated_field(reader: ColumnReader) -> _Floats:
    """The field is zero where its calibration is -1: none."""
    uncalibrated = reader.floats("motionMagneticFieldCalibrationAccuracy") < 0
    fields = _vector("field_{}_ut", "motionMagneticField{}")(reader)
    return {name: np.where(uncalibrated, np.nan, values) for name, values in fields.items()}


def _location(reader: ColumnReader) -> _Floats:
    valid = ~(reader.floats("locationHorizontalAccuracy") < 0)
    return {
        "lat_deg": np.where(valid, reader.floats("locationLatitude"), np.nan),
        "lon_deg": np.where(valid, reader.floats("locationLongitude"), np.nan),
        "height_msl_m": np.where(
            reader.floats("locationVerticalAccuracy") < 0, np.nan, reader.floats("locationAltitude")
        ),
        "speed_mps": known(reader.floats("locationSpeed")),
        "course_deg": known(reader.floats("locationCourse")),
        "h_acc_m": known(reader.floats("locationHorizontalAccuracy")),
        "v_acc_m": known(reader.floats("locationVerticalAccuracy")),
        "s_acc_mps": known(reader.floats("locationSpeedAccuracy")),
    }


def _pressure(reader: ColumnReader) -> _Floats:
    return {"pressure_pa": 1000 * reader.floats("altimeterPressure")}


def _attitude(reader: ColumnReader) -> _Floats:
    return {
        "roll_deg": np.degrees(reader.floats("motionRoll")),
        "pitch_deg": np.degrees(reader.floats("motionPitch")),
    }


_BOOT, _UNIX = "Timestamp_sinceReboot", "Timestamp_since1970"
_SENSORS = (
    SensorColumns(
        f"accelerometer{_BOOT}",
        "imu",
        "raw",
        _vector("accel_{}_mps2", "accelerometerAcceleration{}", -STANDARD_GRAVITY_MPS2),
    ),
    SensorColumns(f"gyro{_BOOT}", "imu", "raw", _vector("gyro_{}_radps", "gyroRotation{}")),
    SensorColumns(
        f"motion{_BOOT}",
        "imu",
        "device motion",
        _motion,
    ),
    SensorColumns(f"location{_UNIX}", "gnss", "", _location),
    SensorColumns(
        f"magnetometer{_BOOT}",
        "mag",
        "magnetometer, uncalibrated",
        _vector("field_{}_ut", "magnetometer{}"),
    ),
    SensorColumns(f"motion{_BOOT}", "mag", "device motion, calibrated", _calibrated_field),
    SensorColumns(
        f"locationHeading{_UNIX}",
        "mag",
        "heading",
        _vector("field_{}_ut", "locationHeading{}"),
    ),
    SensorColumns(f"altimeter{_BOOT}", "baro", "", _pressure),
    SensorColumns(f"motion{_BOOT}", "ins", "", _attitude),
)
_KINDS = {"imu": "imu", "mag": "mag", "baro": "baro", "gnss": "gnss/pvt", "ins": "ins/pva"}
_ABOUT = {
    "imu": {
        "device_axes": contract.DEVICE_AXES,
        "accel_basis": "Core Motion's sign turned, g into m/s2",
    },
    "mag": {"device_axes": contract.DEVICE_AXES},
    "gnss": {"solution_basis": "Core Location, which does not say what it fuses"},
    "ins": {
        "body": contract.BODY,
        "yaw_basis": "absent: its zero depends on the reference frame",
        "solution_basis": "attitude of inertial sensors and magnetometer",
    },
}


def normal(name: str) -> str:
    """Return a column's name without its unit."""
    return re.sub(r"\s*\([^)]*\)$", "", name)


def sniff(parts: Sequence[PhoneFile]) -> float:
    """Return 1 where a file has the app's columns, else 0."""
    return float(any(_is_table(part) for part in parts))


def _is_table(part: PhoneFile) -> bool:
    index = HeaderSchema.of(part.head).index(normal)
    return _LOGGED in index and any(sensor.stamp in index for sensor in _SENSORS)


def convert(parts: Sequence[PhoneFile], options: Options) -> Iterator[Item]:
    """Yield what a log holds, the one file of it that is one.

    Raises:
        ConversionError: there are several; or its rows have no clock.
    """
    part = only([part for part in text_parts(parts) if _is_table(part)], "logs")
    assert part is not None
    schema = HeaderSchema.of(part.head)
    clock = _survey(part, schema)
    log = _SensorLogConversion(schema, clock)
    for item in read_columns(part, schema, normal):
        if isinstance(item, ColumnReader):
            yield from log.take(item)
        else:
            yield item
    yield from log.finish()
    session = {"session_id": options.session} if options.session else {}
    yield SourceMetadata(
        {
            "recording": {
                "clock": "sensor",
                "clock_basis": clock.basis,
                "boot_unix_ns": str(clock.offset_ns),
                **session,
            }
        }
    )
    yield from (other.rejected(ANOTHER) for other in parts if other is not part)


class BootClock(NamedTuple):
    """Unix time minus time since boot, when the log begins, and how both are known."""

    offset_ns: int
    start_ns: int
    basis: str


def _survey(part: PhoneFile, schema: HeaderSchema) -> BootClock:
    """Lay the time since boot on Unix time by the first rows' logging time; its zone, where it
    names none, by a stamp since 1970.
    """
    first = next(
        (
            reader
            for reader in read_columns(part, schema, normal)
            if isinstance(reader, ColumnReader)
        ),
        None,
    )
    if first is None:
        raise ConversionError("the log has no rows")
    head = first.take(slice(0, _SURVEY_ROWS))
    texts = [text.decode("ascii", "replace") for text in head.texts(_LOGGED).tolist()]
    logged = [_read_time(text) for text in texts]
    stamps = [head.exact((sensor.stamp,), 9) for sensor in _SENSORS if sensor.stamp.endswith(_UNIX)]
    absolute = [int(time) for times, present in stamps for time in times[present & (times > 0)]]
    known_rows = [row for row, time in enumerate(logged) if time is not None]
    if not known_rows:
        raise ConversionError(
            f"none of the first rows has a {_LOGGED} that can be read, such as {texts[0]!r}"
        )
    start = next(time for time in logged if time is not None)
    zone, basis = timedelta(0), "its own zone"
    if start.tzinfo is None:
        zone, basis = timedelta(0), "taken as UTC, for no stamp tells its zone"
        if absolute:
            ahead_s = start.replace(tzinfo=UTC).timestamp() - max(absolute) / 1e9
            zone, basis = (
                timedelta(seconds=_QUARTER_HOUR_S * round(ahead_s / _QUARTER_HOUR_S)),
                "its zone from the stamps since 1970",
            )
    unix = {
        row: unix_ns(time if time.tzinfo else time - zone)
        for row in known_rows
        if (time := logged[row]) is not None
    }
    offsets: list[int] = []
    for sensor in _SENSORS:
        if sensor.stamp.endswith(_BOOT) and not offsets:
            times, present = head.exact((sensor.stamp,), 9)
            fresh = present & (times > 0) & np.concatenate([[True], times[1:] != times[:-1]])
            offsets = [
                unix[row] - int(times[row]) for row in np.flatnonzero(fresh).tolist() if row in unix
            ]
    offset = int(np.sort(offsets)[(len(offsets) - 1) // 2]) if offsets else 0
    return BootClock(
        offset,
        min(unix.values()),
        f"median of the first rows' {_LOGGED} ({basis}) minus time since boot",
    )


def _read_time(text: str) -> datetime | None:
    try:
        return datetime.fromisoformat(re.sub(r"\s+([+-]\d\d:?\d\d)$", r"\1", text.strip()))
    except ValueError:
        return None


class _SensorLogConversion:
    """A table being converted."""

    def __init__(self, schema: HeaderSchema, clock: BootClock) -> None:
        self._clock = clock
        index = schema.index(normal)
        self._sensors = [sensor for sensor in _SENSORS if sensor.stamp in index]
        self._last: dict[int, int] = {}
        self._topics: dict[tuple[str, str], MergedTopic] = {}
        self._sources: dict[tuple[str, str], str] = {}

    def take(self, reader: ColumnReader) -> Iterator[Item]:
        """Yield what a piece holds: of each sensor the rows in which its stamp is another than
        before.
        """
        owned = np.zeros(len(reader), bool)
        pushes: dict[tuple[str, str], list[RowBatch]] = {}
        read = [
            (sensor, *self._new(number, sensor, reader), sensor.read(reader))
            for number, sensor in enumerate(self._sensors)
        ]
        bad = reader.bad
        yield from reader.rejects(bad, NOT_A_NUMBER)
        for sensor, time_ns, new, fields in read:
            new = new & ~bad & ~np.all([np.isnan(values) for values in fields.values()], axis=0)
            if sensor.stamp.endswith(_UNIX):
                older = new & (time_ns < self._clock.start_ns - _OLDEST_FIX_NS)
                yield from (Reject(at, 0, contract.OLDER) for at in reader.offset[older].tolist())
                new &= ~older
            if new.any():
                if sensor.family == "imu":
                    fields = {**fields, "interval_s": np.zeros(len(reader))}
                rows = reader.batch(_KINDS[sensor.family], time_ns, fields, new)
                rows = replace(rows, units=np.where(owned[new], 0, rows.units))
                pushes.setdefault((sensor.family, sensor.which), []).append(rows)
            owned |= new
        yield from reader.rejects(~owned & ~bad, REPEATED)
        for key, batches in pushes.items():
            yield from self._topic(*key).push(in_file_order(batches))

    def finish(self) -> Iterator[Item]:
        """Yield what is held, and the sources."""
        for topic in self._topics.values():
            yield from topic.finish()
        for (family, which), name in self._sources.items():
            about = {**({"topic": which} if which else {}), **_ABOUT.get(family, {})}
            yield SourceMetadata({f"source/{name}": {"app": "SensorLog", **about}})

    def _new(
        self, number: int, sensor: SensorColumns, reader: ColumnReader
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Return a sensor's times, and which rows have one that is not that of the row before."""
        stamps, present = reader.exact((sensor.stamp,), 9)
        present &= stamps > 0
        rows = np.flatnonzero(present)
        before = np.append(self._last.get(number, 0), stamps[rows][:-1])
        new = np.zeros(len(reader), bool)
        new[rows] = stamps[rows] != before[: rows.size]
        if rows.size:
            self._last[number] = int(stamps[rows[-1]])
        return stamps + (self._clock.offset_ns if sensor.stamp.endswith(_BOOT) else 0), new

    def _topic(self, family: str, which: str) -> MergedTopic:
        key = (family, which)
        if key not in self._topics:
            self._sources[key] = f"{family}{sum(other == family for other, _ in self._sources)}"
            self._topics[key] = MergedTopic(self._sources[key], _KINDS[family], joins=True)
        return self._topics[key]
