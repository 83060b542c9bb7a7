"""Where the records of delimited text lie: RFC 4180, read around damage.

A quoted cell may hold delimiters and line ends; a quotation mark in the midst of a cell that does
not begin with one is a character like any other. Where marks do not fit together, the line that
opened the cell is damaged and the next line begins a record.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spoofbench.arrays import Bools, Ints, Octets
from spoofbench_converters.text.lines import BLANK, CR, LF, QUOTE, TAB

MAX_RECORD_BYTES = 2**20
MAX_RECORD_LINES = 64


@dataclass(frozen=True, slots=True)
class RecordBounds:
    """Records of a piece of text; each ends where the next starts, the last one at ``end``.

    Attributes:
        starts: int64 ``(n,)``.
        end: what follows is the beginning of a record that is not complete yet.
        cells: int64 ``(n,)``, number of cells of each.
        damaged: bool ``(n,)``, records whose quotation marks do not fit.
    """

    starts: Ints
    end: int
    cells: Ints
    damaged: Bools

    def lengths(self) -> Ints:
        return np.diff(self.starts, append=self.end)


@dataclass(frozen=True, slots=True)
class _Marks:
    """Quotation marks of lines: how many are odd, and whether they fit a line that begins outside
    or inside a quoted cell.
    """

    odd: Bools
    literal: Bools
    fit_outside: Bools
    fit_inside: Bools


def find(octets: Octets, delimiter: int, line_end: int, comment: bytes, last: bool) -> RecordBounds:
    """Return the records of a piece that begins with a record; ``last``: no more text follows."""
    ends = np.flatnonzero(octets == line_end) + 1
    if last and octets.size and (not ends.size or ends[-1] < octets.size):
        ends = np.append(ends, octets.size)
    starts = (
        np.concatenate([[0], ends[:-1]]).astype(np.int64) if ends.size else np.zeros(0, np.int64)
    )
    end = int(ends[-1]) if ends.size else 0
    places = np.flatnonzero(octets[:end] == QUOTE)
    if not places.size:
        return RecordBounds(
            starts, end, _count(octets[:end] == delimiter, starts) + 1, np.zeros(starts.size, bool)
        )
    marks = _marks(octets[:end], places, starts, delimiter, starts_with(octets, starts, comment))
    first, damaged, complete = _records(marks, starts, ends, last)
    end = int(ends[complete - 1]) if complete else 0
    plain = np.zeros(starts.size, bool)
    plain[first] = marks.literal[first] | damaged
    special = places[~plain[np.searchsorted(starts, places, "right") - 1]]
    turns = np.zeros(end, np.uint8)
    turns[special[special < end]] = 1
    outside = np.cumsum(turns, dtype=np.uint8) % 2 == 0
    return RecordBounds(
        starts[first],
        end,
        _count((octets[:end] == delimiter) & outside, starts[first]) + 1,
        damaged,
    )


def starts_with(octets: Octets, starts: Ints, prefix: bytes) -> Bools:
    """Return which of the records or lines at these places start with a prefix, bool ``(n,)``; none
    if it is empty.
    """
    found: Bools = np.full(starts.size, bool(prefix))
    for place, octet in enumerate(prefix):
        within = starts + place < octets.size
        found &= within & (octets[np.where(within, starts + place, 0)] == octet)
    return found


def find_by_blanks(octets: Octets, line_end: int, last: bool) -> RecordBounds:
    """Return the lines of a piece whose cells are words separated by blanks or tabs; marks have no
    meaning.
    """
    found = find(np.where(octets == QUOTE, np.uint8(0), octets), 0, line_end, b"", last)
    return RecordBounds(
        found.starts,
        found.end,
        _count(_word_starts(octets[: found.end]), found.starts),
        found.damaged,
    )


def tabbed(octets: Octets) -> Octets:
    """Return lines with one tab between their words."""
    blank = (octets == BLANK) | (octets == TAB)
    words = np.flatnonzero(_word_starts(octets))
    kept = ~blank
    lines = np.cumsum(octets == LF)[words] if words.size else words
    kept[words[np.diff(lines, prepend=-1) == 0] - 1] = (
        True  # the last blank before a word that is not the first of its line
    )
    return np.asarray(np.where(blank, TAB, octets).astype(np.uint8)[kept])


def _word_starts(octets: Octets) -> Bools:
    gap = (octets == BLANK) | (octets == TAB) | (octets == LF) | (octets == CR)
    return np.asarray(~gap & np.append(True, gap[:-1])[: gap.size])


def _count(flags: NDArray[np.bool_], starts: Ints) -> Ints:
    """Return how many flags are set from each start to the next, the last one's to the end."""
    return np.diff(np.searchsorted(np.flatnonzero(flags), np.append(starts, flags.size)))


