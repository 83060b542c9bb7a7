"""The spoofers and monitors of Lo et al. (2017) Table 2, over many runs at once.

Arrays have the shape ``(epochs, runs)`` at 10 Hz; NaN is unavailable. The monitors give the alerts
of :class:`spoofbench_acceleration.AccelerationMonitor`, which a test holds them to.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from spoofbench_acceleration.monitor import AccelerationMonitor
from spoofbench_acceleration.statistics import Executive, chi_square, mean_difference

from spoofbench.arrays import Bools, Floats, Ints
from spoofbench_papers.lo2017.approach import CHOSEN, RATE_HZ

Spoofer = Literal["nominal", "zero", "repeat", "extrapolate", "extrapolate & smooth"]

PAPER = AccelerationMonitor()


def spoofed(
    gnss_mps2: Floats, spoofer: Spoofer, delay_s: float, smoothing_s: float = CHOSEN.smoothing_s
) -> Floats:
    """Return the averaged acceleration that a spoofer shows who knows the true one ``delay_s``
    late.

    ``extrapolate`` follows the slope over one epoch of what it knows, linearly over the delay;
    ``extrapolate & smooth`` is the trailing mean of that. Neither is spelled out in the paper. The
    first rows repeat the first one known.
    """
    if spoofer == "nominal":
        return gnss_mps2
    if spoofer == "zero":
        return np.zeros_like(gnss_mps2)
    steps = round(delay_s * RATE_HZ)
    known = _delayed(gnss_mps2, steps)
    if spoofer == "repeat":
        return known
    ahead = known + steps * (known - _delayed(known, 1))
    return (
        ahead if spoofer == "extrapolate" else _trailing_mean(ahead, round(smoothing_s * RATE_HZ))
    )


@dataclass(frozen=True, slots=True)
class Flags:
    """Which epochs each test flags, ``(epochs, runs)``, the first row being the start of
    evaluation.
    """

    mean_difference: Bools
    chi_square: Bools

    def counts(self) -> tuple[Ints, Ints]:
        """Flags of each test within the last 5 s, counted from the start of evaluation."""
        window = round(PAPER.window_s * RATE_HZ)
        return _moving_sum(self.mean_difference, window), _moving_sum(self.chi_square, window)

    def alerts(self, executive: Executive) -> Bools:
        """Alerts of an executive monitor, Lo et al. (2017) Fig 14."""
        window = PAPER.window_s * RATE_HZ
        both, alone = round(window * PAPER.flagged_share), round(window * PAPER.flagged_share_alone)
        z, chi2 = self.counts()
        simple = (z > both) & (chi2 > both)
        return simple if executive == "simple" else simple | (chi2 > alone)


def flags(difference_mps2: Floats, start: int, stride: int) -> Flags:
    """Test the averaged difference from row ``start`` on; the samples reach back before it."""
    reach = (PAPER.samples - 1) * stride
    samples = np.stack(
        [
            difference_mps2[start - lag : len(difference_mps2) - lag]
            for lag in range(0, reach + 1, stride)
        ]
    )
    z = mean_difference(samples.mean(axis=0), PAPER.bias_mps2, PAPER.sigma_mps2)
    chi2 = chi_square(samples.var(axis=0, ddof=1), PAPER.samples, PAPER.sigma_mps2)
    return Flags(z > PAPER.z_threshold, chi2 > PAPER.chi2_threshold)


def percentage(alerts: Bools) -> Floats:
    """Share of the epochs with an alert, in percent; an unavailable epoch counts as missed;
    ``(runs,)``.
    """
    share: Floats = alerts.mean(axis=0)
    return 100 * share


def first_detection_s(alerts: Bools) -> Floats:
    """Time to first detection, one epoch for an alert in the first, inf for none; ``(runs,)``."""
    first = (np.argmax(alerts, axis=0) + 1) / RATE_HZ
    return np.where(alerts.any(axis=0), first, np.inf)


def _delayed(values: Floats, steps: int) -> Floats:
    return np.concatenate([np.repeat(values[:1], steps, axis=0), values[:-steps]])


def _trailing_mean(values: Floats, steps: int) -> Floats:
    padded = np.concatenate([np.repeat(values[:1], steps, axis=0), values])
    sums = np.cumsum(padded, axis=0)
    means: Floats = (sums[steps:] - sums[:-steps]) / steps
    return means


def _moving_sum(flagged: Bools, window: int) -> Ints:
    sums = np.cumsum(flagged, axis=0, dtype=np.int64)
    sums[window:] -= sums[:-window].copy()
    return sums
