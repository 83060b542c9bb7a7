"""The recordings that stand in for Borio's, whose own are not public: which logs, and what is made
of them.
"""

import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from spoofbench_correlation.correlation import Correlation
from spoofbench_correlation.series import receiver_velocity

from spoofbench import codec
from spoofbench.arrays import Floats
from spoofbench.conversion import convert
from spoofbench.demo import drive_bag
from spoofbench.detector import detect
from spoofbench.errors import NotApplicable, SpoofbenchError
from spoofbench.navigation.gnss import radii_m
from spoofbench.navigation.imu import FORCE, RATE
from spoofbench.recording import Recording
from spoofbench.table import Table

WINDOWS_S = (120, 60, 30, 10)  # the paper's first; a shorter recording has to do with a shorter one
EPOCH_S = 1.0
LAGS_S = sorted(np.round(np.arange(-1.5, 1.55, 0.1), 1).tolist(), key=abs)
"""Of lags that fit equally well, the smallest counts."""
MIN_FITTED_S = 60
"""A lag is not fitted to windows shorter than this."""
STANDARD_GRAVITY = 9.80665


@dataclass(frozen=True, slots=True)
class FieldLog:
    """A log: its files below the folder of logs (none: the drive of the demo), the table
    converter's mapping, what it is.

    Attributes:
        group: recordings that share it are of one route, driven at different times or by different
            receivers; those of Fairbanks of one car, and of one route in part.
        lag_s: how late the receiver's velocities are against the IMU, where that is known; None: it
            is fitted, or 0 for a short recording.
    """

    name: str
    files: tuple[str, ...]
    group: str
    about: str
    mapping: str | None = None
    lag_s: float | None = None


LOGS = (
    FieldLog("drive", (), "drive", "car, VN-100 at 100 Hz, ZED-F9T", lag_s=0.34),
    FieldLog(
        "rtk-drive",
        (
            "phone_bag/rtk_drive_imu_1934.csv",
            "phone_bag/rtk_drive_imu_1934.csv.tag",
            "phone_bag/rtk_drive_gnss_1934.pos",
        ),
        "rtk-drive",
        "car, MEMS IMU at 100 Hz, RTK",
        "gnss_imu_drive",
    ),
    FieldLog(
        "boston",
        ("phone_bag/boston_town_run1_imu.csv", "phone_bag/boston_town_run1_gps.csv"),
        "boston",
        "car, VN-100, GNSS puck",
    ),
    FieldLog(
        "boston-run2",
        ("phone_bag/ros1_boston_town_gps_run2.bag",),
        "boston",
        "the same route again, GNSS alone",
    ),
    FieldLog(
        "phone-car",
        ("phone_bag/phone_car_1hz_20230809.csv",),
        "phone-car",
        "phone in a car, motorway, means over 1 s",
    ),
    FieldLog(
        "iphone-2", ("phone_bag/iphone_car_trip2.csv",), "pittsburgh", "phone in a car, IMU at 5 Hz"
    ),
    FieldLog(
        "iphone-3", ("phone_bag/iphone_car_trip3.csv",), "pittsburgh", "phone in a car, IMU at 5 Hz"
    ),
    FieldLog(
        "iphone-5", ("phone_bag/iphone_car_trip5.csv",), "pittsburgh", "phone in a car, IMU at 5 Hz"
    ),
    FieldLog("zed-f9r-a", ("nmea_ubx/las_220114_0121_drive.ubx",), "fairbanks", "car, ZED-F9R"),
    FieldLog("zed-f9r-b", ("nmea_ubx/las_220110_0655_drive.ubx",), "fairbanks", "car, ZED-F9R"),
    FieldLog(
        "dresden", ("phone_bag/balzer_car_50hz_20140326.csv",), "dresden", "car, MEMS IMU at 50 Hz"
    ),
    FieldLog(
        "comma",
        ("phone_bag/comma2k19_example1_imu_gnss.zip",),
        "comma",
        "phone-grade IMU in a car, straight road, u-blox M8",
    ),
    FieldLog(
        "motorbike",
        ("phone_bag/sensorlog_motorbike_20160809.csv",),
        "motorbike",
        "phone on a motorbike, which leans",
    ),
    FieldLog("pixel-6", ("phone_bag/gl_pixel6_163232.txt",), "pitch", "phone in a runner's hand"),
    FieldLog(
        "pixel-7",
        ("phone_bag/gl_pixel7_163231.txt",),
        "pitch",
        "phone in a second runner's hand, the same seconds",
    ),
)


