"""Sensor Logger (Kelvin Choi): a folder or zip archive of one CSV table per sensor.

Sources: ``UNITS.md``, ``COORDINATES.md``, ``CROSSPLATFORM.md`` and ``FUSEDLOCATION.md`` of
tszheichoi/awesome-sensor-logger. On iOS accelerations are Core Motion's, -1 g on the axis that
points up at rest, and uncalibrated ones in g, unless the recording was made with standardised units
and frames.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from spoofbench.conversion import Item, RowBatch, SourceMetadata
from spoofbench.errors import ConversionError
from spoofbench.table import Column
from spoofbench_converters.phone.contract import (
    AXES,
    BODY,
    DEVICE_AXES,
    NO_TIME,
    OLDER,
    STANDARD_GRAVITY_MPS2,
    Options,
    known,
    positive,
)
from spoofbench_converters.phone.files import (
    HeaderSchema,
    PhoneFile,
    read_columns,
    records,
    used_whole,
)
from spoofbench_converters.phone.merging import MergedTopic, merge
from spoofbench_converters.text.columns import NOT_A_NUMBER, ColumnReader, Fields

_OLDEST_FIX_S = -1.0  # before the start of the recording: an older one was cached


@dataclass(frozen=True, slots=True)
class Phone:
    """What decides units and signs: ``ios`` or ``android``, empty where unknown, and whether they
    are standardised.
    """

    platform: str = ""
    standardised: bool = False
    basis: str = "Metadata.csv"

    @property
    def is_core_motion(self) -> bool:
        """Whether accelerations have Core Motion's sign."""
        return self.platform == "ios" and not self.standardised


class SensorTable(NamedTuple):
    """A file: the kind of source it belongs to, which one, and how its rows are read."""

    family: str
    which: str
    read: Callable[[ColumnReader, Phone], Fields]


def _vector(
    field: str, *, is_acceleration: bool = False, in_g_on_ios: bool = False
) -> Callable[[ColumnReader, Phone], Fields]:
    def read(reader: ColumnReader, phone: Phone) -> Fields:
        scale = -1.0 if is_acceleration and phone.is_core_motion else 1.0
        scale *= STANDARD_GRAVITY_MPS2 if in_g_on_ios and phone.is_core_motion else 1.0
        return {field.format(axis): scale * reader.floats(axis) for axis in AXES}

    return read


def _location(reader: ColumnReader, phone: Phone) -> Fields:
    del phone
    return {
        "lat_deg": reader.floats("latitude"),
        "lon_deg": reader.floats("longitude"),
        "height_m": reader.floats("altitude"),
        "height_msl_m": reader.floats("altitudeAboveMeanSeaLevel"),
        "speed_mps": known(reader.floats("speed")),
        "course_deg": known(reader.floats("bearing")),
        "h_acc_m": positive(reader.floats("horizontalAccuracy")),
        "v_acc_m": positive(reader.floats("verticalAccuracy")),
        "s_acc_mps": positive(reader.floats("speedAccuracy")),
    }


def _barometer(reader: ColumnReader, phone: Phone) -> Fields:
    del phone
    return {"pressure_pa": reader.floats("pressure") * 100}


def _orientation(reader: ColumnReader, phone: Phone) -> Fields:
    nose_up = 1.0 if phone.is_core_motion else -1.0
    return {
        "roll_deg": np.degrees(reader.floats("roll")),
        "pitch_deg": nose_up * np.degrees(reader.floats("pitch")),
    }


_SENSORS: Mapping[str, SensorTable] = {
    "Accelerometer": SensorTable(
        "imu", "calibrated", _vector("linear_accel_{}_mps2", is_acceleration=True)
    ),
    "Gravity": SensorTable("imu", "calibrated", _vector("gravity_{}", is_acceleration=True)),
    "TotalAcceleration": SensorTable(
        "imu", "calibrated", _vector("accel_{}_mps2", is_acceleration=True)
    ),
    "Gyroscope": SensorTable("imu", "calibrated", _vector("gyro_{}_radps")),
    "AccelerometerUncalibrated": SensorTable(
        "imu", "uncalibrated", _vector("accel_{}_mps2", is_acceleration=True, in_g_on_ios=True)
    ),
    "GyroscopeUncalibrated": SensorTable("imu", "uncalibrated", _vector("gyro_{}_radps")),
    "Magnetometer": SensorTable("mag", "calibrated", _vector("field_{}_ut")),
    "MagnetometerUncalibrated": SensorTable("mag", "uncalibrated", _vector("field_{}_ut")),
    "Barometer": SensorTable("baro", "", _barometer),
    "LocationGps": SensorTable("gnss", "GPS", _location),
    "Location": SensorTable("gnss", "FLP", _location),
    "LocationNetwork": SensorTable("gnss", "NLP", _location),
    "Orientation": SensorTable("ins", "", _orientation),
}
_KINDS = {"imu": "imu", "mag": "mag", "baro": "baro", "gnss": "gnss/pvt", "ins": "ins/pva"}
_SIGNED = (
    "Accelerometer",
    "Gravity",
    "TotalAcceleration",
    "AccelerometerUncalibrated",
    "Orientation",
)


