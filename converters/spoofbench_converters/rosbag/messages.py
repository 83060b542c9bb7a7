"""What the message types of ROS say: sensor_msgs, geometry_msgs, nav_msgs, and GPSFix of gps_common
and gps_msgs.

Units and frames are those that the definitions' comments and REP 103 and 105 (ros.org/reps)
declare. Northings are a twist's y, eastings its x, for REP 103 lays geographic axes east, north,
up.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from spoofbench.conversion import Columns
from spoofbench.schema.v1 import gnss_pb2
from spoofbench_converters.rosbag.contract import DecodedMessages, DecodedRows, Refusal
from spoofbench_converters.rosbag.fields import Fields, Floats

Reader = Callable[[Fields], DecodedMessages]

_ENU_TO_NED = (("nn", 4, 1), ("ne", 1, 1), ("nd", 5, -1), ("ee", 0, 1), ("ed", 2, -1), ("dd", 8, 1))
_DIAGONAL = frozenset({"nn", "ee", "dd"})
_APPROXIMATED, _DIAGONAL_KNOWN, _KNOWN = 1, 2, 3
_NO_FIX = -1
_OFF_THE_GLOBE = "the position is not on the globe"

# NavSatStatus and GPSStatus. A ground-based augmentation may be RTK or not: the type does not say.
_FIX_TYPES = {
    _NO_FIX: gnss_pb2.FIX_TYPE_NONE,
    0: gnss_pb2.FIX_TYPE_3D,
    1: gnss_pb2.FIX_TYPE_DIFFERENTIAL,
    2: gnss_pb2.FIX_TYPE_DIFFERENTIAL,
    18: gnss_pb2.FIX_TYPE_DIFFERENTIAL,
    19: gnss_pb2.FIX_TYPE_RTK_FIXED,
    20: gnss_pb2.FIX_TYPE_RTK_FLOAT,
    33: gnss_pb2.FIX_TYPE_DIFFERENTIAL,
}


@dataclass(frozen=True, slots=True)
class Spec:
    """How messages of one type are read.

    Attributes:
        kinds: what they may give.
        read: gives it.
        side: ``position`` or ``velocity`` of a receiver, where that is all they give.
        about: metadata of their sources, by kind.
    """

    kinds: tuple[str, ...]
    read: Reader
    side: str = ""
    about: Mapping[str, Mapping[str, str]] = field(default_factory=dict)


def _vector(fields: Fields, path: str, names: str, scale: float = 1.0) -> Columns:
    return {names.format(axis): fields.floats(f"{path}.{axis}", scale) for axis in "xyz"}


def _said_to_be_absent(
    fields: Fields, covariance: str
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Which messages say by a first covariance of -1 that they have no such values."""
    values = fields.array(covariance, 9)
    return np.zeros(len(fields), bool) if values is None else values[:, 0] == -1


def imu(fields: Fields) -> DecodedMessages:
    """Return specific force and angular rate of sensor_msgs/Imu, without those that it says it does
    not have.
    """
    accel = _vector(fields, "linear_acceleration", "accel_{}_mps2")
    gyro = _vector(fields, "angular_velocity", "gyro_{}_radps")
    for columns, covariance in (
        (accel, "linear_acceleration_covariance"),
        (gyro, "angular_velocity_covariance"),
    ):
        absent = _said_to_be_absent(fields, covariance)
        columns.update({name: np.where(absent, np.nan, values) for name, values in columns.items()})
    columns = {**accel, **gyro}
    nothing = np.all([np.isnan(values) for values in columns.values()], axis=0)
    part = DecodedRows("imu", {**columns, "interval_s": np.zeros(len(fields))})
    return DecodedMessages(
        [part], fields.stamp_ns(), [(nothing, "it holds neither accelerations nor rates")]
    )


def mag(fields: Fields) -> DecodedMessages:
    """Return the flux density of sensor_msgs/MagneticField, which is in tesla."""
    columns = _vector(fields, "magnetic_field", "field_{}_ut", 1e6)
    nothing = np.all([np.isnan(values) for values in columns.values()], axis=0)
    return DecodedMessages(
        [DecodedRows("mag", columns)], fields.stamp_ns(), [(nothing, "it holds no field")]
    )


def baro(fields: Fields) -> DecodedMessages:
    """Return the pressure of sensor_msgs/FluidPressure."""
    pressure = fields.floats("fluid_pressure")
    return DecodedMessages(
        [DecodedRows("baro", {"pressure_pa": pressure})],
        fields.stamp_ns(),
        [(np.isnan(pressure), "it holds no pressure")],
    )


def time_reference(fields: Fields) -> DecodedMessages:
    """Return how far the time of sensor_msgs/TimeReference is ahead of the host's, by which its
    header is stamped.
    """
    host, reference = fields.stamp_ns(), fields.stamp_ns("time_ref")
    if host is None or reference is None:
        return DecodedMessages([], None, [(np.ones(len(fields), bool), "it holds no time")])
    part = DecodedRows("gnss/clock", {"host_offset_s": (reference - host) / 1e9})
    return DecodedMessages([part], host, [((host == 0) | (reference == 0), "it holds no time")])


