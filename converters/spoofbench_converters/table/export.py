"""The reverse of a mapping: a recording as the tables that the mapping reads."""

import csv
import io
from collections.abc import Mapping as ByName
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench.errors import ConversionError
from spoofbench.gnss_time import SECOND_NS, gps_of_week, gps_to_utc
from spoofbench.recording import Recording
from spoofbench.table import Table
from spoofbench_converters.table.fields import FieldSpec, TimeSpec
from spoofbench_converters.table.files import fits
from spoofbench_converters.table.mapping import Mapping, TableSpec, TopicSpec, load_mapping
from spoofbench_converters.table.settings import ECEF
from spoofbench_converters.table.times import write_times
from spoofbench_converters.table.topic import earth_centred, resolve

Rows = NDArray[np.intp]


def export(recording: Recording, mapping: str | Path, out: Path) -> tuple[Path, ...]:
    """Write a recording as the tables of a mapping; what the mapping does not name is left out.

    Converted again by the same mapping they give the rows of the recording that the mapping can
    say.

    Args:
        recording: rows of other topics than the mapping's are left out.
        mapping: the path of a mapping, or the name of a ready one.
        out: a ``.csv`` or ``.parquet`` file for one table, else a folder for one CSV file per
            table.

    Returns:
        the files written.

    Raises:
        ConversionError: the recording has none of the mapping's topics, or the tables are of a
            format that is only read.
    """
    chosen = load_mapping(mapping)
    tables = [
        table for table in chosen.tables if any(topic.topic in recording for topic in table.topics)
    ]
    if not tables:
        topics = [topic.topic for table in chosen.tables for topic in table.topics]
        raise ConversionError(
            f"the recording has none of the topics of the mapping {chosen.name!r}: "
            f"{', '.join(topics)}"
        )
    is_file = out.suffix in (".csv", ".parquet")
    if is_file and len(tables) > 1:
        raise ConversionError(
            f"the mapping {chosen.name!r} has {len(tables)} tables, which do not fit the one file "
            f"{out.name!r}: name a folder"
        )
    if not is_file:
        out.mkdir(parents=True, exist_ok=True)
    written = []
    for table in tables:
        path = out if is_file else out / _file_name(chosen, table)
        _write(table, _columns(recording, table), path)
        written.append(path)
    return tuple(written)


def _file_name(mapping: Mapping, table: TableSpec) -> str:
    """Return a name that the table's own pattern fits."""
    if not table.files:
        return f"{table.name}.csv"
    pattern = table.files[0].rpartition("/")[2]
    plain = f"{table.name}{Path(pattern).suffix}"
    name = plain if fits(plain, pattern) else pattern.replace("*", table.name)
    if not fits(name, pattern):
        raise ConversionError(
            f"the mapping {mapping.name!r} has files {pattern!r}, from which no name can be made"
        )
    return name


def _write(table: TableSpec, columns: ByName[str, Any], path: Path) -> None:
    import pyarrow as pa
    import pyarrow.compute as pc
    import pyarrow.parquet as pq
    from pyarrow import csv as arrow

    layout = table.layout
    if layout.format not in (None, "csv", "parquet") or (
        path.suffix == ".parquet" and layout.format == "csv"
    ):
        raise ConversionError(
            f"the table {table.name!r} of the mapping is of the format {layout.format!r}, which "
            f"cannot be written as {path.name!r}"
        )
    count = max((len(column) for column in columns.values()), default=0)
    whole = {
        name: columns.get(name, pa.nulls(count, pa.string()))
        for name in table.columns or {**columns, **_needed(table)}
    }
    part = path.with_name(f"{path.name}.part")
    if path.suffix == ".parquet" or layout.format == "parquet":
        pq.write_table(pa.table(whole), part)
    else:
        is_blank = layout.delimiter == "whitespace"
        texts = whole
        if is_blank or layout.decimal_comma:
            texts = {name: pc.cast(column, pa.string()) for name, column in whole.items()}
        if layout.decimal_comma:
            numeric = {
                name for name, column in whole.items() if not pa.types.is_string(column.type)
            }
            texts = {
                name: pc.replace_substring(column, ".", ",") if name in numeric else column
                for name, column in texts.items()
            }
        if is_blank:
            texts = {name: pc.fill_null(column, "nan") for name, column in texts.items()}
        delimiter = " " if is_blank else layout.delimiter
        options = arrow.WriteOptions(
            include_header=False,
            delimiter=delimiter,
            quoting_style="none" if is_blank else "needed",
        )
        with part.open("wb") as file:
            if layout.header:
                file.write(_header(tuple(texts), delimiter))
            arrow.write_csv(pa.table(texts), file, options)
    part.replace(path)


def _needed(table: TableSpec) -> dict[str, None]:
    """Return the columns without which the mapping would not read the table."""
    return {
        name.removeprefix("-"): None for name, optional in table.wanted().items() if not optional
    }


def _header(names: Sequence[str], delimiter: str) -> bytes:
    text = io.StringIO()
    csv.writer(text, delimiter=delimiter, lineterminator="\n").writerow(names)
    return text.getvalue().encode()


