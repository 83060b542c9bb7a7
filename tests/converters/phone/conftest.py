"""Small logs of every phone app, made here: a drive around a circle, known at every time."""

import math
import zipfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest

SHARED = Path(__file__).parents[4] / "shared" / "data" / "phone_bag"
START_NS = 1_700_000_000_123_456_789
BOOT_NS = START_NS - 5_000_000_000_001
DURATION_S = 70
RATE_HZ = 20
SPEED_MPS, RATE_RADPS = 12.0, 0.1
GRAVITY_MPS2 = 9.80665

RAW_HEADER = (
    "Raw,utcTimeMillis,TimeNanos,LeapSecond,TimeUncertaintyNanos,FullBiasNanos,BiasNanos,BiasUncertaintyNanos,DriftNanosPerSecond,"
    "DriftUncertaintyNanosPerSecond,"
    "HardwareClockDiscontinuityCount,Svid,TimeOffsetNanos,State,ReceivedSvTimeNanos,"
    "ReceivedSvTimeUncertaintyNanos,"
    "Cn0DbHz,PseudorangeRateMetersPerSecond,PseudorangeRateUncertaintyMetersPerSecond,"
    "AccumulatedDeltaRangeState,"
    "AccumulatedDeltaRangeMeters,"
    "AccumulatedDeltaRangeUncertaintyMeters,CarrierFrequencyHz,CarrierCycles,"
    "CarrierPhase,CarrierPhaseUncertainty,MultipathIndicator,SnrInDb,ConstellationType,AgcDb,BasebandCn0DbHz,FullInterSignalBiasNanos,"
    "FullInterSignalBiasUncertaintyNanos,"
    "SatelliteInterSignalBiasNanos,SatelliteInterSignalBiasUncertaintyNanos,CodeType,"
    "ChipsetElapsedRealtimeNanos"
)
GNSSLOGGER_HEADER = f"""\
# Header Description:
#\x20
# Version: v3.1.0.0 Platform: 14 Manufacturer: Acme Model: Phone One
#\x20
# {RAW_HEADER}
#\x20
# UncalAccel,utcTimeMillis,elapsedRealtimeNanos,UncalAccelXMps2,UncalAccelYMps2,UncalAccelZMps2,\
BiasXMps2,BiasYMps2,BiasZMps2
#\x20
# UncalGyro,utcTimeMillis,elapsedRealtimeNanos,UncalGyroXRadPerSec,UncalGyroYRadPerSec,\
UncalGyroZRadPerSec,DriftXRadPerSec,\
DriftYRadPerSec,DriftZRadPerSec
#\x20
# UncalMag,utcTimeMillis,elapsedRealtimeNanos,UncalMagXMicroT,UncalMagYMicroT,UncalMagZMicroT,\
BiasXMicroT,BiasYMicroT,BiasZMicroT
#\x20
# OrientationDeg,utcTimeMillis,elapsedRealtimeNanos,yawDeg,rollDeg,pitchDeg
#\x20
# Fix,Provider,LatitudeDegrees,LongitudeDegrees,AltitudeMeters,SpeedMps,AccuracyMeters,\
BearingDegrees,UnixTimeMillis,SpeedAccuracyMps,\
BearingAccuracyDegrees,elapsedRealtimeNanos,VerticalAccuracyMeters,MockLocation
#\x20
# Nav,Svid,Type,Status,MessageId,Sub-messageId,Data(Bytes)
#\x20
# Status,UnixTimeMillis,SignalCount,SignalIndex,ConstellationType,Svid,CarrierFrequencyHz,Cn0DbHz,\
AzimuthDegrees,ElevationDegrees,\
UsedInFix,HasAlmanacData,HasEphemerisData,BasebandCn0DbHz
#\x20
# Agc,utcTimeMillis,TimeNanos,LeapSecond,TimeUncertaintyNanos,FullBiasNanos,BiasNanos,\
BiasUncertaintyNanos,DriftNanosPerSecond,\
DriftUncertaintyNanosPerSecond,HardwareClockDiscontinuityCount,AgcDb,CarrierFrequencyHz,ConstellationType
#\x20
"""


