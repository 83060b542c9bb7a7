"""Mappings: a TOML file that says what the columns of tables are.

A mapping has tables, a table has a time and topics, a topic has fields, and a field has a column::

    about = "A car logger at 50 Hz"
    # what the time is told by: sensor, recorder or gnss
    clock = "sensor"

    [source.imu0]
    axes = "flu"                                        # metadata of a source, as in a recording

    [table.log]
    files = "*.csv"                                     # within a folder or archive
    delimiter = ","

    [table.log.time]
    column = "millis"
    unit = "ms"                                         # since 1970, UTC, unless said otherwise

    [table.log."/imu0/imu"]
    accel = { columns = ["ax", "ay", "-az"], unit = "g" }
    gyro_z_radps = { column = "yawrate", unit = "deg/s" }

    [table.log."/gnss0/gnss/pvt"]
    # a row only where one of these differs from the row before
    changes = ["lat", "lon"]
    lat_deg = "lat"                                     # in the field's own unit
    fix_type = { column = "q", values = { 1 = "RTK_FIXED", 2 = "RTK_FLOAT" } }

The README beside the ready mappings lists every key. A leading minus negates a column. The columns
of a ROS message are
the paths of its fields (``imu.linear_acceleration.x``), and those of an array ``value[0]``.
"""

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from spoofbench.errors import ConversionError, RecordingError
from spoofbench.recording import Metadata
from spoofbench.schema import split_topic
from spoofbench_converters.table.fields import FieldSpec, TimeSpec, read_fields, read_time
from spoofbench_converters.table.toml import Node

MAX_MAPPING_BYTES = 2**20
READY = Path(__file__).parent / "mappings"

Format = Literal["csv", "parquet", "mat", "npy"]
_CLOCKS = ("sensor", "recorder", "gnss")
_FORMATS = ("csv", "parquet", "mat", "npy")
_TOPIC_SETTINGS = ("where", "unless", "changes")
_TABLE_SETTINGS = (
    "files",
    "messages",
    "format",
    "delimiter",
    "header",
    "columns",
    "signature",
    "comment",
    "skip_lines",
    "decimal_comma",
    "encoding",
    "variable",
    "index",
    "time",
)


@dataclass(frozen=True, slots=True)
class Layout:
    """How a table is written down.

    Attributes:
        format: None: told by content.
        delimiter: one character, or ``whitespace``: runs of blanks and tabs.
        header: whether the first line names the columns.
        comment: lines that start with it are no rows.
        skip_lines: lines before the header that are no rows.
        decimal_comma: whether numbers are written ``1,5``.
        encoding: ``utf-8`` or ``latin-1``.
        variable: name of the matrix in a MAT file.
        index: name of the array in each folder of arrays by which the rows of several folders are
            matched.
    """

    format: Format | None
    delimiter: str
    header: bool
    comment: str | None
    skip_lines: int
    decimal_comma: bool
    encoding: str
    variable: str | None
    index: str | None


@dataclass(frozen=True, slots=True)
class TopicSpec:
    """Rows of one topic.

    Attributes:
        where: by column, the values with which a row is of this topic.
        unless: by column, the values with which it is not.
        changes: columns of which at least one must differ from the row before.
        fields: by field of the kind.
        claims: the time that a receiver claims, for ``gps_week`` and ``tow_s``.
        receive_time: for ``receive_time_ns``.
    """

    topic: str
    kind: str
    where: tuple[tuple[str, tuple[str, ...]], ...]
    unless: tuple[tuple[str, tuple[str, ...]], ...]
    changes: tuple[str, ...]
    fields: tuple[FieldSpec, ...]
    claims: TimeSpec | None
    receive_time: TimeSpec | None

    @property
    def source(self) -> str:
        return split_topic(self.topic)[0]

    def columns(self) -> dict[str, bool]:
        """Return the columns that the topic reads, and whether a table may lack each."""
        found: dict[str, bool] = {}
        names = [
            (field.column, field.optional) for field in self.fields if field.column is not None
        ]
        names += [(name, False) for name, _ in (*self.where, *self.unless)] + [
            (name, False) for name in self.changes
        ]
        names += [
            (name, False)
            for time in (self.claims, self.receive_time)
            if time
            for name in time.columns()
        ]
        for name, optional in names:
            found[name] = optional and found.get(name, True)
        return found


@dataclass(frozen=True, slots=True)
class TableSpec:
    """One table, which may be spread over several files, or the messages of one type.

    Attributes:
        files: patterns of paths within the folder or archive.
        messages: patterns of ROS message types (``package/Type``).
        columns: names of the columns; of a table with a header, all that it may have, by which it
            is recognised.
        signature: what a comment before a table without header starts with, by which it is
            recognised; runs of blanks are one.
    """

    name: str
    files: tuple[str, ...]
    messages: tuple[str, ...]
    layout: Layout
    columns: tuple[str, ...]
    signature: str
    time: TimeSpec | None
    topics: tuple[TopicSpec, ...]

    def wanted(self) -> dict[str, bool]:
        """Return the columns that are read, and whether the table may lack each."""
        found = dict.fromkeys(self.time.columns() if self.time else (), False)
        for topic in self.topics:
            for name, optional in topic.columns().items():
                found[name] = optional and found.get(name, True)
        return found


@dataclass(frozen=True, slots=True)
class Anchor:
    """Where a clock without date meets time: at the first row of a table that has both, or by
    RTKLIB's time tags of it.
    """

    table: str
    time: TimeSpec | None
    tags: str | None


@dataclass(frozen=True, slots=True)
class Mapping:
    """A whole mapping; ``folder`` is where a user's own mapping file lies, None of a ready one."""

    name: str
    about: str
    clock: str
    recognised: bool
    sources: Metadata
    tables: tuple[TableSpec, ...]
    anchor: Anchor | None
    folder: Path | None


