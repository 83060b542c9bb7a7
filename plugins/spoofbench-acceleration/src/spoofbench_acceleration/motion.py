"""The motion that GNSS suggests: acceleration, attitude, and the specific force that follows.

Row n is the epoch t[n], vectors are NED. Nothing is interpolated and nothing rests on rows after
its epoch. NaN is unavailable.
"""

from dataclasses import dataclass

import numpy as np

from spoofbench.arrays import Floats, Times, forward_fill
from spoofbench.navigation.imu import FORCE, axis_along, held_means
from spoofbench.table import Table

_IMU_SILENCE_S = 0.25


@dataclass(frozen=True, slots=True)
class GnssMotion:
    """What GNSS says of the motion over the interval that ends at each epoch, NED, ``(n, 3)``.

    Attributes:
        velocity_mps: mean over the interval.
        acceleration_mps2: likewise.
    """

    velocity_mps: Floats
    acceleration_mps2: Floats


def motion_from_velocity(steps_s: Floats, velocity_mps: Floats) -> GnssMotion:
    """Return the motion by the first difference of the velocity; the first row is unavailable.

    Args:
        steps_s: intervals between the epochs, ``(n - 1,)``; NaN where one is not to be bridged.
        velocity_mps: at the epochs, ``(n, 3)``.
    """
    velocity, acceleration = np.full_like(velocity_mps, np.nan), np.full_like(velocity_mps, np.nan)
    velocity[1:] = (velocity_mps[1:] + velocity_mps[:-1]) / 2
    acceleration[1:] = np.diff(velocity_mps, axis=0) / steps_s[:, None]
    return GnssMotion(velocity, acceleration)


def motion_from_position(steps_s: Floats, position_m: Floats) -> GnssMotion:
    """Return the motion by the second difference of the position; the first two rows are
    unavailable, and it lags by half an interval.

    Over uneven intervals it is twice the second divided difference.

    Args:
        steps_s: intervals between the epochs, ``(n - 1,)``; NaN where one is not to be bridged.
        position_m: at the epochs, ``(n, 3)``.
    """
    velocity, acceleration = np.full_like(position_m, np.nan), np.full_like(position_m, np.nan)
    velocity[1:] = np.diff(position_m, axis=0) / steps_s[:, None]
    acceleration[2:] = 2 * np.diff(velocity[1:], axis=0) / (steps_s[1:] + steps_s[:-1])[:, None]
    return GnssMotion(velocity, acceleration)


def pitch_rad(velocity_mps: Floats, slowest_mps: float) -> Floats:
    """Return the pitch of a vehicle whose nose follows its velocity, positive up, ``(n,)``; Lo et
    al. (2017) Eq (2).

    Below ``slowest_mps`` over ground the last pitch is held, since a vehicle keeps its slope when
    it stops; NaN before any. ``velocity_mps`` is ``(n, 3)``.
    """
    ground = np.hypot(velocity_mps[:, 0], velocity_mps[:, 1])
    return forward_fill(np.arctan2(-velocity_mps[:, 2], ground), ground >= slowest_mps, np.nan)


def heading_rad(velocity_mps: Floats, slowest_mps: float) -> Floats:
    """Return the course over ground, clockwise from north, ``(n,)``.

    It is held below ``slowest_mps``; NaN before any. ``velocity_mps`` is ``(n, 3)``.
    """
    ground = np.hypot(velocity_mps[:, 0], velocity_mps[:, 1])
    return forward_fill(
        np.arctan2(velocity_mps[:, 1], velocity_mps[:, 0]), ground >= slowest_mps, np.nan
    )


def roll_rad(motion: GnssMotion, gravity_mps2: float, slowest_mps: float) -> Floats:
    """Return the roll of a coordinated turn, atan(v omega / g), positive to the right, ``(n,)``.

    Lo et al. (2017) Eq (3) prints atan(v^2 / r), which lacks g. Eq (4) takes r from dN/dE and fails
    heading north: the course rate omega = v / r serves instead, 0 below ``slowest_mps``. NaN
    without acceleration.
    """
    velocity, acceleration = motion.velocity_mps, motion.acceleration_mps2
    ground = np.hypot(velocity[:, 0], velocity[:, 1])
    across = velocity[:, 0] * acceleration[:, 1] - velocity[:, 1] * acceleration[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        centripetal = np.where(ground < slowest_mps, 0.0, across / ground)
    roll: Floats = np.arctan(centripetal / gravity_mps2)
    return roll


def specific_force(
    motion: GnssMotion, attitude_rad: tuple[Floats, Floats, Floats], axis: str, gravity_mps2: float
) -> Floats:
    """Return the specific force that an axis of a body of this attitude should feel, m/s^2,
    ``(n,)``; Lo et al. (2017) Eq (1).

    Args:
        motion: what GNSS says.
        attitude_rad: roll, pitch and heading, each ``(n,)``.
        axis: ``forward`` or ``up`` in the body.
        gravity_mps2: g, down.
    """
    roll, pitch, heading = attitude_rad
    north, east, down = (motion.acceleration_mps2 - [0.0, 0.0, gravity_mps2]).T
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


def sensed_force(imu: Table, axes: str, axis: str, edges_ns: Times) -> Floats:
    """Return the mean specific force of the IMU along an axis between successive edges, m/s^2,
    ``(n,)``, as :func:`spoofbench.navigation.imu.held_means` does.

    NaN in the first row, and where the IMU is silent for more than 0.25 s.

    Args:
        imu: rows of kind ``imu``.
        axes: what x, y, z point to, such as ``frd``.
        axis: ``forward`` or ``up``.
        edges_ns: ends of the intervals on the recording's clock, increasing, ``(n,)``.

    Raises:
        RecordingError: ``axes`` does not say which axis it is.
    """
    number, sign = axis_along(axes, axis)
    return sign * held_means(imu.time_ns, imu[FORCE[number]], edges_ns, _IMU_SILENCE_S)