def nav_sat_fix(fields: Fields) -> DecodedMessages:
    """Return the position of sensor_msgs/NavSatFix: WGS 84, altitude above the ellipsoid."""
    columns = {
        "lat_deg": fields.floats("latitude"),
        "lon_deg": fields.floats("longitude"),
        "height_m": fields.floats("altitude"),
    }
    fixed, refusals = _fix(fields, columns)
    return DecodedMessages(
        [DecodedRows("gnss/pvt", {**fixed, **_covariance(fields)})], fields.stamp_ns(), refusals
    )


def gps_fix(fields: Fields) -> DecodedMessages:
    """Return what gps_common/GPSFix says of the solution and, through its status, of the
    satellites.
    """
    columns = {
        "lat_deg": fields.floats("latitude"),
        "lon_deg": fields.floats("longitude"),
        "height_msl_m": fields.floats("altitude"),
    }
    fixed, refusals = _fix(fields, columns)
    more = {
        "course_deg": fields.floats("track"),
        "speed_mps": fields.floats("speed"),
        "vel_d_mps": fields.floats("climb", -1.0),
        **{name: _above_zero(fields.floats(name)) for name in ("pdop", "hdop", "vdop")},
        "h_acc_m": _above_zero(fields.floats("err_horz")),
        "v_acc_m": _above_zero(fields.floats("err_vert")),
        "s_acc_mps": _above_zero(fields.floats("err_speed")),
        "time_acc_s": _above_zero(fields.floats("err_time")),
        "num_sv": fields.floats("status.satellites_used"),
    }
    pvt = DecodedRows("gnss/pvt", {**fixed, **more, **_covariance(fields)})
    return DecodedMessages([pvt, _signals(fields, "status.")], fields.stamp_ns(), refusals)


def gps_status(fields: Fields) -> DecodedMessages:
    """Return what gps_common/GPSStatus says of the satellites."""
    signals = _signals(fields, "")
    seen = np.zeros(len(fields), bool)
    seen[signals.message] = True
    return DecodedMessages([signals], fields.stamp_ns(), [(~seen, "no satellite is in view")])


def twist(prefix: str) -> Reader:
    """Return a reader of a receiver's velocity, given east, north, up."""

    def read(fields: Fields) -> DecodedMessages:
        columns: Columns = {
            "vel_n_mps": fields.floats(f"{prefix}linear.y"),
            "vel_e_mps": fields.floats(f"{prefix}linear.x"),
            "vel_d_mps": fields.floats(f"{prefix}linear.z", -1.0),
        }
        covariance = fields.array("twist.covariance", 36)
        if covariance is not None:
            matrix = covariance.reshape(-1, 6, 6)[:, :3, :3].reshape(-1, 9)
            known = (matrix[:, [0, 4, 8]] > 0).all(axis=1)
            columns |= {
                f"cov_vel_{axes}_m2ps2": np.where(known, sign * matrix[:, place], np.nan)
                for axes, place, sign in _ENU_TO_NED
            }
        nothing = np.isnan(columns["vel_n_mps"]) & np.isnan(columns["vel_e_mps"])
        return DecodedMessages(
            [DecodedRows("gnss/pvt", columns)],
            fields.stamp_ns(),
            [(nothing, "it holds no velocity")],
        )

    return read


def odometry(fields: Fields) -> DecodedMessages:
    """Return the speed along the x axis of a vehicle's frame, which REP 103 lays forward, of
    nav_msgs/Odometry.
    """
    speed = fields.floats("twist.twist.linear.x")
    return DecodedMessages(
        [DecodedRows("odometer", {"speed_mps": speed})],
        fields.stamp_ns(),
        [(np.isnan(speed), "it holds no speed")],
    )


def _fix(fields: Fields, columns: Columns) -> tuple[Columns, list[Refusal]]:
    """Return position and type of fix; a position of zeros without a fix is none."""
    lat, lon = columns["lat_deg"], columns["lon_deg"]
    status = fields.integers("status.status")
    types = np.full(len(fields), np.nan)
    if status is not None:
        for code, fix_type in _FIX_TYPES.items():
            types[status == code] = fix_type
        height = next(values for name, values in columns.items() if name.startswith("height"))
        types[(status == 0) & np.isnan(height)] = gnss_pb2.FIX_TYPE_2D
        empty = (status == _NO_FIX) & (lat == 0) & (lon == 0)
        columns = {name: np.where(empty, np.nan, values) for name, values in columns.items()}
    return {**columns, "fix_type": types}, [
        ((np.abs(lat) > 90) | (np.abs(lon) > 360), _OFF_THE_GLOBE)
    ]