def _columns(recording: Recording, table: TableSpec) -> dict[str, Any]:
    """Return a table's columns as Arrow arrays."""
    topics = [topic for topic in table.topics if topic.topic in recording]
    places, times = _places(recording, topics)
    assert table.time is not None
    columns = write_times(table.time, times)
    for topic, rows in zip(topics, places, strict=True):
        for name, cells in _cells(recording[topic.topic], topic, table).items():
            _place(columns, name, cells, rows, times.size)
    return columns


def _places(
    recording: Recording, topics: Sequence[TopicSpec]
) -> tuple[list[Rows], NDArray[np.int64]]:
    """Return in which row of the table each row of each topic stands, and the rows' times.

    Rows of equal time are one, the first of each topic with the first of the others, and so on; not
    where topics have conditions, which one row cannot all meet.
    """
    times = [recording[topic.topic].time_ns for topic in topics]
    apart = any(topic.where or topic.unless for topic in topics)
    keys = []
    for place, time_ns in enumerate(times):
        first = np.searchsorted(time_ns, time_ns, "left")
        keys.append(
            np.stack(
                [
                    time_ns,
                    np.full(time_ns.size, place if apart else 0),
                    np.arange(time_ns.size) - first,
                ],
                axis=1,
            )
        )
    unique, inverse = np.unique(np.concatenate(keys), axis=0, return_inverse=True)
    stops = np.cumsum([time_ns.size for time_ns in times])[:-1]
    return np.split(inverse.reshape(-1), stops), unique[:, 0]


def _place(columns: dict[str, Any], name: str, cells: Any, rows: Rows, count: int) -> None:
    """Put cells into the rows of a column, where it has none yet."""
    import pyarrow as pa
    import pyarrow.compute as pc

    order = np.full(count, -1)
    order[rows] = np.arange(rows.size)
    spread = cells.take(pa.array(order, mask=order < 0))
    if name in columns and columns[name].type != spread.type:
        spread = pc.cast(spread, columns[name].type)
    columns[name] = pc.coalesce(columns[name], spread) if name in columns else spread


def _cells(rows: Table, topic: TopicSpec, table: TableSpec) -> dict[str, Any]:
    """Return a topic's columns as Arrow arrays ``(n,)``."""
    import pyarrow as pa

    cells: dict[str, Any] = {}
    known = frozenset(table.columns) or frozenset(name.removeprefix("-") for name in table.wanted())
    columns: ByName[str, Any] = (
        earth_centred(rows)
        if any(field.name.startswith(tuple(ECEF)) for field in topic.fields)
        else {}
    )
    for field in topic.fields:
        column = resolve(field.column, known) if field.column is not None else None
        if column is not None:
            found = _field(rows, field, column[1] != field.negate, columns.get(field.name))
            cells[column[0]] = found
    if topic.receive_time is not None:
        cells |= _written_times(
            topic.receive_time, rows["receive_time_ns"], rows.valid("receive_time_ns")
        )
    if topic.claims is not None:
        tow_ns = np.rint(np.nan_to_num(rows["tow_s"]) * SECOND_NS).astype(np.int64)
        cells |= _written_times(
            topic.claims,
            gps_to_utc(gps_of_week(rows["gps_week"], tow_ns), topic.claims.leap_seconds),
            rows.valid("gps_week") & rows.valid("tow_s"),
        )
    for name, words in topic.where:
        cells.setdefault(name, pa.array([words[0]] * len(rows), pa.string()))
    for name in topic.changes:
        cells.setdefault(name, pa.array(np.arange(len(rows))))
    return cells


def _written_times(
    spec: TimeSpec, time_ns: NDArray[np.int64], valid: NDArray[np.bool_]
) -> dict[str, Any]:
    import pyarrow as pa
    import pyarrow.compute as pc

    return {
        name: pc.if_else(pa.array(valid), cells, pa.scalar(None, cells.type))
        for name, cells in write_times(spec, time_ns).items()
    }


def _field(rows: Table, field: FieldSpec, minus: bool, derived: NDArray[np.float64] | None) -> Any:
    """Return a field's values as what stands in its column."""
    import pyarrow as pa

    if field.values is not None:
        return _named(rows, field)
    if derived is None and rows.column(field.name).categories is not None:
        return pa.array(rows.texts(field.name), pa.string())
    values = rows[field.name] if derived is None else derived
    if values.dtype.kind == "f":
        shifted = values - field.offset if field.offset else values
        raw = field.unit.from_schema(shifted.astype(np.float64))
        return pa.array(-raw if minus else raw, mask=np.isnan(values))
    whole = field.unit.from_schema(values.astype(np.float64)) if field.unit.factor != 1 else values
    return pa.array(-whole if minus else whole, mask=~rows.valid(field.name))


def _named(rows: Table, field: FieldSpec) -> Any:
    """Return the words that a mapping has for a field's values, empty where it has none."""
    import pyarrow as pa

    assert field.values is not None
    is_text = rows.column(field.name).categories is not None
    words = np.full(len(rows), None, object)
    values = np.array(rows.texts(field.name), object) if is_text else rows[field.name]
    for word, constant in reversed(tuple(field.values.items())):
        words[(values == constant) & rows.valid(field.name)] = word
    return pa.array(words, pa.string())
