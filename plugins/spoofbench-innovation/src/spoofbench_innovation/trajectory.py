"""The nominal trajectory: attitude from the IMU alone, in a level frame whose azimuth is arbitrary;
and where GNSS tells that azimuth, so that a filter can start.

The wander frame has its third axis down; its first points anywhere. Where GNSS errors are the same
in all horizontal directions, the filter's covariances do not depend on that azimuth: with this
trajectory they are a function of the IMU and of the times of the epochs, whatever GNSS says.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from spoofbench.arrays import Complexes, Floats, Indices, Times, ragged_arange, run_starts
from spoofbench.navigation.preintegration import (
    Increments,
    increments,
    rotation_vectors,
)
from spoofbench.table import Table
from spoofbench_innovation.measurements import Measurements

STEP_S = 1.0  # longer intervals between epochs are cut into such steps
LEVELLING_S = 60.0  # time constant with which the accelerometer levels the gyros' attitude
BIAS_S = 60.0  # time constant of the gyros' offset that is taken out

WINDOW_S = 30.0
# integral of the squared change of velocity per second, as of 5 s at 2.2 m/s^2
ENERGY_M2PS = 25.0
COHERENCE = 0.9  # lowest share of it that GNSS and IMU have in common
_PAIR_S, _LONGEST_PAIR_S = 0.9, 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
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

    epoch: Indices
    run: Indices
    duration_s: Floats
    silent_s: Floats
    attitude: Floats
    velocity_mps: Floats
    position_m: Floats
    correction_rad: Floats

    def between(self, steps: slice) -> "Trajectory":
        """Return these steps, without epochs."""
        return Trajectory(
            np.empty(0, np.intp),
            self.run[steps],
            self.duration_s[steps],
            self.silent_s[steps],
            self.attitude[steps],
            self.velocity_mps[steps],
            self.position_m[steps],
            self.correction_rad[steps],
        )


def nominal_trajectory(
    imu: Table, epoch_ns: Times, lag_ns: int, restart_s: float, offset_radps: float
) -> Trajectory:
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


def _edges(epoch_ns: Times, restart_s: float) -> tuple[Times, Indices]:
    """Return the ends of the steps, ``(n + 1,)``, and each epoch's index among them, ``(m,)``."""
    gap_s = np.diff(epoch_ns) * 1e-9
    pieces = np.where(gap_s <= restart_s, np.maximum(np.ceil(gap_s / STEP_S - 0.5), 1), 1).astype(
        np.intp
    )
    epoch = np.concatenate([np.zeros(min(epoch_ns.size, 1), np.intp), np.cumsum(pieces)])
    cut = np.repeat(epoch_ns[:-1], pieces) + ragged_arange(pieces) * round(STEP_S * 1e9)
    return np.concatenate([cut, epoch_ns[-1:]]), epoch


def rotation(x_rad: float, y_rad: float, z_rad: float) -> Floats:
    """Return the matrix of one rotation vector (Rodrigues), shape ``(3, 3)``: what
    :func:`~spoofbench.navigation.preintegration.rotations` gives, a hundred times as fast for one.
    """
    square = x_rad * x_rad + y_rad * y_rad + z_rad * z_rad
    angle = math.sqrt(square)
    sine = math.sin(angle) / angle if angle else 1.0
    half = math.sin(angle / 2) / (angle / 2) if angle else 1.0
    versine = half * half / 2
    return np.array(
        [
            [
                1 - versine * (y_rad * y_rad + z_rad * z_rad),
                versine * x_rad * y_rad - sine * z_rad,
                versine * x_rad * z_rad + sine * y_rad,
            ],
            [
                versine * x_rad * y_rad + sine * z_rad,
                1 - versine * (x_rad * x_rad + z_rad * z_rad),
                versine * y_rad * z_rad - sine * x_rad,
            ],
            [
                versine * x_rad * z_rad - sine * y_rad,
                versine * y_rad * z_rad + sine * x_rad,
                1 - versine * (x_rad * x_rad + y_rad * y_rad),
            ],
        ]
    )


