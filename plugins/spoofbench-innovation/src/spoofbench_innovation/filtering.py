"""The filter on measurements: innovations of every epoch, with the gains of the recording."""

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import partial
from typing import Generic, TypeVar

import numpy as np

from spoofbench.arrays import Floats, Indices
from spoofbench.navigation.gnss import EARTH_RATE_RADPS, normal_gravity_mps2
from spoofbench.table import Table
from spoofbench_innovation import error_model, gains
from spoofbench_innovation.error_model import AZIMUTH, MEASURED, STATES, Grade
from spoofbench_innovation.gains import BLOCK
from spoofbench_innovation.measurements import Measurements
from spoofbench_innovation.trajectory import (
    Start,
    Trajectory,
    horizontal_velocity,
    nominal_trajectory,
    starts,
)

T = TypeVar("T")

# 1 sigma of the levelling and of the azimuth at alignment
TILT_RAD, AZIMUTH_RAD = np.radians(2.0), np.radians(5.0)
# variance at alignment of a velocity or height that is not measured, m^2/s^2 or m^2
_UNKNOWN = 100.0


class SameTable:
    """A table as a key: equal if it is the same object, which the key keeps alive. Tables cannot
    change.
    """

    def __init__(self, table: Table) -> None:
        self.table = table

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SameTable) and self.table is other.table

    def __hash__(self) -> int:
        return id(self.table)


