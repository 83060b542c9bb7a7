"""Array types that signatures name, and steps on arrays that many modules take.

An alias says what the numbers are; the shape stands in the docstring, as ``(n,)`` or ``(n, 3)``.
"""

from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Complexes = NDArray[np.complex128]
Octets = NDArray[np.uint8]
"""Bytes as numbers."""
Times = NDArray[np.int64]
"""Nanoseconds: Unix time, unless the name says otherwise."""
Indices = NDArray[np.intp]
"""Row numbers, from 0; -1 where there is none."""

T = TypeVar("T", bound=np.generic)


def last_index(known: Bools) -> Indices:
    """Return the index of the last true entry up to and including each one, -1 before the first.

    Args:
        known: shape ``(n,)``.

    Returns:
        Shape ``(n,)``.
    """
    return np.maximum.accumulate(np.where(known, np.arange(known.size), -1))


def forward_fill(values: NDArray[T], known: Bools, before: Any) -> NDArray[T]:
    """Return each value that is known, and the last known one elsewhere.

    Args:
        values: shape ``(..., n)``; filled along the last axis.
        known: shape ``(n,)``; values elsewhere are ignored.
        before: what stands before the first known value; a scalar, or shape ``(..., 1)``.

    Returns:
        Shape ``(..., n)``, of the dtype of ``values``.
    """
    index = last_index(known)
    filled: NDArray[T] = np.where(index >= 0, values[..., np.maximum(index, 0)], before)
    return filled.astype(values.dtype, copy=False)


def run_starts(labels: NDArray[Any]) -> Indices:
    """Return the index at which each entry's run of equal labels begins.

    Args:
        labels: shape ``(n,)``.

    Returns:
        Shape ``(n,)``: ``[7, 7, 3, 7]`` gives ``[0, 0, 2, 3]``.
    """
    begins = np.ones(labels.size, bool)
    begins[1:] = labels[1:] != labels[:-1]
    return last_index(begins)


def ragged_arange(counts: ArrayLike) -> Indices:
    """Return 0, 1, ... for each group on its own.

    Args:
        counts: length of each group, none negative, shape ``(k,)``.

    Returns:
        Shape ``(sum of counts,)``: ``[2, 0, 3]`` gives ``[0, 1, 0, 1, 2]``.
    """
    sizes = np.asarray(counts, np.intp)
    ends = np.cumsum(sizes)
    total = int(ends[-1]) if ends.size else 0
    return np.asarray(np.arange(total) - np.repeat(ends - sizes, sizes))


def ragged_ranges(starts: ArrayLike, counts: ArrayLike) -> Indices:
    """Return the ranges ``start, start + 1, ...`` of all groups, one after the other.

    Args:
        starts: first index of each group, shape ``(k,)``.
        counts: length of each group, none negative, shape ``(k,)``.

    Returns:
        Shape ``(sum of counts,)``: ``[5, 9], [2, 1]`` gives ``[5, 6, 9]``.
    """
    sizes = np.asarray(counts, np.intp)
    return np.asarray(np.repeat(np.asarray(starts, np.intp), sizes) + ragged_arange(sizes))
