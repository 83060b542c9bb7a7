"""A topic's rows as an Arrow table, and that as Parquet or CSV.

Columns are ``time_ns`` (int64, Unix UTC on the recording's clock), ``time`` (the same as a
timestamp, UTC) and the fields that the topic has, under their names. Absent is null, in CSV an
empty cell. Enums are the names of the schema's values, numbers that it does not name are digits.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from spoofbench.recording import Metadata
from spoofbench.schema import Field
from spoofbench.table import Table


def arrow_table(table: Table, topic: str, metadata: Metadata) -> Any:
    """Return the rows as a ``pyarrow.Table``; its schema's metadata name the topic and hold the
    recording's metadata as JSON.
    """
    import pyarrow as pa

    columns = {
        "time_ns": pa.array(table.time_ns),
        "time": pa.array(table.time_ns).cast(pa.timestamp("ns", "UTC")),
    }
    columns |= {
        name: _array(table, field) for name, field in table.kind.fields.items() if name in table
    }
    about = {
        "spoofbench.topic": topic,
        "spoofbench.metadata": json.dumps(
            {name: dict(record) for name, record in metadata.items()}
        ),
    }
    return pa.table(columns).replace_schema_metadata(about)


def _array(table: Table, field: Field) -> Any:
    import pyarrow as pa

    column, absent = table.column(field.name), ~table.valid(field.name)
    if field.category == "enum":
        used, codes = np.unique(column.values, return_inverse=True)
        names = table.kind.message.fields_by_name[field.name].enum_type.values_by_number
        words = [names[number].name if number in names else str(number) for number in used.tolist()]
        return pa.DictionaryArray.from_arrays(
            pa.array(codes.astype(np.int32), mask=absent), pa.array(words, pa.string())
        )
    if column.words is not None:
        kind = pa.string() if field.category == "text" else pa.binary()
        return pa.DictionaryArray.from_arrays(
            pa.array(column.values, mask=absent), pa.array(column.words, kind)
        )
    return pa.array(column.values, mask=absent)


def write_parquet(table: Any, path: Path) -> None:
    """Write an Arrow table, bit by bit what it holds."""
    from pyarrow import parquet

    parquet.write_table(table, path, compression="zstd")


def write_csv(table: Any, path: Path) -> None:
    """Write an Arrow table as UTF-8 text with a header; floats read back to the same value, bytes
    are hexadecimal digits.
    """
    import pyarrow as pa
    from pyarrow import csv

    table = table.set_column(1, "time", _iso(table["time_ns"]))
    for place, field in enumerate(table.schema):
        if pa.types.is_dictionary(field.type):
            table = table.set_column(place, field.name, _spelled(table[field.name]))
    csv.write_csv(table, path)


def _iso(time_ns: Any) -> Any:
    """``2026-01-02T03:04:05.000000006Z``"""
    import pyarrow as pa

    stamps = (
        np.datetime_as_string(time_ns.to_numpy().astype("datetime64[ns]")) if len(time_ns) else []
    )
    return pa.array([f"{stamp}Z" for stamp in stamps], pa.string())


def _spelled(column: Any) -> Any:
    import pyarrow as pa

    array = column.combine_chunks()
    words: Sequence[Any] = array.dictionary.to_pylist()
    texts = pa.array(
        [word.hex() if isinstance(word, bytes) else word for word in words], pa.string()
    )
    return texts.take(array.indices)
