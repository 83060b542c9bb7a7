"""Bytes of a log that no row came from: what they are, and where rejected epochs' bytes lie."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spoofbench.arrays import Bools, Ints, Octets, ragged_arange, ragged_ranges
from spoofbench.conversion import Rejects
from spoofbench_converters.serial.framing import line_ends

REASONS = (
    "blank or line end",
    "text that is no sentence",
    "binary data that are no frame",
    "comment line",
    "UBX frame with a wrong checksum",
    "UBX frame cut off at the end of the log",
    "sentence with a wrong checksum",
    "sentence without a checksum",
    "sentence broken off",
)
BLANK, TEXT, BINARY, COMMENT, UBX_WRONG, UBX_CUT, WRONG, MISSING, BROKEN = range(len(REASONS))

LONGEST = 65_536
"""Longest reject, in bytes: what goes on is a reject by its own content."""

_LF, _CR, _HASH = b"\n\r#"


@dataclass(frozen=True, slots=True, eq=False)
class DamageMarks:
    """Where damaged frames and sentences start, and the reason of each: int64 and int8 ``(k,)``."""

    offsets: Ints
    reasons: NDArray[np.int8]


def divide(
    octets: Octets, gaps: tuple[Ints, Ints], damage: DamageMarks, at_line_start: bool
) -> tuple[Ints, Ints, NDArray[np.int8]]:
    """Return starts, ends and reasons, int64 and int8 ``(r,)``, of the rejects that skipped bytes
    make.

    A run of skipped bytes is divided where a damaged frame or sentence, or a comment, starts; a
    damaged sentence and a comment end with their line. The rest of a run is blank, else text, else
    binary.

    Args:
        octets: a stretch of the log, ``(n,)``.
        gaps: starts and ends of what is skipped, int64 ``(g,)``, in order, none empty.
        damage: where it starts, within the gaps or not.
        at_line_start: whether a line starts with the first byte.
    """
    starts, ends = gaps
    comments = _comments(octets, starts, ends, at_line_start)
    offsets = np.concatenate([damage.offsets, comments])
    known = np.concatenate([damage.reasons, np.full(comments.size, COMMENT, np.int8)])
    skipped = _within(offsets, starts, ends)
    offsets, known = offsets[skipped], known[skipped]
    lines = offsets[(known == COMMENT) | (known >= WRONG)]
    stops = _line_stops(octets, lines)
    stops = stops[(stops - lines <= LONGEST) & _within(stops, starts, ends)]
    bounds = np.sort(np.concatenate([starts, offsets, stops]), kind="stable")
    bounds = bounds[np.diff(bounds, prepend=-1) > 0]
    reasons = np.full(bounds.size, -1, np.int8)
    reasons[np.searchsorted(bounds, offsets)] = known
    stops = np.minimum(
        np.append(bounds[1:], octets.size), ends[np.searchsorted(starts, bounds, "right") - 1]
    )
    bounds, stops, reasons = _shortened(bounds, stops, reasons)
    by_content = reasons < 0
    reasons[by_content] = _content(octets, bounds[by_content], stops[by_content])
    return bounds, stops, reasons


def rejects(base: int, starts: Ints, ends: Ints, reasons: NDArray[np.int8]) -> list[Rejects]:
    """Return rejects by reason, of starts, ends and reasons ``(r,)`` as of :func:`divide`; ``base``
    is the offset of the stretch in the log.
    """
    return [
        Rejects(
            starts[reasons == reason] + base, (ends - starts)[reasons == reason], REASONS[reason]
        )
        for reason in np.unique(reasons).tolist()
    ]


def _within(offsets: Ints, starts: Ints, ends: Ints) -> Bools:
    gap = np.searchsorted(starts, offsets, "right") - 1
    return (
        np.asarray((gap >= 0) & (offsets < ends[gap]))
        if starts.size
        else np.zeros(offsets.size, bool)
    )


def _comments(octets: Octets, starts: Ints, ends: Ints, at_line_start: bool) -> Ints:
    """Return where lines start with ``#``."""
    offsets = np.flatnonzero(octets == _HASH) if starts.size else starts
    offsets = offsets[_within(offsets, starts, ends)]
    before = octets[offsets - 1]
    return offsets[np.where(offsets == 0, at_line_start, (before == _LF) | (before == _CR))]


