"""Alignment: where a run's filter may start, and the azimuth of the wander frame there.

GNSS and IMU see the same changes of velocity, one in NED, the other in the wander frame. The angle
between the two is the azimuth. So neither the IMU's mounting nor a forward motion is needed, only
some acceleration.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spoofbench_innovation.measurements import Measurements
from spoofbench_innovation.nominal import Nominal

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

WINDOW_S = 30.0
ENERGY_M2PS = 25.0  # integral of the squared change of velocity per second, as of 5 s at 2.2 m/s^2
COHERENCE = 0.9  # least share of it that GNSS and IMU have in common
_PAIR_S, _LONGEST_PAIR_S = 0.9, 3.0


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


def starts(found: Measurements, trajectory: Nominal) -> Iterator[Start]:
    """Yield where each run can first be aligned; runs that cannot are left out."""
    if found.time_ns.size < 2:
        return
    run = np.append(-1, trajectory.run[trajectory.epoch[1:]])
    common, gnss, imu = _energies(found, trajectory, _first_of_run(run))
    coherent = np.abs(common) >= COHERENCE * np.sqrt(gnss * imu)
    usable = np.flatnonzero(
        (run >= 0) & (gnss >= ENERGY_M2PS) & coherent & ~np.isnan(found.values[:, 0])
    )
    ends = np.append(np.flatnonzero(np.diff(trajectory.run)) + 1, trajectory.run.size)
    for place in np.unique(run[usable], return_index=True)[1].tolist():
        epoch = int(usable[place])
        end = int(ends[np.searchsorted(ends, trajectory.epoch[epoch], "right")])
        yield Start(epoch, end, float(np.angle(common[epoch])))


def horizontal_velocity(found: Measurements) -> Complex:
    """Velocity as north + i east, from the last change of position where there is none, ``(m,)``;
    NaN is unknown.
    """
    measured = found.values[:, 3] + 1j * found.values[:, 4]
    position = found.values[:, 0] + 1j * found.values[:, 1]
    differenced = np.full(measured.size, np.nan, complex)
    differenced[1:] = np.diff(position) / (np.diff(found.time_ns) * 1e-9)
    return np.where(np.isnan(measured), differenced, measured)


def _energies(
    found: Measurements, trajectory: Nominal, first: NDArray[np.intp]
) -> tuple[Complex, Floats, Floats]:
    """Sums over the window of the changes of velocity: what GNSS and IMU have in common, GNSS
    alone, IMU alone; ``(m,)`` each.

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


def _first_of_run(run: NDArray[np.intp]) -> NDArray[np.intp]:
    return np.maximum.accumulate(
        np.where(np.diff(run, prepend=run[0]) != 0, np.arange(run.size), 0)
    )
