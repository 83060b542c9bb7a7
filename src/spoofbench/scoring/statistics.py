"""Estimates with their intervals: rates, proportions, survival, ROC. None where there is nothing to
estimate.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

CONFIDENCE = 0.95
MIN_SESSIONS = 5
BOOTSTRAP_DRAWS = 2000
_ROUNDING = 1e-12


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value and its two-sided 95 % interval."""

    value: float
    lo: float
    hi: float


def poisson_rate(count: int, exposure: float) -> Estimate | None:
    """Return ``count / exposure`` with the exact interval of a Poisson mean (Garwood 1936)."""
    if exposure <= 0:
        return None
    from scipy.stats import chi2

    tail = (1 - CONFIDENCE) / 2
    lo = float(chi2.ppf(tail, 2 * count)) / 2 if count else 0.0
    hi = float(chi2.isf(tail, 2 * count + 2)) / 2
    return Estimate(count / exposure, lo / exposure, hi / exposure)


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
class Survival:
    """The share of attacks not yet detected, S(t), as a step function (Kaplan and Meier 1958).

    Attributes:
        time_s: times of detections, increasing, shape ``(n,)``.
        undetected: S just after each, shape ``(n,)``; it is 1 before the first.
    """

    time_s: Floats
    undetected: Floats

    def quantile_s(self, detected: float) -> float | None:
        """Return the first time by which this share is detected; None where it never is."""
        reached = np.flatnonzero(self.undetected <= 1 - detected + _ROUNDING)
        return float(self.time_s[reached[0]]) if reached.size else None

    def restricted_mean_s(self, horizon_s: float) -> float:
        """Return the mean time to first detection restricted to a horizon: the integral of S from 0
        to there.

        Beyond the last observation S stays as it is: what was not seen to be detected is not
        counted as detected.
        """
        steps_s = np.concatenate([[0.0], np.minimum(self.time_s, horizon_s), [horizon_s]])
        return float(np.diff(steps_s) @ np.append(1.0, self.undetected))


def survival(observed_s: Sequence[float], detected: Sequence[bool]) -> Survival | None:
    """Estimate S(t) from times to first detection, censored (at the attack's length) where not
    detected.
    """
    if not len(observed_s):
        return None
    observed, flags = np.asarray(observed_s, float), np.asarray(detected, bool)
    time_s, detections = np.unique(observed[flags], return_counts=True)
    at_risk = observed.size - np.searchsorted(np.sort(observed), time_s, "left")
    return Survival(time_s, np.cumprod(1 - detections / at_risk, dtype=np.float64))


def roc(clean_score: Floats, spoofed_score: Floats) -> tuple[Floats, Floats] | None:
    """Return ``(p_fa, p_d)``, each non-decreasing from 0, as the threshold falls through the
    scores.

    A score is a statistic over its threshold, so scaling it is moving the threshold. NaN is
    unavailable: left out on clean epochs, missed on spoofed ones, so that the curve ends at ``(1,
    available share)``.
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
    """Return the area under the ROC curve up to ``P_FA = limit``, over the limit: 1 is perfect,
    limit / 2 is chance.
    """
    below = p_fa < limit
    last = int(np.flatnonzero(below)[-1])
    after = last + 1
    slope = (p_d[after] - p_d[last]) / (p_fa[after] - p_fa[last])
    x = np.append(p_fa[below], limit)
    y = np.append(p_d[below], p_d[last] + slope * (limit - p_fa[last]))
    return float(np.trapezoid(y, x)) / limit


def session_interval(
    values: Sequence[float], sessions: Sequence[str], seed: int = 0
) -> tuple[float, float] | None:
    """Return the 95 % percentile-bootstrap interval of the mean, resampling whole sessions.

    Values of one session are not independent. None below 5 sessions, where resampling them says
    nothing.
    """
    names, owner = np.unique(np.asarray(sessions, str), return_inverse=True)
    if names.size < MIN_SESSIONS:
        return None
    sums, counts = np.bincount(owner, np.asarray(values, float)), np.bincount(owner)
    drawn = np.random.default_rng(seed).integers(names.size, size=(BOOTSTRAP_DRAWS, names.size))
    means = sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
    tail = 50 * (1 - CONFIDENCE)
    lo, hi = np.percentile(means, [tail, 100 - tail])
    return float(lo), float(hi)