class ResultCache(Generic[T]):
    """Results that a process keeps, by key: those last used, of up to so many bytes in all; the
    newest is kept whatever its size.
    """

    def __init__(self, limit_bytes: int, size_bytes: Callable[[T], int]) -> None:
        self._limit, self._size = limit_bytes, size_bytes
        self._kept: OrderedDict[Hashable, T] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return what is remembered under a key, or make it. The key must hold all that the result
        depends on.
        """
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        made = make()
        with self._lock:
            self._kept[key] = made
            while len(self._kept) > 1 and sum(map(self._size, self._kept.values())) > self._limit:
                self._kept.popitem(last=False)
        return made


@dataclass(frozen=True, slots=True)
class FilterSettings:
    """What a filter's covariances rest on besides IMU and epochs.

    Attributes:
        grade: error parameters of the IMU.
        lag_ns: how late the epochs are against the IMU.
        restart_s: a longer time without an epoch ends a run.
    """

    grade: Grade
    lag_ns: int
    restart_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Innovations:
    """Measurements less what the filter predicted of them, for ``m`` epochs.

    Attributes:
        value: gamma of position, m, and velocity, m/s, in the wander frame, ``(m, 6)``; NaN where
            not measured.
        covariance: S, ``(m, 6, 6)``; rows and columns of what is not measured are those of the
            identity.
        run: number of the filter's run, -1 where there is none, ``(m,)``.
    """

    value: Floats
    covariance: Floats
    run: Indices

    @property
    def measured(self) -> Indices:
        """Number of measurements of each epoch, ``(m,)``."""
        return np.asarray((~np.isnan(self.value)).sum(axis=1))

    @property
    def squared(self) -> Floats:
        """gamma^T S^-1 gamma, the normalised innovation squared (NIS), ``(m,)``; 0 where nothing is
        measured.
        """
        value = np.nan_to_num(self.value)
        return np.asarray(
            np.vecdot(value, np.linalg.solve(self.covariance, value[:, :, None])[:, :, 0])
        )


@dataclass(frozen=True, slots=True, eq=False)
class FilterRun:
    """A run of the filter without the measurements, from the step after its start: what all
    variants of a recording share.

    Attributes:
        matrices: :func:`~spoofbench_innovation.gains.block_matrices`.
        motion: :func:`~spoofbench_innovation.gains.block_motion`.
        covariance: S of each step, ``(n, 6, 6)``.
    """

    matrices: Floats
    motion: Floats
    covariance: Floats


_trajectories: ResultCache[Trajectory] = ResultCache(16 << 20, lambda one: 400 * one.run.size)
_runs: ResultCache[FilterRun] = ResultCache(
    128 << 20, lambda one: one.matrices.nbytes + one.motion.nbytes + one.covariance.nbytes
)


def _run_of(
    trajectory: Trajectory, grade: Grade, steps: slice, initial: Floats, noise: Floats
) -> FilterRun:
    """Run the covariances over some steps, from these variances of the states, with these of what
    is measured.
    """
    part = trajectory.between(steps)
    transition, process = error_model.model(part, grade)
    found = gains.recursion(np.diag(initial), transition, process, noise)
    motion = error_model.free_motion(part, transition)
    return FilterRun(
        gains.block_matrices(transition, found.gain),
        gains.block_motion(transition, motion),
        found.innovation,
    )


def innovations(imu: Table, found: Measurements, settings: FilterSettings) -> Innovations:
    """Run the filter over all runs of a recording.

    What depends on the IMU, on the times of the epochs, and on which measurements they have with
    which variances, is remembered.
    """
    size = found.time_ns.size
    value, covariance = np.full((size, MEASURED), np.nan), np.tile(np.eye(MEASURED), (size, 1, 1))
    run = np.full(size, -1, np.intp)
    if size < 2:
        return Innovations(value, covariance, run)
    key, offset = (
        (SameTable(imu), found.time_ns.tobytes(), settings),
        5 * settings.grade.gyro_bias_radps,
    )
    trajectory = _trajectories.get(
        key,
        lambda: nominal_trajectory(imu, found.time_ns, settings.lag_ns, settings.restart_s, offset),
    )
    measured_variances = np.where(np.isnan(found.values), np.nan, found.variances)
    for number, start in enumerate(starts(found, trajectory)):
        first = int(trajectory.epoch[start.epoch]) + 1
        epochs = np.flatnonzero((trajectory.epoch >= first) & (trajectory.epoch < start.end))
        steps = trajectory.epoch[epochs] - first
        values, noise = (
            np.full((start.end - first, MEASURED), np.nan),
            np.full((start.end - first, MEASURED), np.nan),
        )
        values[steps], noise[steps] = found.values[epochs], measured_variances[epochs]
        initial = _initial_variances(measured_variances[start.epoch], settings.grade)
        work = partial(_run_of, trajectory, settings.grade, slice(first, start.end), initial, noise)
        shared = _runs.get((*key, first, start.end, initial.tobytes(), noise.tobytes()), work)
        state, constants = _start(found, start)
        value[epochs] = run_filter(
            shared, values[:, :, None], state[:, None], start.azimuth_rad, constants
        )[steps, :, 0]
        covariance[epochs], run[epochs] = shared.covariance[steps], number
    return Innovations(value, covariance, run)


def _initial_variances(measured: Floats, grade: Grade) -> Floats:
    level = [TILT_RAD**2, TILT_RAD**2, AZIMUTH_RAD**2]
    return np.concatenate(
        [
            np.where(np.isnan(measured), _UNKNOWN, measured),
            level,
            [grade.accel_bias_mps2**2] * 3,
            [grade.gyro_bias_radps**2] * 3,
        ]
    )


def _start(found: Measurements, start: Start) -> tuple[Floats, tuple[float, complex, float]]:
    """Return the state, ``(15,)`` in the wander frame, then gravity and the Earth's rate, north + i
    east and down.
    """
    epoch, state = start.epoch, np.zeros(STATES)
    state[:MEASURED] = np.nan_to_num(found.values[epoch])
    velocity = horizontal_velocity(found)[epoch]
    turn = np.exp(-1j * start.azimuth_rad)
    for index, value in ((0, complex(*state[:2])), (3, complex(np.nan_to_num(velocity)))):
        state[index : index + 2] = (value * turn).real, (value * turn).imag
    lat = float(found.lat_rad[epoch])
    gravity = normal_gravity_mps2(lat, float(np.nan_to_num(found.height_m[epoch])))
    return state, (gravity, EARTH_RATE_RADPS * np.cos(lat), -EARTH_RATE_RADPS * np.sin(lat))


def run_filter(
    shared: FilterRun,
    values: Floats,
    state: Floats,
    azimuth_rad: float,
    constants: tuple[float, complex, float],
) -> Floats:
    """Return the innovations of many variants of one recording, wander frame, ``(n, 6, v)``; NaN
    where nothing is measured.

    At the start of each block the estimated error of the azimuth moves into the azimuth, about
    which alone the trajectory is not levelled; no covariance depends on it.

    Args:
        shared: what the variants share.
        values: measurements after each step, NED, ``(n, 6, v)``; NaN where there is none, for all
            variants alike.
        state: at the start, wander frame, ``(15, v)``.
        azimuth_rad: of the wander frame at the start.
        constants: gravity, m/s^2, and the Earth's rate: north + i east and down, rad/s.
    """
    size, _, variants = values.shape
    blocks = len(shared.matrices)
    padded = np.zeros((blocks * BLOCK, MEASURED, variants))
    padded[:size] = np.nan_to_num(values)
    padded = padded.reshape(blocks, BLOCK, 2, 3, variants)
    horizontal, vertical = padded[..., 0, :] + 1j * padded[..., 1, :], padded[..., 2, :]
    result = np.empty((blocks, BLOCK * MEASURED, variants))
    azimuth = np.full(variants, azimuth_rad)
    gravity, earth, earth_down = constants
    inputs, driven = np.empty((STATES + BLOCK * MEASURED, variants)), np.ones((5, variants))
    driven[1], driven[4] = gravity, earth_down
    split = inputs[STATES:].reshape(BLOCK, 2, 3, variants)
    for block in range(blocks):
        turn = np.exp(-1j * azimuth)
        driven[2], driven[3] = (earth * turn).real, (earth * turn).imag
        turned = horizontal[block] * turn
        split[:, :, 0], split[:, :, 1], split[:, :, 2] = turned.real, turned.imag, vertical[block]
        moved = shared.motion[block] @ driven
        inputs[STATES:] -= moved[:-STATES]
        inputs[:STATES] = state
        found = shared.matrices[block] @ inputs
        result[block] = found[:-STATES]
        state = found[-STATES:] + moved[-STATES:]
        azimuth = azimuth + state[AZIMUTH]
        state = _turned(state)
    innovations = result.reshape(-1, MEASURED, variants)[:size]
    innovations[np.isnan(values)] = np.nan
    return innovations


def _turned(state: Floats) -> Floats:
    """Return the state in the wander frame turned by its own error of azimuth, which is then
    zero.
    """
    levels = state[:9].reshape(3, 3, -1)
    turned = (levels[:, 0] + 1j * levels[:, 1]) * np.exp(-1j * state[AZIMUTH])
    state = state.copy()
    levels = state[:9].reshape(3, 3, -1)
    levels[:, 0], levels[:, 1] = turned.real, turned.imag
    levels[2, 2] = 0.0
    return state
