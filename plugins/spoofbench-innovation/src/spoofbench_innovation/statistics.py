"""Tests on innovations: sums of normalised innovations squared against chi-square thresholds."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from spoofbench_innovation.filtering import Innovations

Floats = NDArray[np.float64]
Statistic = Literal["cumulative", "windowed", "per-epoch"]

_LARGEST = 1e9  # a squared innovation beyond it is cut, so that sums stay exact


def ratio(
    time_ns: NDArray[np.int64],
    found: Innovations,
    statistic: Statistic,
    window_s: float,
    p_fa: float,
) -> Floats:
    """Return q / T^2 of each epoch, ``(m,)``; NaN where nothing is measured.

    q is the sum of the normalised innovations squared of the epoch (``per-epoch``), of the epochs
    of the run within the last ``window_s`` (``windowed``), or of all epochs of the run
    (``cumulative``; Tanil et al. 2018, Eq 19). T^2 is exceeded by a chi-square variable of as many
    degrees of freedom as there are measurements in the sum with the probability ``p_fa``.
    """
    size = time_ns.size
    squared = np.nan_to_num(np.minimum(found.squared, _LARGEST), nan=_LARGEST)
    change = np.diff(found.run, prepend=-1) != 0
    first = np.maximum.accumulate(np.where(change, np.arange(size), 0))
    if statistic == "per-epoch":
        first = np.arange(size)
    elif statistic == "windowed":
        first = np.maximum(
            first, np.searchsorted(time_ns, time_ns - round(window_s * 1e9), "right")
        )
    q, degrees = (np.append(0.0, np.cumsum(values)) for values in (squared, found.measured))
    usable = (found.run >= 0) & (found.measured > 0)
    result = np.full(size, np.nan)
    result[usable] = (q[1:] - q[first])[usable] / thresholds_squared(
        (degrees[1:] - degrees[first])[usable], p_fa
    )
    return result


def thresholds_squared(degrees: Floats, p_fa: float) -> Floats:
    """Return T^2 for each number of degrees of freedom: the chi-square point that ``p_fa`` lies
    above.
    """
    from scipy.special import chdtri

    distinct, place = np.unique(degrees, return_inverse=True)
    return np.asarray(chdtri(distinct, p_fa), np.float64)[place]