def sniff(parts: Sequence[PhoneFile]) -> float:
    """Return 1 for files of the app, 0 for others."""
    return float(
        any(_is_table(part) and (not part.name or part.stem in _SENSORS) for part in parts)
    )


def convert(parts: Sequence[PhoneFile], options: Options) -> Iterator[Item]:
    """Yield what a recording holds.

    Raises:
        ConversionError: there is more than one recording, or one table alone that does not say of
            which sensor it is.
    """
    found = tables(parts)
    metadata = next(
        (part for part in parts if part.stem.lower() == "metadata" and b"device name" in part.head),
        None,
    )
    phone, device = _phone(found, metadata), _device(metadata)
    recording = {"clock": "sensor", **({"session_id": options.session} if options.session else {})}
    yield SourceMetadata({"recording": recording})
    for source, names in _sources(found).items():
        sensor = _SENSORS[names[0]]
        yield SourceMetadata({f"source/{source}": {**device, **_about(sensor, names, phone)}})
        if options.source and sensor.family == "gnss" and options.source.upper() != sensor.which:
            yield from (
                found[name].rejected("fixes of another provider: not asked for") for name in names
            )
            continue
        derive = _with_gravity if sensor.family == "imu" else None
        kind = _KINDS[sensor.family]
        topic = MergedTopic(source, kind, inputs=names, joins=True, derive=derive)
        yield from merge(topic, {name: _rows(name, found[name], phone) for name in names})
    for part in parts:
        if part is metadata:
            yield used_whole(part)
        elif part not in found.values():
            yield part.rejected()


def _is_table(part: PhoneFile) -> bool:
    return {"time", "seconds_elapsed"} <= set(HeaderSchema.of(part.head).names)


def tables(parts: Sequence[PhoneFile]) -> dict[str, PhoneFile]:
    """Return the tables that are understood, by sensor.

    Raises:
        ConversionError: there are two of one sensor, or one table alone that does not say of which
            it is.
    """
    found: dict[str, PhoneFile] = {}
    for part in parts:
        name = part.stem if part.name else _sensor_of(part)
        if name not in _SENSORS or not _is_table(part):
            continue
        if name in found:
            raise ConversionError(
                f"there are two tables {name!r}, {found[name].name!r} and {part.name!r}; convert "
                "one recording at a time"
            )
        found[name] = part
    if "Gravity" in found and ("Accelerometer" not in found or "TotalAcceleration" in found):
        del found["Gravity"]
    return found


def _sensor_of(part: PhoneFile) -> str:
    """Return the sensor of a table that stands alone, by its columns."""
    names = set(HeaderSchema.of(part.head).names)
    for column, sensor in (("latitude", "Location"), ("pressure", "Barometer")):
        if column in names:
            return sensor
    raise ConversionError(
        f"a table of {sorted(names)} does not say of which sensor it is; convert the recording's "
        "folder or zip archive"
    )


def _sources(tables: Mapping[str, PhoneFile]) -> dict[str, tuple[str, ...]]:
    """Return the sensors of each source, by its name."""
    groups: dict[tuple[str, str], list[str]] = {}
    for name, sensor in _SENSORS.items():
        if name in tables:
            groups.setdefault((sensor.family, sensor.which), []).append(name)
    numbers: dict[str, int] = {}
    sources = {}
    for (family, _), names in groups.items():
        sources[f"{family}{numbers.setdefault(family, 0)}"] = tuple(names)
        numbers[family] += 1
    return sources


