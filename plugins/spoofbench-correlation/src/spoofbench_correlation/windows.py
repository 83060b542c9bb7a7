"""Correlation over trailing windows of pairs of epochs."""

from typing import NamedTuple

import numpy as np

from spoofbench.arrays import Bools, Floats, Indices, Times

# variance, as share of the mean square, below which too few digits are left of their difference
CANCELLED = 1e-5
VANISHING = 1e-24  # the same, below which a window holds a constant


class WindowCorrelations(NamedTuple):
    """Correlation of k pairs of series over n windows, ``(k, n)`` each.

    Attributes:
        coefficient: in [-1, 1], NaN where a variance vanishes.
        std_x, std_y: standard deviations.
    """

    coefficient: Floats
    std_x: Floats
    std_y: Floats


def first_of_window(start_ns: Times, end_ns: Times, window_s: float) -> Indices:
    """Return the index of the first pair of the window that ends with each pair, ``(n,)``.

    A pair belongs to the window that holds its middle, so jitter of the epochs does not add or drop
    one.

    Args:
        start_ns, end_ns: of the pairs, increasing, ``(n,)``.
        window_s: length of the windows.
    """
    middle = start_ns + (end_ns - start_ns) // 2
    return np.searchsorted(middle, end_ns - round(window_s * 1e9), "right")


def covered_s(dt_s: Floats, valid: Bools, first: Indices) -> Floats:
    """Return the seconds of each window that valid pairs cover, ``(n,)``.

    Args:
        dt_s: length of the pairs, ``(n,)``.
        valid: which pairs count, ``(n,)``.
        first: index of each window's first pair, ``(n,)``.
    """
    total = np.concatenate(
        ([0], np.cumsum(np.where(valid, np.rint(dt_s * 1e9), 0).astype(np.int64)))
    )
    return (total[1:] - total[first]) / 1e9


def correlate(x: Floats, y: Floats, valid: Bools, first: Indices) -> WindowCorrelations:
    """Return the correlation over the valid pairs of each window (Borio, Eq 8, with N terms and
    divisor N).

    Each window is summed on its own, so that its rounding knows nothing of louder times or of the
    future. Where the mean so exceeds the spread that the moments cancel, the window is summed again
    about its mean.

    Args:
        x: ``(k, n)``, n > 0.
        y: ``(k, n)``.
        valid: which pairs count, ``(n,)``; values elsewhere are ignored.
        first: index of each window's first pair, ``(n,)``.
    """
    x, y = np.where(valid, x, 0.0), np.where(valid, y, 0.0)
    end = np.arange(1, valid.size + 1)
    total = np.concatenate(([0], np.cumsum(valid)))
    edges = np.stack((first, end), axis=1).ravel()[:-1]
    sums = np.add.reduceat(np.stack([x, y, x * x, y * y, x * y]), edges, axis=-1)[..., ::2]
    mean_x, mean_y, xx, yy, xy = sums / np.maximum(total[end] - total[first], 1)
    moments = np.stack([xx - mean_x**2, yy - mean_y**2, xy - mean_x * mean_y])
    moving = (xx > 0) & (yy > 0)
    for row, window in np.argwhere(
        moving & ((moments[0] < CANCELLED * xx) | (moments[1] < CANCELLED * yy))
    ).tolist():
        kept = np.flatnonzero(valid[first[window] : window + 1]) + first[window]
        moments[:, row, window] = _central_moments(x[row, kept], y[row, kept])
    variance_x, variance_y, covariance = moments
    loose = moving & (variance_x > VANISHING * xx) & (variance_y > VANISHING * yy)
    std_x, std_y = np.sqrt(np.maximum(variance_x, 0)), np.sqrt(np.maximum(variance_y, 0))
    coefficient = np.divide(covariance, std_x * std_y, out=np.full_like(xx, np.nan), where=loose)
    return WindowCorrelations(np.clip(coefficient, -1, 1), std_x, std_y)


def _central_moments(x: Floats, y: Floats) -> tuple[float, float, float]:
    x, y = x - x.mean(), y - y.mean()
    return float((x * x).mean()), float((y * y).mean()), float((x * y).mean())


def trailing_median(values: Floats, length: int) -> Floats:
    """Return the median of each value and the ``length - 1`` before it, ``(k, n)``; NaN where one
    of them is missing.
    """
    if length == 1:
        return values
    padded = np.concatenate([np.full((values.shape[0], length - 1), np.nan), values], axis=1)
    return np.asarray(
        np.median(np.lib.stride_tricks.sliding_window_view(padded, length, axis=1), axis=2)
    )
