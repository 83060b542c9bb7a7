"""Statistics with their intervals: rates, shares, survival, ROC curves.

Intervals are two-sided and of 95 %. Where there is nothing to estimate, functions return None.

What happens within a session (one outing of one receiver) is not independent, so the session is the
unit of every interval that speaks of more than one. Fewer than :data:`MIN_SESSIONS` give none, and
none has width 0. ``python -m benchmarks.coverage`` measures how often each holds the truth.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from spoofbench.arrays import Bools, Floats

CONFIDENCE = 0.95
_TAIL = (1 - CONFIDENCE) / 2

MIN_SESSIONS = 5
"""Fewest sessions whose spread says anything."""

MIN_EPISODES_PER_SESSION = 5
"""Mean number of episodes per session below which the interval of a rate is not to be relied on."""

TYPICAL_DISPERSION = 30.0
DISPERSION_WEIGHT = 8.0
"""Variance of a session's episodes over their mean that is assumed before any are seen, and the
number of degrees of freedom that it counts as."""

TYPICAL_CORRELATION = 0.5
CORRELATION_WEIGHT = 2.0
"""The same for the correlation of two outcomes within a session."""

BOOTSTRAP_DRAWS = 2000
_DRAWN_AT_ONCE = 1_000_000
"""Sessions drawn before their means are taken: bounds the memory, changes no number."""

_ROUNDING = 1e-12


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value and its two-sided 95 % interval."""

    value: float
    lo: float
    hi: float


def poisson_rate(count: int, exposure: float) -> Estimate | None:
    """Return ``count / exposure`` with the exact interval of a Poisson mean (Garwood 1936).

    The rate is per unit of the exposure, such as per hour; None where there is no exposure.
    """
    if exposure <= 0:
        return None
    from scipy.special import gammainccinv, gammaincinv

    lo = float(gammaincinv(count, _TAIL)) if count else 0.0
    hi = float(gammainccinv(count + 1, _TAIL))
    return Estimate(count / exposure, lo / exposure, hi / exposure)


def rate_interval(episodes: ArrayLike, hours: ArrayLike) -> Estimate | None:
    """Return episodes per hour with an interval that respects how sessions differ.

    It estimates the rate of an hour drawn from all hours: sessions count by their length. Within
    one session the interval is that of :func:`poisson_rate`. From :data:`MIN_SESSIONS` on, the
    total N over H hours is taken as negative binomial with mean R H and variance phi R H, so that
    ``P(X <= N) = I_{1/phi}(R H / (phi - 1), N + 1)``; the ends are the rates R at which either tail
    holds 2.5 %. phi is the dispersion about the pooled rate (that of the ratio estimator, Cochran
    1977, section 2.11), shrunk towards :data:`TYPICAL_DISPERSION` and never below what was seen.

    It falls short, to 88 % of the 95, where lengths differ fortyfold and rates as an exponential
    does: what is typical then is no longer wide enough.

    Args:
        episodes: of each session, shape ``(n,)``.
        hours: that they were counted in, shape ``(n,)``. Sessions without any are left out.

    Returns:
        None without hours, and for 2 to 4 sessions.
    """
    count, time_h = _counted(episodes, hours)
    sessions, total, total_h = count.size, float(count.sum()), float(time_h.sum())
    if sessions == 1:
        return poisson_rate(int(total), total_h)
    if sessions < MIN_SESSIONS:
        return None
    from scipy.special import btdtria

    squares = float(((count - total / total_h * time_h) ** 2).sum())
    # Counts that become rare become Poisson, whose dispersion is 1.
    seen = squares * sessions / (sessions - 1) / total if total else 1.0
    phi = _shrunk(seen, sessions - 1, TYPICAL_DISPERSION, DISPERSION_WEIGHT)
    lo = float(btdtria(1 - _TAIL, total, 1 / phi)) if total else 0.0
    hi = float(btdtria(_TAIL, total + 1, 1 / phi))
    per_hour = (phi - 1) / total_h
    return Estimate(total / total_h, lo * per_hour, hi * per_hour)


def too_few_episodes(episodes: ArrayLike, hours: ArrayLike) -> bool:
    """Whether :func:`rate_interval` of these, shape ``(n,)`` each, must be read with care.

    Over several sessions, with fewer than :data:`MIN_EPISODES_PER_SESSION` on average, their
    dispersion is assumed rather than seen.
    """
    count, _ = _counted(episodes, hours)
    return count.size > 1 and float(count.mean()) < MIN_EPISODES_PER_SESSION