class Motion:
    """Where the phone is and what its sensors feel, seconds after the start: screen up, its top
    forward, turning left.
    """

    @staticmethod
    def position(time_s: float) -> tuple[float, float]:
        """Latitude and longitude in degrees."""
        radius, angle = SPEED_MPS / RATE_RADPS, RATE_RADPS * time_s
        return 50.0 + radius * math.sin(angle) / 111_111, 8.0 + radius * (
            math.cos(angle) - 1
        ) / 71_000

    @staticmethod
    def course(time_s: float) -> float:
        """Course in degrees, clockwise from north."""
        return -math.degrees(RATE_RADPS * time_s) % 360

    @staticmethod
    def force(time_s: float) -> tuple[float, float, float]:
        """Specific force in m/s2: right, forward, up."""
        return -SPEED_MPS * RATE_RADPS, 0.01 * math.sin(time_s), GRAVITY_MPS2

    @staticmethod
    def rate(time_s: float) -> tuple[float, float, float]:
        """Angular rate in rad/s about right, forward, up."""
        return 0.001 * math.cos(time_s), 0.0, RATE_RADPS


def ticks(
    rate_hz: int, delay_ns: int = 0, duration_s: int = DURATION_S
) -> Iterator[tuple[float, int]]:
    """Yield seconds and Unix nanoseconds."""
    for tick in range(duration_s * rate_hz):
        nanoseconds = tick * 1_000_000_000 // rate_hz + delay_ns
        yield nanoseconds / 1e9, START_NS + nanoseconds


def row(*cells: object) -> str:
    """Return a CSV line."""
    return ",".join(repr(cell) if isinstance(cell, float) else str(cell) for cell in cells) + "\n"


def gnsslogger_lines(
    gnss_behind_ns: int = 980_000_000, duration_s: int = DURATION_S
) -> Iterator[tuple[int, str]]:
    """Yield ``(time_ns, line)`` of a log whose GNSS time is behind the phone's clock."""
    for time_s, unix in ticks(RATE_HZ, 0, duration_s):
        elapsed, milli = unix - BOOT_NS, unix // 1_000_000
        yield unix, row("UncalAccel", milli, elapsed, *Motion.force(time_s), 0.01, 0.02, 0.03)
        yield unix + 1, row("OrientationDeg", milli, elapsed, 12.0, 2.0, -16.0)
    for time_s, unix in ticks(RATE_HZ, 7_000_001, duration_s):
        elapsed, milli = unix - BOOT_NS, unix // 1_000_000
        yield unix, row("UncalGyro", milli, elapsed, *Motion.rate(time_s), 0.0, 0.0, 0.0)
        yield unix + 1, row("UncalMag", milli, elapsed, 20.0, 1.0, -40.0, 0.0, 0.0, 0.0)
    for time_s, unix in ticks(1, 0, duration_s):
        yield from _gnss_lines(time_s, unix, gnss_behind_ns)


def _gnss_lines(time_s: float, unix: int, behind_ns: int) -> Iterator[tuple[int, str]]:
    elapsed, claimed = unix - BOOT_NS, (unix - behind_ns) // 1_000_000
    lat, lon = Motion.position(time_s)
    late = unix + 300_000_000
    bearing = "" if time_s == 3 else Motion.course(time_s)
    yield (
        late,
        row(
            "Fix",
            "GPS",
            lat,
            lon,
            105.5,
            SPEED_MPS,
            3.5,
            bearing,
            claimed,
            0.2,
            1.5,
            elapsed,
            2.5,
            0,
        ),
    )
    yield (
        late + 1,
        row(
            "Fix",
            "FLP",
            lat,
            lon,
            105.5,
            SPEED_MPS,
            4.5,
            Motion.course(time_s),
            unix // 1_000_000,
            "",
            "",
            elapsed + 5,
            2.5,
            0,
        ),
    )
    if time_s % 10 == 0:
        yield (
            late + 2,
            row(
                "Fix",
                "NLP",
                lat + 0.001,
                lon,
                105.5,
                "",
                45.0,
                "",
                unix // 1_000_000,
                "",
                "",
                elapsed + 9,
                9.5,
                0,
            ),
        )
        yield late + 3, row("Nav", 3, 257, 1, -1, 2, *(octet - 128 for octet in range(40)))
    nanos = round(time_s) * 1_000_000_000 + 77
    bias = nanos - (claimed * 1_000_000 - 315_964_800_000_000_000 + 18_000_000_000)
    clock = (nanos, 18, "", bias, 0.25, 8.0, 300.5, 1.5, 3)
    for index, (svid, constellation, hertz, code) in enumerate(
        ((5, 1, 1575420030.0, "C"), (25, 6, 1176450050.0, "Q"))
    ):
        flight = 70_000_000 + 1000 * round(time_s) + index
        sent = (nanos - bias - flight) % (7 * 86_400_000_000_000)
        measured = (
            svid,
            0.0,
            16431,
            sent,
            20,
            41.5,
            -123.25,
            0.15,
            1,
            -500.0 - time_s,
            0.01,
            hertz,
            "",
            "",
            "",
            0,
            "",
            constellation,
            "",
        )
        yield (
            late + 4,
            row("Raw", claimed, *clock, *measured, 37.0, 0.0, 0.0, 0.0, 0.0, code, elapsed),
        )
        yield (
            late + 6,
            row(
                "Status",
                claimed - 1000,
                2,
                index,
                constellation,
                svid,
                hertz,
                41.5,
                120.0,
                45.0,
                1,
                1,
                1,
                37.0,
            ),
        )
    yield late + 5, row("Agc", claimed, *clock, 20.5, 1575420030.0, 1)