def _marks(octets: Octets, places: Ints, starts: Ints, delimiter: int, comments: Bools) -> _Marks:
    lines = np.searchsorted(starts, places, "right") - 1
    counts = np.bincount(lines, minlength=starts.size)
    order = np.arange(places.size) - (np.cumsum(counts) - counts)[lines]
    before = np.where(places > 0, octets[places - 1], LF)
    after = np.where(places + 1 < octets.size, octets[np.minimum(places + 1, octets.size - 1)], LF)
    at_cell = (before == delimiter) | (before == LF) | (before == CR)
    opens = at_cell | (before == QUOTE)
    closes = (after == delimiter) | (after == LF) | (after == CR) | (after == QUOTE)
    even = order % 2 == 0
    none = np.bincount(lines[at_cell], minlength=starts.size) == 0
    outside = np.bincount(lines[~np.where(even, opens, closes)], minlength=starts.size) == 0
    inside = np.bincount(lines[~np.where(even, closes, opens)], minlength=starts.size) == 0
    return _Marks(counts % 2 == 1, none | comments, outside, inside)


def _records(marks: _Marks, starts: Ints, ends: Ints, last: bool) -> tuple[Ints, Bools, int]:
    """Return the first lines of the records, which are damaged, and how many lines belong to
    complete records.
    """
    # A line with an odd number of marks turns outside and inside round; one whose marks are mere
    # characters outside closes a cell if it begins inside: after it, all is outside.
    resets = marks.odd & marks.literal
    turns = np.cumsum(marks.odd & ~resets)
    at_reset = np.maximum.accumulate(np.where(resets, turns, 0))
    inside = np.equal((turns - at_reset) % 2, 1)  # after each line
    outside = ~np.append(False, inside)[:-1]
    closed = np.flatnonzero(~inside)
    complete = int(closed[-1]) + 1 if closed.size else 0
    first = np.flatnonzero(outside[:complete])
    fit = np.where(outside, marks.literal | marks.fit_outside, marks.fit_inside)[:complete]
    stops = np.append(first[1:], complete)
    small = (stops - first == 1) | (
        (stops - first <= MAX_RECORD_LINES) & (ends[stops - 1] - starts[first] <= MAX_RECORD_BYTES)
    )
    open_lines = starts.size - complete
    if (
        fit.all()
        and small.all()
        and (not open_lines or not last)
        and not _too_long(starts, ends, complete)
    ):
        return first, np.zeros(first.size, bool), complete
    return _around_damage(marks, starts, ends, last)


def _too_long(starts: Ints, ends: Ints, first: int) -> bool:
    """Whether an open record has more lines or bytes than a record may have."""
    return first < starts.size and (
        starts.size - first > MAX_RECORD_LINES or int(ends[-1] - starts[first]) > MAX_RECORD_BYTES
    )


def _around_damage(marks: _Marks, starts: Ints, ends: Ints, last: bool) -> tuple[Ints, Bools, int]:
    """Do what :func:`_records` does line by line."""
    odd, literal = marks.odd.tolist(), marks.literal.tolist()
    fit_outside, fit_inside = marks.fit_outside.tolist(), marks.fit_inside.tolist()
    begins, stops = starts.tolist(), ends.tolist()
    first: list[int] = []
    damaged: list[bool] = []
    line = 0
    while line < len(odd):
        after, sound = line + 1, True
        if not literal[line]:
            sound, is_open = fit_outside[line], odd[line]
            while sound and is_open:
                if (
                    after - line >= MAX_RECORD_LINES
                    or stops[after - 1] - begins[line] > MAX_RECORD_BYTES
                ):
                    sound = False
                elif after == len(odd):
                    if not last:
                        return np.array(first, np.int64), np.array(damaged, bool), line
                    sound = False
                else:
                    sound = fit_inside[after]
                    is_open ^= odd[after]
                    after += 1
        first.append(line)
        damaged.append(not sound)
        line = after if sound else line + 1
    return np.array(first, np.int64), np.array(damaged, bool), line
