"""Statistics with their intervals: rates, proportions, survival, ROC curves.

Intervals are two-sided and of 95 %. Where there is nothing to estimate, functions return None.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from spoofbench.arrays import Bools, Floats

CONFIDENCE = 0.95
MIN_SESSIONS = 5
"""Fewest sessions whose resampling says anything."""

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
    from scipy.stats import chi2

    tail = (1 - CONFIDENCE) / 2
    lo = float(chi2.ppf(tail, 2 * count)) / 2 if count else 0.0
    hi = float(chi2.isf(tail, 2 * count + 2)) / 2
    return Estimate(count / exposure, lo / exposure, hi / exposure)


@lru_cache(65536)
def proportion(count: int, trials: int) -> Estimate | None:
    """Return ``count / trials`` with the exact binomial interval (Clopper and Pearson 1934)."""
    if trials == 0:
        return None
    from scipy.stats import beta

    tail = (1 - CONFIDENCE) / 2
    lo = float(beta.ppf(tail, count, trials - count + 1)) if count else 0.0
    hi = float(beta.isf(tail, count + 1, trials - count)) if count < trials else 1.0
    return Estimate(count / trials, lo, hi)


@dataclass(frozen=True, slots=True, eq=False)
class SurvivalCurve:
    """The share of attacks not yet detected, S(t), as a step function (Kaplan and Meier 1958).

    Attributes:
        time_s: times of detections since the attack began, increasing, shape ``(n,)``.
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
    observed, was_detected = np.asarray(observed_s, float), np.asarray(detected, bool)
    time_s, detections = np.unique(observed[was_detected], return_counts=True)
    at_risk = observed.size - np.searchsorted(np.sort(observed), time_s, "left")
    return SurvivalCurve(time_s, np.cumprod(1 - detections / at_risk, dtype=np.float64))


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