@pytest.fixture(scope="session")
def gnsslogger() -> Callable[..., bytes]:
    """Make a GnssLogger log; arguments as of :func:`gnsslogger_lines`."""

    def make(**arguments: int) -> bytes:
        lines = sorted(gnsslogger_lines(**arguments), key=lambda line: line[0])
        return (GNSSLOGGER_HEADER + "".join(line for _, line in lines)).encode()

    return make


def sensor_logger_tables(platform: str, standardised: bool = False) -> Iterator[tuple[str, str]]:
    """Yield ``(name, text)`` of a Sensor Logger recording's files; the first fix is an old one."""
    sign, unit = (-1.0, 1 / GRAVITY_MPS2) if platform == "ios" and not standardised else (1.0, 1.0)
    tables: dict[str, list[str]] = {
        name: []
        for name in (
            "Accelerometer",
            "Gravity",
            "Gyroscope",
            "AccelerometerUncalibrated",
            "Location",
        )
    }
    for time_s, unix in ticks(RATE_HZ):
        x, y, z = (sign * value for value in Motion.force(time_s))
        a, b, c = Motion.rate(time_s)
        tables["Accelerometer"].append(row(unix, time_s, z - sign * GRAVITY_MPS2, y, x))
        tables["Gravity"].append(row(unix, time_s, sign * GRAVITY_MPS2, 0.0, 0.0))
        tables["Gyroscope"].append(row(unix, time_s, c, b, a))
        tables["AccelerometerUncalibrated"].append(
            row(unix + 999, time_s, z * unit, y * unit, x * unit)
        )
    lat, lon = Motion.position(0)
    tables["Location"].append(row(START_NS - 108_000_000_000, -108.0, -1, -1, lat, 105.5, 3.5, lon))
    for time_s, unix in ticks(1):
        lat, lon = Motion.position(time_s)
        tables["Location"].append(
            row(
                unix,
                time_s,
                -1 if time_s == 3 else Motion.course(time_s),
                SPEED_MPS,
                lat,
                105.5,
                3.5,
                lon,
            )
        )
    yield (
        "Metadata.csv",
        (
            "version,device name,platform,appVersion,standardisation\n"
            f"3,Phone,{platform},1.49,{str(standardised).lower()}"
        ),
    )
    yield "Annotation.csv", 'time,seconds_elapsed,text\n1,2,"a, b\nc"\n'
    for name, rows in tables.items():
        columns = (
            "bearing,speed,latitude,altitude,horizontalAccuracy,longitude"
            if name == "Location"
            else "z,y,x"
        )
        yield f"{name}.csv", f"time,seconds_elapsed,{columns}\n" + "".join(rows)


def phyphox_tables(
    delimiter: str = ",", comma: bool = False, paused_s: float = 20.0
) -> Iterator[tuple[str, str]]:
    """Yield ``(name, text)`` of a phyphox export, paused for 1000 s."""

    def line(*values: float) -> str:
        texts = [f"{value:.9E}".replace("E+0", "E").replace("E-0", "E-") for value in values]
        return delimiter.join(text.replace(".", ",") if comma else text for text in texts) + "\n"

    def header(*names: str) -> str:
        return delimiter.join(f'"{name}"' for name in names) + "\n"

    accel, gyro, location = [], [], []
    for time_s, _ in ticks(RATE_HZ):
        accel.append(line(time_s, *Motion.force(time_s)))
        gyro.append(line(time_s, *Motion.rate(time_s)))
    for time_s, _ in ticks(1):
        lat, lon = Motion.position(time_s)
        location.append(line(time_s, lat, lon, 105.5, SPEED_MPS, Motion.course(time_s), 3.5, 2.5))
    yield (
        "Accelerometer.csv",
        header("Time (s)", *(f"Acceleration {axis} (m/s^2)" for axis in "xyz")) + "".join(accel),
    )
    yield (
        "Gyroscope.csv",
        header("Time (s)", *(f"Gyroscope {axis} (rad/s)" for axis in "xyz")) + "".join(gyro),
    )
    names = (
        "Latitude (°)",
        "Longitude (°)",
        "Height (m)",
        "Velocity (m/s)",
        "Direction (°)",
        "Horizontal Accuracy (m)",
        "Vertical Accuracy (m)",
    )
    yield "Location.csv", header("Time (s)", *names) + "".join(location)
    start = START_NS / 1e9
    events = [
        ("START", 0.0, start),
        ("PAUSE", paused_s, start + paused_s),
        ("START", paused_s, start + paused_s + 1000),
    ]
    text = header("event", "experiment time", "system time", "system time text")
    for event, experiment, system in events:
        number = (f"{experiment:.9E}", f"{system:.3f}")
        number = tuple(text.replace(".", ",") for text in number) if comma else number
        text += delimiter.join((f'"{event}"', *number, '"a text"')) + "\n"
    yield "meta/time.csv", text


