"""Which sentences belong to one epoch of a receiver.

Sentences with a time open an epoch when their time differs from the one before, or when a position
sentence or a ZDA of the epoch comes again with other content (a clock that stands still, or no time
at all). The same sentence again is a repetition and opens nothing, unless the clock is known to
stand while the position moves. A time without decimals is the same as one with decimals in its
second; a ZDA up to 0.1 s after a fix is of that fix, and one without decimals up to 1 s before a
fix is of the next, for some receivers give it the time of sending.

Sentences without a time between two epochs belong to the first of them, but for those from the
first GSV on where the log puts GSV first in its bursts. That is so, in this order: where the
recorder's stamps leave their longest gap there; not if a GSA stands right before the GSV; if a GSA
or VTG follows it; if the log began with a GSV.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from spoofbench.arrays import Bools, Ints, ragged_ranges
from spoofbench.conversion import Columns
from spoofbench.conversion.rows import take
from spoofbench.gnss_time import DAY_NS, SECOND_NS, wrap_difference
from spoofbench_converters.nmea.batch import CODES, READ
from spoofbench_converters.serial.contract import ABSENT_NS

MAX_SENTENCES = 8_192  # of one epoch: more make epochs without a time

_SENDING_NS = 100_000_000
_STANDS = 3  # moves without a tick that show a clock that stands
_CLEAR_GAP = 2  # a gap this many times the next longest one separates bursts
_REPEATING = np.isin(READ, ("GGA", "RMC", "GLL", "GNS", "ZDA", "PUBX00"))
_CLOCKS = np.isin(READ, ("ZDA", "PUBX04"))
_GSV, _GSA, _VTG = CODES["GSV"], CODES["GSA"], CODES["VTG"]


@dataclass(frozen=True, slots=True)
class ReceiverTraits:
    """What the start of a log shows of a receiver.

    Attributes:
        gsv_first: the log began with a GSV sentence.
        clock_stands: positions change while the time does not.
    """

    gsv_first: bool = False
    clock_stands: bool = False

    @classmethod
    def of(cls, frames: Columns) -> Self:
        """Judge by the columns ``(n,)`` of a receiver's first sentences."""
        if not frames["code"].size:
            return cls()
        repeating = np.flatnonzero(_REPEATING[frames["code"]])
        later, earlier = _again(frames, repeating, np.zeros(frames["code"].size, np.int64))
        timed = (frames["tod_ns"][later] == frames["tod_ns"][earlier]) & (
            frames["tod_ns"][later] != ABSENT_NS
        )
        moved = timed & (np.abs(frames["lat_deg"][later] - frames["lat_deg"][earlier]) > 0)
        return cls(
            bool(frames["code"][0] == _GSV and frames["message"][0] <= 1),
            int(moved.sum()) >= _STANDS,
        )


@dataclass(frozen=True, slots=True)
class PreviousTimes:
    """The last time before the sentences at hand, and the last one with decimals, ``ABSENT_NS`` for
    none.
    """

    tod_ns: int = ABSENT_NS
    fine_ns: int = ABSENT_NS


@dataclass(frozen=True, slots=True, eq=False)
class Division:
    """How the sentences of one receiver divide into epochs.

    Attributes:
        starts: bool ``(n,)``, which sentences open an epoch; the first one does.
        tod_ns: int64 ``(n,)``, times as compared, ``ABSENT_NS`` where a sentence has none.
        fine: bool ``(n,)``, which times have decimals.
    """

    starts: Bools
    tod_ns: Ints
    fine: Bools

    def before(self, index: int, start: PreviousTimes) -> PreviousTimes:
        """What came before the sentence at an index."""
        timed = np.flatnonzero(self.tod_ns[:index] != ABSENT_NS)
        fine = timed[self.fine[timed]]
        return PreviousTimes(
            int(self.tod_ns[timed[-1]]) if timed.size else start.tod_ns,
            int(self.tod_ns[fine[-1]]) if fine.size else start.fine_ns,
        )


