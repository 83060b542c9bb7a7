"""The nominal trajectory: attitude from the IMU alone, in a level frame whose azimuth is arbitrary.

The wander frame has its third axis down; its first points anywhere. Where GNSS errors are the same
in all horizontal directions, the filter's covariances do not depend on that azimuth: with this
trajectory they are a function of the IMU and of the times of the epochs, whatever GNSS says.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spoofbench.table import Table
from spoofbench_innovation.preintegration import Increments, increments, rotation_vectors, rotations

Floats = NDArray[np.float64]

STEP_S = 1.0  # longer intervals between epochs are cut into such steps
LEVELLING_S = 60.0  # time constant with which the accelerometer levels the gyros' attitude
BIAS_S = 60.0  # time constant of the gyros' offset that is taken out


@dataclass(frozen=True, slots=True, eq=False)
class Nominal:
    """The inertial share of a filter over ``n`` steps; step k leads from one time to the next.

    Attributes:
        epoch: of each GNSS epoch, the step that ends there; -1 for the first epoch, ``(m,)``.
        run: number of the run that a step belongs to, -1 where the IMU is unknown; runs are not
            connected, ``(n,)``.
        duration_s: ``(n,)``.
        silent_s: how much of it the IMU said nothing, ``(n,)``.
        attitude: mean over the step of the rotation from body to wander frame, ``(n, 3, 3)``.
        velocity_mps: gained by specific force, wander frame, ``(n, 3)``.
        position_m: likewise, ``(n, 3)``.
        correction_rad: rotation by which the attitude was corrected at the end of the step, wander
            frame, ``(n, 3)``.
    """

    epoch: NDArray[np.intp]
    run: NDArray[np.intp]
    duration_s: Floats
    silent_s: Floats
    attitude: Floats
    velocity_mps: Floats
    position_m: Floats
    correction_rad: Floats

    def between(self, steps: slice) -> "Nominal":
        """Return these steps, without epochs."""
        return Nominal(
            np.empty(0, np.intp),
            self.run[steps],
            self.duration_s[steps],
            self.silent_s[steps],
            self.attitude[steps],
            self.velocity_mps[steps],
            self.position_m[steps],
            self.correction_rad[steps],
        )


def nominal(
    imu: Table, epoch_ns: NDArray[np.int64], lag_ns: int, restart_s: float, offset_radps: float
) -> Nominal:
    """Return the nominal trajectory between epochs.

    Args:
        imu: rows of kind ``imu``; its axes may be any right-handed three.
        epoch_ns: times of the epochs, increasing, ``(m,)``.
        lag_ns: how late the epochs are.
        restart_s: a longer interval between epochs starts a new run; at least 2.
        offset_radps: largest rate that can be an offset of the gyros.
    """
    edges, epoch = _edges(epoch_ns - lag_ns, restart_s)
    steps = increments(imu, edges[:-1], edges[1:], 2 * STEP_S)
    return _chained(steps, epoch - 1, offset_radps)


def _edges(
    epoch_ns: NDArray[np.int64], restart_s: float
) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
    """Return the ends of the steps, and the place of each epoch among them."""
    gap_s = np.diff(epoch_ns) * 1e-9
    pieces = np.where(gap_s <= restart_s, np.maximum(np.ceil(gap_s / STEP_S - 0.5), 1), 1).astype(
        np.intp
    )
    epoch = np.concatenate([np.zeros(min(epoch_ns.size, 1), np.intp), np.cumsum(pieces)])
    piece = np.arange(pieces.sum()) - np.repeat(epoch[:-1], pieces)
    cut = np.repeat(epoch_ns[:-1], pieces) + piece * round(STEP_S * 1e9)
    return np.concatenate([cut, epoch_ns[-1:]]), epoch


def _chained(steps: Increments, epoch: NDArray[np.intp], offset_radps: float) -> Nominal:
    """Chain the steps' rotations.

    The mean specific force, which is up on average, levels the attitude; the mean of slow rates is
    taken for the gyros' offset. Neither need be right: the filter is told of both corrections, and
    they only keep its errors small enough to be linear.
    """
    size = steps.duration_s.size
    start, correction = np.tile(np.eye(3), (size, 1, 1)), np.zeros((size, 3))
    rate = rotation_vectors(steps.rotation) / steps.duration_s[:, None]
    slow: list[bool] = np.less_equal(np.linalg.norm(rate, axis=1), offset_radps).tolist()
    run = (
        np.cumsum(~steps.known & np.append(True, steps.known[:-1]))
        if size
        else np.zeros(0, np.intp)
    )
    age, attitude = 0.0, np.eye(3)
    slow_s, offset = 0.0, np.zeros(3)
    for k in range(size):
        if not steps.known[k]:
            age = 0.0
            continue
        if age == 0.0:
            attitude = _upright(steps.velocity_mps[k])
        start[k], step_s = attitude, steps.duration_s[k]
        force = attitude @ steps.velocity_mps[k]
        age += step_s
        if slow[k]:
            slow_s += step_s
            offset = offset + step_s / min(slow_s, BIAS_S) * (rate[k] - offset)
        levelled = (
            step_s
            / min(age, LEVELLING_S)
            * np.array([-force[1], force[0], 0.0])
            / max(np.linalg.norm(force), 1e-9)
        )
        correction[k] = levelled - attitude @ steps.mean_rotation[k] @ offset * step_s
        attitude = rotations(correction[k]) @ attitude @ steps.rotation[k]
    return Nominal(
        epoch,
        np.where(steps.known, run, -1),
        steps.duration_s,
        steps.silent_s,
        start @ steps.mean_rotation,
        np.matvec(start, steps.velocity_mps),
        np.matvec(start, steps.position_m),
        correction,
    )


def _upright(force: Floats) -> Floats:
    """Return a rotation from the body to a level frame that turns this specific force upward
    (against the third axis).
    """
    norm = float(np.linalg.norm(force))
    if not norm > 0:
        return np.eye(3)
    down = -force / norm
    aside = np.eye(3)[np.argmin(np.abs(down))]
    second = np.cross(down, aside)
    second /= np.linalg.norm(second)
    return np.stack([np.cross(second, down), second, down])