def _covariance(fields: Fields) -> Columns:
    """Return the position covariance in NED as far as its type says that it is known."""
    given, kinds = (
        fields.array("position_covariance", 9),
        fields.integers("position_covariance_type"),
    )
    if given is None or kinds is None:
        return {f"cov_{axes}_m2": np.full(len(fields), np.nan) for axes, _, _ in _ENU_TO_NED}
    can_be = (given[:, [0, 4, 8]] >= 0).all(axis=1)
    whole = can_be & (kinds == _KNOWN)
    diagonal = whole | can_be & np.isin(kinds, (_APPROXIMATED, _DIAGONAL_KNOWN))
    return {
        f"cov_{axes}_m2": np.where(
            diagonal if axes in _DIAGONAL else whole, sign * given[:, place], np.nan
        )
        for axes, place, sign in _ENU_TO_NED
    }


def _above_zero(values: Floats) -> Floats:
    """Return the values, absent where 0 or less stands for unknown."""
    return np.where(values > 0, values, np.nan)


def _signals(fields: Fields, prefix: str) -> DecodedRows:
    """Return a row per satellite in view; the numbers are gpsd's, in one series for all
    constellations.
    """
    ids = fields.array(f"{prefix}satellite_visible_prn")
    count = 0 if ids is None else ids.shape[1]
    ids = np.zeros((len(fields), 0)) if ids is None else ids
    constellation, svid = _constellations(ids.reshape(-1))
    used = fields.array(f"{prefix}satellite_used_prn")
    in_use = (
        np.zeros(ids.shape, bool)
        if used is None
        else (ids[:, :, None] == used[:, None, :]).any(axis=2)
    )

    def per_satellite(name: str) -> Floats:
        values = fields.array(f"{prefix}satellite_visible_{name}", count)
        return np.full(ids.size, np.nan) if values is None else values.reshape(-1)

    columns: Columns = {
        "constellation": constellation,
        "svid": svid,
        "cn0_dbhz": _above_zero(per_satellite("snr")),
        "elevation_deg": per_satellite("z"),
        "azimuth_deg": per_satellite("azimuth"),
        "used": in_use.reshape(-1).astype(np.float64),
    }
    return DecodedRows("gnss/signal", columns, np.repeat(np.arange(len(fields)), count))


def _constellations(ids: Floats) -> tuple[Floats, Floats]:
    """Return constellation and number within it of gpsd's satellite numbers that NMEA 0183 defines;
    of others, the number alone.
    """
    constellation, svid = np.full(ids.shape, np.nan), ids.copy()
    for first, last, which, less in (
        (1, 32, gnss_pb2.CONSTELLATION_GPS, 0),
        (33, 64, gnss_pb2.CONSTELLATION_SBAS, -87),
        (65, 96, gnss_pb2.CONSTELLATION_GLONASS, 64),
        (120, 158, gnss_pb2.CONSTELLATION_SBAS, 0),
        (193, 202, gnss_pb2.CONSTELLATION_QZSS, 192),
    ):
        mine = (ids >= first) & (ids <= last)
        constellation[mine], svid[mine] = which, ids[mine] - less
    return constellation, np.where(svid >= 0, svid, np.nan)


_GPS_FIX = Spec(
    ("gnss/pvt", "gnss/signal"),
    gps_fix,
    about={
        "gnss/pvt": {
            "height_basis": "above a reference that GPSFix does not name, taken as sea level",
            "accuracy": "95 %, as GPSFix declares it",
        }
    },
)
_TWIST, _TWIST_COVARIANCE = (
    Spec(("gnss/pvt",), twist(prefix), "velocity") for prefix in ("twist.", "twist.twist.")
)

STANDARD: Mapping[str, Spec] = MappingProxyType(
    {
        "sensor_msgs/msg/Imu": Spec(("imu",), imu),
        "sensor_msgs/msg/MagneticField": Spec(("mag",), mag),
        "sensor_msgs/msg/FluidPressure": Spec(("baro",), baro),
        "sensor_msgs/msg/NavSatFix": Spec(("gnss/pvt",), nav_sat_fix, "position"),
        "sensor_msgs/msg/TimeReference": Spec(("gnss/clock",), time_reference),
        "geometry_msgs/msg/TwistStamped": _TWIST,
        "geometry_msgs/msg/TwistWithCovarianceStamped": _TWIST_COVARIANCE,
        "nav_msgs/msg/Odometry": Spec(("odometer",), odometry),
        **{f"{package}/msg/GPSFix": _GPS_FIX for package in ("gps_common", "gps_msgs")},
        **{
            f"{package}/msg/GPSStatus": Spec(("gnss/signal",), gps_status)
            for package in ("gps_common", "gps_msgs")
        },
    }
)
"""By type."""

EMBEDDED: Mapping[str, Spec] = MappingProxyType(
    {
        f"sensor_msgs/msg/{name}": STANDARD[f"sensor_msgs/msg/{name}"]
        for name in ("Imu", "MagneticField", "FluidPressure", "NavSatFix")
    }
)
"""Those that are also read where messages of other types hold them."""
