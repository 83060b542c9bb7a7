"""Recordings for other programs: Parquet, CSV, GPX, or a table laid out by a mapping.

A table has the columns ``time_ns`` (int64, Unix UTC on the recording's clock), ``time`` (the same
as a timestamp, UTC) and the fields that the topic has, under their names. Absent is null, in CSV an
empty cell. Enums are the names of the schema's values; numbers that it does not name are digits.
Each file appears whole or not at all.
"""

import json
import os
import re
import shutil
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal
from xml.sax.saxutils import XMLGenerator
from xml.sax.xmlreader import AttributesImpl

import numpy as np

from spoofbench import __version__, plugins
from spoofbench.arrays import Indices
from spoofbench.codec import read
from spoofbench.conversion import Exporting
from spoofbench.errors import PluginError, RecordingError, SpoofbenchError
from spoofbench.formatting import printable
from spoofbench.recording import Metadata, Recording
from spoofbench.schema import Field, split_topic
from spoofbench.schema.v1 import gnss_pb2
from spoofbench.table import Table

TableFormat = Literal["parquet", "csv"]

SEGMENT_GAP_S = 10.0
"""A longer gap ends a segment of a track: the receiver was lost or switched off, and no line may be
drawn.
"""


def export(
    file: Path, out: Path, *, topics: Sequence[str] = (), table_format: TableFormat = "csv"
) -> list[str]:
    """Write topics of a recording for other programs; return their names.

    Args:
        file: the recording.
        out: ends in ``.parquet`` or ``.csv``: one topic; in ``.gpx``: the tracks of all receivers,
            or of those asked for; in ``.zip``, or anything else, a folder: a file per topic.
        topics: those to write; else all.
        table_format: of the files in a folder or an archive.

    Raises:
        FormatError: the file is not a recording.
        RecordingError: it has no such topic, or several where one file is to be written; ``out``
            cannot be written, or is a folder that is not empty.
    """
    recording = read(file)
    for topic in topics:
        if topic not in recording:
            raise RecordingError(
                f"the recording has no topic {topic!r}; it has {sorted(recording)}"
            )
    chosen = list(dict.fromkeys(topics)) or list(recording)
    suffix = out.suffix.removeprefix(".")
    if suffix == "gpx":
        chosen = [topic for topic in chosen if split_topic(topic)[1] == "gnss/pvt"]
        if not chosen:
            raise RecordingError(
                f"{file.name!r} has no gnss/pvt topic to draw; it has {sorted(recording)}"
            )
        with _whole(out) as path:
            write_gpx([(split_topic(topic)[0], recording[topic]) for topic in chosen], path)
    elif suffix in _TABLE_WRITERS:
        if len(chosen) != 1:
            raise RecordingError(
                f"{out.name!r} can hold one topic; say which with --topic, or name a folder or a "
                f".zip: {chosen}"
            )
        with _whole(out) as path:
            _write_topic(recording, chosen[0], path, suffix)
    else:
        with _whole(out) as path:
            folder = path.with_name(f"{path.name}.d") if suffix == "zip" else path
            folder.mkdir(parents=True)
            try:
                for topic, name in _file_names(chosen).items():
                    _write_topic(recording, topic, folder / f"{name}.{table_format}", table_format)
                if folder != path:
                    _pack(folder, path)
            finally:
                if folder != path:
                    shutil.rmtree(folder)
    return chosen


def export_by_mapping(file: Path, out: Path, mapping: str) -> None:
    """Write a recording as the table, or the folder of tables, that a mapping describes.

    Args:
        file: the recording.
        out: what to write to.
        mapping: path of a mapping, or the name of a ready one.

    Raises:
        FormatError: the file is not a recording.
        PluginError: no converter knows mappings, or it failed.
        ConversionError: there is no such mapping, or the recording lacks what it names.
    """
    recording = read(file)
    for plugin in plugins.found(plugins.CONVERTERS).values():
        converter = plugin.load()
        if isinstance(converter, Exporting):
            break
    else:
        raise PluginError("no converter that is installed can export by a mapping")
    try:
        with _whole(out) as path:
            converter.export(recording, mapping, path)
    except SpoofbenchError:
        raise
    except Exception as error:  # a plugin may raise anything
        raise PluginError(
            f"{plugin} failed to export {file.name!r}: {type(error).__name__}: {error}"
        ) from error


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
        name: _arrow_array(table, field)
        for name, field in table.kind.fields.items()
        if name in table
    }
    records = {name: dict(record) for name, record in metadata.items()}
    about = {"spoofbench.topic": topic, "spoofbench.metadata": json.dumps(records)}
    return pa.table(columns).replace_schema_metadata(about)


