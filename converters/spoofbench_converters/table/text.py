"""Delimited text: records with the bytes that they take, in bounded memory.

Records are found first (RFC 4180: a quoted cell may hold line ends and delimiters), so that each
byte has its place in the account and damage costs one record; the sound ones are then taken apart
by Arrow.
"""

import csv
import io
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from spoofbench.arrays import Ints, Octets
from spoofbench.conversion import Reject, Rejects
from spoofbench.errors import ConversionError
from spoofbench_converters.table.cells import NULLS
from spoofbench_converters.table.mapping import Layout
from spoofbench_converters.text.columns import parse
from spoofbench_converters.text.lines import BOM, CR, LF, TAB, read_pieces
from spoofbench_converters.text.records import (
    MAX_RECORD_BYTES,
    RecordBounds,
    find,
    find_by_blanks,
    starts_with,
    tabbed,
)

MAX_COLUMNS = 10_000
HEAD_LINES = 64
_WITH_COMMA = r"^(\s*[+-]?\d*),(\d*([eE][+-]?\d+)?\s*)$"
_MARKS = "quotation marks that do not fit together"
_ENDLESS = "a record of more than 1 MiB"


@dataclass(frozen=True, slots=True)
class CellBatch:
    """Successive rows of a table.

    Attributes:
        columns: Arrow arrays ``(n,)`` by name; null is an empty cell.
        offsets, lengths: int64 ``(n,)``, where each row lies in the source and what it takes of it.
        besides: units of the source that are understood, but no rows: header, comments, blank
            lines.
    """

    columns: Mapping[str, Any]
    offsets: Ints
    lengths: Ints
    besides: int = 0


@dataclass(frozen=True, slots=True)
class Head:
    """What the beginning of a text file says.

    Attributes:
        names: of the columns, from the header; empty without one.
        width: number of cells that most of the first lines after it have, 0 if there is none.
        comments: the comment lines before it, blanks joined.
        octets: how many bytes the file has before its first record.
        line_end: the last octet of a line end.
    """

    names: tuple[str, ...]
    width: int
    comments: tuple[str, ...]
    octets: int
    line_end: int


