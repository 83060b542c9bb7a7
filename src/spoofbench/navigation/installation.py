"""What differs from one installation to the next, estimated from clean recordings: how late the
receiver's velocities are against the IMU, and how the IMU is turned in the vehicle.

A detector compares a series of the receiver with one of the IMU over the same intervals. The lag is
where the two agree best: the one at which their correlation over all clean recordings is largest.
It depends on what is compared, since receivers filter turns and accelerations differently, so a
detector fits the lag of its own series (:func:`best_lag`); two series that need no mounting are
here, the yaw rate and the horizontal force. All this looks back at a whole recording: it is for
calibration, never for decisions.
"""

import cmath
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from spoofbench.arrays import Bools, Complexes, Floats, Times
from spoofbench.errors import NotApplicable
from spoofbench.navigation.gnss import lacks_fix, velocity_ned
from spoofbench.navigation.imu import FORCE, RATE, axis_along, imu_axes
from spoofbench.recording import Recording
from spoofbench.table import Table

EARLIEST_S, LATEST_S = -1.0, 3.0
"""The lags that are tried: a receiver may be late, and stamps may be ahead of the IMU's."""
COARSE_S, FINE_S = 0.1, 0.02
BLOCK_S = 60.0
"""Length of the blocks that the jackknife leaves out: errors of neighbouring epochs are alike."""
LEAST_INTERVALS = 10
"""Intervals that a block must know."""
LEAST_BLOCKS = 3
ROUNDING = 1e-9
TINY = 1e-12
TRIMMED = 0.05
LEAST_CORRELATION = 0.3
LARGEST_STD_S = 0.25

LONGEST_SILENCE_S = 0.25
LONGEST_INTERVAL_S = 2.5
SLOWEST_MPS = 1.5
LEVELLING_S = 30.0

MotionSeries = Literal["yaw_rate", "horizontal_force"]


@dataclass(frozen=True, slots=True, eq=False)
class LagSeries:
    """What a detector compares over the intervals of a recording, for any lag.

    Attributes:
        time_ns: ends of the intervals, increasing, ``(n,)``.
        gnss: what the receiver says, of k series, real or complex, ``(k, n)``; NaN is unknown.
        imu: what the IMU says, ``(k, n)``, if the receiver is this many seconds late.
    """

    time_ns: Times
    gnss: Floats | Complexes
    imu: Callable[[float], Floats | Complexes]


@dataclass(frozen=True, slots=True)
class LagEstimate:
    """How late a receiver is.

    Attributes:
        lag_s: positive where its epochs are late against the IMU.
        std_s: standard deviation of that, by the jackknife over blocks of a minute, or over
            recordings where that is larger.
        correlation: of the two series at that lag.
    """

    lag_s: float
    std_s: float
    correlation: float