def _arrow_array(table: Table, field: Field) -> Any:
    import pyarrow as pa

    column, absent = table.column(field.name), ~table.valid(field.name)
    if field.category == "enum":
        used, codes = np.unique(column.values, return_inverse=True)
        values = table.kind.message.fields_by_name[field.name].enum_type.values_by_number
        names = [values[n].name if n in values else str(n) for n in used.tolist()]
        return pa.DictionaryArray.from_arrays(
            pa.array(codes.astype(np.int32), mask=absent), pa.array(names, pa.string())
        )
    if column.categories is not None:
        kind = pa.string() if field.category == "text" else pa.binary()
        return pa.DictionaryArray.from_arrays(
            pa.array(column.values, mask=absent), pa.array(column.categories, kind)
        )
    return pa.array(column.values, mask=absent)


def write_parquet(table: Any, path: Path) -> None:
    """Write an Arrow table, bit by bit what it holds."""
    from pyarrow import parquet

    parquet.write_table(table, path, compression="zstd")


def write_csv(table: Any, path: Path) -> None:
    """Write an Arrow table as UTF-8 text with a header; floats read back to the same value, times
    are as ``2026-01-02T03:04:05.000000006Z``, bytes are hexadecimal digits.
    """
    import pyarrow as pa
    from pyarrow import csv

    times = table["time_ns"].to_numpy().astype("datetime64[ns]")
    stamps = np.datetime_as_string(times) if times.size else []
    table = table.set_column(1, "time", pa.array([f"{stamp}Z" for stamp in stamps], pa.string()))
    for index, field in enumerate(table.schema):
        if pa.types.is_dictionary(field.type):
            array = table[field.name].combine_chunks()
            texts = [
                value.hex() if isinstance(value, bytes) else value
                for value in array.dictionary.to_pylist()
            ]
            column = pa.array(texts, pa.string()).take(array.indices)
            table = table.set_column(index, field.name, column)
    csv.write_csv(table, path)


_TABLE_WRITERS: Mapping[str, Callable[[Any, Path], None]] = {
    "parquet": write_parquet,
    "csv": write_csv,
}


def _write_topic(recording: Recording, topic: str, path: Path, table_format: str) -> None:
    table = arrow_table(recording[topic], topic, recording.metadata)
    _TABLE_WRITERS[table_format](table, path)


def write_gpx(tracks: Iterable[tuple[str, Table]], path: Path) -> None:
    """Write the positions of ``gnss/pvt`` tables as tracks for maps, each by its name.

    GPX 1.1 (https://www.topografix.com/GPX/1/1/). ``ele`` is the height above mean sea level, m,
    absent where the receiver gave none; rows without a position give no point and end a segment.
    """
    root = {
        "version": "1.1",
        "creator": f"spoofbench {__version__}",
        "xmlns": "http://www.topografix.com/GPX/1/1",
    }
    with path.open("w", encoding="utf-8") as file:
        xml = XMLGenerator(file, "utf-8", short_empty_elements=True)
        xml.startDocument()
        xml.startElement("gpx", AttributesImpl(root))
        for name, table in tracks:
            xml.characters("\n")
            xml.startElement("trk", _NO_ATTRIBUTES)
            _write_element(xml, "name", printable(name))
            for rows in _segments(table):
                xml.characters("\n")
                xml.startElement("trkseg", _NO_ATTRIBUTES)
                for attributes, elements in _track_points(table.take(rows)):
                    xml.characters("\n")
                    xml.startElement("trkpt", AttributesImpl(attributes))
                    for element, text in elements.items():
                        _write_element(xml, element, text)
                    xml.endElement("trkpt")
                xml.endElement("trkseg")
            xml.endElement("trk")
        xml.endElement("gpx")
        xml.endDocument()


_NO_ATTRIBUTES: "AttributesImpl[str]" = AttributesImpl({})
_GPX_FIXES: Mapping[int, str] = {
    gnss_pb2.FIX_TYPE_NONE: "none",
    gnss_pb2.FIX_TYPE_2D: "2d",
    gnss_pb2.FIX_TYPE_3D: "3d",
    gnss_pb2.FIX_TYPE_DIFFERENTIAL: "dgps",
}
_GPX_FIELDS = ("height_msl_m", "height_m", "num_sv", "hdop", "vdop", "pdop", "diff_age_s")


