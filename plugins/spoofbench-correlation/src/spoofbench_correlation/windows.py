"""Correlation over trailing windows of pairs of epochs."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Counts = NDArray[np.intp]

BLOCK = 512  # windows that are centred on one value
VANISHING = 1e-10  # variance, as share of the mean square, below which a window holds a constant


class Correlation(NamedTuple):
    """Per window, shapes ``(k, n)``: coefficients in [-1, 1], NaN where a variance vanishes, and standard deviations."""

    coefficient: Floats
    std_x: Floats
    std_y: Floats


def first_of_window(start_ns: NDArray[np.int64], end_ns: NDArray[np.int64], window_s: float) -> Counts:
    """Index of the first pair of the window that ends with each pair, shape ``(n,)``.

    A pair belongs to the window that holds its middle, so jitter of the epochs does not add or drop one.
    """
    middle = start_ns + (end_ns - start_ns) // 2
    return np.searchsorted(middle, end_ns - round(window_s * 1e9), "right")


def covered_s(dt_s: Floats, valid: NDArray[np.bool_], first: Counts) -> Floats:
    """Seconds of each window that valid pairs cover, shape ``(n,)``."""
    total = np.concatenate(([0], np.cumsum(np.where(valid, np.rint(dt_s * 1e9), 0).astype(np.int64))))
    return (total[1:] - total[first]) / 1e9


def correlate(x: Floats, y: Floats, valid: NDArray[np.bool_], first: Counts) -> Correlation:
    """Correlation coefficients over the valid pairs of each window (Borio, Eq 8, with N terms and divisor N).

    Sums are formed window by window, about a value from the block's first window: so nothing of louder times
    outside the window and nothing of the future is in their rounding.

    Args:
        x: shape ``(k, n)``.
        y: shape ``(k, n)``.
        valid: which pairs count, shape ``(n,)``; values elsewhere are ignored.
        first: index of each window's first pair, non-decreasing, shape ``(n,)``.
    """
    both = np.where(valid, np.stack([x, y]), 0.0)
    moments = np.empty((5, *x.shape))
    anchors = np.empty((2, *x.shape))
    for start in range(0, valid.size, BLOCK):
        stop = min(start + BLOCK, valid.size)
        rows = slice(int(first[start]), stop)
        head = slice(rows.start, start + 1)
        anchor = both[:, :, head].sum(axis=2, keepdims=True) / max(int(valid[head].sum()), 1)
        a, b = np.where(valid[rows], both[:, :, rows] - anchor, 0.0)
        terms = np.stack([a, b, a * a, b * b, a * b])
        moments[..., start:stop] = _window_sums(terms, first[start:stop] - rows.start, np.arange(start, stop) + 1 - rows.start)
        anchors[..., start:stop] = anchor
    total = np.concatenate(([0], np.cumsum(valid)))
    return _coefficients(moments / np.maximum(total[1:] - total[first], 1), anchors)


def trailing_median(values: Floats, length: int) -> Floats:
    """Median of each value and the ``length - 1`` before it; NaN where one of them is missing. Shape ``(k, n)``."""
    if length == 1:
        return values
    padded = np.concatenate([np.full((values.shape[0], length - 1), np.nan), values], axis=1)
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, length, axis=1), axis=2))


def _window_sums(terms: Floats, first: Counts, end: Counts) -> Floats:
    """Sums of ``terms[..., first:end]``, every window of at least one element."""
    edges = np.stack((first, end), axis=1).ravel()
    return np.asarray(np.add.reduceat(terms, edges[:-1], axis=-1)[..., ::2])


def _coefficients(moments: Floats, anchors: Floats) -> Correlation:
    mean_x, mean_y, xx, yy, xy = moments
    variance_x, variance_y = xx - mean_x**2, yy - mean_y**2
    anchor_x, anchor_y = anchors
    loose = (variance_x > VANISHING * (xx + anchor_x**2)) & (variance_y > VANISHING * (yy + anchor_y**2))
    std_x, std_y = np.sqrt(np.maximum(variance_x, 0)), np.sqrt(np.maximum(variance_y, 0))
    coefficient = np.divide(xy - mean_x * mean_y, std_x * std_y, out=np.full_like(xx, np.nan), where=loose)
    return Correlation(np.clip(coefficient, -1, 1), std_x, std_y)
