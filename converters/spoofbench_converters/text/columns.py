"""Tables whose columns are found by name."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench.conversion import Rejects, RowBatch
from spoofbench.table import Column
from spoofbench_converters.text import numbers
from spoofbench_converters.text.lines import Rows

NOT_A_NUMBER = "a cell that must be a number is none"
WRONG_WIDTH = "the number of cells is not that of the header"

Fields = Mapping[str, NDArray[Any] | Column]
"""Values of rows by field: an array ``(n,)``, or a column that says which rows have it."""


class ColumnReader:
    """Rows of one width, read column by column.

    Attributes:
        rows: the rows.
        places: place of each column by name.
        bad: bool ``(n,)``, which have had, in the columns read so far, a cell that is no number.
    """

    def __init__(self, rows: Rows, places: Mapping[str, int], decimal_comma: bool = False) -> None:
        self.rows = rows
        self.bad = np.zeros(rows.widths.size, bool)
        self.places = places
        self._width = int(rows.widths.min()) if rows.widths.size else 0
        self._decimal_comma = decimal_comma

    def __len__(self) -> int:
        """Number of rows."""
        return self.rows.widths.size

    def __contains__(self, name: str) -> bool:
        return self.places.get(name, self._width) < self._width

    @property
    def offset(self) -> NDArray[np.int64]:
        """Where each row begins in the log, in bytes, ``(n,)``."""
        return self.rows.lines.offsets

    @property
    def units(self) -> NDArray[np.int64]:
        """How many bytes each row takes, ``(n,)``."""
        return self.rows.lines.lengths

    def floats(self, *names: str) -> NDArray[np.float64]:
        """Return the first of these columns that there is, NaN where a cell is empty, or where
        there is none of them.
        """
        for name in names:
            if name in self:
                values, bad = numbers.floats(
                    self.rows.column(self.places[name]), self._decimal_comma
                )
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
                    self.rows.column(self.places[name]), decimals, self._decimal_comma
                )
                self.bad |= bad
                return values, present
        return np.zeros(len(self), np.int64), np.zeros(len(self), bool)

    def words(self, name: str) -> NDArray[np.bytes_]:
        """Return a column of words, empty where there is none."""
        return (
            numbers.words(self.rows.column(self.places[name]))
            if name in self
            else np.zeros(len(self), "S1")
        )

    def rejects(self, rows: NDArray[np.bool_], reason: str) -> Iterator[Rejects]:
        """Yield the rows that a mask selects as rejects, if there are any."""
        if rows.any():
            yield Rejects(self.offset[rows], self.units[rows], reason)

    def batch(
        self, kind: str, time_ns: NDArray[np.int64], fields: Fields, rows: NDArray[np.bool_]
    ) -> RowBatch:
        """Return the rows that a mask selects as rows of a kind, whose bytes they take."""
        whole = RowBatch.of(kind, time_ns, fields, self.offset, self.units)
        return whole if rows.all() else whole.take(rows)