def _write_element(xml: XMLGenerator, name: str, text: str) -> None:
    xml.startElement(name, _NO_ATTRIBUTES)
    xml.characters(text)
    xml.endElement(name)


def _segments(table: Table) -> list[Indices]:
    """Return the rows of each unbroken stretch, ``(k,)`` each."""
    lat, lon = table["lat_deg"], table["lon_deg"]
    rows = np.flatnonzero((np.abs(lat) <= 90) & (np.abs(lon) <= 180))
    if not rows.size:
        return []
    breaks = (np.diff(rows) > 1) | (np.diff(table.time_ns[rows]) > SEGMENT_GAP_S * 1e9)
    return np.split(rows, np.flatnonzero(breaks) + 1)


def _track_points(table: Table) -> Iterator[tuple[dict[str, str], dict[str, str]]]:
    """Yield each point's attributes and, in the order of the standard, its elements; absent is left
    out.
    """
    times = np.datetime_as_string(table.time_ns.astype("datetime64[ns]"))
    columns = {name: np.where(table.valid(name), table[name], np.nan) for name in _GPX_FIELDS}
    fixes = np.where(table.valid("fix_type"), table["fix_type"], gnss_pb2.FIX_TYPE_UNSPECIFIED)
    lon = np.where(table["lon_deg"] == 180, -180.0, table["lon_deg"])  # the standard excludes 180
    for i in range(len(table)):
        elements = {
            "ele": _decimal(columns["height_msl_m"][i]),
            "time": f"{times[i]}Z",
            "geoidheight": _decimal(columns["height_m"][i] - columns["height_msl_m"][i]),
            "fix": _GPX_FIXES.get(int(fixes[i])),
            "sat": _decimal(columns["num_sv"][i]),
            "hdop": _decimal(columns["hdop"][i]),
            "vdop": _decimal(columns["vdop"][i]),
            "pdop": _decimal(columns["pdop"][i]),
            "ageofdgpsdata": _decimal(columns["diff_age_s"][i]),
        }
        position = {"lat": _decimal(table["lat_deg"][i]), "lon": _decimal(lon[i])}
        yield (
            {name: text for name, text in position.items() if text is not None},
            {name: text for name, text in elements.items() if text is not None},
        )


def _decimal(value: float) -> str | None:
    """Return a number without an exponent; None where it is not finite."""
    return np.format_float_positional(value, trim="-") if np.isfinite(value) else None


def _file_names(topics: Sequence[str]) -> dict[str, str]:
    """Return a file name per topic, such as ``gnss0_gnss_pvt``, without what a path could take for
    more than a name.
    """
    names: dict[str, str] = {}
    for topic in topics:
        name = re.sub(r"[^A-Za-z0-9-]+", "_", topic).strip("_")
        while name.casefold() in {other.casefold() for other in names.values()}:
            name += "_"
        names[topic] = name
    return names


def _pack(folder: Path, archive: Path) -> None:
    """Pack a folder; the times of its files are left out, so that the same tables give the same
    archive.
    """
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as packed:
        for path in sorted(folder.iterdir()):
            member = packed.open(zipfile.ZipInfo(path.name), "w", force_zip64=True)
            with path.open("rb") as file, member:
                shutil.copyfileobj(file, member)


@contextmanager
def _whole(out: Path) -> Iterator[Path]:
    """Yield a path to write to; what is there takes the name of ``out`` at the end, or goes if an
    exception ends it.
    """
    temporary = out.with_name(f".{os.getpid()}.part.{out.name}")  # its suffix says the format
    if out.is_dir() and any(out.iterdir()):
        raise RecordingError(f"the folder {str(out)!r} is not empty; name another")
    if out.exists() and not (out.is_dir() or out.is_file()):
        raise RecordingError(f"{str(out)!r} is neither a file nor a folder; name another")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        temporary.replace(out)
    except OSError as error:
        raise RecordingError(
            f"{str(out)!r} cannot be written: {error.strerror or error}"
        ) from error
    finally:
        if temporary.is_dir():
            shutil.rmtree(temporary)
        temporary.unlink(missing_ok=True)
