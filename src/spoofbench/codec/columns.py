"""Decoded pieces of a topic, gathered in file order, and the table of them."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench.errors import FormatError, RecordingError
from spoofbench.recording import Column, Table
from spoofbench.schema import Field, Kind

Values = tuple[NDArray[Any], NDArray[np.bool_] | None]
"""Values of a field ``(n,)``, and which rows have it, None where all do."""


class Columns:
    """Gathers a topic's rows in file order and makes the table of them."""

    def __init__(self, kind: Kind) -> None:
        self._kind = kind.name
        self._fields: Mapping[str, Field] = kind.fields
        self.words: dict[str, dict[bytes, int]] = {f.name: {} for f in kind.fields.values() if f.category in ("text", "bytes")}
        self._times: list[bytes] = []
        self._places: list[NDArray[np.int64]] = []
        self._rows: list[int] = []
        self._values: dict[str, list[bytes]] = {}
        self._valid: dict[str, list[bytes]] = {}

    def add(self, times: NDArray[np.int64], values: dict[str, Values], places: NDArray[np.int64] | None = None) -> None:
        """Append rows; places say their file order where it is not that of the calls."""
        for name in values.keys() - self._values.keys():
            self._values[name], self._valid[name] = [], []
            for rows in self._rows:
                self._append(self._fields[name], rows, None)
        for name in self._values:
            self._append(self._fields[name], times.size, values.get(name))
        if places is not None:
            self._places.append(places)
        self._times.append(times.tobytes())
        self._rows.append(times.size)

    def _append(self, field: Field, rows: int, given: Values | None) -> None:
        is_text = field.name in self.words
        if given is None:
            given = _blank(np.dtype(field.dtype), rows, is_text), np.zeros(rows, bool)
        values, valid = given
        if valid is not None and (is_text or values.dtype.kind == "f"):
            values = np.where(valid, values, _blank(values.dtype, rows, is_text))
        self._values[field.name].append(values.tobytes())
        if not is_text and values.dtype.kind != "f":
            self._valid[field.name].append(b"\x01" * rows if valid is None else valid.tobytes())

    def table(self) -> Table:
        """Return the table, its rows in the order of time, those of one time in file order.

        Raises:
            FormatError: a text is not valid UTF-8.
        """
        times = np.frombuffer(b"".join(self._times), np.int64)
        columns: dict[str, Column] = {}
        for name, field in self._fields.items():
            if name not in self._values:
                continue
            values = np.frombuffer(b"".join(self._values.pop(name)), field.dtype)
            mask = b"".join(self._valid[name])
            valid = np.frombuffer(mask, bool) if mask and b"\x00" in mask else None
            columns[name] = Column(values, valid, decoded(field, self.words[name]) if name in self.words else None)
        if self._places or np.any(times[1:] < times[:-1]):
            order = np.lexsort((np.concatenate(self._places), times)) if self._places else np.argsort(times, kind="stable")
            times = times[order]
            columns = {n: Column(c.values[order], None if c.valid is None else c.valid[order], c.words) for n, c in columns.items()}
        try:
            return Table(self._kind, times, columns)
        except RecordingError as error:
            raise FormatError(f"the file holds a {self._kind} table that makes no sense: {error}") from error


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
        raise FormatError(f"field {field.name!r} holds {error.object!r}, which is not valid UTF-8") from error


def _blank(dtype: np.dtype[Any], rows: int, is_text: bool) -> NDArray[Any]:
    return np.full(rows, np.nan if dtype.kind == "f" else -1 if is_text else 0, dtype)