def ready_names() -> tuple[str, ...]:
    """Return the names of the mappings that come with the converter."""
    return tuple(sorted(path.stem for path in READY.glob("*.toml")))


def load_mapping(path_or_name: str | Path) -> Mapping:
    """Return a ready mapping by its name, or a mapping by the path of its TOML file.

    Raises:
        ConversionError: there is none, or it does not say what it must; the text says where and
            what is near.
    """
    text = str(path_or_name)
    if text in ready_names():
        path, folder = READY / f"{text}.toml", None
    else:
        path, folder = Path(path_or_name), Path(path_or_name).resolve().parent
    if not path.is_file():
        raise ConversionError(
            f"there is no mapping {text!r}: give the path of a TOML file, or one of "
            f"{', '.join(ready_names())}"
        )
    if path.stat().st_size > MAX_MAPPING_BYTES:
        raise ConversionError(
            f"{path.name!r} is no mapping: it has more than {MAX_MAPPING_BYTES:,} bytes"
        )
    return read_mapping(path.read_bytes(), path.stem, folder)


def read_mapping(octets: bytes, name: str, folder: Path | None = None) -> Mapping:
    """Return the mapping that TOML text says.

    Raises:
        ConversionError: as :func:`load_mapping`.
    """
    try:
        content = tomllib.loads(octets.decode())
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise ConversionError(f"the mapping {name!r} is not TOML: {error}") from error
    root = Node(content, f"the mapping {name!r}")
    root.only("about", "clock", "recognise", "source", "table", "anchor")
    tables = tuple(_table(node, key) for key, node in root.children("table"))
    if not tables:
        raise root.error("has no [table.<name>]")
    topics = [topic.topic for table in tables for topic in table.topics]
    twice = next((topic for topic in topics if topics.count(topic) > 1), None)
    if twice:
        raise root.error(
            f"has the topic {twice!r} twice: join the tables first, or give each a source of its "
            "own"
        )
    sources = {
        f"source/{key}": {k: node.text(k) for k in node} for key, node in root.children("source")
    }
    clock = root.one_of("clock", _CLOCKS)
    return Mapping(
        name,
        root.text("about", ""),
        clock,
        root.flag("recognise", False),
        sources,
        tables,
        _anchor(root, [t.name for t in tables]),
        folder,
    )


def _anchor(root: Node, tables: list[str]) -> Anchor | None:
    node = root.child("anchor")
    if node is None:
        return None
    node.only("table", "time", "rtklib_tags")
    table, time, tags = (
        node.one_of("table", tables),
        node.child("time"),
        node.text("rtklib_tags", ""),
    )
    if (time is None) == (not tags):
        raise node.error("needs one of 'time' and 'rtklib_tags'")
    return Anchor(table, read_time(time) if time else None, tags or None)


def _table(node: Node, name: str) -> TableSpec:
    topics = [key for key in node if key.startswith("/")]
    node.only(*_TABLE_SETTINGS, *topics)
    if not topics:
        raise node.error('has no topic, such as [table.<name>."/imu0/imu"]')
    files = node.texts("files")
    if any(pattern.startswith("/") or ".." in pattern.split("/") for pattern in files):
        raise node.error(
            f"has files {list(files)!r}, which must lie within the mapping's own folder"
        )
    time, messages = node.child("time"), node.texts("messages")
    if time is None and not messages:
        raise node.error(
            "has no time: say at least which column it is, as in time = { column = 't', unit = "
            "'s' }"
        )
    layout, columns = _layout(node), node.texts("columns")
    if not layout.header and not columns and layout.format in (None, "csv"):
        raise node.error("has no header, so it needs 'columns': a name for each, from the left")
    if len(set(columns)) < len(columns):
        raise node.error("names a column twice in 'columns'")
    return TableSpec(
        name,
        files,
        messages,
        layout,
        columns,
        node.text("signature", ""),
        read_time(time) if time else None,
        tuple(_topic(node.child_of(topic), topic) for topic in topics),
    )


def _layout(node: Node) -> Layout:
    formats: tuple[Format | None, ...] = ("csv", "parquet", "mat", "npy")
    delimiter = node.text("delimiter", ",")
    if delimiter != "whitespace" and (
        len(delimiter) != 1 or delimiter in '"\r\n' or not delimiter.isascii()
    ):
        raise node.error(
            f"has the delimiter {delimiter!r}, which must be one ASCII character or 'whitespace'"
        )
    chosen = node.one_of("format", _FORMATS, "")
    return Layout(
        next((each for each in formats if each == chosen), None),
        delimiter,
        node.flag("header", True),
        node.text("comment", "") or None,
        node.count("skip_lines"),
        node.flag("decimal_comma", False),
        node.one_of("encoding", ("utf-8", "latin-1"), "utf-8"),
        node.text("variable", "") or None,
        node.text("index", "") or None,
    )


def _topic(node: Node, topic: str) -> TopicSpec:
    try:
        _, kind = split_topic(topic)
    except RecordingError as error:
        raise node.error(f"is none: {error}") from error
    if kind == "truth/attack":
        raise node.error("cannot be converted: attacks are made, or labelled, not logged")
    fields, claims, receive_time = read_fields(node, kind, _TOPIC_SETTINGS)
    return TopicSpec(
        topic,
        kind,
        _conditions(node, "where"),
        _conditions(node, "unless"),
        node.texts("changes"),
        fields,
        claims,
        receive_time,
    )


def _conditions(node: Node, key: str) -> tuple[tuple[str, tuple[str, ...]], ...]:
    conditions = node.child(key)
    return (
        () if conditions is None else tuple((name, conditions.words(name)) for name in conditions)
    )
