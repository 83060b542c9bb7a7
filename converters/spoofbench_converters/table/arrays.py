"""Tables that are no text: Parquet, NumPy arrays, and the matrices of MAT files, as rows.

Their rows have no bytes of their own, so the bytes of a file are shared out evenly among the rows
that it has.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from tokenize import TokenError
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from spoofbench.errors import ConversionError, LimitError
from spoofbench_converters.table.files import read_up_to
from spoofbench_converters.table.text import CellBatch

MAX_ARRAY_BYTES = 2**30
BATCH_ROWS = 65_536

Arrays = Mapping[str, NDArray[Any]]


class Shares:
    """Shares ``octets`` bytes of the source from ``base`` on out among ``rows`` rows."""

    def __init__(self, base: int, octets: int, rows: int) -> None:
        self._base, self._octets, self._rows = base, octets, rows
        self._given = 0

    def next(self, count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return offsets and lengths of the next rows, int64 ``(count,)`` each."""
        first, self._given = self._given, self._given + count
        ends = np.array([self._octets * row // self._rows for row in (first, self._given)])
        bounds = ends[0] + (ends[1] - ends[0]) * np.arange(count + 1) // max(count, 1)
        return self._base + bounds[:-1], np.diff(bounds)


def column_names(arrays: Arrays, names: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the columns of arrays: of a matrix ``name[0]``, ``name[1]``, ..., or the names given
    for those of a single one.
    """
    found: list[str] = []
    for name, array in arrays.items():
        found += (
            [name] if array.ndim == 1 else [f"{name}[{place}]" for place in range(array.shape[1])]
        )
    if names and len(arrays) == 1:
        return tuple(names[: len(found)])
    return tuple(found)


def rows_of(arrays: Arrays, names: Sequence[str], shares: Shares) -> Iterator[CellBatch]:
    """Yield the rows of arrays of equal length ``(n,)`` or ``(n, k)``.

    Raises:
        ConversionError: their lengths differ.
    """
    import pyarrow as pa

    columns = [
        part
        for array in arrays.values()
        for part in ([array] if array.ndim == 1 else list(array.T))
    ]
    by_name = dict(zip(column_names(arrays, names), columns, strict=False))
    sizes = {name: array.shape[0] for name, array in arrays.items()}
    if len(set(sizes.values())) > 1:
        raise ConversionError(f"arrays of one table differ in length: {sizes}")
    total = next(iter(sizes.values()), 0)
    for first in range(0, total, BATCH_ROWS):
        part = {
            name: pa.array(np.ascontiguousarray(column[first : first + BATCH_ROWS]))
            for name, column in by_name.items()
        }
        yield CellBatch(part, *shares.next(min(BATCH_ROWS, total - first)))


def read_npy(file: IO[bytes], name: str) -> NDArray[Any]:
    """Return a NumPy array of numbers, ``(n,)`` or ``(n, k)``.

    Raises:
        ConversionError: it is none, or is cut off; LimitError: it is too large.
    """
    try:
        version = np.lib.format.read_magic(file)
        if version[0] > 2:
            raise ValueError(f"version {version}")
        reader = (
            np.lib.format.read_array_header_1_0
            if version[0] == 1
            else np.lib.format.read_array_header_2_0
        )
        shape, by_columns, dtype = reader(file)
    except (
        ValueError,
        TypeError,
        SyntaxError,
        TokenError,
        EOFError,
        RecursionError,
        MemoryError,
    ) as error:
        raise ConversionError(f"{name!r} is no NumPy array that can be read: {error}") from error
    if dtype.kind not in "fiubM" or dtype.itemsize > 16 or len(shape) not in (1, 2):
        raise ConversionError(
            f"{name!r} is an array {shape} of {dtype}, where numbers with one or two axes can be "
            "read"
        )
    octets = math.prod(shape) * dtype.itemsize
    if octets > MAX_ARRAY_BYTES:
        raise LimitError(f"the array {name!r} has {octets:,} bytes, more than {MAX_ARRAY_BYTES:,}")
    content = read_up_to(file, octets)
    if len(content) < octets:
        raise ConversionError(
            f"the array {name!r} is cut off: it has {len(content):,} of {octets:,} bytes"
        )
    array = np.frombuffer(content, dtype).reshape(shape, order="F" if by_columns else "C")
    return array.astype(dtype.newbyteorder("="))


def matched(arrays: Arrays, index: str) -> Arrays:
    """Return the arrays of several folders as columns of one table, in rows of equal times; absent
    where a folder has no such time.

    Args:
        arrays: by ``<folder>/<name>``; each folder has an array called ``index``.
    """
    times = {
        name.rpartition("/")[0]: array
        for name, array in arrays.items()
        if name.rpartition("/")[2] == index
    }
    if any(array.ndim != 1 for array in times.values()) or not times:
        raise ConversionError(
            f"the arrays {sorted(arrays)} have no array {index!r} with one axis beside them"
        )
    every = np.unique(np.concatenate(list(times.values())))
    found: dict[str, NDArray[Any]] = {index: every}
    for name, array in arrays.items():
        folder, _, own = name.rpartition("/")
        if own == index or folder not in times:
            continue
        if array.shape[0] != times[folder].size:
            raise ConversionError(
                f"the array {name!r} has {array.shape[0]} rows, but {folder}/{index} has "
                f"{times[folder].size}"
            )
        filled = np.full((every.size, *array.shape[1:]), np.nan)
        filled[np.searchsorted(every, times[folder])] = array
        found[name] = filled
    return found


def parquet_rows(
    file: IO[bytes], name: str, wanted: Sequence[str], base: int, octets: int
) -> Iterator[CellBatch]:
    """Yield the rows of a Parquet file.

    Raises:
        ConversionError: it cannot be read.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.ParquetFile(file)
        shares, read = Shares(base, octets, table.metadata.num_rows), 0
        for batch in table.iter_batches(BATCH_ROWS, columns=list(wanted)):
            batch.validate(full=True)
            read += batch.num_rows
            if read > table.metadata.num_rows:
                break
            yield CellBatch(
                {column: _plain(batch.column(column)) for column in wanted},
                *shares.next(batch.num_rows),
            )
    except (pa.ArrowException, OSError, ValueError) as error:
        raise ConversionError(f"{name!r} is no Parquet file that can be read: {error}") from error
    if read != table.metadata.num_rows:
        raise ConversionError(
            f"the Parquet file {name!r} is damaged: it declares {table.metadata.num_rows:,} rows, "
            "but holds others"
        )
    if not read:
        yield CellBatch({}, np.zeros(0, np.int64), np.zeros(0, np.int64), octets)


def parquet_columns(file: IO[bytes], name: str) -> tuple[str, ...]:
    """Return the names of a Parquet file's columns."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        return tuple(pq.ParquetFile(file).schema_arrow.names)
    except (pa.ArrowException, OSError, ValueError) as error:
        raise ConversionError(f"{name!r} is no Parquet file that can be read: {error}") from error


def _plain(cells: Any) -> Any:
    """Return cells without a dictionary, texts as such."""
    import pyarrow as pa
    import pyarrow.compute as pc

    if pa.types.is_dictionary(cells.type):
        cells = cells.dictionary_decode()
    if pa.types.is_large_string(cells.type) or pa.types.is_string_view(cells.type):
        cells = pc.cast(cells, pa.string())
    if pa.types.is_string(cells.type):
        cells = pc.if_else(pc.equal(cells, ""), pa.scalar(None, pa.string()), cells)
    return cells