def divide(
    frames: Columns, segment: Ints, before: PreviousTimes, traits: ReceiverTraits
) -> Division:
    """Divide a receiver's sentences, in file order; no epoch goes across the border of two
    segments.

    Args:
        frames: columns of :class:`spoofbench_converters.nmea.batch.SentenceBatch`.
        segment: int64 ``(n,)``, not decreasing.
        before: what came before the first of them.
        habits: of the receiver.
    """
    n = segment.size
    tod_ns, fine = _comparable(frames, before)
    timed = np.flatnonzero(tod_ns != ABSENT_NS)
    opens = np.zeros(n, bool)
    if timed.size:
        new_segment = np.append(
            segment[timed[0]] != segment[0], segment[timed[1:]] != segment[timed[:-1]]
        )
        opens[timed] = (tod_ns[timed] != np.append(before.tod_ns, tod_ns[timed[:-1]])) | new_segment
    repeating = np.flatnonzero(_REPEATING[frames["code"]])
    border = np.append(np.ones(min(n, 1), bool), segment[1:] != segment[:-1])
    _open_at_repetition(frames, repeating, np.cumsum(opens | border), opens, traits.clock_stands)
    anchors = np.flatnonzero((tod_ns != ABSENT_NS) | _REPEATING[frames["code"]])
    starts = _with_what_leads(frames, np.flatnonzero(opens), anchors, border, traits.gsv_first)
    return Division(starts | border, tod_ns, fine)


def open_within_bounds(
    frames: Columns, indices: Ints, size: int, before: PreviousTimes, traits: ReceiverTraits
) -> tuple[Bools, PreviousTimes]:
    """Divide a receiver's sentences among others, so that no epoch has more than ``MAX_SENTENCES``
    of all.

    Args:
        frames: the receiver's sentences.
        indices: int64 ``(n,)``, their indices among all.
        size: how many there are of all.
        before: what came before the first.
        habits: of the receiver.

    Returns:
        Which of all sentences open an epoch, bool ``(size,)``, and what came before the last one
        that does.
    """
    starts = np.zeros(size, bool)
    begin = 0
    while True:
        own = int(np.searchsorted(indices, begin))
        division = divide(
            take(frames, slice(own, None)), np.zeros(indices.size - own, np.int64), before, traits
        )
        starts[indices[own:][division.starts]] = True
        starts[begin : begin + 1] = True
        opening = begin + np.flatnonzero(starts[begin:])
        long = np.flatnonzero(np.diff(np.append(opening, size)) > MAX_SENTENCES)
        if not long.size:
            return starts, division.before(int(np.searchsorted(indices, opening[-1])) - own, before)
        begin = int(opening[long[0]]) + MAX_SENTENCES
        before = division.before(int(np.searchsorted(indices, begin)) - own, before)
        starts[begin:] = False


