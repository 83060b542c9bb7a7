"""Thresholds from clean recordings: the factor at which a detector keeps a false-alert rate.

A score is a statistic over its threshold, so an operating point is a factor c: alert = score > c.
What a clean recording says of all factors at once is its :class:`EpisodeCurve`; the curves of many
add up, and :func:`threshold` reads the factor off their sum. No detector runs again.

The rule, where T hours of clean, available material may have a rate r: K = floor(r T) - 1 episodes
are allowed, because a threshold at which K remain is crossed (K + 1) / T times per hour of new
material, in expectation. Candidates are the distinct finite positive values of
:func:`~spoofbench.scoring.metrics.alarm_level` on the epochs that count. Episodes merge, so their
number does not fall throughout as c rises; c is the smallest candidate at which, *and at every
larger one*, at most K remain.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import accumulate
from math import floor
from typing import Literal

import numpy as np

from spoofbench.arrays import Bools, Floats, Indices, Ints, Times
from spoofbench.recording import Interval
from spoofbench.scoring.metrics import MAX_EPISODE_NS, separation_ns, steps_ns

How = Literal["calibrated", "raised only", "no clean score", "uncalibratable"]


@dataclass(frozen=True, slots=True, eq=False)
class EpisodeCurve:
    """How many alarm episodes clean material has at each factor.

    Attributes:
        levels: levels at which the number changes, and the smallest there is; all above 0 and
            decreasing, float64 ``(m,)``. The first is infinite where a clean score is.
        episodes: number of episodes of the alarm ``level of the epoch >= levels``, int64 ``(m,)``.
        clean_ns: available clean time, in nanoseconds: sums are exact in any order.
    """

    levels: Floats
    episodes: Ints
    clean_ns: int

    @property
    def hours(self) -> float:
        """Available clean time."""
        return self.clean_ns / 3.6e12

    @property
    def infinite(self) -> bool:
        """Whether a clean score is infinite: no factor silences it."""
        return bool(self.levels.size) and bool(np.isinf(self.levels[0]))

    def episodes_at(self, factor: float) -> int:
        """Return the episodes at a factor above 0: of the alarm ``level > factor``."""
        above = int(np.searchsorted(-self.levels, -factor, "left"))
        return int(self.episodes[above - 1]) if above else 0

    def __add__(self, other: "EpisodeCurve") -> "EpisodeCurve":
        """Return the curve of both materials together, whose episodes do not touch."""
        levels = np.concatenate([self.levels, other.levels])
        steps = np.concatenate([np.diff(curve.episodes, prepend=[0]) for curve in (self, other)])
        order = np.argsort(-levels, kind="stable")
        return _curve(levels[order], np.cumsum(steps[order]), self.clean_ns + other.clean_ns)


NO_CLEAN_TIME = EpisodeCurve(np.empty(0), np.empty(0, np.int64), 0)
"""The curve of no material: adding it changes nothing."""


@dataclass(frozen=True, slots=True)
class Threshold:
    """The factor of an operating point and what it rests on.

    Attributes:
        factor: alert = score > factor; None where uncalibratable.
        how: ``calibrated`` by the rule of this module; ``raised only`` where the material is too
            short to show one episode at the target (c = max(1, largest level)); ``no clean score``
            where no level is positive (c = 1); ``uncalibratable`` where one is infinite.
        hours: of the material, T.
        allowed: episodes that were allowed, K; 0 where the material is too short.
        episodes: that remain at the factor; None where uncalibratable.
        largest_expected_per_hour: (K + 1) / T, the rate that new material of the same kind has in
            expectation, or less; at most the target where calibrated. None where uncalibratable or
            without material.
    """

    factor: float | None
    how: How
    hours: float
    allowed: int
    episodes: int | None
    largest_expected_per_hour: float | None

    @property
    def allowed_per_hour(self) -> float | None:
        """K / T, the rate of the material itself at this operating point, or less."""
        return self.allowed / self.hours if self.hours else None


def episode_curve(time_ns: Times, level: Floats, counted: Bools, epoch_ns: int) -> EpisodeCurve:
    """Return the exact episode curve of one clean task.

    At any factor c > 0 its number is that of
    :func:`~spoofbench.scoring.metrics.count_episodes` with the alarm ``level > c``. It comes from
    adding the epochs by falling level, one by one, each to the episodes before and after it.

    Args:
        time_ns: epochs, increasing, ``(n,)``.
        level: :func:`~spoofbench.scoring.metrics.alarm_level` of each, ``(n,)``.
        counted: whether each is clean and its level known, ``(n,)``.
        epoch_ns: nominal interval of the grid.
    """
    clean_ns = int(steps_ns(time_ns, epoch_ns)[counted].sum())
    used = np.flatnonzero(counted & (level > 0))
    level = level[used]
    order = np.argsort(-level, kind="stable")
    changes = _changes(time_ns[used], order, separation_ns(epoch_ns))
    return _curve(level[order], np.cumsum(changes), clean_ns)


def total(curves: Iterable[EpisodeCurve]) -> EpisodeCurve:
    """Return the curve of all materials together, of none :data:`NO_CLEAN_TIME`."""
    return reduce(EpisodeCurve.__add__, curves, NO_CLEAN_TIME)


def leave_one_out(curves: Sequence[EpisodeCurve]) -> list[EpisodeCurve]:
    """Return for each curve the sum of all others, in time that grows like that of one sum."""
    if not curves:
        return []
    before = accumulate(curves[:-1], EpisodeCurve.__add__, initial=NO_CLEAN_TIME)
    after = accumulate(curves[:0:-1], EpisodeCurve.__add__, initial=NO_CLEAN_TIME)
    return [
        some + others for _, some, others in zip(curves, before, reversed(list(after)), strict=True)
    ]


def threshold(curve: EpisodeCurve, target_per_hour: float) -> Threshold:
    """Return the factor at which clean material keeps a false-alert rate, by the module's rule.

    Over a falling target the factors never fall: an operating curve is this, of a grid of targets.

    Args:
        curve: of all the material.
        target_per_hour: false-alert rate to keep on new material, above 0.
    """
    hours = curve.hours
    resolved = target_per_hour * hours >= 1
    allowed = floor(target_per_hour * hours) - 1 if resolved else 0
    if curve.infinite:
        return Threshold(None, "uncalibratable", hours, allowed, None, None)
    how: How = "calibrated"
    if not curve.levels.size:
        factor, how = 1.0, "no clean score"
    elif not resolved:
        factor, how = max(1.0, float(curve.levels[0])), "raised only"
    else:
        too_many = np.flatnonzero(curve.episodes > allowed)
        factor = float(curve.levels[too_many[0] if too_many.size else -1])
    expected = (allowed + 1) / hours if hours else None
    return Threshold(factor, how, hours, allowed, curve.episodes_at(factor), expected)


def detection_times_s(time_ns: Times, score: Floats, interval: Interval, factors: Floats) -> Floats:
    """Return the time to first detection of one attack at many factors, ``(g,)``, NaN where missed.

    At each factor it is ``ttfd_s`` of :func:`~spoofbench.scoring.metrics.find_events`, with the
    alert ``score > factor``.

    Args:
        time_ns: of the decisions, ``(m,)``.
        score: of each, NaN where unavailable, ``(m,)``.
        interval: of the attack.
        factors: finite, in any order, ``(g,)``.
    """
    first, end = np.searchsorted(time_ns, (interval.start_ns, interval.end_ns))
    lead = max(int(first) - 1, 0)
    decided = np.where(np.isnan(score[lead:end]), -np.inf, score[lead:end])
    before = decided[0] if first else -np.inf
    inside = decided[int(first) - lead :]
    row = np.searchsorted(np.maximum.accumulate(inside), factors, "right")
    # an alert that is on before the attack must fall before it can rise
    lasting = factors < before
    if lasting.any():
        silent = inside <= factors[lasting, np.newaxis]
        fell = np.logical_or.accumulate(silent, axis=1)
        rises = np.pad(fell & ~silent, ((0, 0), (0, 1)), constant_values=True)
        row[lasting] = np.argmax(rises, axis=1)
    after_s = (time_ns[first:end] - interval.start_ns) / 1e9
    return np.append(after_s, np.nan)[np.minimum(row, inside.size)]


def _curve(level: Floats, episodes: Ints, clean_ns: int) -> EpisodeCurve:
    """Keep of a number after each level, falling with ties, what changes it, and the last."""
    last_of_tie = np.append(level[1:] != level[:-1], True)[: level.size]
    level, episodes = level[last_of_tie], episodes[last_of_tie]
    kept = np.diff(episodes, prepend=[0]) != 0
    kept[-1:] = True
    return EpisodeCurve(level[kept], episodes[kept], clean_ns)


def _changes(time_ns: Times, order: Indices, apart_ns: int) -> Ints:
    """How the number of episodes changes as epochs join the alarm in this order, ``(n,)``.

    Args:
        time_ns: epochs, increasing, ``(n,)``.
        order: a permutation of their rows, ``(n,)``.
        apart_ns: time from which on two alerts are two episodes.
    """
    before, after = _neighbours_when_joining(order)
    sentinel_ns = 2 * apart_ns
    padded_ns = (
        np.concatenate([time_ns[:1] - sentinel_ns, time_ns, time_ns[-1:] + sentinel_ns])
        if time_ns.size
        else time_ns
    )
    at_ns, before_ns, after_ns = padded_ns[order + 1], padded_ns[before], padded_ns[after]
    joins_before, joins_after = at_ns - before_ns < apart_ns, after_ns - at_ns < apart_ns
    # between two alerts that are one episode already, nothing changes: most epochs
    changing = np.flatnonzero(after_ns - before_ns >= apart_ns)
    changes = np.zeros(order.size, np.int64)
    begins: dict[int, int] = {}  # the first row of an episode by its last
    ends: dict[int, int] = {}  # and the other way round
    times = padded_ns.tolist()
    for index, row, previous, following, left, right in zip(
        changing.tolist(),
        (order + 1)[changing].tolist(),
        before[changing].tolist(),
        after[changing].tolist(),
        joins_before[changing].tolist(),
        joins_after[changing].tolist(),
        strict=True,
    ):
        begin = end = row
        change = 1
        if left:
            begin = begins[previous]
            change -= 1 + (times[previous] - times[begin]) // MAX_EPISODE_NS
        if right:
            end = ends[following]
            change -= 1 + (times[end] - times[following]) // MAX_EPISODE_NS
        changes[index] = change + (times[end] - times[begin]) // MAX_EPISODE_NS
        begins[end], ends[begin] = begin, end
    return changes


def _neighbours_when_joining(order: Indices) -> tuple[Indices, Indices]:
    """For each row of a permutation, the nearest rows on either side that came before it in it.

    Rows count from 1; 0 and n + 1 stand for none. Taking the rows out of a linked list, last
    first, leaves each with the neighbours that it found.
    """
    rows = order.size
    before, after = list(range(-1, rows + 1)), list(range(1, rows + 3))
    for row in (order[::-1] + 1).tolist():
        left, right = before[row], after[row]
        after[left], before[right] = right, left
    return np.array(before)[order + 1], np.array(after)[order + 1]
