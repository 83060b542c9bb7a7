"""Text logs as lines, piece by piece in bounded memory, and lines as cells; every byte keeps its
place in the log.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import IO

import numpy as np
from numpy.typing import NDArray

from spoofbench.conversion import Reject, Rejects

PIECE_BYTES = 2**22
LONGEST_LINE_BYTES = 2**16
MOST_LINES = 2**16
BOM = b"\xef\xbb\xbf"

_LF, _CR, _QUOTE, _SPACE = b'\n\r" '


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """Lines of one piece of a log.

    Attributes:
        octets: uint8 ``(k,)``, the piece.
        starts, ends: int64 ``(n,)``, each line's text within ``octets``, without its end.
        offsets, lengths: int64 ``(n,)``, where each line lies in the log, with its end and a byte
            order mark before it.
    """

    octets: NDArray[np.uint8]
    starts: NDArray[np.int64]
    ends: NDArray[np.int64]
    offsets: NDArray[np.int64]
    lengths: NDArray[np.int64]

    def take(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> "Lines":
        """Return the lines that a mask or index array selects."""
        return Lines(
            self.octets, self.starts[rows], self.ends[rows], self.offsets[rows], self.lengths[rows]
        )

    def rejects(self, rows: NDArray[np.bool_], reason: str) -> Iterator[Rejects]:
        """Yield the lines that a mask selects as rejects, if there are any."""
        if rows.any():
            yield Rejects(self.offsets[rows], self.lengths[rows], reason)

    def text(self, row: int) -> str:
        """Return one line's text."""
        return self.octets[self.starts[row] : self.ends[row]].tobytes().decode("utf-8", "replace")


def read_lines(file: IO[bytes], origin: int = 0) -> Iterator[Lines | Reject]:
    """Yield a stream's lines; those longer than 64 KiB, and a last line without an end, are
    rejects.

    Args:
        file: the stream.
        origin: offset of its first byte in the log as a whole.

    Raises:
        ConversionError: while reading, where what the log is packed in is damaged.
    """
    left, base, skipping = b"", origin, 0
    while True:
        piece = _read(file, PIECE_BYTES)
        if not piece:
            break
        octets = left + piece
        if skipping:
            cut = octets.find(b"\n") + 1
            if not cut:
                skipping, base, left = skipping + len(octets), base + len(octets), b""
                continue
            yield _too_long(base - skipping, skipping + cut)
            octets, base, skipping = octets[cut:], base + cut, 0
        whole = octets.rfind(b"\n") + 1
        if whole:
            yield from _lines(np.frombuffer(octets, np.uint8, whole), base, base == origin)
        left, base = octets[whole:], base + whole
        if len(left) > LONGEST_LINE_BYTES:
            skipping, base, left = len(left), base + len(left), b""
    if skipping:
        yield _too_long(base - skipping, skipping)
    elif left:
        yield Reject(base, len(left), "cut off: the last line has no end")


def _read(file: IO[bytes], size: int) -> bytes:
    """Read this many bytes, fewer at the end alone, however the stream gives them."""
    pieces: list[bytes] = []
    while size and (piece := file.read(size)):
        pieces.append(piece)
        size -= len(piece)
    return b"".join(pieces)


def _too_long(offset: int, length: int) -> Reject:
    return Reject(offset, length, f"a line of more than {LONGEST_LINE_BYTES:,} bytes")


def _lines(octets: NDArray[np.uint8], base: int, first: bool) -> Iterator[Lines | Reject]:
    """Yield the lines of a piece that ends with one, so many at a time that their places stay
    small.
    """
    step = octets.size if int(np.count_nonzero(octets == _LF)) <= MOST_LINES else MOST_LINES
    start = 0
    while start < octets.size:
        stop = min(start + step, octets.size)
        stop += int(np.argmax(octets[stop - 1 :] == _LF))
        yield from _cut(octets[start:stop], base + start, first and start == 0)
        start = stop