def sensorlog_table(held: bool = False) -> str:
    """Return a SensorLog table: sparse as of old versions, or with units and values held as of new
    ones.
    """
    names = [
        "loggingTime",
        "locationTimestamp_since1970",
        "locationLatitude",
        "locationLongitude",
        "locationSpeed",
        "locationCourse",
    ]
    names += [
        "locationHorizontalAccuracy",
        "accelerometerTimestamp_sinceReboot",
        *(f"accelerometerAcceleration{axis}" for axis in "XYZ"),
    ]
    names += ["gyroTimestamp_sinceReboot", *(f"gyroRotation{axis}" for axis in "XYZ")]
    units = [
        "txt",
        "s",
        "WGS84",
        "WGS84",
        "m/s",
        "°",
        "m",
        "s",
        "G",
        "G",
        "G",
        "s",
        "rad/s",
        "rad/s",
        "rad/s",
    ]
    header = [f"{name}({unit})" for name, unit in zip(names, units, strict=True)] if held else names
    lines, last = [",".join(header)], [""] * 6
    for tick, (time_s, unix) in enumerate(ticks(RATE_HZ)):
        location: Sequence[str] = ["null"] * 6 if held else [""] * 6
        if tick % RATE_HZ == 0:
            lat, lon = Motion.position(time_s)
            course = -1 if time_s == 3 else Motion.course(time_s)
            location = [
                f"{unix / 1e9:.6f}",
                repr(lat),
                repr(lon),
                repr(SPEED_MPS),
                repr(course),
                "5",
            ]
            last = list(location)
        location = last if held else location
        boot = (unix - BOOT_NS) / 1e9
        accel = [f"{boot:.6f}", *(repr(-value / GRAVITY_MPS2) for value in Motion.force(time_s))]
        gyro = [f"{boot + 0.011:.6f}", *(repr(value) for value in Motion.rate(time_s))]
        lines.append(",".join([_local(unix, held), *location, *accel, *gyro]))
    return "\n".join(lines) + "\n"


def _local(unix_ns: int, zone: bool) -> str:
    from datetime import UTC, datetime, timedelta

    local = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(hours=2, microseconds=unix_ns // 1000)
    return local.strftime("%Y-%m-%d %H:%M:%S.%f")[:-3] + (" +0200" if zone else "")


def zipped(path: Path, tables: Iterator[tuple[str, str]], folder: str = "") -> Path:
    """Write a zip archive of tables."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in tables:
            archive.writestr(folder + name, text)
    return path


@pytest.fixture(scope="session")
def sensor_logger(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Make a Sensor Logger zip archive."""

    def make(platform: str = "ios", standardised: bool = False) -> Path:
        name = f"{platform}{standardised}.zip"
        return zipped(
            tmp_path_factory.mktemp("sensorlogger") / name,
            sensor_logger_tables(platform, standardised),
            "2024-01-01/",
        )

    return make


@pytest.fixture(scope="session")
def phyphox(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Make a phyphox zip archive."""

    def make(delimiter: str = ",", comma: bool = False) -> Path:
        return zipped(
            tmp_path_factory.mktemp("phyphox") / "export.zip", phyphox_tables(delimiter, comma)
        )

    return make


@pytest.fixture(scope="session")
def sensorlog() -> Callable[..., bytes]:
    """Make a SensorLog table."""
    return lambda held=False: sensorlog_table(held).encode()


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of real logs."""
    if not SHARED.is_dir():
        pytest.skip(f"the real logs are not there: {SHARED}")
    return SHARED