def _chained(steps: Increments, epoch: Indices, offset_radps: float) -> Trajectory:
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
        attitude = rotation(*correction[k].tolist()) @ attitude @ steps.rotation[k]
    return Trajectory(
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


@dataclass(frozen=True, slots=True)
class Start:
    """A filter's start.

    Attributes:
        epoch: the epoch whose measurements are its state.
        end: the first step that is no longer of the same run.
        azimuth_rad: from north to the first axis of the wander frame, positive to the east.
    """

    epoch: int
    end: int
    azimuth_rad: float


def starts(found: Measurements, trajectory: Trajectory) -> Iterator[Start]:
    """Yield where each run can first be aligned; runs that cannot are left out.

    GNSS and IMU see the same changes of velocity, one in NED, the other in the wander frame. The
    angle between the two is the azimuth. So neither the IMU's mounting nor a forward motion is
    needed, only some acceleration.
    """
    if found.time_ns.size < 2:
        return
    run = np.append(-1, trajectory.run[trajectory.epoch[1:]])
    common, gnss, imu = _energies(found, trajectory, run_starts(run))
    coherent = np.abs(common) >= COHERENCE * np.sqrt(gnss * imu)
    usable = np.flatnonzero(
        (run >= 0) & (gnss >= ENERGY_M2PS) & coherent & ~np.isnan(found.values[:, 0])
    )
    ends = np.append(np.flatnonzero(np.diff(trajectory.run)) + 1, trajectory.run.size)
    for index in np.unique(run[usable], return_index=True)[1].tolist():
        epoch = int(usable[index])
        end = int(ends[np.searchsorted(ends, trajectory.epoch[epoch], "right")])
        yield Start(epoch, end, float(np.angle(common[epoch])))


def horizontal_velocity(found: Measurements) -> Complexes:
    """Return the velocity as north + i east, m/s, ``(m,)``, from the last change of position where
    there is none; NaN is unknown.
    """
    measured = found.values[:, 3] + 1j * found.values[:, 4]
    position = found.values[:, 0] + 1j * found.values[:, 1]
    differenced = np.full(measured.size, np.nan, complex)
    differenced[1:] = np.diff(position) / (np.diff(found.time_ns) * 1e-9)
    return np.where(np.isnan(measured), differenced, measured)


def _energies(
    found: Measurements, trajectory: Trajectory, first: Indices
) -> tuple[Complexes, Floats, Floats]:
    """Return sums over the window of the changes of velocity, ``(m,)`` each: what GNSS and IMU have
    in common, GNSS alone, IMU alone.

    ``first`` is the first epoch of each epoch's run, ``(m,)``.
    """
    time_s = (found.time_ns - found.time_ns[0]) * 1e-9
    velocity = horizontal_velocity(found)
    gained = np.append(
        0.0, np.cumsum(trajectory.velocity_mps[:, 0] + 1j * trajectory.velocity_mps[:, 1])
    )[trajectory.epoch + 1]
    partner = np.maximum(np.searchsorted(time_s, time_s - _PAIR_S, "right") - 1, first)
    change, felt = velocity - velocity[partner], gained - gained[partner]
    usable = (
        (time_s - time_s[partner] >= _PAIR_S)
        & (time_s - time_s[partner] <= _LONGEST_PAIR_S)
        & ~np.isnan(change)
    )
    weight = np.diff(time_s, prepend=time_s[0])
    products = np.where(
        usable,
        weight
        * np.stack([change * np.conj(felt), np.abs(change) ** 2 + 0j, np.abs(felt) ** 2 + 0j]),
        0,
    )
    total = np.concatenate([np.zeros((3, 1), complex), np.cumsum(products, axis=1)], axis=1)
    sums = (
        total[:, 1:]
        - total[:, np.maximum(np.searchsorted(time_s, time_s - WINDOW_S, "right"), first)]
    )
    return sums[0], np.maximum(sums[1].real, 0), np.maximum(sums[2].real, 0)
