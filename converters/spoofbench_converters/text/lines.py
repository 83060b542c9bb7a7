"""Text in pieces of whole lines or records, in bounded memory; every byte keeps its place in the
log.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import IO, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from spoofbench.conversion import Reject, Rejects
from spoofbench.table import Rows

PIECE_BYTES = 2**22
MAX_LINE_BYTES = 2**16
MAX_LINES = 2**16
BOM = b"\xef\xbb\xbf"

LF, CR, TAB, BLANK, QUOTE = b'\n\r\t "'
_MASK = np.uint8(ord("?"))
_MAX_PLAIN = ord("~")


class Cut(Protocol):
    """What is found in a piece: ``end`` is where what is whole of it ends."""

    @property
    def end(self) -> int: ...


AnyCut = TypeVar("AnyCut", bound=Cut)


def read_pieces(
    file: IO[bytes],
    find: Callable[[bytes, bool], AnyCut],
    base: int,
    max_bytes: int,
    too_long: str,
    line_end: bytes = b"\n",
) -> Iterator[tuple[bytes, int, AnyCut] | Reject]:
    """Yield a stream in pieces, each with its offset in the log and with what is found in it.

    Args:
        file: the stream, however it gives its bytes.
        find: takes the bytes from where the last piece ended, and whether no more follow.
        base: offset of the stream in the log.
        max_bytes: a longer record without an end is skipped up to the next line end, as a reject.
        too_long: the reason of that.
        line_end: one byte.

    Raises:
        ConversionError: while reading, where what the log is packed in is damaged.
    """
    rest, skipped, last = b"", 0, False
    while not last:
        piece = _read(file, PIECE_BYTES)
        last = not piece
        if skipped:
            cut = piece.find(line_end) + 1
            skipped, piece = skipped + (cut or len(piece)), piece[cut:] if cut else b""
            if not cut and not last:
                continue
            yield Reject(base, skipped, too_long)
            base, skipped = base + skipped, 0
        rest += piece
        found = find(rest, last)
        if found.end:
            yield rest[: found.end], base, found
            base, rest = base + found.end, rest[found.end :]
        if len(rest) > max_bytes:
            skipped, rest = len(rest), b""
    if skipped:
        yield Reject(base, skipped, too_long)


def _read(file: IO[bytes], size: int) -> bytes:
    """Read this many bytes, fewer at the end alone, however the stream gives them."""
    pieces: list[bytes] = []
    while size and (piece := file.read(size)):
        pieces.append(piece)
        size -= len(piece)
    return b"".join(pieces)


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """Lines of one piece of a log, each of which is a record.

    Attributes:
        octets: uint8 ``(k,)``, the piece.
        plain: uint8 ``(k,)``, the piece as printable ASCII, other characters masked; so are
            delimiters between quotation marks, which are text.
        starts, ends: int64 ``(n,)``, each line's text within ``octets``, without its end.
        offsets, lengths: int64 ``(n,)``, where each line lies in the log, with its end and a byte
            order mark before it.
        cells: int64 ``(n,)``, number of cells of each.
    """

    octets: NDArray[np.uint8]
    plain: NDArray[np.uint8]
    starts: NDArray[np.int64]
    ends: NDArray[np.int64]
    offsets: NDArray[np.int64]
    lengths: NDArray[np.int64]
    cells: NDArray[np.int64]

    def __len__(self) -> int:
        """Number of lines."""
        return self.starts.size

    def take(self, rows: Rows) -> "Lines":
        """Return the lines that a slice, mask or index array selects."""
        columns = (self.starts, self.ends, self.offsets, self.lengths, self.cells)
        return Lines(self.octets, self.plain, *(column[rows] for column in columns))

    def rejects(self, rows: NDArray[np.bool_], reason: str) -> Iterator[Rejects]:
        """Yield the lines that a mask selects as rejects, if there are any."""
        if rows.any():
            yield Rejects(self.offsets[rows], self.lengths[rows], reason)

    def text(self, row: int) -> str:
        """Return one line's text."""
        return self.octets[self.starts[row] : self.ends[row]].tobytes().decode("utf-8", "replace")

    def joined(self) -> bytes:
        """Return the lines one after the other, as printable ASCII, a line feed behind each."""
        if not len(self):
            return b""
        first, last = int(self.starts[0]), int(self.ends[-1])
        piece = self.plain[first:last].tobytes()
        if int(self.lengths.sum()) == int(self.offsets[-1] + self.lengths[-1] - self.offsets[0]):
            return piece + b"\n"
        bounds = zip((self.starts - first).tolist(), (self.ends - first).tolist(), strict=True)
        return b"\n".join([piece[start:end] for start, end in bounds]) + b"\n"


