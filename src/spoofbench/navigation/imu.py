"""An IMU between the epochs of a receiver: where its axes point, means, standing still.

Two kinds of means are here. :func:`interval_means` weighs each row by the time that it says it
stands for, and needs no row outside the interval. :func:`held_means` integrates a staircase, whose
last step is held up to the edge: it covers every instant, however few rows there are.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from spoofbench.arrays import Floats, Indices, Times
from spoofbench.errors import RecordingError
from spoofbench.recording import Recording
from spoofbench.schema import split_topic
from spoofbench.table import Table

FORCE = ("accel_x_mps2", "accel_y_mps2", "accel_z_mps2")
RATE = ("gyro_x_radps", "gyro_y_radps", "gyro_z_radps")
DEFAULT_AXES = "frd"
GAP_S = 0.2
"""A sampled row stands for the time since the row before it, up to this."""
COVERAGE = 0.8
"""Share of an interval that rows must stand for, or its mean is unknown."""

_LETTERS = {
    "f": ("forward", 1),
    "b": ("forward", -1),
    "u": ("up", 1),
    "d": ("up", -1),
    "r": ("right", 1),
    "l": ("right", -1),
}


def imu_axes(recording: Recording) -> str:
    """Return what x, y and z of the primary IMU point to, as the recording says: three letters of
    forward, backward, right, left, up, down, such as ``flu``; ``frd`` where it does not say.

    Raises:
        RecordingError: there is no IMU.
    """
    topics = recording.topics("imu")
    if not topics:
        raise RecordingError("the recording has no 'imu'")
    source = split_topic(topics[0])[0]
    return recording.metadata.get(f"source/{source}", {}).get("axes", DEFAULT_AXES)


def axis_along(axes: str, direction: str) -> tuple[int, int]:
    """Return the number of the axis, 0 to 2, along ``forward``, ``right`` or ``up``, and its sign.

    Raises:
        RecordingError: ``axes`` is not three letters of f, b, r, l, u, d that name three axes.
    """
    known = [_LETTERS.get(letter, ("", 0)) for letter in axes.lower()]
    if {name for name, _ in known} != {"forward", "right", "up"} or len(known) != 3:
        raise RecordingError(
            f"the IMU's axes are {axes!r}; say where x, y and z point by the parameter axes, such "
            "as 'frd'"
        )
    index = [name for name, _ in known].index(direction)
    return index, known[index][1]


def turned_axes(axes: str, quarters: int) -> str:
    """Return the axes of an IMU that is turned clockwise from above by so many quarters against
    where its axes are said to point.

    One called ``frd`` that is turned by two quarters has the axes ``bld``; its forward axis points
    right after one quarter.

    Args:
        axes: three letters, see :func:`imu_axes`.
        quarters: any whole number.
    """
    around = "frbl"
    return "".join(
        around[(around.index(letter) + quarters) % 4] if letter in around else letter
        for letter in axes.lower()
    )


def last_row(time_ns: Times, at_ns: Times) -> Indices:
    """Return the last row at or before each time, what is known then; -1 where there is none.

    Args:
        time_ns: of the rows, increasing, ``(k,)``.
        at_ns: ``(n,)``.
    """
    return np.asarray(np.searchsorted(time_ns, at_ns, "right") - 1)


def held_means(time_ns: Times, values: Floats, edges_ns: Times, silence_s: float) -> Floats:
    """Return the means of a sensor between successive edges, ``(n,)``.

    A row stands for the time since the row before it. From the last row to an edge that row is
    held, since the next one may lie in the future.

    Args:
        time_ns: of the rows, increasing, ``(k,)``.
        values: ``(k,)``; rows that are NaN do not count.
        edges_ns: increasing, ``(n,)``.
        silence_s: a longer gap between rows, or from the last row to an edge, is not bridged.

    Returns:
        Mean over the interval that ends at each edge; NaN at the first, and over a silence.
    """
    usable = ~np.isnan(values)
    if not usable.all():
        time_ns, values = time_ns[usable], values[usable]
    mean = np.full(edges_ns.size, np.nan)
    if time_ns.size < 2:
        return mean
    steps_s = np.diff(time_ns) * 1e-9
    integral = np.zeros(time_ns.size)
    np.cumsum(values[1:] * steps_s, out=integral[1:])
    last = last_row(time_ns, edges_ns)
    since_s = (edges_ns - time_ns[last]) * 1e-9
    at_edge = integral[last] + values[last] * since_s
    at_edge[(last < 0) | (since_s > silence_s)] = np.nan
    silences = np.searchsorted(np.flatnonzero(steps_s > silence_s) + 1, last, "right")
    mean[1:] = np.diff(at_edge) / (np.diff(edges_ns) * 1e-9)
    mean[1:][np.diff(silences) > 0] = np.nan
    return mean


class ImuMeans(NamedTuple):
    """Means over intervals in the sensor frame, ``(n, 3)``; NaN where rows cover too little.

    Attributes:
        force_mps2: specific force.
        rate_radps: angular rate.
    """

    force_mps2: Floats
    rate_radps: Floats


def interval_means(imu: Table, start_ns: Times, end_ns: Times) -> ImuMeans:
    """Return the mean specific force and angular rate over the intervals ``(start, end]``.

    A row that is averaged over ``interval_s`` contributes its increment to the interval in which it
    ends; a sampled one stands for the time since the row before it, up to :data:`GAP_S`. A row that
    lacks one of the two says nothing of it: accelerometer and gyroscope may tick apart.

    Args:
        imu: rows of kind ``imu``.
        start_ns: ``(n,)``.
        end_ns: ``(n,)``, not before ``start_ns``.
    """
    force, rate = (
        _means(imu, [imu[name] for name in names], start_ns, end_ns).T for names in (FORCE, RATE)
    )
    return ImuMeans(force, rate)


class Standstill(NamedTuple):
    """What standing still means for an IMU.

    Attributes:
        span_s: time before an instant over which it is judged.
        smooth_s: length of the means that smooth the specific force.
        force_std_mps2: standard deviation of the smoothed specific force below which it may stand
            still: root of the summed variances of the axes, so that mounting does not matter.
        rate_rms_radps: root mean square of the angular rate below which it may.
    """

    span_s: float = 1.0
    smooth_s: float = 0.2
    force_std_mps2: float = 0.15
    rate_rms_radps: float = 0.010


def is_stationary(imu: Table, time_ns: Times, limits: Standstill) -> Floats:
    """Return whether the IMU stands still in the span before each time: 1, 0, or NaN where rows are
    missing, ``(n,)``.

    Args:
        imu: rows of kind ``imu``.
        time_ns: ``(n,)``.
        limits: below both of which it stands still.
    """
    force_std, rate_rms = agitation(imu, time_ns, limits.span_s, limits.smooth_s)
    still = (force_std < limits.force_std_mps2) & (rate_rms < limits.rate_rms_radps)
    return np.where(np.isnan(force_std) | np.isnan(rate_rms), np.nan, still)


def agitation(imu: Table, time_ns: Times, span_s: float, smooth_s: float) -> tuple[Floats, Floats]:
    """Return how much force, m/s^2, and rate, rad/s, vary in the span before each time, as
    :class:`Standstill` has it, ``(n,)`` each; NaN where rows are missing.

    Args:
        imu: rows of kind ``imu``.
        time_ns: ``(n,)``.
        span_s: over which they are judged.
        smooth_s: of the force.
    """
    blocks = round(span_s / smooth_s)
    edges = time_ns[:, None] + np.rint(np.linspace(-span_s, 0, blocks + 1) * 1e9).astype(np.int64)
    force = _means(imu, [imu[name] for name in FORCE], edges[:, :-1].ravel(), edges[:, 1:].ravel())
    force_std = np.sqrt(force.reshape(3, -1, blocks).var(axis=2).sum(axis=0))
    x, y, z = (imu[name] for name in RATE)
    rate_rms = np.sqrt(_means(imu, [x * x + y * y + z * z], edges[:, 0], edges[:, -1])[0])
    return force_std, rate_rms


def _means(imu: Table, columns: Sequence[Floats], start_ns: Times, end_ns: Times) -> Floats:
    """Return means of k columns over the rows within each ``(start, end]`` that have them all,
    weighted by the seconds that the rows stand for, ``(k, n)``.
    """
    time_ns, interval_s, known = imu.time_ns, imu["interval_s"], ~np.isnan(columns).any(axis=0)
    if not known.all():
        time_ns, interval_s, columns = (
            time_ns[known],
            interval_s[known],
            [column[known] for column in columns],
        )
    sampled = ~(interval_s > 0)
    weight = interval_s
    if sampled.any():
        elapsed = np.diff(time_ns, prepend=time_ns[:1]) / 1e9
        weight = np.where(sampled, np.minimum(elapsed, GAP_S), interval_s)
    first, last = (np.searchsorted(time_ns, edge_ns, "right") for edge_ns in (start_ns, end_ns))
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