def _counted(episodes: ArrayLike, hours: ArrayLike) -> tuple[Floats, Floats]:
    count, time_h = np.asarray(episodes, float), np.asarray(hours, float)
    return count[time_h > 0], time_h[time_h > 0]


def _shrunk(seen: float, freedom: int, typical: float, weight: float) -> float:
    """Draw an estimate towards what is typical, but never below what was seen."""
    return max(seen, (freedom * seen + weight * typical) / (freedom + weight))


@lru_cache(65536)
def proportion(count: float, trials: float) -> Estimate | None:
    """Return ``count / trials`` with the exact binomial interval (Clopper and Pearson 1934).

    By the beta quantiles, which neither number needs to be whole for.
    """
    if trials == 0:
        return None
    from scipy.special import betainccinv, betaincinv

    lo = float(betaincinv(count, trials - count + 1, _TAIL)) if count else 0.0
    hi = float(betainccinv(count + 1, trials - count, _TAIL)) if count < trials else 1.0
    return Estimate(count / trials, lo, hi)


def session_means(values: ArrayLike, sessions: ArrayLike, among: ArrayLike) -> Floats:
    """Return the mean of each session's known values.

    Args:
        values: of windows, NaN where unknown, shape ``(n,)``.
        sessions: label of each value's session, text or numbers, shape ``(n,)``.
        among: labels of the sessions to answer for, increasing, shape ``(k,)``. Values of others
            are left out.

    Returns:
        Shape ``(k,)``, NaN where a session has no known value.
    """
    value, label, labels = np.asarray(values, float), np.asarray(sessions), np.asarray(among)
    known = ~np.isnan(value) & np.isin(label, labels)
    owner = np.searchsorted(labels, label[known])
    sums = np.bincount(owner, value[known], minlength=labels.size)
    counts = np.bincount(owner, minlength=labels.size)
    means: Floats = np.divide(sums, counts, out=np.full(labels.size, np.nan), where=counts > 0)
    return means


def share_interval(values: ArrayLike, largest: float = 1.0) -> Estimate | None:
    """Return the mean of the sessions' means with its interval.

    It estimates the mean of a session drawn from all sessions: each counts once, however long it
    is or however many windows it has. The interval is that of Clopper and Pearson on the effective
    number of outcomes (Korn and Graubard 1998): n sessions over the correlation of the outcomes
    within one, ``s^2 / (p (1 - p))``, shrunk towards :data:`TYPICAL_CORRELATION` and never below
    what was seen, times the square of the normal quantile over that of Student's t with n - 1
    degrees of freedom. Where all sessions are alike, the effective number is that of the sessions.

    Args:
        values: mean of each session, NaN where unknown, shape ``(n,)``, from 0 to ``largest``.
        largest: what a value can be at most, such as 100 for percentages, or the horizon of
            restricted mean times.

    Returns:
        None below :data:`MIN_SESSIONS` known values.

    Raises:
        ValueError: a value lies outside of its range.
    """
    known = np.asarray(values, float)
    known = known[~np.isnan(known)] / largest
    if known.size < MIN_SESSIONS:
        return None
    if known.min() < -_ROUNDING or known.max() > 1 + _ROUNDING:
        raise ValueError(f"values must lie between 0 and {largest}")
    from scipy.special import ndtri, stdtrit

    known = np.clip(known, 0, 1)
    share, n = float(known.mean()), known.size
    if np.ptp(known) <= _ROUNDING:
        outcomes = float(n)
    else:
        seen = float(known.var(ddof=1)) / (share * (1 - share))
        correlation = _shrunk(seen, n - 1, TYPICAL_CORRELATION, CORRELATION_WEIGHT)
        outcomes = n / correlation * float(ndtri(_TAIL) / stdtrit(n - 1, _TAIL)) ** 2
    found = proportion(share * outcomes, outcomes)
    return found and Estimate(largest * share, largest * found.lo, largest * found.hi)