@dataclass(frozen=True, slots=True)
class _WholeLines:
    end: int


def read_lines(
    file: IO[bytes], origin: int = 0, delimiter: str = ","
) -> Iterator[Lines | Reject | Rejects]:
    """Yield a stream's lines; those longer than 64 KiB, and a last line without an end, are
    rejects.

    Args:
        file: the stream.
        origin: offset of its first byte in the log as a whole.
        delimiter: of cells; between double quotes it is text.

    Raises:
        ConversionError: as :func:`read_pieces`.
    """
    end, too_long = origin, f"a line of more than {MAX_LINE_BYTES:,} bytes"
    rest = 0

    def find(octets: bytes, last: bool) -> _WholeLines:
        nonlocal rest
        whole = octets.rfind(b"\n") + 1
        rest = len(octets) - whole if last else 0
        return _WholeLines(whole)

    for item in read_pieces(file, find, origin, MAX_LINE_BYTES, too_long):
        if isinstance(item, Reject):
            yield item
            end = item.offset + item.length
            continue
        piece, base, found = item
        octets = np.frombuffer(piece, np.uint8)
        for start, stop in _parts(octets):
            first = base == origin and start == 0
            lines = _cut(octets[start:stop], base + start, ord(delimiter), first)
            long = lines.lengths > MAX_LINE_BYTES
            yield from lines.rejects(long, too_long)
            yield lines.take(~long) if long.any() else lines
        end = base + found.end
    if 0 < rest <= MAX_LINE_BYTES:
        yield Reject(end, rest, "cut off: the last line has no end")


def _parts(octets: NDArray[np.uint8]) -> Iterator[tuple[int, int]]:
    """Yield from where to where a piece is cut, so that the places of its lines stay few."""
    step = octets.size if int(np.count_nonzero(octets == LF)) <= MAX_LINES else MAX_LINES
    start = 0
    while start < octets.size:
        stop = min(start + step, octets.size)
        stop += int(np.argmax(octets[stop - 1 :] == LF))
        yield start, stop
        start = stop


def _cut(octets: NDArray[np.uint8], base: int, delimiter: int, is_first: bool) -> Lines:
    line_ends = np.flatnonzero(octets == LF)
    firsts = np.concatenate([[0], line_ends[:-1] + 1])
    lengths = line_ends + 1 - firsts
    ends = line_ends - ((lengths > 1) & (octets[np.maximum(line_ends - 1, 0)] == CR))
    starts = firsts.copy()
    if is_first and octets[: len(BOM)].tobytes() == BOM:
        starts[0] = len(BOM)
    delimiters = np.flatnonzero(octets == delimiter)
    plain, is_text = octets, _between_quotes(octets, delimiters, firsts)
    ended_by_cr = int(np.count_nonzero(ends < line_ends))
    if int(octets.max()) > _MAX_PLAIN or is_text.any() or _controls(octets) > ended_by_cr:
        odd = (octets > _MAX_PLAIN) | ((octets < BLANK) & (octets != LF) & (octets != TAB))
        odd[ends[ends < line_ends]] = False
        plain = np.where(odd, _MASK, octets)
        plain[delimiters[is_text]] = _MASK
        delimiters = delimiters[~is_text]
    cells = np.diff(np.searchsorted(delimiters, np.append(firsts, octets.size))) + 1
    return Lines(octets, plain, starts, ends, base + firsts, lengths, cells)


def _controls(octets: NDArray[np.uint8]) -> int:
    """Return how many control characters there are beside line feeds and tabs."""
    return sum(
        sign * int(np.count_nonzero(found))
        for sign, found in ((1, octets < BLANK), (-1, octets == LF), (-1, octets == TAB))
    )


def _between_quotes(
    octets: NDArray[np.uint8], places: NDArray[np.int64], firsts: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Return which places have an odd number of quotation marks before them in their lines."""
    quotes = np.flatnonzero(octets == QUOTE)
    if not quotes.size:
        return np.zeros(places.size, bool)
    line = np.searchsorted(firsts, places, "right") - 1
    before = np.searchsorted(quotes, places) - np.searchsorted(quotes, firsts)[line]
    return np.asarray(before % 2 == 1)
