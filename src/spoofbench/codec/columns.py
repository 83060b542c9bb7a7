"""Decoded pieces of a topic, gathered in file order, and the table of them."""

from collections.abc import Iterable, Mapping
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench.errors import FormatError, RecordingError
from spoofbench.schema import Field, Kind
from spoofbench.table import Column, Table

Values = tuple[NDArray[Any], NDArray[np.bool_] | None]
"""Values of a field ``(n,)``, and which rows have it, None where all do."""


class Gathering:
    """Gathers a topic's rows in file order and makes the table of them.

    A column grows in a ``BytesIO``, whose value is taken as immutable bytes without another copy.
    """

    def __init__(self, kind: Kind) -> None:
        self._kind = kind.name
        self._fields: Mapping[str, Field] = kind.fields
        self.words: dict[str, dict[bytes, int]] = {
            f.name: {} for f in kind.fields.values() if f.category in ("text", "bytes")
        }
        self._rows = 0
        self._times = BytesIO()
        self._places: list[NDArray[np.int64]] = []
        self._values: dict[str, BytesIO] = {}
        self._valid: dict[str, BytesIO] = {}

    def add(
        self,
        times: NDArray[np.int64],
        values: dict[str, Values],
        places: NDArray[np.int64] | None = None,
    ) -> None:
        """Append rows; places say their file order where it is not that of the calls."""
        for name in values.keys() - self._values.keys():
            self._values[name], self._valid[name] = BytesIO(), BytesIO()
            self._append(self._fields[name], self._rows, None)
        for name in self._values:
            self._append(self._fields[name], times.size, values.get(name))
        if places is not None:
            self._places.append(places)
        _extend(self._times, times)
        self._rows += times.size

    def _append(self, field: Field, rows: int, given: Values | None) -> None:
        blank = np.nan if field.category == "float" else -1 if field.name in self.words else 0
        values, valid = given or (np.full(rows, blank, field.dtype), np.zeros(rows, bool))
        if field.category == "float" or field.name in self.words:
            values = (
                values if valid is None else np.where(valid, values, np.array(blank, values.dtype))
            )
        else:
            _extend(self._valid[field.name], np.ones(rows, bool) if valid is None else valid)
        _extend(self._values[field.name], values)

    def table(self) -> Table:
        """Return the table, its rows in the order of time, those of one time in file order.

        Raises:
            FormatError: a text is not valid UTF-8.
        """
        times = np.frombuffer(self._times.getvalue(), np.int64)
        columns: dict[str, Column] = {}
        for name, field in self._fields.items():
            if name in self._values:
                values = np.frombuffer(self._values.pop(name).getvalue(), field.dtype)
                valid = np.frombuffer(self._valid[name].getvalue(), bool)
                words = decoded(field, self.words[name]) if name in self.words else None
                columns[name] = Column(values, None if valid.all() else valid, words)
        if self._places or np.any(times[1:] < times[:-1]):
            order = (
                np.lexsort((np.concatenate(self._places), times))
                if self._places
                else np.argsort(times, kind="stable")
            )
            times = times[order]
            columns = {
                n: Column(c.values[order], None if c.valid is None else c.valid[order], c.words)
                for n, c in columns.items()
            }
        try:
            return Table(self._kind, times, columns)
        except RecordingError as error:
            raise FormatError(
                f"the file holds a {self._kind} table that makes no sense: {error}"
            ) from error


def _extend(column: BytesIO, values: NDArray[Any]) -> None:
    column.write(np.ascontiguousarray(values).data)


def decoded(field: Field, words: Iterable[bytes]) -> tuple[str, ...] | tuple[bytes, ...]:
    """Return a text or bytes field's words as the column has them.

    Raises:
        FormatError: a text is not valid UTF-8.
    """
    if field.category == "bytes":
        return tuple(words)
    try:
        return tuple(word.decode() for word in words)
    except UnicodeDecodeError as error:
        raise FormatError(
            f"field {field.name!r} holds {error.object!r}, which is not valid UTF-8"
        ) from error