def _phone(tables: Mapping[str, PhoneFile], metadata: PhoneFile | None) -> Phone:
    rows = records(metadata, 1) if metadata else []
    if rows and rows[0].get("platform", "").lower() in ("ios", "android"):
        return Phone(
            rows[0]["platform"].lower(), rows[0].get("standardisation", "").lower() == "true"
        )
    if {"TotalAcceleration", "LocationGps", "LocationNetwork"} & set(tables):
        return Phone("android", basis="tables that only Android has")
    if (
        "Location" in tables
        and "altitudeAboveMeanSeaLevel" in HeaderSchema.of(tables["Location"].head).names
    ):
        return Phone("ios", basis="a column that only iOS has")
    return Phone()


def _device(metadata: PhoneFile | None) -> dict[str, str]:
    row = next(iter(records(metadata, 1) if metadata else []), {})
    device = {
        "device": row.get("device name", ""),
        "app": f"Sensor Logger {row['appVersion']}" if row.get("appVersion") else "Sensor Logger",
    }
    return {name: text for name, text in device.items() if text}


def _about(sensor: SensorTable, names: Sequence[str], phone: Phone) -> dict[str, str]:
    about = {"topic": " ".join(names)}
    if sensor.family in ("imu", "mag"):
        about["device_axes"] = DEVICE_AXES
    if sensor.family == "imu":
        sign = (
            "Core Motion's sign turned, uncalibrated g into m/s2"
            if phone.is_core_motion
            else "as logged"
        )
        about["accel_basis"] = f"{phone.platform or 'unknown'} by {phone.basis}: {sign}"
        if "Gravity" in names:
            about["accel_basis"] += (
                "; specific force is the sum of gravity and the acceleration without it"
            )
    elif sensor.family == "gnss":
        about |= _provider(sensor, phone)
    elif sensor.family == "ins":
        about |= {
            "body": BODY,
            "yaw_basis": "absent: from which north it counts differs by phone",
            "solution_basis": "attitude of inertial sensors and magnetometer",
        }
    return about


def _provider(sensor: SensorTable, phone: Phone) -> dict[str, str]:
    if sensor.which == "GPS":
        return {"solution": "gnss", "solution_basis": "Android's GPS provider"}
    if phone.platform == "ios":
        return {"solution_basis": "Core Location, which does not say what it fuses"}
    return {
        "solution": "fused",
        "solution_basis": "fused location"
        if sensor.which == "FLP"
        else "network location, no satellites",
    }


def _rows(name: str, part: PhoneFile, phone: Phone) -> Iterator[RowBatch | Item]:
    sensor = _SENSORS[name]
    for reader in read_columns(part, HeaderSchema.of(part.head)):
        if not isinstance(reader, ColumnReader):
            yield reader
            continue
        fields = sensor.read(reader, phone)
        time_ns, timed = reader.exact(("time",))
        before_s = reader.floats("seconds_elapsed")
        if sensor.family == "imu":
            fields = {**fields, "interval_s": np.zeros(len(reader))}
        refusals = [(reader.bad, NOT_A_NUMBER), (~timed | (time_ns <= 0), NO_TIME)]
        if sensor.family == "gnss":
            refusals.append((before_s < _OLDEST_FIX_S, OLDER))
        if name in _SIGNED and not phone.platform:
            reason = "nothing says whether the phone is iOS or Android, so the sign is unknown"
            refusals.append((np.ones(len(reader), bool), reason))
        kept = np.ones(len(reader), bool)
        for refused, reason in refusals:
            yield from reader.rejects(refused & kept, reason)
            kept &= ~refused
        yield reader.batch(_KINDS[sensor.family], time_ns, fields, kept)


def _with_gravity(rows: RowBatch) -> RowBatch:
    """Add gravity to the accelerations without it where the specific force is not logged."""
    columns = dict(rows.columns)
    for axis in AXES:
        parts = [columns.get(name.format(axis)) for name in ("gravity_{}", "linear_accel_{}_mps2")]
        if parts[0] is not None and parts[1] is not None:
            logged = columns.get(f"accel_{axis}_mps2")
            total = parts[0].values + parts[1].values
            if logged is not None:
                total = np.where(np.isnan(logged.values), total, logged.values)
            columns[f"accel_{axis}_mps2"] = Column(total)
    return replace(rows, columns=columns)