def _line_stops(octets: Octets, offsets: Ints) -> Ints:
    """Return where the line of each offset ends, line end included."""
    if not offsets.size:
        return offsets
    breaks = np.append(np.flatnonzero((octets == _LF) | (octets == _CR)), octets.size)
    return line_ends(octets, breaks[np.searchsorted(breaks, offsets)])


def _shortened(
    starts: Ints, stops: Ints, reasons: NDArray[np.int8]
) -> tuple[Ints, Ints, NDArray[np.int8]]:
    """Divide what is longer than a reject may be."""
    pieces = -(-(stops - starts) // LONGEST)
    if (pieces <= 1).all():
        return starts, stops, reasons
    of = np.repeat(np.arange(starts.size), pieces)
    number = ragged_arange(pieces)
    begins = starts[of] + number * LONGEST
    return (
        begins,
        np.minimum(begins + LONGEST, stops[of]),
        np.where(number == 0, reasons[of], np.int8(-1)),
    )


def _content(octets: Octets, starts: Ints, stops: Ints) -> NDArray[np.int8]:
    """Return whether each stretch is blank, text or binary; they do not overlap and none is
    empty.
    """
    if not starts.size:
        return np.zeros(0, np.int8)
    lengths = stops - starts
    begins = np.cumsum(lengths) - lengths
    here = octets[ragged_ranges(starts, lengths)]
    blank = (here == _LF) | (here == _CR) | (here == 0x20) | (here == 0x09)
    kinds = np.where(
        blank,
        np.uint8(BLANK),
        np.where(here - np.uint8(0x20) <= 0x7E - 0x20, np.uint8(TEXT), np.uint8(BINARY)),
    )
    return np.asarray(np.maximum.reduceat(kinds, begins), np.int8)


class RejectedBytes:
    """Keeps account of the rejects of a stretch of a log, so that those of whole epochs do not
    overlap them.

    An epoch is known by the offset of its first frame and the sum of its frames' bytes, between
    which frames of others may stand. Its bytes are laid on the first ground from its offset on that
    no reject has.
    """

    def __init__(self) -> None:
        self._starts: list[Ints] = []
        self._ends: list[Ints] = []

    def take(self, rejects: Rejects) -> Rejects:
        """Note rejects whose bytes are known, and return them."""
        self._starts.append(rejects.offsets)
        self._ends.append(rejects.offsets + rejects.lengths)
        return rejects

    def forget(self, before: int) -> None:
        """Forget what lies before the first epoch that is still undecided."""
        starts, ends = self._sorted()
        starts, ends = starts[ends > before], ends[ends > before]
        apart = np.ones(starts.size, bool)
        apart[1:] = starts[1:] > ends[:-1]
        self._starts, self._ends = [starts[apart]], [ends[np.append(apart[1:], True)[: ends.size]]]

    def lay(self, offsets: Ints, lengths: Ints, reason: str) -> Iterator[Rejects]:
        """Yield rejects for epochs, none of whose bytes overlap a reject known.

        Args:
            offsets: int64 ``(m,)``, of the epochs, in order.
            lengths: int64 ``(m,)``, bytes of each.
            reason: of all.
        """
        starts, ends = (each.tolist() for each in self._sorted())
        begins, sizes, at, here = [], [], 0, 0
        for offset, length in zip(offsets.tolist(), lengths.tolist(), strict=True):
            at, left = max(at, offset), length
            while left:
                while here < len(starts) and ends[here] <= at:
                    here += 1
                if here < len(starts) and starts[here] <= at:
                    at = ends[here]
                    continue
                free = min(left, starts[here] - at) if here < len(starts) else left
                begins.append(at)
                sizes.append(free)
                at, left = at + free, left - free
        if begins:
            yield self.take(Rejects(np.array(begins), np.array(sizes), reason))

    def _sorted(self) -> tuple[Ints, Ints]:
        starts = np.concatenate([np.zeros(0, np.int64), *self._starts])
        ends = np.concatenate([np.zeros(0, np.int64), *self._ends])
        order = np.argsort(starts, kind="stable")
        return starts[order], ends[order]