@dataclass(frozen=True, slots=True, eq=False)
class SurvivalCurve:
    """The share of attacks not yet detected, S(t), as a step function (Kaplan and Meier 1958).

    Attributes:
        time_s: times since the attack began at which one was detected or ended, increasing, shape
            ``(n,)``.
        undetected: S just after each, from 1 down to 0, shape ``(n,)``; it is 1 before the first.
    """

    time_s: Floats
    undetected: Floats

    def quantile_s(self, detected: float) -> float | None:
        """Return the first time by which this share is detected; None where it never is."""
        reached = np.flatnonzero(self.undetected <= 1 - detected + _ROUNDING)
        return float(self.time_s[reached[0]]) if reached.size else None

    def restricted_mean_s(self, horizon_s: float) -> float:
        """Return the mean time to first detection up to a horizon: the integral of S from 0 to it.

        Beyond the last observation S stays as it is: what was not seen to be detected is not
        counted as detected.
        """
        steps_s = np.concatenate([[0.0], np.minimum(self.time_s, horizon_s), [horizon_s]])
        return float(np.diff(steps_s) @ np.append(1.0, self.undetected))


def survival_curve(
    observed_s: Sequence[float] | Floats, detected: Sequence[bool] | Bools
) -> SurvivalCurve | None:
    """Estimate S(t) of attacks.

    Args:
        observed_s: time to first detection of each attack, or its length where it was not detected
            (censored), shape ``(n,)``.
        detected: whether it was, shape ``(n,)``.
    """
    if not len(observed_s):
        return None
    from scipy.stats import CensoredData, ecdf

    missed = ~np.asarray(detected, bool)
    survival = ecdf(CensoredData.right_censored(np.asarray(observed_s, float), missed)).sf
    return SurvivalCurve(survival.quantiles, survival.probabilities)


def roc_curve(clean_score: Floats, spoofed_score: Floats) -> tuple[Floats, Floats] | None:
    """Return the operating points of a detector as its threshold falls through the scores.

    A score is a statistic over its threshold, so scaling it is moving the threshold. NaN is
    unavailable: left out on clean epochs, missed on spoofed ones, so that the curve ends at ``(1,
    available share)``.

    Args:
        clean_score: scores of the clean epochs, shape ``(n,)``.
        spoofed_score: scores of the spoofed epochs, shape ``(m,)``.

    Returns:
        P_FA and P_D per epoch, each non-decreasing from 0, shape ``(k,)``.
    """
    clean = np.sort(clean_score[~np.isnan(clean_score)])
    spoofed = np.sort(spoofed_score[~np.isnan(spoofed_score)])
    if not clean.size or not spoofed_score.size:
        return None
    thresholds = np.unique(np.concatenate([clean, spoofed]))[::-1]
    p_fa, p_d = (
        np.append(0.0, (scores.size - np.searchsorted(scores, thresholds, "left")) / epochs)
        for scores, epochs in ((clean, clean.size), (spoofed, spoofed_score.size))
    )
    return p_fa, p_d


def partial_auc(p_fa: Floats, p_d: Floats, limit: float) -> float:
    """Return the area under a ROC curve up to ``P_FA = limit``, over the limit.

    1 is perfect, limit / 2 is chance. The curve is that of
    :func:`roc_curve`, shape ``(k,)`` each, and reaches the limit.
    """
    below = p_fa < limit
    last = int(np.flatnonzero(below)[-1])
    after = last + 1
    slope = (p_d[after] - p_d[last]) / (p_fa[after] - p_fa[last])
    x = np.append(p_fa[below], limit)
    y = np.append(p_d[below], p_d[last] + slope * (limit - p_fa[last]))
    return float(np.trapezoid(y, x)) / limit


def session_interval(
    values: ArrayLike, sessions: ArrayLike, seed: int = 0
) -> tuple[float, float] | None:
    """Return the 95 % percentile-bootstrap interval of the mean, resampling whole sessions.

    Values of one session are not independent. None below :data:`MIN_SESSIONS` sessions.

    Args:
        values: shape ``(n,)``.
        sessions: label of each value's session, text or numbers, shape ``(n,)``.
        seed: of the resampling: equal input, equal interval.
    """
    labels, owner = np.unique(np.asarray(sessions), return_inverse=True)
    if labels.size < MIN_SESSIONS:
        return None
    sums, counts = np.bincount(owner, np.asarray(values, float)), np.bincount(owner)
    rng = np.random.default_rng(seed)
    means = np.empty(BOOTSTRAP_DRAWS)
    at_once = max(1, _DRAWN_AT_ONCE // labels.size)
    for first in range(0, BOOTSTRAP_DRAWS, at_once):
        some = means[first : first + at_once]
        drawn = rng.integers(labels.size, size=(some.size, labels.size))
        some[:] = sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
    tail = 50 * (1 - CONFIDENCE)
    lo, hi = np.percentile(means, [tail, 100 - tail])
    return float(lo), float(hi)