@dataclass(frozen=True, slots=True)
class FieldSession:
    """A recording of one IMU and one receiver at 1 Hz, the IMU's times moved by the receiver's lag.

    Attributes:
        log: where it comes from.
        recording: without ``imu`` where the log has none: it serves as donor alone.
        velocity: what the receiver's velocity is.
        inertial: what the IMU's rows are; empty without one.
        lag_s: by which the IMU's times are moved, so that no detector needs a lag.
        window_s: the longest of the windows that the recording holds twice.
    """

    log: FieldLog
    recording: Recording
    velocity: str
    inertial: str
    lag_s: float
    window_s: float

    @property
    def name(self) -> str:
        return self.log.name


def sessions(
    data: Path | None, quick: bool, progress: Callable[[float], None]
) -> tuple[list[FieldSession], list[str]]:
    """Convert and prepare all logs; return what could be, and a sentence on each that could not.

    Args:
        data: folder of logs; None, or ``quick``: the drive alone.
        quick: the short form.
        progress: is told the share that is done.
    """
    found, left_out = [], []
    logs = LOGS if data is not None and not quick else LOGS[:1]
    for number, log in enumerate(logs):
        progress(number / len(logs))
        try:
            found.append(prepared(log, _converted(log, data)))
        except SpoofbenchError as error:
            left_out.append(f"{log.name} is left out: {error}.")
    return found, left_out


def _converted(log: FieldLog, data: Path | None) -> Recording:
    with TemporaryDirectory() as folder:
        out = Path(folder) / "recording.mcap"
        if not log.files or data is None:
            convert(drive_bag(), out)
        else:
            files = [data / file for file in log.files]
            absent = [file.name for file in files if not file.exists()]
            if absent:
                raise NotApplicable(f"the folder of logs has no {absent[0]!r}")
            if len(files) == 1:
                convert(files[0], out)
            else:
                together = Path(folder) / "session"
                together.mkdir()
                for file in files:
                    shutil.copy(file, together)
                convert(
                    together,
                    out,
                    format="table",
                    options={"mapping": log.mapping} if log.mapping else {},
                )
        read = codec.read(out)
        return Recording(
            {
                topic: read[topic]
                for topic in read
                if topic.endswith(("/imu", "/gnss/pvt", "/ins/pva"))
            },
            read.metadata,
        )


def prepared(log: FieldLog, recording: Recording) -> FieldSession:
    """Return the session of a converted log.

    Raises:
        NotApplicable: the receiver says neither velocity nor position.
    """
    pvt, velocity = with_velocity(at_1_hz(recording.primary("gnss/pvt").last_per_time()))
    imu, inertial = _imu(recording)
    duration_s = (int(pvt.time_ns[-1]) - int(pvt.time_ns[0])) / 1e9
    window_s = next((window for window in WINDOWS_S if duration_s >= 2 * window), WINDOWS_S[-1])
    if imu is None:
        return FieldSession(log, Recording({"/gnss0/gnss/pvt": pvt}), velocity, "", 0.0, window_s)
    lag_s = log.lag_s
    if lag_s is None:
        lag_s = fitted_lag_s(imu, pvt, window_s) if window_s >= MIN_FITTED_S else 0.0
    return FieldSession(log, _together(imu, pvt, lag_s), velocity, inertial, lag_s, window_s)


def at_1_hz(pvt: Table) -> Table:
    """Return the rows that are a second apart, or all where the receiver is no faster."""
    interval_ns = float(np.median(np.diff(pvt.time_ns)))
    if interval_ns > 0.75 * EPOCH_S * 1e9:
        return pvt
    kept: list[int] = []
    for row, time_ns in enumerate(pvt.time_ns.tolist()):
        if not kept or time_ns - pvt.time_ns[kept[-1]] > EPOCH_S * 1e9 - interval_ns / 2:
            kept.append(row)
    return pvt.take(np.array(kept, np.intp))