def best_lag(recordings: Sequence[LagSeries], weights: Sequence[float] = (1.0,)) -> LagEstimate:
    """Return the lag at which the correlation of the two series is largest.

    What is maximised is the mean of the correlations in blocks of a minute, over all recordings,
    each weighted by the variance that both series have there: the smaller of the two. So neither a
    phone that is taken in the hand nor a leap of GNSS decides, and who moves more says more. Of
    complex series the modulus of a block's correlation counts, so that a constant turn between the
    two does not matter. Where several series are compared, the weighted mean of theirs is taken.

    The peak is that of a parabola through the correlations within 0.1 s of the largest. Where rows
    are so coarse that a range of lags is equally good, it is the middle of the range.

    Args:
        recordings: clean ones.
        weights: of the k series, of sum 1.

    Raises:
        NotApplicable: the recordings do not determine the lag; the text says why.
    """
    recordings = [one for one in recordings if one.time_ns.size]
    coarse = np.arange(EARLIEST_S, LATEST_S + COARSE_S / 2, COARSE_S)
    blocks = [_block_terms(one, coarse) for one in recordings]
    minutes = sum(np.count_nonzero(one.known) for one in blocks)
    if minutes < LEAST_BLOCKS:
        raise NotApplicable(
            f"the lag cannot be fitted: GNSS and IMU are known together in {minutes} minutes, and "
            f"{LEAST_BLOCKS} are needed"
        )
    numerator, denominator = _summed(blocks)
    curve = _combined(numerator, denominator, weights)
    best = float(curve.max())
    if not best >= LEAST_CORRELATION:
        raise NotApplicable(
            f"the lag cannot be fitted: the correlation of GNSS and IMU is {best:.2f} at the best, "
            f"and {LEAST_CORRELATION} is needed; more motion may help"
        )
    equal = np.flatnonzero(curve >= best - ROUNDING)
    first_s, last_s = float(coarse[equal[0]]), float(coarse[equal[-1]])
    if equal[0] == 0 or equal[-1] == coarse.size - 1:
        raise NotApplicable(
            f"the lag cannot be fitted: GNSS and IMU agree best at {first_s:.1f} s or beyond"
        )
    middle_s = (first_s + last_s) / 2
    if equal.size > 2:
        return LagEstimate(middle_s, (last_s - first_s) / np.sqrt(12), best)
    fine = middle_s + np.arange(-COARSE_S, COARSE_S + FINE_S / 2, FINE_S)
    return _refined([_block_terms(one, fine) for one in recordings], fine, weights)


class _BlockTerms(NamedTuple):
    """Terms of the mean correlation, per block, series and lag.

    Attributes:
        known: whether enough intervals are known in the block, ``(b,)``; the others weigh nothing.
        products: weight times correlation, ``(b, k, l)``.
        weights: ``(b, k)``.
    """

    known: Bools
    products: Floats
    weights: Floats


def _block_terms(series: LagSeries, lags_s: Floats) -> _BlockTerms:
    minute = (series.time_ns - series.time_ns[0]) // round(BLOCK_S * 1e9)
    starts = np.flatnonzero(np.diff(minute, prepend=-1))
    correlations, variances, counts = [], [], []
    for lag_s in lags_s.tolist():
        x, y = series.imu(lag_s), series.gnss
        known = ~(np.isnan(x) | np.isnan(y))
        x, y = np.where(known, x, 0), np.where(known, y, 0)
        products = np.stack([known, x, y, np.abs(x) ** 2, np.abs(y) ** 2, np.conj(x) * y])
        count, x, y, xx, yy, xy = np.add.reduceat(products, starts, axis=2)
        size = np.maximum(count.real, 1)
        x, y, xx, yy, xy = x / size, y / size, xx.real / size, yy.real / size, xy / size
        xx, yy, xy = xx - np.abs(x) ** 2, yy - np.abs(y) ** 2, xy - np.conj(x) * y
        common = np.abs(xy) if np.iscomplexobj(series.gnss) else xy
        scale = np.sqrt(np.maximum(xx * yy, 0))
        correlations.append(np.divide(common, scale, out=np.zeros_like(scale), where=scale > TINY))
        variances.append(np.where(scale > TINY, np.minimum(xx, yy), 0.0) * count.real)
        counts.append(count.real.min(axis=0))
    known = np.min(counts, axis=0) >= LEAST_INTERVALS
    weights = np.where(known, np.mean(variances, axis=0), 0.0).T
    return _BlockTerms(
        known, np.stack(correlations, -1).swapaxes(0, 1) * weights[:, :, None], weights
    )


def _summed(recordings: Sequence[_BlockTerms]) -> tuple[Floats, Floats]:
    """Return the sums of products, ``(k, l)``, and weights, ``(k,)``, over all blocks."""
    return (
        np.sum([one.products.sum(axis=0) for one in recordings], axis=0),
        np.sum([one.weights.sum(axis=0) for one in recordings], axis=0),
    )


def _combined(products: Floats, weights: Floats, of_series: Sequence[float]) -> Floats:
    """Return the mean correlation at each lag, ``(..., l)``, of summed products, ``(..., k, l)``,
    and weights, ``(..., k)``; 0 where nothing moves.
    """
    means = np.divide(
        products, weights[..., None], out=np.zeros_like(products), where=weights[..., None] > 0
    )
    return np.asarray(np.array(of_series) @ means)


