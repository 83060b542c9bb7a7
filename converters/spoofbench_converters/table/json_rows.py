"""Tables in JSON, as pandas writes them: a list of flat records, or an object of columns.

Records are found by their braces, so that each byte has its place in the account and damage costs
one record; they hold no objects, and no braces in texts. Columns lie apart from one another in the
file: such a table is read as a whole, and its bytes are shared out evenly among its rows.
"""

import json
import re
from collections.abc import Iterator, Sequence
from typing import IO, Any

import numpy as np

from spoofbench.conversion import Rejects
from spoofbench.errors import ConversionError, LimitError
from spoofbench_converters.table.arrays import Shares
from spoofbench_converters.table.files import is_columns, read_up_to
from spoofbench_converters.table.text import CellBatch

MAX_COLUMNS_BYTES = 2**28
"""Largest table that is read as a whole."""

MAX_RECORD_BYTES = 2**20
_PIECE_BYTES = 2**22
_RECORD = re.compile(rb"\{[^{}]*\}")
_BETWEEN = b"[], \t\r\n"
_NO_RECORD = "text that is no record"


def json_columns(file: IO[bytes], head: bytes, name: str) -> tuple[str, ...]:
    """Return the names of the columns; of records, those that the first bytes name.

    Raises:
        ConversionError: a table of columns cannot be read.
    """
    if is_columns(head):
        return tuple(_whole(file, name)[0])
    records = (_record(octets) for octets in _RECORD.findall(head))
    return tuple(dict.fromkeys(key for record in records if record for key in record))


def json_rows(
    file: IO[bytes], head: bytes, name: str, wanted: Sequence[str], base: int
) -> Iterator[CellBatch | Rejects]:
    """Yield the rows of a table whose first byte lies at ``base`` in the source.

    Raises:
        ConversionError: a table of columns cannot be read.
    """
    if is_columns(head):
        columns, octets = _whole(file, name)
        places = list(dict.fromkeys(key for column in columns.values() for key in column))
        cells = {each: _cells([columns[each].get(key) for key in places]) for each in wanted}
        yield CellBatch(cells, *Shares(base, octets, len(places)).next(len(places)))
        return
    at, rest = base, b""
    while piece := read_up_to(file, _PIECE_BYTES):
        text = rest + piece
        items, read = _batch(text, wanted, at)
        yield from items
        if len(text) - read > MAX_RECORD_BYTES:
            yield Rejects(np.array([at + read]), np.array([len(text) - read]), _NO_RECORD)
            read = len(text)
        rest = text[read:]
        at += read
    if rest:
        yield from _apart(rest, [0], [len(rest)], at)


def _batch(octets: bytes, wanted: Sequence[str], at: int) -> tuple[list[CellBatch | Rejects], int]:
    """Return the rows of the complete records, what is none, and where the last one ends."""
    found = [match.span() for match in _RECORD.finditer(octets)]
    if not found:
        return [], 0
    starts, ends = np.array(found, np.int64).T
    items: list[CellBatch | Rejects] = []
    between = _apart(octets, [0, *ends[:-1].tolist()], starts.tolist(), at)
    items += between
    try:
        records = json.loads(b"[" + b",".join(octets[a:b] for a, b in found) + b"]")
    except (ValueError, RecursionError):
        records = [_record(octets[a:b]) for a, b in found]
    sound = np.array([record is not None for record in records], bool)
    if not sound.all():
        items.append(Rejects(at + starts[~sound], (ends - starts)[~sound], _NO_RECORD))
    rows = [record for record in records if record is not None]
    cells = {each: _cells([row.get(each) for row in rows]) for each in wanted}
    items.append(CellBatch(cells, at + starts[sound], (ends - starts)[sound]))
    return items, int(ends[-1])


def _apart(
    octets: bytes, starts: Sequence[int], ends: Sequence[int], at: int
) -> list[CellBatch | Rejects]:
    """Account for what stands between records: the signs that part them, or damage."""
    besides, wrong = 0, []
    for start, end in zip(starts, ends, strict=True):
        if octets[start:end].strip(_BETWEEN):
            wrong.append((start, end))
        else:
            besides += end - start
    none = np.zeros(0, np.int64)
    items: list[CellBatch | Rejects] = [CellBatch({}, none, none, besides)] if besides else []
    if wrong:
        first, last = (np.array(part, np.int64) for part in zip(*wrong, strict=True))
        items.append(Rejects(at + first, last - first, _NO_RECORD))
    return items


def _record(octets: bytes) -> dict[str, Any] | None:
    try:
        record = json.loads(octets)
    except (ValueError, RecursionError):
        return None
    return record if isinstance(record, dict) else None


def _whole(file: IO[bytes], name: str) -> tuple[dict[str, dict[str, Any]], int]:
    """Return the columns of a file, and its size.

    Raises:
        ConversionError: it is damaged; LimitError: it is too large.
    """
    octets = read_up_to(file, MAX_COLUMNS_BYTES + 1)
    if len(octets) > MAX_COLUMNS_BYTES:
        raise LimitError(f"{name!r} has more than {MAX_COLUMNS_BYTES:,} bytes")
    try:
        columns = json.loads(octets)
    except (ValueError, RecursionError) as error:
        raise ConversionError(f"the JSON table {name!r} is damaged: {error}") from error
    if not isinstance(columns, dict) or not all(isinstance(c, dict) for c in columns.values()):
        raise ConversionError(f"the JSON table {name!r} is no object of columns")
    return columns, len(octets)


def _cells(values: list[Any]) -> Any:
    """Return values as an Arrow array ``(n,)``: of numbers, of flags, else of texts."""
    import pyarrow as pa

    kinds = {type(value) for value in values} - {type(None)}
    if kinds and kinds <= {int, float}:
        return pa.array([_number(value) for value in values], pa.float64(), from_pandas=True)
    if kinds == {bool}:
        return pa.array(values, pa.bool_())
    return pa.array([_text(value) for value in values], pa.string())


def _number(value: float | None) -> float | None:
    try:
        return None if value is None else float(value)
    except OverflowError:
        return float("inf")


def _text(value: Any) -> str | None:
    if value is None or value == "":
        return None
    text = value if isinstance(value, str) else json.dumps(value)
    return text.encode("utf-8", "replace").decode()