def _cut(octets: NDArray[np.uint8], base: int, first: bool) -> Iterator[Lines | Reject]:
    line_ends = np.flatnonzero(octets == _LF)
    firsts = np.concatenate([[0], line_ends[:-1] + 1])
    lengths = line_ends + 1 - firsts
    ends = line_ends - ((lengths > 1) & (octets[np.maximum(line_ends - 1, 0)] == _CR))
    starts = firsts.copy()
    if first and octets[: len(BOM)].tobytes() == BOM:
        starts[0] = len(BOM)
    lines = Lines(octets, starts, ends, base + firsts, lengths)
    long = lengths > LONGEST_LINE_BYTES
    if long.any():
        for row in np.flatnonzero(long).tolist():
            yield _too_long(int(lines.offsets[row]), int(lengths[row]))
        lines = lines.take(~long)
    yield lines


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """One cell of each of n lines: where it starts and ends in ``octets``, int64 ``(n,)``."""

    octets: NDArray[np.uint8]
    starts: NDArray[np.int64]
    ends: NDArray[np.int64]

    def take(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> "Cells":
        """Return the cells that a mask or index array selects."""
        return Cells(self.octets, self.starts[rows], self.ends[rows])


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Lines cut into cells.

    Attributes:
        lines: the lines.
        widths: int64 ``(n,)``, number of cells of each.
        firsts: int64 ``(n,)``, place of each line's first cell in ``starts``.
        starts, ends: int64 ``(m,)``, all cells within the octets.
    """

    lines: Lines
    widths: NDArray[np.int64]
    firsts: NDArray[np.int64]
    starts: NDArray[np.int64]
    ends: NDArray[np.int64]

    def take(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> "Rows":
        """Return the rows that a mask or index array selects."""
        return Rows(
            self.lines.take(rows), self.widths[rows], self.firsts[rows], self.starts, self.ends
        )

    def column(self, place: int) -> Cells:
        """Return the cells of one column; each row must have it."""
        cells = self.firsts + place
        return Cells(self.lines.octets, self.starts[cells], self.ends[cells])


def split(lines: Lines, delimiter: str = ",") -> Rows:
    """Cut lines into cells; a delimiter between double quotes is text, quotes and blanks around a
    cell are not.
    """
    octets = lines.octets
    if not lines.starts.size:
        none = np.empty(0, np.int64)
        return Rows(lines, none, none, none, none)
    places = np.flatnonzero(octets == ord(delimiter))
    owner = np.searchsorted(lines.starts, places, "right") - 1
    inside = (owner >= 0) & (places < lines.ends[np.maximum(owner, 0)])
    quotes = np.flatnonzero(octets == _QUOTE)
    if quotes.size:
        before = (
            np.searchsorted(quotes, places)
            - np.searchsorted(quotes, lines.starts)[np.maximum(owner, 0)]
        )
        inside &= before % 2 == 0
    places, owner = places[inside], owner[inside]
    widths = np.bincount(owner, minlength=lines.starts.size) + 1
    firsts = np.cumsum(widths) - widths
    starts = np.empty(int(widths.sum()), np.int64)
    ends = np.empty_like(starts)
    after = np.ones(starts.size, bool)
    after[firsts] = False
    starts[firsts], starts[after] = lines.starts, places + 1
    last = np.zeros(starts.size, bool)
    last[firsts + widths - 1] = True
    ends[last], ends[~last] = lines.ends, places
    if octets.size and (quotes.size or bool(np.any(octets == _SPACE))):
        _strip(octets, starts, ends)
    return Rows(lines, widths, firsts, starts, ends)


def _strip(octets: NDArray[np.uint8], starts: NDArray[np.int64], ends: NDArray[np.int64]) -> None:
    """Move the edges of cells past one blank on either side, then past a pair of quotes."""
    for blank in (_SPACE, _QUOTE):
        filled = ends - starts > (blank == _QUOTE)
        first = octets[np.minimum(starts, octets.size - 1)] == blank
        last = octets[np.maximum(ends - 1, 0)] == blank
        if blank == _QUOTE:
            first = last = first & last
        starts += filled & first
        ends -= filled & last & (ends > starts)
