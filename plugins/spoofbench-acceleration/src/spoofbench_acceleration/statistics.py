"""The averaging, the two test statistics and the executive monitors of Lo et al. (2017).

All of them are causal: row k of a result depends on rows up to k alone. NaN is unavailable.
"""

from typing import Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from spoofbench.arrays import Floats, Indices, Ints

Averaging = Literal["span", "time_constant"]
Executive = Literal["simple", "multi"]

_INTERVALS = 9
_BLOCK = 1_000_000


def weights(steps_s: Floats, averaging_s: float, averaging: Averaging) -> Floats:
    """Return the weights of new samples in the exponential average over T seconds, ``(n,)``.

    The paper does not say what its 5 s are: of a span, 2 / (T / dt + 1), they turn its static 1.198
    m/s^2 into 0.028 as printed; as a time constant, 1 - exp(-dt / T), they suit its accelerometer
    better.

    Args:
        steps_s: dt, the time since the sample before, ``(n,)``.
        averaging_s: T.
        averaging: what T means.
    """
    if averaging == "span":
        return 2 / (averaging_s / steps_s + 1)
    return -np.expm1(-steps_s / averaging_s)


def exponential_average(
    time_s: Floats, values: Floats, averaging_s: float, averaging: Averaging
) -> tuple[Floats, Ints]:
    """Return the exponential average, NaN where the input is, and the number of the run that each
    row belongs to, ``(n,)`` each.

    An unavailable input holds the state; more than ``averaging_s`` since the last available one
    restarts the average with its input, as a new run.

    Args:
        time_s: ``(n,)``, increasing.
        values: ``(n,)``.
        averaging_s: T.
        averaging: what T means, see :func:`weights`.
    """
    average, runs = np.full(values.size, np.nan), np.zeros(values.size, np.int64)
    rows = np.flatnonzero(~np.isnan(values))
    steps_s = np.diff(time_s[rows], prepend=-np.inf)
    restart = steps_s > averaging_s
    weight = np.where(
        restart, 1.0, weights(np.minimum(steps_s, averaging_s), averaging_s, averaging)
    )
    state, averages = 0.0, []
    for value, share, anew in zip(
        values[rows].tolist(), weight.tolist(), restart.tolist(), strict=True
    ):
        state = value if anew else state + share * (value - state)
        averages.append(state)
    average[rows], runs[rows] = averages, np.cumsum(restart)
    return average, runs


def sample_statistics(
    differences: Floats, runs: Ints, samples: int, stride: int
) -> tuple[Floats, Floats]:
    """Return mean and unbiased variance of the last samples, ``(n,)`` each; NaN unless all of them
    are available and of one run.

    Args:
        differences: averaged acceleration difference, m/s^2, ``(n,)``.
        runs: from :func:`exponential_average`, ``(n,)``.
        samples: how many, n of Lo et al. (2017) Eq (6).
        stride: every how many rows one is taken, the last row being the newest sample.
    """
    mean, variance = np.full(differences.size, np.nan), np.full(differences.size, np.nan)
    reach = (samples - 1) * stride
    if differences.size > reach:
        windows = sliding_window_view(differences, reach + 1)[:, ::stride]
        whole = runs[reach:] == runs[: differences.size - reach]
        mean[reach:] = np.where(whole, windows.mean(axis=1), np.nan)
        variance[reach:] = np.where(whole, windows.var(axis=1, ddof=1), np.nan)
    return mean, variance


def mean_difference(mean: Floats, bias_mps2: float, sigma_mps2: float) -> Floats:
    """Return z of Lo et al. (2017) Eq (5), ``(n,)``, with the absolute mean: its threshold 6.1 is a
    two-sided one.

    Args:
        mean: of the averaged difference, m/s^2, ``(n,)``.
        bias_mps2: largest nominal bias.
        sigma_mps2: standard deviation of the averaged difference.
    """
    return np.maximum(np.abs(mean) - bias_mps2, 0) / sigma_mps2


def chi_square(variance: Floats, samples: int, sigma_mps2: float) -> Floats:
    """Return the chi-square statistic of Lo et al. (2017) Eq (6), ``(n,)``, of ``samples`` - 1
    degrees of freedom.

    Args:
        variance: of the last samples, (m/s^2)^2, ``(n,)``.
        samples: how many.
        sigma_mps2: standard deviation of the averaged difference.
    """
    return (samples - 1) * variance / sigma_mps2**2


def nominal_interval_s(time_s: Floats) -> Floats:
    """Return the median of the last nine intervals at each row, ``(n,)``; NaN at the first."""
    steps = np.full(time_s.size + _INTERVALS - 1, np.nan)
    steps[_INTERVALS:] = np.diff(time_s)
    windows = np.sort(sliding_window_view(steps, _INTERVALS), axis=1)
    known = np.minimum(np.arange(time_s.size), _INTERVALS)
    middle: Floats = windows[np.arange(time_s.size), np.maximum(known - 1, 0) // 2]
    return middle


def executive_margin(
    time_s: Floats,
    z: Floats,
    chi2: Floats,
    window_s: float,
    flags: tuple[float, float],
    executive: Executive,
) -> Floats:
    """Return the executive monitor's margin: above 1 exactly where it alerts; ``(n,)``.

    A test flags where its ratio is above 1. With W the epochs of the window at the receiver's rate,
    more than K1 = round(W flags[0]) flags of each test within the window alert; in the
    multi-condition monitor also more than K2 = round(W flags[1]) flags of the chi-square test (Lo
    et al. 2017, Figure 14). The margin is the (K + 1)-th largest ratio in the window, so that
    scaling it is scaling the tests' thresholds.

    Args:
        time_s: ``(n,)``, increasing.
        z: mean-difference statistic over its threshold, NaN is no flag.
        chi2: chi-square statistic over its threshold, NaN is no flag.
        window_s: length of the observation window.
        flags: shares of the window that must be flagged, of both tests and of the chi-square test
            alone.
        executive: which monitor.
    """
    if time_s.size < 2:
        return np.zeros(time_s.size)
    interval_s = nominal_interval_s(time_s)
    interval_s[0] = interval_s[1]
    epochs = np.maximum(np.round(window_s / interval_s), 1)
    first = np.searchsorted(time_s, time_s - window_s + interval_s / 2, "right")
    first = np.minimum(first, np.arange(time_s.size))
    both, alone = (np.floor(epochs * share + 0.5).astype(int) for share in flags)
    margin = np.minimum(_ranked(z, first, both), _ranked(chi2, first, both))
    return margin if executive == "simple" else np.maximum(margin, _ranked(chi2, first, alone))


def _ranked(ratios: Floats, first: Indices, rank: Ints) -> Floats:
    """Return each row's (rank + 1)-th largest ratio since its first row, 0 where there are fewer;
    ``(n,)``.
    """
    rows = np.arange(first.size)
    longest = int(np.max(rows - first)) + 1
    windows = sliding_window_view(
        np.concatenate([np.zeros(longest - 1), np.nan_to_num(ratios, posinf=np.inf)]), longest
    )
    age = np.arange(longest - 1, -1, -1)
    result = np.zeros(first.size)
    for block in np.array_split(rows, max(1, first.size * longest // _BLOCK)):
        inside = age <= (block - first[block])[:, None]
        smallest_first = np.sort(np.where(inside, windows[block], 0.0), axis=1)
        enough = rank[block] < longest
        result[block] = np.where(
            enough,
            smallest_first[
                np.arange(block.size), longest - 1 - np.minimum(rank[block], longest - 1)
            ],
            0.0,
        )
    return result
