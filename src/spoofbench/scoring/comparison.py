"""Which rows can be told apart from the first, session by session.

Rows face the same sessions, so that their differences are compared within each: what makes a
session hard is common to both. The test asks whether the signs of the differences are by chance.
"""

from dataclasses import dataclass
from math import ceil, log2

import numpy as np
from numpy.typing import ArrayLike

from spoofbench.arrays import Floats
from spoofbench.scoring.statistics import CONFIDENCE, Estimate, share_interval

LEVEL = 1 - CONFIDENCE
"""Chance that any row is told apart from the first although none differs."""

POWER = 0.8
"""Chance to tell a row apart that :attr:`Comparison.sessions_needed` asks for."""

_EXACT_SESSIONS = 15
_DRAWS = 2**_EXACT_SESSIONS - 1
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class Comparison:
    """A row against the first.

    Attributes:
        sessions: in which both are known.
        difference: mean over them of the row's value minus the first's, with its interval; None
            below 5 sessions, or where a value has no upper bound.
        p: of the sign-flip test, adjusted for the number of rows (Holm 1979); None without a common
            session.
        told_apart: whether ``p`` is at most :data:`LEVEL`.
        sessions_needed: about how many would tell the two apart; None where they are, and where no
            difference was seen.
    """

    sessions: int
    difference: Estimate | None
    p: float | None
    told_apart: bool
    sessions_needed: int | None


def compare_with_first(values: ArrayLike, largest: float | None = None) -> tuple[Comparison, ...]:
    """Compare each row with the first, in pairs by session.

    The interval of a difference d is that of :func:`share_interval` for (1 + d) / 2, which lies
    between 0 and 1 as values do between 0 and ``largest``. It is one at a time, not adjusted for
    the number of rows, and wider than the test where differences are small.

    Args:
        values: a figure of each row in each session, NaN where unknown, shape ``(rows, sessions)``.
        largest: what a value from 0 on can be at most, such as 1 for shares; None where it has no
            bound, as rates, whose differences get no interval.

    Returns:
        One of each row but the first, shape ``(rows - 1,)``.
    """
    figures = np.asarray(values, float)
    differences = [_known(row - figures[0]) for row in figures[1:]]
    p = holm([sign_flip_p(difference) for difference in differences])
    return tuple(
        Comparison(
            sessions=difference.size,
            difference=None if largest is None else _difference_interval(difference, largest),
            p=adjusted if difference.size else None,
            told_apart=adjusted <= LEVEL,
            sessions_needed=None
            if adjusted <= LEVEL
            else sessions_needed(difference, len(differences)),
        )
        for difference, adjusted in zip(differences, p, strict=True)
    )


def sign_flip_p(differences: ArrayLike, seed: int = 0) -> float:
    """Return the two-sided p value of a mean of 0 when every difference is as likely as its
    negative (Fisher 1935).

    Exact up to 15 differences; above, from 32,767 draws of signs and the signs that were seen
    (Phipson and Smyth 2010). 1 where there are none.

    Args:
        differences: one per session, shape ``(n,)``.
        seed: of the draws.
    """
    difference = np.asarray(differences, float)
    if difference.size <= _EXACT_SESSIONS:
        sums = np.zeros(1)
        for one in difference:
            sums = np.concatenate([sums + one, sums - one])
    else:
        drawn = np.random.default_rng(seed).integers(2, size=(_DRAWS, difference.size))
        sums = np.append((1 - 2 * drawn) @ difference, difference.sum())
    rounding = _ROUNDING * np.abs(difference).sum()
    return float((np.abs(sums) >= abs(difference.sum()) - rounding).mean())


def holm(p: ArrayLike) -> list[float]:
    """Return the p values of several tests, adjusted so that the chance of any false rejection is
    at most the level they are held against (Holm 1979).

    Args:
        p: shape ``(n,)``.
    """
    raw = np.asarray(p, float)
    order = np.argsort(raw, kind="stable")
    stepped = np.maximum.accumulate(raw[order] * np.arange(raw.size, 0, -1))
    adjusted = np.empty(raw.size)
    adjusted[order] = np.minimum(stepped, 1)
    return adjusted.tolist()


def fewest_sessions(comparisons: int) -> int:
    """Return the fewest sessions with which one of so many rows can be told apart from the first.

    The sign-flip test of n sessions cannot go below ``2 / 2^n``, and Holm's first step asks for the
    level over the number of comparisons.
    """
    return ceil(log2(2 * max(comparisons, 1) / LEVEL) - _ROUNDING)


def sessions_needed(differences: ArrayLike, comparisons: int) -> int | None:
    """Return about how many sessions would tell two rows apart that differ as these do.

    With normal quantiles, at Holm's first step and :data:`POWER`, for the mean and the spread that
    were seen, at least one more session than there are and at least :func:`fewest_sessions`.

    Args:
        differences: one per session, shape ``(n,)``; that they do not suffice is known.
        comparisons: number of rows that are compared with the first.

    Returns:
        None where no difference was seen.
    """
    difference = np.asarray(differences, float)
    mean = float(difference.mean()) if difference.size else 0.0
    if abs(mean) <= _ROUNDING * float(np.abs(difference).max(initial=0.0)):
        return None
    from scipy.special import ndtri

    spread = float(difference.std(ddof=1)) if difference.size > 1 else 0.0
    quantiles = float(ndtri(1 - LEVEL / 2 / comparisons) + ndtri(POWER))
    wanted = ceil((quantiles * spread / mean) ** 2)
    return max(wanted, difference.size + 1, fewest_sessions(comparisons))


def _known(values: Floats) -> Floats:
    return values[~np.isnan(values)]


def _difference_interval(differences: Floats, largest: float) -> Estimate | None:
    found = share_interval((largest + differences) / 2, largest)
    if found is None:
        return None
    value, lo, hi = (2 * end - largest for end in (found.value, found.lo, found.hi))
    return Estimate(value, lo, hi)