def read_head(octets: bytes, layout: Layout, name: str) -> Head:
    """Return what the first bytes of a file say.

    Raises:
        ConversionError: it is no text that can be read here.
    """
    if octets[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise ConversionError(f"{name!r} is UTF-16 text; save it as UTF-8")
    place = len(BOM) if octets.startswith(BOM) else 0
    line_end = b"\r" if b"\r" in octets and b"\n" not in octets else b"\n"
    names: tuple[str, ...] = ()
    comments: list[str] = []
    skip, want_header, first = layout.skip_lines, layout.header, -1
    widths: Counter[int] = Counter()
    while place < len(octets) and widths.total() < HEAD_LINES:
        end = octets.find(line_end, place) + 1 or len(octets)
        line = (
            octets[place:end]
            .decode("latin-1" if layout.encoding == "latin-1" else "utf-8", "replace")
            .strip("\r\n\0")
        )
        if skip:
            skip -= 1
        elif layout.comment and line.startswith(layout.comment):
            comments.append(" ".join(line.split()))
        elif line.strip() and want_header:
            names, want_header = _unique(split_line(line, layout)), False
            if any(letter < " " for letter in "".join(names).replace("\t", " ")):
                raise ConversionError(
                    f"{name!r} is no text: there are control characters in the names of its columns"
                )
        elif line.strip():
            first = place if first < 0 else first
            widths[len(split_line(line, layout))] += 1
        place = end
    if max((len(names), *widths)) > MAX_COLUMNS:
        raise ConversionError(f"{name!r} has more than {MAX_COLUMNS:,} columns")
    width = max(widths, key=lambda each: (widths[each], each), default=0)
    return Head(names, width, tuple(comments), place if first < 0 else first, line_end[0])


def split_line(line: str, layout: Layout) -> list[str]:
    """Return the cells of one line."""
    if layout.delimiter == "whitespace":
        return line.split()
    try:
        cells = next(csv.reader(io.StringIO(line), delimiter=layout.delimiter), [])
    except csv.Error:
        cells = line.split(layout.delimiter)
    return [cell.strip() for cell in cells]


def _unique(names: Sequence[str]) -> tuple[str, ...]:
    seen: dict[str, int] = {}
    found = []
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        found.append(name if seen[name] == 1 else f"{name}.{seen[name]}")
    return tuple(found)


class RecordReader:
    """Takes a text file apart.

    Args:
        layout: how it is written.
        names: of its columns, as many as its rows have cells.
        wanted: names of the columns to return.
        base: offset of the file in the source.
    """

    def __init__(
        self, layout: Layout, names: Sequence[str], wanted: Sequence[str], base: int
    ) -> None:
        self._layout, self._names, self._wanted = layout, tuple(names), tuple(wanted)
        self._comment = (layout.comment or "").encode()
        self._blanks = layout.delimiter == "whitespace"
        self._delimiter = TAB if self._blanks else ord(layout.delimiter)
        self._base = base

    def read(self, file: IO[bytes], head: Head) -> Iterator[CellBatch | Rejects]:
        """Yield the rows of a file, and what is none."""
        file.read(head.octets)
        yield CellBatch({}, np.zeros(0, np.int64), np.zeros(0, np.int64), head.octets)

        def find_in(octets: bytes, last: bool) -> RecordBounds:
            piece = np.frombuffer(octets, np.uint8)
            if self._blanks:
                return find_by_blanks(piece, head.line_end, last)
            return find(piece, self._delimiter, head.line_end, self._comment, last)

        base = self._base + head.octets
        line_end = bytes([head.line_end])
        for item in read_pieces(file, find_in, base, MAX_RECORD_BYTES, _ENDLESS, line_end):
            if isinstance(item, Reject):
                yield Rejects(np.array([item.offset]), np.array([item.length]), item.reason)
            else:
                octets, at, found = item
                yield from self._sorted(np.frombuffer(octets, np.uint8), found, at)

    def _sorted(
        self, octets: Octets, found: RecordBounds, base: int
    ) -> Iterator[CellBatch | Rejects]:
        """Yield the rows of complete records, and those that are damaged."""
        offsets, lengths = found.starts + base, found.lengths()
        besides = starts_with(octets, found.starts, self._comment)
        besides |= (found.cells == 0) | (
            (lengths <= 2) & ((octets[found.starts] == LF) | (octets[found.starts] == CR))
        )
        trailing = self._trailing(octets, found)
        sound = ~besides
        for reason, wrong in (
            (_MARKS, found.damaged),
            (_ENDLESS, lengths > MAX_RECORD_BYTES),
            ("NUL bytes", _any(octets == 0, found.starts)),
            (
                "another number of cells than the table has columns",
                found.cells - trailing != len(self._names),
            ),
            ("text that is not UTF-8", self._undecodable(octets, found)),
        ):
            lost = sound & wrong
            if lost.any():
                yield Rejects(offsets[lost], lengths[lost], reason)
                sound = sound & ~wrong
        kept = np.repeat(sound, lengths)
        kept[_last_octets(octets, found)[trailing & sound]] = False
        text = octets if kept.all() else octets[kept]
        sizes = (lengths - trailing)[sound]
        rows = CellBatch({}, offsets[sound], lengths[sound], int(lengths[besides].sum()))
        yield from self._rows(text, sizes, rows)

    def _trailing(self, octets: Octets, found: RecordBounds) -> NDArray[np.bool_]:
        """Which records end with a delimiter behind which there is nothing, beyond the last
        column.
        """
        if self._blanks:
            return np.zeros(found.starts.size, bool)
        return np.asarray(
            (found.cells == len(self._names) + 1)
            & (octets[_last_octets(octets, found)] == self._delimiter)
        )

    def _undecodable(self, octets: Octets, found: RecordBounds) -> NDArray[np.bool_]:
        wrong = np.zeros(found.starts.size, bool)
        if self._layout.encoding == "latin-1" or _decodes(octets):
            return wrong
        stops = found.starts + found.lengths()
        for place in np.flatnonzero(_any(octets >= 0x80, found.starts)).tolist():
            wrong[place] = not _decodes(octets[found.starts[place] : stops[place]])
        return wrong

    def _rows(self, octets: Octets, sizes: Ints, rows: CellBatch) -> Iterator[CellBatch | Rejects]:
        """Yield the rows of sound records of these sizes; where Arrow sees other records than we
        do, halve until the one is found.
        """
        columns = self._parsed(octets, sizes.size)
        if columns is not None:
            yield CellBatch(columns, rows.offsets, rows.lengths, rows.besides)
        elif sizes.size == 1:
            yield CellBatch({}, rows.offsets[:0], rows.lengths[:0], rows.besides)
            yield Rejects(rows.offsets, rows.lengths, _MARKS)
        else:
            half = sizes.size // 2
            cut = int(sizes[:half].sum())
            yield from self._rows(
                octets[:cut],
                sizes[:half],
                CellBatch({}, rows.offsets[:half], rows.lengths[:half], rows.besides),
            )
            yield from self._rows(
                octets[cut:], sizes[half:], CellBatch({}, rows.offsets[half:], rows.lengths[half:])
            )

    def _parsed(self, octets: Octets, rows: int) -> Mapping[str, Any] | None:
        import pyarrow as pa

        if not rows:
            return {name: pa.array([], pa.string()) for name in self._wanted}
        text = (tabbed(octets) if self._blanks else octets).tobytes()
        if self._layout.encoding == "latin-1":
            text = text.decode("latin-1").encode()
        table = parse(
            text,
            self._names,
            self._wanted,
            delimiter=chr(self._delimiter),
            quoted=not self._blanks,
            empty=NULLS,
        )
        if table is None or table.num_rows != rows:
            return None
        return {
            name: self._with_points(table.column(name).combine_chunks()) for name in self._wanted
        }

    def _with_points(self, cells: Any) -> Any:
        """Return cells with numbers written with a point where the layout has a comma."""
        if not self._layout.decimal_comma:
            return cells
        import pyarrow.compute as pc

        return pc.replace_substring_regex(cells, _WITH_COMMA, r"\1.\2")


def _any(flags: NDArray[np.bool_], starts: Ints) -> NDArray[np.bool_]:
    """Which records have a flag that is set."""
    found = np.zeros(starts.size, bool)
    found[np.searchsorted(starts, np.flatnonzero(flags), "right") - 1] = True
    return found


def _last_octets(octets: Octets, found: RecordBounds) -> Ints:
    """Where the last octet before the line end of each record is."""
    last = found.starts + found.lengths() - 1
    for line_end in (LF, CR):
        last = np.where((octets[last] == line_end) & (last > found.starts), last - 1, last)
    return last


def _decodes(octets: Octets) -> bool:
    try:
        octets.tobytes().decode()
    except UnicodeDecodeError:
        return False
    return True