def _comparable(frames: Columns, before: PreviousTimes) -> tuple[Ints, Bools]:
    """Times such that those of one epoch are equal; and which had decimals."""
    tod_ns = frames["tod_ns"].copy()
    timed = np.flatnonzero(tod_ns != ABSENT_NS)
    is_fine = frames["tod_places"] > 0
    fine = timed[is_fine[timed]]
    coarse = timed[~is_fine[timed]]
    if coarse.size and (fine.size or before.fine_ns != ABSENT_NS):
        known = np.concatenate([[before.fine_ns], tod_ns[fine], [ABSENT_NS]])
        index = np.searchsorted(fine, coarse)
        own = tod_ns[coarse]
        for near in (known[index + 1], known[index]):
            same = (near != ABSENT_NS) & (near // SECOND_NS == own // SECOND_NS)
            tod_ns[coarse] = np.where(same, near, tod_ns[coarse])
    if timed.size:
        last = np.append(before.tod_ns, tod_ns[timed[:-1]])
        following = np.append(tod_ns[timed[1:]], ABSENT_NS)
        is_clock = _CLOCKS[frames["code"][timed]]
        late, early = _lag(tod_ns[timed], last), _lag(following, tod_ns[timed])
        sent_late = is_clock & (late > 0) & (late < _SENDING_NS)
        ahead = (
            is_clock
            & ~is_fine[timed]
            & (late != 0)
            & (early > 0)
            & (early <= SECOND_NS)
            & ~np.append(is_clock[1:], True)
        )
        tod_ns[timed[sent_late]] = last[sent_late]
        tod_ns[timed[ahead]] = following[ahead]
    return tod_ns, is_fine


def _lag(time_ns: Ints, since_ns: Ints) -> Ints:
    """How much later times of day are than others, to within half a day; -1 where either is
    absent.
    """
    known = (time_ns != ABSENT_NS) & (since_ns != ABSENT_NS)
    return np.where(
        known,
        wrap_difference(np.where(known, time_ns, 0) - np.where(known, since_ns, 0), DAY_NS),
        -1,
    )


def _again(frames: Columns, repeating: Ints, run: Ints) -> tuple[Ints, Ints]:
    """Sentences of whose type and talker there was one before in their run, in file order, and
    those before them.
    """
    identity = frames["talker"][repeating] * len(CODES) + frames["code"][repeating]
    order = np.lexsort((repeating, identity, run[repeating]))
    ordered, key = repeating[order], identity[order]
    again = np.flatnonzero((key[1:] == key[:-1]) & (run[ordered][1:] == run[ordered][:-1]))
    by_place = np.argsort(ordered[again + 1])
    return ordered[again + 1][by_place], ordered[again][by_place]


def _open_at_repetition(
    frames: Columns, repeating: Ints, run: Ints, opens: Bools, clock_stands: bool
) -> None:
    """Open an epoch where a sentence of the epoch comes again, saying something else, within a run
    of one time.
    """
    later, earlier = _again(frames, repeating, run)
    same = frames["tod_ns"][later] != ABSENT_NS
    for name in ("tod_ns", "lat_deg", "lon_deg"):
        values = frames[name]
        same &= (values[later] == values[earlier]) | (
            (values[later] != values[later]) & (values[earlier] != values[earlier])
        )
    if clock_stands:
        same &= np.searchsorted(repeating, later) - np.searchsorted(repeating, earlier) == 1
    start = -1
    for index, last in zip(later[~same].tolist(), earlier[~same].tolist(), strict=True):
        if last >= start:
            opens[index] = True
            start = index


def _with_what_leads(
    frames: Columns, opening: Ints, anchors: Ints, border: Bools, gsv_first: bool
) -> Bools:
    """Move the start of each epoch back to the sentences without a time that lead its burst."""
    starts = np.zeros(border.size, bool)
    index = np.searchsorted(anchors, opening)
    last_anchor = np.append(-1, anchors)[index]
    borders = np.flatnonzero(border)
    first = np.maximum(last_anchor + 1, borders[np.searchsorted(borders, opening, "right") - 1])
    gsv = np.append(np.flatnonzero(frames["code"] == _GSV), border.size)
    lead = gsv[np.searchsorted(gsv, first)]
    after_gsa = (lead > first) & (frames["code"][np.minimum(lead, border.size - 1) - 1] == _GSA)
    others = np.append(-1, np.flatnonzero((frames["code"] == _GSA) | (frames["code"] == _VTG)))
    followed = others[np.searchsorted(others, opening) - 1] > lead
    leads = (lead < opening) & ~after_gsa & (followed | gsv_first)
    chosen = np.where(leads, lead, opening)
    stamped = _after_gap(frames["receive_time_ns"], first, opening, border)
    starts[np.where(stamped >= 0, stamped, chosen)] = True
    return starts


def _after_gap(receive_time_ns: Ints, first: Ints, opening: Ints, border: Bools) -> Ints:
    """The sentence after the longest gap between stamps from ``first`` to each opening sentence, -1
    where there is no clear one.
    """
    found = np.full(opening.size, -1)
    length = opening - first + 1
    rows = np.flatnonzero(length > 1)
    if not rows.size or not np.any(receive_time_ns != ABSENT_NS):
        return found
    group = np.repeat(np.arange(rows.size), length[rows])
    index = ragged_ranges(first[rows], length[rows])
    known = (receive_time_ns[index] != ABSENT_NS) & (
        border[index] | (receive_time_ns[index - 1] != ABSENT_NS)
    )
    gap = np.where(
        border[index],
        np.inf,
        np.where(known, receive_time_ns[index].astype(float) - receive_time_ns[index - 1], -1),
    )
    order = np.lexsort((gap, group))
    last = np.searchsorted(group[order], np.arange(rows.size), "right") - 1
    longest, second = gap[order][last], gap[order][last - 1]
    unknown = np.bincount(group[~known], minlength=rows.size) > 0
    clear = ~unknown & (longest > 0) & (longest >= _CLEAR_GAP * np.maximum(second, 0))
    found[rows[clear]] = index[order][last][clear]
    return found
