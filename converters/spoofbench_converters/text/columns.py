"""Records of one width as columns of cells, taken apart by Arrow."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench.conversion import Rejects, RowBatch
from spoofbench.table import Column
from spoofbench_converters.text import numbers
from spoofbench_converters.text.lines import Lines

NOT_A_NUMBER = "a cell that must be a number is none"
WRONG_WIDTH = "the number of cells is not that of the header"

Fields = Mapping[str, NDArray[Any] | Column]
"""Values of rows by field: an array ``(n,)``, or a column that says which rows have it."""


def parse(
    octets: bytes,
    names: Sequence[str],
    wanted: Sequence[str],
    *,
    delimiter: str,
    quoted: bool,
    empty: Sequence[str],
    ascii_only: bool = False,
) -> Any | None:
    """Return the wanted columns of delimited text as an Arrow table of texts, null where empty;
    None where Arrow finds other than one cell for each name in every record.

    Args:
        octets: the records, UTF-8.
        names: of all columns, which differ.
        quoted: whether cells may stand in quotation marks.
        empty: texts that stand for an empty cell.
        ascii_only: whether the records are known to be ASCII.
    """
    import pyarrow as pa
    from pyarrow import csv

    pa.default_memory_pool().release_unused()  # of the piece before: memory stays bounded
    try:
        return csv.read_csv(
            pa.BufferReader(octets),
            csv.ReadOptions(
                use_threads=False, block_size=len(octets) + 1, column_names=list(names)
            ),
            csv.ParseOptions(
                delimiter=delimiter,
                quote_char='"' if quoted else False,
                newlines_in_values=quoted,
            ),
            csv.ConvertOptions(
                check_utf8=not ascii_only,
                column_types=dict.fromkeys(wanted, pa.string()),
                include_columns=list(wanted),
                null_values=list(empty),
                strings_can_be_null=True,
            ),
        )
    except pa.ArrowInvalid:
        return None


class ColumnReader:
    """Lines of one width, read column by column.

    Attributes:
        lines: the lines, none of them blank.
        index: number of each column by name.
        bad: bool ``(n,)``, which have had, in the columns read so far, a cell that is no number.
    """

    def __init__(
        self,
        lines: Lines,
        index: Mapping[str, int],
        delimiter: str = ",",
        decimal_comma: bool = False,
    ) -> None:
        self.lines = lines
        self.index = index
        self.bad = np.zeros(len(lines), bool)
        self._delimiter, self._decimal_comma = delimiter, decimal_comma
        self._width = int(lines.cells[0]) if len(lines) else 0
        self._cells: Any = None

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.lines)

    def __contains__(self, name: str) -> bool:
        return self.index.get(name, self._width) < self._width

    @property
    def offset(self) -> NDArray[np.int64]:
        """Where each row begins in the log, in bytes, ``(n,)``."""
        return self.lines.offsets

    @property
    def units(self) -> NDArray[np.int64]:
        """How many bytes each row takes, ``(n,)``."""
        return self.lines.lengths

    def cells(self, number: int) -> Any:
        """Return the cells of one column as an Arrow array of texts, null where empty; blanks and
        quotation marks around a cell are no part of it.
        """
        if self._cells is None:
            names = [str(each) for each in range(self._width)]
            self._cells = parse(
                self.lines.joined(),
                names,
                names,
                delimiter=self._delimiter,
                quoted=False,
                empty=("",),
                ascii_only=True,
            )
            assert self._cells is not None
            assert self._cells.num_rows == len(self), "lines were miscounted"
        return numbers.stripped(self._cells.column(number).combine_chunks())

    def take(self, rows: slice) -> "ColumnReader":
        """Return the rows that a slice selects, none of them bad yet."""
        taken = ColumnReader(
            self.lines.take(rows), self.index, self._delimiter, self._decimal_comma
        )
        if self._cells is not None:
            start, stop, _ = rows.indices(len(self))
            taken._cells = self._cells.slice(start, stop - start)
        return taken

    def floats(self, *names: str) -> NDArray[np.float64]:
        """Return the first of these columns that there is, NaN where a cell is empty, or where
        there is none of them.
        """
        for name in names:
            if name in self:
                values, bad = numbers.floats(self.cells(self.index[name]), self._decimal_comma)
                self.bad |= bad
                return values
        return np.full(len(self), np.nan)

    def exact(
        self, names: Sequence[str], decimals: int = 0
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Return the first of these columns that there is, times ``10 ** decimals``, and which rows
        have a value.
        """
        for name in names:
            if name in self:
                values, present, bad = numbers.scaled(
                    self.cells(self.index[name]), decimals, self._decimal_comma
                )
                self.bad |= bad
                return values, present
        return np.zeros(len(self), np.int64), np.zeros(len(self), bool)

    def texts(self, name: str) -> NDArray[np.bytes_]:
        """Return a column of words, empty where there is none."""
        if name not in self:
            return np.zeros(len(self), "S1")
        return numbers.words(numbers.TextCells.of(self.cells(self.index[name])))

    def rejects(self, rows: NDArray[np.bool_], reason: str) -> Iterator[Rejects]:
        """Yield the rows that a mask selects as rejects, if there are any."""
        yield from self.lines.rejects(rows, reason)

    def batch(
        self, kind: str, time_ns: NDArray[np.int64], fields: Fields, rows: NDArray[np.bool_]
    ) -> RowBatch:
        """Return the rows that a mask selects as rows of a kind, whose bytes they take."""
        whole = RowBatch.of(kind, time_ns, fields, self.offset, self.units)
        return whole if rows.all() else whole.take(rows)
