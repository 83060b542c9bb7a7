"""The IMU's share: means over intervals from cumulated increments, and whether it stands still.

Arrays of vectors have shape ``(3, n)``, in the sensor frame as recorded.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spoofbench.table import Table

Floats = NDArray[np.float64]
Times = NDArray[np.int64]

FORCE = ("accel_x_mps2", "accel_y_mps2", "accel_z_mps2")
RATE = ("gyro_x_radps", "gyro_y_radps", "gyro_z_radps")
GAP_S = 0.2  # a sampled row stands for the time since the row before it, up to this
COVERAGE = 0.8  # share of an interval that rows must stand for, or its mean is NaN


class Motion(NamedTuple):
    """Means over intervals, shapes ``(3, n)``; NaN where the rows cover too little."""

    force_mps2: Floats
    rate_radps: Floats


def interval_means(imu: Table, start_ns: Times, end_ns: Times) -> Motion:
    """Mean specific force and angular rate over the intervals ``(start, end]``.

    A row that is averaged over ``interval_s`` contributes its increment to the interval in which it
    ends. A row that lacks one of the two says nothing of it: accelerometer and gyroscope may tick
    apart.

    Args:
        imu: rows of kind ``imu``.
        start_ns: shape ``(n,)``.
        end_ns: shape ``(n,)``, not before ``start_ns``.
    """
    force, rate = (
        _means(imu, [imu[name] for name in names], start_ns, end_ns) for names in (FORCE, RATE)
    )
    return Motion(force, rate)


class Rest(NamedTuple):
    """What standing still means for an IMU."""

    span_s: float = 1.0
    smooth_s: float = 0.2
    force_std_mps2: float = 0.15
    rate_rms_radps: float = 0.010


def is_stationary(imu: Table, time_ns: Times, rest: Rest) -> Floats:
    """Whether the IMU stands still in the span before each time: 1, 0, or NaN where rows are
    missing. Shape ``(n,)``.

    It does where the specific force, smoothed by means over ``smooth_s``, has a standard deviation
    (root of the summed variances of the axes, so that mounting does not matter) below
    ``force_std_mps2``, and the angular rate a root mean square below ``rate_rms_radps``.
    """
    blocks = round(rest.span_s / rest.smooth_s)
    edges = time_ns[:, None] + np.rint(np.linspace(-rest.span_s, 0, blocks + 1) * 1e9).astype(
        np.int64
    )
    force = _means(imu, [imu[name] for name in FORCE], edges[:, :-1].ravel(), edges[:, 1:].ravel())
    force_std = np.sqrt(force.reshape(3, -1, blocks).var(axis=2).sum(axis=0))
    x, y, z = (imu[name] for name in RATE)
    rate_rms = np.sqrt(_means(imu, [x * x + y * y + z * z], edges[:, 0], edges[:, -1])[0])
    still = (force_std < rest.force_std_mps2) & (rate_rms < rest.rate_rms_radps)
    return np.where(np.isnan(force_std) | np.isnan(rate_rms), np.nan, still)


def _weights(time_ns: Times, interval_s: Floats) -> Floats:
    """Seconds that each row stands for: its averaging interval, or for a sampled row the time since
    the last.
    """
    sampled = ~(interval_s > 0)
    if not sampled.any():
        return interval_s
    elapsed = np.diff(time_ns, prepend=time_ns[:1]) / 1e9
    return np.where(sampled, np.minimum(elapsed, GAP_S), interval_s)


def _means(imu: Table, columns: Sequence[Floats], start_ns: Times, end_ns: Times) -> Floats:
    """Means of k columns over the rows within each ``(start, end]`` that have them all, weighted by
    seconds, shape ``(k, n)``.
    """
    time_ns, interval_s, known = imu.time_ns, imu["interval_s"], ~np.isnan(columns).any(axis=0)
    if not known.all():
        time_ns, interval_s, columns = (
            time_ns[known],
            interval_s[known],
            [column[known] for column in columns],
        )
    first, last = (
        np.searchsorted(time_ns, start_ns, "right"),
        np.searchsorted(time_ns, end_ns, "right"),
    )
    weight = _weights(time_ns, interval_s)
    # reduceat sums each interval on its own, so no mean depends on where the recording starts or
    # ends. It wants starts that exist: one zero more than there are rows stands behind the last.
    edges = np.stack((first, last), axis=1).ravel()
    increments = np.zeros(time_ns.size + 1)
    sums = []
    for column in (np.ones(1), *columns):
        np.multiply(column, weight, out=increments[:-1])
        sums.append(np.add.reduceat(increments, edges)[::2] if edges.size else np.empty(0))
    seconds, *totals = np.where(first < last, sums, 0.0)
    covered = (seconds > 0) & (seconds >= COVERAGE * (end_ns - start_ns) / 1e9)
    means: Floats = np.divide(
        totals, seconds, out=np.full((len(totals), seconds.size), np.nan), where=covered
    )
    return means
