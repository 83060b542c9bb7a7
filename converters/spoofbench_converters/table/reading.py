"""From the files of a table to its rows, whatever they are written in."""

import io
from collections.abc import Iterator, Sequence
from typing import Any

from numpy.typing import NDArray

from spoofbench.conversion import Rejects
from spoofbench.conversion.sources import HEAD_BYTES
from spoofbench.errors import ConversionError
from spoofbench_converters.table import arrays
from spoofbench_converters.table.files import File, array_name
from spoofbench_converters.table.json_rows import json_columns, json_rows
from spoofbench_converters.table.mapping import TableSpec
from spoofbench_converters.table.matfile import read_mat
from spoofbench_converters.table.rows import used_columns
from spoofbench_converters.table.text import CellBatch, Head, RecordReader, read_head
from spoofbench_converters.table.topic import resolve


def rows(table: TableSpec, files: Sequence[File], base: int) -> Iterator[CellBatch | Rejects]:
    """Yield the rows of a table's files, the first of which lies at ``base`` in the source, in file
    order.
    """
    if files[0].format == "npy":
        yield from _npy_rows(table, files, base)
        return
    for file in files:
        for item in _file_rows(table, file, base):
            base += int(item.lengths.sum()) + (item.besides if isinstance(item, CellBatch) else 0)
            yield item


def columns_of(table: TableSpec, file: File) -> tuple[str, ...]:
    """Return the names of a file's columns."""
    if file.format == "parquet":
        with file.seekable() as opened:
            return arrays.parquet_columns(opened, file.name)
    if file.format == "mat":
        return arrays.column_names(*_mat(table, file))
    if file.format == "json":
        with file.open() as opened:
            return json_columns(opened, file.head, file.name)
    return ()


def required_columns(table: TableSpec) -> set[str]:
    """Return the columns that a table may not lack."""
    known = frozenset(table.columns) if table.columns else None
    return {
        (resolve(name, known) or (name, False))[0] if known else name.removeprefix("-")
        for name, optional in table.wanted().items()
        if not optional
    }


def minimum_width(table: TableSpec) -> int:
    """Return how many columns a table without header has at least: up to the last that it may not
    lack.
    """
    required = required_columns(table)
    return max(
        (place + 1 for place, name in enumerate(table.columns) if name in required), default=1
    )


def _file_rows(table: TableSpec, file: File, base: int) -> Iterator[CellBatch | Rejects]:
    if file.format == "parquet":
        with file.seekable() as opened:
            octets = opened.seek(0, io.SEEK_END)
            opened.seek(0)
            wanted = used_columns(table, arrays.parquet_columns(opened, file.name))
            yield from arrays.parquet_rows(opened, file.name, wanted, base, octets)
    elif file.format == "mat":
        found, names = _mat(table, file)
        used_columns(table, arrays.column_names(found, names))
        yield from arrays.rows_of(
            found, names, arrays.Shares(base, file.size() or 0, _length(found))
        )
    elif file.format == "json":
        wanted = used_columns(table, columns_of(table, file))
        with file.open() as opened:
            yield from json_rows(opened, file.head, file.name, wanted, base)
    else:
        head = read_head(file.head, table.layout, file.name)
        names = _names(table, head, file.name)
        with file.open() as opened:
            yield from RecordReader(table.layout, names, used_columns(table, names), base).read(
                opened, head
            )


def _names(table: TableSpec, head: Head, name: str) -> tuple[str, ...]:
    """Return the names of a text file's columns.

    Raises:
        ConversionError: it has more or fewer columns than the mapping names.
    """
    if table.layout.header:
        if not head.names:
            raise ConversionError(f"{name!r} has no header within its first {HEAD_BYTES:,} bytes")
        return head.names
    if head.width and not minimum_width(table) <= head.width <= len(table.columns):
        raise ConversionError(
            f"{name!r} has {head.width} columns, where the mapping's table {table.name!r} names "
            f"{len(table.columns)}"
        )
    return table.columns[: head.width] if head.width else table.columns


def _npy_rows(table: TableSpec, files: Sequence[File], base: int) -> Iterator[CellBatch | Rejects]:
    found: dict[str, NDArray[Any]] = {}
    octets = 0
    for file in files:
        name = array_name(file)
        if name in found:
            raise ConversionError(f"two arrays are called {name!r}: convert one session at a time")
        content = io.BytesIO(file.whole())
        found[name] = arrays.read_npy(content, file.name)
        octets += content.getbuffer().nbytes
    together: arrays.Arrays = (
        arrays.matched(found, table.layout.index) if table.layout.index else found
    )
    used_columns(table, arrays.column_names(together))
    yield from arrays.rows_of(together, (), arrays.Shares(base, octets, _length(together)))


def _mat(table: TableSpec, file: File) -> tuple[arrays.Arrays, tuple[str, ...]]:
    """Return a table's variables in a MAT file, and the names of the columns of a matrix: the
    mapping's, or those beside it in the file.
    """
    variable = table.layout.variable
    names = (
        [variable]
        if variable
        else [name.partition("[")[0].removeprefix("-") for name in table.wanted()]
    )
    labels = f"{variable}_label"
    numbers, texts = read_mat(file.whole(), file.name, frozenset([*names, labels]))
    if not numbers:
        raise ConversionError(
            f"{file.name!r} has no variable of numbers {' or '.join(map(repr, names))}; "
            "what lies in cells, in structures within structures and in arrays of structures is "
            "not read: save it as a matrix"
        )
    if variable and variable not in numbers:
        return {name.removeprefix(f"{variable}."): array for name, array in numbers.items()}, ()
    return numbers, table.columns or texts.get(labels, ())


def _length(found: arrays.Arrays) -> int:
    return max((array.shape[0] for array in found.values()), default=0)
