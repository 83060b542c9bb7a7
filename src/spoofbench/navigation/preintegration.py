"""The IMU between two times: increments of attitude, velocity and position in the body frame at the
first.

All intervals are integrated at once, sample after sample. A row stands for the time since the row
before it, as an average over it; from the last row to the end of an interval that row is held,
since the next one may lie in the future.
"""

from dataclasses import dataclass

import numpy as np

from spoofbench.arrays import Bools, Floats, Indices, Times
from spoofbench.navigation.imu import FORCE, RATE, last_row
from spoofbench.table import Table

SILENCE_S = 0.25  # a longer gap in the IMU's rows is bridged by the row before it, and counted
LONGEST_SILENCE_S = 3.0  # a still longer one is not: the attitude is lost
_ABSURD = 1e4  # m/s^2 or rad/s, which no vehicle does


@dataclass(frozen=True, slots=True, eq=False)
class Increments:
    """What the IMU measured over ``n`` intervals, in the body frame at the start of each.

    Attributes:
        duration_s: ``(n,)``.
        silent_s: how much of it lies in gaps of the rows that are bridged, ``(n,)``.
        known: whether rows cover the interval, ``(n,)``; the others hold zeros.
        rotation: matrix that takes vectors from the body at the end to the body at the start,
            ``(n, 3, 3)``.
        mean_rotation: its mean over the interval, ``(n, 3, 3)``.
        velocity_mps: integral of the specific force, ``(n, 3)``.
        position_m: integral of that, ``(n, 3)``.
    """

    duration_s: Floats
    silent_s: Floats
    known: Bools
    rotation: Floats
    mean_rotation: Floats
    velocity_mps: Floats
    position_m: Floats


def increments(imu: Table, start_ns: Times, end_ns: Times, longest_s: float) -> Increments:
    """Integrate the rows of an IMU over the intervals ``(start, end]``.

    Args:
        imu: rows of kind ``imu``; those that lack a value, or have one beyond 1e4, are left out.
        start_ns: ``(n,)``.
        end_ns: ``(n,)``, after ``start_ns``.
        longest_s: a longer interval is not integrated and counts as unknown.
    """
    names = FORCE + RATE
    complete = np.all([np.abs(imu[name]) < _ABSURD for name in names], axis=0)
    time_ns = imu.time_ns[complete]
    values = np.column_stack([imu[name][complete] for name in names]).astype(np.float64)
    duration_s = (end_ns - start_ns).astype(np.float64) * 1e-9
    first, last = last_row(time_ns, start_ns) + 1, last_row(time_ns, end_ns)
    known = _covered(time_ns, start_ns, end_ns, last) & (duration_s <= longest_s)
    count = np.where(known, last - first + 1, -1)

    size = duration_s.size
    rotation, mean = np.tile(np.eye(3), (size, 1, 1)), np.zeros((size, 3, 3))
    velocity, position, silent = np.zeros((size, 3)), np.zeros((size, 3)), np.zeros(size)
    for sample in range(int(count.max(initial=-1)) + 1):
        rows = np.flatnonzero(count >= sample)
        at = np.minimum(first[rows] + sample, last[rows])
        since = start_ns[rows] if sample == 0 else time_ns[first[rows] + sample - 1]
        until = np.where(sample < count[rows], time_ns[at], end_ns[rows])
        row_before = np.where(sample < count[rows], at - 1, at)
        step_s = ((until - since) * 1e-9)[:, None]
        silent[rows] += np.where(until - time_ns[row_before] > SILENCE_S * 1e9, step_s[:, 0], 0)
        half = rotations(values[at, 3:] * step_s / 2)
        middle = rotation[rows] @ half
        gained = np.matvec(middle, values[at, :3]) * step_s
        position[rows] += (velocity[rows] + gained / 2) * step_s
        velocity[rows] += gained
        mean[rows] += middle * step_s[:, :, None]
        rotation[rows] = middle @ half
    mean[known] /= duration_s[known, None, None]
    return Increments(duration_s, silent, known, rotation, mean, velocity, position)


def _covered(time_ns: Times, start_ns: Times, end_ns: Times, last: Indices) -> Bools:
    """Return whether no gap too long to be bridged lies between the last rows before the two ends
    of an interval, nor after the latter, ``(n,)``.
    """
    if not time_ns.size:
        return np.zeros(start_ns.size, bool)
    before = last_row(time_ns, start_ns)
    silence_ns = round(LONGEST_SILENCE_S * 1e9)
    silences = np.concatenate([[0], np.cumsum(np.diff(time_ns) > silence_ns)])
    fresh = (start_ns - time_ns[before] <= silence_ns) & (end_ns - time_ns[last] <= silence_ns)
    return np.asarray((before >= 0) & fresh & (silences[last] == silences[before]))


def rotations(angle_rad: Floats) -> Floats:
    """Return the rotation matrices of rotation vectors, rad (Rodrigues); shape ``(..., 3)`` to
    ``(..., 3, 3)``.
    """
    square = np.sum(angle_rad**2, axis=-1)[..., None, None]
    angle = np.sqrt(square)
    cross = cross_matrices(angle_rad)
    turn: Floats = (
        np.eye(3)
        + np.sinc(angle / np.pi) * cross
        + np.sinc(angle / (2 * np.pi)) ** 2 / 2 * (cross @ cross)
    )
    return turn


def rotation_vectors(turn: Floats) -> Floats:
    """Return the rotation vectors, rad, of rotations by less than half a turn; shape
    ``(..., 3, 3)`` to ``(..., 3)``.
    """
    twice_sine = np.stack(
        [
            turn[..., 2, 1] - turn[..., 1, 2],
            turn[..., 0, 2] - turn[..., 2, 0],
            turn[..., 1, 0] - turn[..., 0, 1],
        ],
        axis=-1,
    )
    angle = np.arccos(np.clip((np.trace(turn, axis1=-2, axis2=-1) - 1) / 2, -1, 1))
    return np.asarray(twice_sine / (2 * np.sinc(angle / np.pi)[..., None]))


def cross_matrices(vector: Floats) -> Floats:
    """Return the matrix [v x] of each vector, shape ``(..., 3)`` to ``(..., 3, 3)``."""
    x, y, z = np.moveaxis(vector, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*vector.shape, 3)