def _refined(
    recordings: Sequence[_BlockTerms], lags_s: Floats, weights: Sequence[float]
) -> LagEstimate:
    """Return the peak among these lags, with the jackknife over blocks and over recordings."""
    products, total = _summed(recordings)
    curve = _combined(products, total, weights)
    lag_s = float(_peaks(lags_s, curve[None])[0])
    blocks = _BlockTerms(*(np.concatenate(terms) for terms in zip(*recordings, strict=True)))
    each = [_summed([one]) for one in recordings if one.known.any()]
    std_s = 0.0
    for out, out_weight in (
        (blocks.products[blocks.known], blocks.weights[blocks.known]),
        (np.stack([one for one, _ in each]), np.stack([one for _, one in each])),
    ):
        if len(out) > 1:
            without = _peaks(lags_s, _combined(products - out, total - out_weight, weights))
            std_s = max(std_s, jackknife_std(without))
    if not std_s <= LARGEST_STD_S:
        raise NotApplicable(
            f"the lag cannot be fitted: {lag_s:.2f} s has a standard deviation of {std_s:.2f} s; "
            "more motion is needed"
        )
    return LagEstimate(lag_s, std_s, float(curve.max()))


def _peaks(lags_s: Floats, curves: Floats) -> Floats:
    """Return the vertex of a parabola through each curve, within the lags, ``(m,)``, of
    ``(m, l)``.
    """
    middle = lags_s.mean()
    curvature, slope, _ = np.polyfit(lags_s - middle, curves.T, 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = np.where(curvature < 0, -slope / (2 * curvature), 0.0)
    return np.asarray(middle + np.clip(offset, lags_s[0] - middle, lags_s[-1] - middle))


def jackknife_std(without: Floats) -> float:
    """Return the standard deviation of an estimate from those that leave out one block each,
    ``(b,)``; infinite where there is one block alone.
    """
    count = without.size
    return float(np.sqrt((count - 1) * without.var())) if count > 1 else np.inf


def trimmed_mean(values: Floats) -> float:
    """Return the mean of the values, ``(n,)``, n > 0, between their 5 % and 95 % points: a few
    outliers do not count.
    """
    low, high = np.quantile(values, (TRIMMED, 1 - TRIMMED))
    return float(values[(values >= low) & (values <= high)].mean())


def motion_series(recording: Recording, which: MotionSeries) -> LagSeries:
    """Return the yaw rate or the horizontal force of a recording, as GNSS and its IMU have it.

    Neither needs to know how the IMU is turned. Its vertical is the mean specific force of 30 s
    around. The yaw rate is in rad/s, clockwise from above. The horizontal force, m/s^2, is complex:
    of GNSS, acceleration along the course + i to its right; of the IMU, along its axis that is
    called forward + i to the right of that. Below 1.5 m/s, where there is no course, GNSS says
    nothing.

    Raises:
        RecordingError: the recording has no GNSS or no IMU, or it is not known how the IMU's axes
            are called.
    """
    number, sign = axis_along(imu_axes(recording), "forward")
    pvt, imu = recording.primary("gnss/pvt").last_per_time(), _Integrated(recording.primary("imu"))
    north, east, _ = velocity_ned(pvt).T
    velocity = north + 1j * east
    velocity[lacks_fix(pvt) | ~(np.abs(velocity) >= SLOWEST_MPS)] = np.nan
    start_ns, end_ns = pvt.time_ns[:-1], pvt.time_ns[1:]
    seconds = (end_ns - start_ns) / 1e9
    seconds[seconds > LONGEST_INTERVAL_S] = np.nan
    course = np.exp(1j * np.angle(velocity[1:] + velocity[:-1]))
    with np.errstate(invalid="ignore"):
        gnss: Floats | Complexes = np.diff(velocity) / seconds * np.conj(course)
    if which == "yaw_rate":
        gnss = np.angle(velocity[1:] * np.conj(velocity[:-1])) / seconds

    def felt(lag_s: float) -> Floats | Complexes:
        lag_ns = round(lag_s * 1e9)
        force, rate = imu.means(start_ns - lag_ns, end_ns - lag_ns)
        up = imu.up(end_ns - lag_ns)
        if which == "yaw_rate":
            return np.asarray(-(rate * up).sum(axis=0)[None])
        forward = np.zeros((3, 1))
        forward[number] = sign
        forward = forward - (forward * up).sum(axis=0) * up
        forward = forward / np.linalg.norm(forward, axis=0)
        right = np.cross(forward, up, axis=0)
        return np.asarray((force * (forward + 1j * right)).sum(axis=0)[None])

    return LagSeries(end_ns, gnss[None], felt)


def imu_heading_rad(recordings: Sequence[Recording], lag_s: float) -> float:
    """Return where the IMU's axis that is called forward points in the vehicle: the angle from the
    nose, clockwise from above, in (-pi, pi].

    It is the angle between what GNSS and IMU see of the horizontal force.

    Args:
        recordings: clean ones of one installation.
        lag_s: of the receiver.

    Raises:
        RecordingError: as :func:`motion_series`.
    """
    common = 0j
    for recording in recordings:
        series = motion_series(recording, "horizontal_force")
        x, y = series.imu(lag_s), series.gnss
        known = ~(np.isnan(x) | np.isnan(y))
        if known.any():
            common += complex(np.vdot(x[known] - x[known].mean(), y[known]))
    return cmath.phase(common)


class _Integrated:
    """Force and rate of an IMU as integrals, which are interpolated: means over any interval take
    the time of a look-up. A row stands for the time since the row before it.
    """

    def __init__(self, imu: Table) -> None:
        values = np.stack([imu[name] for name in FORCE + RATE])
        known = ~np.isnan(values).any(axis=0) & np.append(True, np.diff(imu.time_ns) > 0)
        self.time_ns = imu.time_ns[known]
        steps = np.diff(self.time_ns, prepend=self.time_ns[:1]) / 1e9
        self.integral = np.cumsum(values[:, known] * steps, axis=1)
        silence_s = max(LONGEST_SILENCE_S, 1.5 * float(np.median(steps)) if steps.size else 0.0)
        self.silent = np.cumsum(np.where(steps > silence_s, steps, 0.0))

    def means(self, start_ns: Times, end_ns: Times) -> tuple[Floats, Floats]:
        """Return mean force and rate over the intervals, ``(3, n)`` each; NaN where the IMU is
        silent within.
        """
        if self.time_ns.size < 2:
            nothing = np.full((3, start_ns.size), np.nan)
            return nothing, nothing
        outside = (start_ns < self.time_ns[0]) | (end_ns > self.time_ns[-1])
        unknown = outside | (self._at(self.silent, end_ns) > self._at(self.silent, start_ns))
        seconds = np.where(unknown, np.nan, (end_ns - start_ns) / 1e9)
        means = np.stack([self._at(one, end_ns) - self._at(one, start_ns) for one in self.integral])
        means /= seconds
        return means[:3], means[3:]

    def up(self, at_ns: Times) -> Floats:
        """Return the direction of the mean force of 30 s around each time, ``(3, n)``."""
        half_ns = round(LEVELLING_S / 2 * 1e9)
        mean = (
            np.stack(
                [
                    self._at(one, at_ns + half_ns) - self._at(one, at_ns - half_ns)
                    for one in self.integral[:3]
                ]
            )
            if self.time_ns.size
            else np.full((3, at_ns.size), np.nan)
        )
        with np.errstate(invalid="ignore"):
            return np.asarray(mean / np.linalg.norm(mean, axis=0))

    def _at(self, integral: Floats, at_ns: Times) -> Floats:
        origin = self.time_ns[0]
        return np.asarray(
            np.interp((at_ns - origin) / 1e9, (self.time_ns - origin) / 1e9, integral)
        )
