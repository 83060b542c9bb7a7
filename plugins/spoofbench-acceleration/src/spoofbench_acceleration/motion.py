"""Acceleration from GNSS, specific force from the IMU, and the attitude that GNSS suggests.

Row n is the epoch t[n]. Nothing is interpolated and nothing rests on rows after its epoch.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spoofbench.errors import RecordingError
from spoofbench.table import Table

Floats = NDArray[np.float64]

_SEMI_MAJOR_M, _ECCENTRICITY2 = 6378137.0, 6.69437999014e-3  # WGS 84
_IMU_SILENCE_S = 0.25
_LETTERS = {
    "f": ("forward", 1),
    "b": ("forward", -1),
    "u": ("up", 1),
    "d": ("up", -1),
    "r": ("right", 1),
    "l": ("right", -1),
}


@dataclass(frozen=True, slots=True)
class Track:
    """What GNSS says of the motion over the interval that ends at each epoch, NED, ``(n, 3)``; NaN
    is unavailable.
    """

    velocity_mps: Floats
    acceleration_mps2: Floats


def track_from_velocity(steps_s: Floats, velocity_mps: Floats) -> Track:
    """First difference of the velocity; the first row is unavailable. The velocity is the mean of
    the two epochs'.

    Args:
        steps_s: intervals between the epochs, ``(n - 1,)``; NaN where one is not to be bridged.
        velocity_mps: at the epochs, ``(n, 3)``.
    """
    velocity, acceleration = np.full_like(velocity_mps, np.nan), np.full_like(velocity_mps, np.nan)
    velocity[1:] = (velocity_mps[1:] + velocity_mps[:-1]) / 2
    acceleration[1:] = np.diff(velocity_mps, axis=0) / steps_s[:, None]
    return Track(velocity, acceleration)


def track_from_position(steps_s: Floats, position_m: Floats) -> Track:
    """Second difference of the position; the first two rows are unavailable. It lags by half an
    interval.

    Over uneven intervals it is twice the second divided difference. Arguments as in
    :func:`track_from_velocity`.
    """
    velocity, acceleration = np.full_like(position_m, np.nan), np.full_like(position_m, np.nan)
    velocity[1:] = np.diff(position_m, axis=0) / steps_s[:, None]
    acceleration[2:] = 2 * np.diff(velocity[1:], axis=0) / (steps_s[1:] + steps_s[:-1])[:, None]
    return Track(velocity, acceleration)


def local_position_m(lat_deg: Floats, lon_deg: Floats, height_m: Floats) -> Floats:
    """NED position about the first epoch that has one, ``(n, 3)``."""
    known = np.flatnonzero(~np.isnan(lat_deg + lon_deg + height_m))
    if not known.size:
        return np.full((lat_deg.size, 3), np.nan)
    lat0, lon0, height0 = (values[known[0]] for values in (lat_deg, lon_deg, height_m))
    w2 = 1 - _ECCENTRICITY2 * np.sin(np.radians(lat0)) ** 2
    meridian, normal = (
        _SEMI_MAJOR_M * (1 - _ECCENTRICITY2) / w2**1.5 + height0,
        _SEMI_MAJOR_M / w2**0.5 + height0,
    )
    east_deg = (lon_deg - lon0 + 180) % 360 - 180
    north = np.radians(lat_deg - lat0) * meridian
    return np.column_stack(
        [north, np.radians(east_deg) * normal * np.cos(np.radians(lat0)), height0 - height_m]
    )


def pitch_rad(velocity_mps: Floats, slowest_mps: float) -> Floats:
    """Pitch of a vehicle whose nose follows its velocity, Lo et al. (2017) Eq (2); ``(n,)``.

    Below ``slowest_mps`` over ground the last pitch is held, since a vehicle keeps its slope when
    it stops; NaN before any.
    """
    ground = np.hypot(velocity_mps[:, 0], velocity_mps[:, 1])
    return _held(np.arctan2(-velocity_mps[:, 2], ground), ground >= slowest_mps)


def heading_rad(velocity_mps: Floats, slowest_mps: float) -> Floats:
    """Course over ground, held below ``slowest_mps``, NaN before any; ``(n,)``."""
    ground = np.hypot(velocity_mps[:, 0], velocity_mps[:, 1])
    return _held(np.arctan2(velocity_mps[:, 1], velocity_mps[:, 0]), ground >= slowest_mps)


def roll_rad(track: Track, gravity_mps2: float, slowest_mps: float) -> Floats:
    """Roll of a coordinated turn, atan(v omega / g), positive to the right; NaN without
    acceleration; ``(n,)``.

    Lo et al. (2017) Eq (3) prints atan(v^2 / r), which lacks g. Eq (4) takes r from dN/dE and fails
    heading north: the course rate omega = v / r serves instead, 0 below ``slowest_mps``.
    """
    velocity, acceleration = track.velocity_mps, track.acceleration_mps2
    ground = np.hypot(velocity[:, 0], velocity[:, 1])
    across = velocity[:, 0] * acceleration[:, 1] - velocity[:, 1] * acceleration[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        centripetal = np.where(ground < slowest_mps, 0.0, across / ground)
    roll: Floats = np.arctan(centripetal / gravity_mps2)
    return roll


def specific_force(
    track: Track, attitude_rad: tuple[Floats, Floats, Floats], axis: str, gravity_mps2: float
) -> Floats:
    """Specific force that the axis of a body of this attitude should feel, Lo et al. (2017) Eq (1);
    m/s^2, ``(n,)``.

    Args:
        track: what GNSS says.
        attitude_rad: roll, pitch and heading, each ``(n,)``.
        axis: ``forward`` or ``up`` in the body.
        gravity_mps2: g.
    """
    roll, pitch, heading = attitude_rad
    north, east, down = (track.acceleration_mps2 - [0.0, 0.0, gravity_mps2]).T
    along, across = (
        north * np.cos(heading) + east * np.sin(heading),
        east * np.cos(heading) - north * np.sin(heading),
    )
    if axis == "forward":
        forward: Floats = along * np.cos(pitch) - down * np.sin(pitch)
        return forward
    up: Floats = across * np.sin(roll) - np.cos(roll) * (
        along * np.sin(pitch) + down * np.cos(pitch)
    )
    return up


def sensed_force(imu: Table, axes: str, axis: str, edges_ns: NDArray[np.int64]) -> Floats:
    """Mean specific force of the IMU along an axis over each interval between two edges; m/s^2,
    ``(n,)``.

    The increments are summed; from the last sample to the edge that sample is held, since the next
    one may lie in the future. NaN where the IMU is silent for more than 0.25 s, and in the first
    row.

    Args:
        imu: rows of the IMU.
        axes: what x, y, z point to, such as ``frd``.
        axis: ``forward`` or ``up``.
        edges_ns: ends of the intervals on the recording's clock, increasing.

    Raises:
        RecordingError: ``axes`` does not say which axis it is.
    """
    column, sign = sensor_axis(axes, axis)
    time_ns, force = imu.time_ns, imu[column]
    usable = ~np.isnan(force)
    if not usable.all():
        time_ns, force = time_ns[usable], force[usable]
    mean = np.full(edges_ns.size, np.nan)
    if time_ns.size < 2:
        return mean
    steps_s = np.diff(time_ns) * 1e-9
    impulse = np.zeros(time_ns.size)
    np.cumsum(force[1:] * steps_s, out=impulse[1:])
    last = np.searchsorted(time_ns, edges_ns, "right") - 1
    since_s = (edges_ns - time_ns[last]) * 1e-9
    at_edge = impulse[last] + force[last] * since_s
    at_edge[(last < 0) | (since_s > _IMU_SILENCE_S)] = np.nan
    silences = np.searchsorted(np.flatnonzero(steps_s > _IMU_SILENCE_S) + 1, last, "right")
    mean[1:] = sign * np.diff(at_edge) / (np.diff(edges_ns) * 1e-9)
    mean[1:][np.diff(silences) > 0] = np.nan
    return mean


def sensor_axis(axes: str, axis: str) -> tuple[str, int]:
    """Return the accelerometer's field and sign that point along ``forward`` or ``up``.

    Raises:
        RecordingError: ``axes`` is not three letters of f, b, r, l, u, d that name three axes.
    """
    known = [_LETTERS.get(letter, ("", 0)) for letter in axes.lower()]
    if {name for name, _ in known} != {"forward", "right", "up"} or len(known) != 3:
        raise RecordingError(
            f"the IMU's axes are {axes!r}; say where x, y and z point by the parameter axes, such "
            "as 'frd'"
        )
    index = [name for name, _ in known].index(axis)
    return f"accel_{'xyz'[index]}_mps2", known[index][1]


def _held(values: Floats, good: NDArray[np.bool_]) -> Floats:
    """Each row's last good value, NaN before the first."""
    last = np.maximum.accumulate(np.where(good, np.arange(values.size), -1))
    return np.where(last >= 0, values[last], np.nan)