def with_velocity(pvt: Table) -> tuple[Table, str]:
    """Return the velocity of each epoch, in the one form that every session has, and whose it is.

    A receiver that gives none has the mean velocity since its last position (as the MAV's first
    authors took it), one that gives speed alone the course of that.

    Raises:
        NotApplicable: there is no position either.
    """
    if pvt.has("vel_n_mps", "vel_e_mps", "vel_d_mps"):
        origin = "the receiver's"
    elif pvt.has("speed_mps", "course_deg"):
        origin = "the receiver's speed and course"
    elif pvt.has("lat_deg", "lon_deg"):
        north, east = _displacement_m(pvt)
        course = np.degrees(np.arctan2(east, north)) % 360
        origin = "the receiver's speed, the course of its positions"
        if not pvt.has("speed_mps"):
            origin = "differences of positions"
            elapsed_s = np.diff(pvt.time_ns, prepend=pvt.time_ns[:1]) / 1e9
            speed = np.divide(
                np.hypot(north, east), elapsed_s, out=np.full(len(pvt), np.nan), where=elapsed_s > 0
            )
            pvt = pvt.replace(speed_mps=speed)
        # A position that is repeated says no course.
        held = (north == 0) & (east == 0) & (pvt["speed_mps"] > 0)
        pvt = pvt.replace(course_deg=np.where(held, np.nan, course))
    else:
        raise NotApplicable("the receiver says neither velocity nor position")
    velocity = receiver_velocity(pvt)
    columns = {
        f"vel_{axis}_mps": component
        for axis, component in zip("ned", velocity.ned_mps, strict=True)
    }
    return Table("gnss/pvt", velocity.time_ns, columns), origin


def _displacement_m(pvt: Table) -> tuple[Floats, Floats]:
    """North and east from the position before, shapes ``(n,)``; NaN at the first."""
    lat, lon = np.radians(pvt["lat_deg"]), np.radians(pvt["lon_deg"])
    meridian, normal = radii_m(lat, np.zeros_like(lat))
    return meridian * np.diff(lat, prepend=np.nan), normal * np.cos(lat) * np.diff(
        lon, prepend=np.nan
    )


def _imu(recording: Recording) -> tuple[Table | None, str]:
    if recording.topics("imu"):
        imu = recording.primary("imu")
        return imu, "IMU"
    if not recording.topics("ins/pva") or not recording.primary("ins/pva").has(
        "linear_accel_x_mps2", "rate_x_radps"
    ):
        return None, ""
    ins = recording.primary("ins/pva")
    force = [ins[f"linear_accel_{axis}_mps2"] for axis in "xyz"]
    force[2] = force[2] - STANDARD_GRAVITY
    rate = [ins[f"rate_{axis}_radps"] for axis in "xyz"]
    columns = dict(zip((*FORCE, *RATE), (*force, *rate), strict=True))
    # a sample a second, that has to stand for it
    columns["interval_s"] = np.full(len(ins), EPOCH_S)
    return Table(
        "imu", ins.time_ns, columns
    ), "the receiver's own inertial solution, gravity added, a sample a second"


def _together(imu: Table, pvt: Table, lag_s: float) -> Recording:
    """A recording whose IMU is as late as its receiver."""
    late = Table("imu", imu.time_ns + round(lag_s * 1e9), {name: imu.column(name) for name in imu})
    return Recording({"/imu0/imu": late, "/gnss0/gnss/pvt": pvt})


def fitted_lag_s(imu: Table, pvt: Table, window_s: float) -> float:
    """Return the lag, of a grid of 0.1 s, at which the genuine recording's median H (Eq 15) is
    greatest; 0 where H is never known.
    """
    medians = list(_medians(imu, pvt, window_s))
    return LAGS_S[int(np.nanargmax(medians))] if np.isfinite(medians).any() else 0.0


def _medians(imu: Table, pvt: Table, window_s: float) -> Iterator[float]:
    detector = Correlation(statistic="H", window_s=window_s)
    for lag_s in LAGS_S:
        decisions = detect(detector, _together(imu, pvt, lag_s))
        yield (
            1 - float(np.median(decisions.score[decisions.available])) * (1 - detector.threshold)
            if decisions.available.any()
            else np.nan
        )
