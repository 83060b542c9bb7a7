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

from collections import abc
from dataclasses import dataclass
from pathlib import Path

from spoofbench import config
from spoofbench.errors import ConversionError, RecordingError
from spoofbench.recording import Metadata
from spoofbench.schema import split_topic
from spoofbench_converters.table.fields import FieldSpec, TimeSpec, field_specs, time_spec
from spoofbench_converters.table.settings import (
    AnchorSettings,
    Cells,
    Format,
    MappingSettings,
    TableSettings,
    TimeSettings,
    TopicSettings,
    as_tuple,
    cells_as_text,
    topic_settings,
)

MAX_MAPPING_BYTES = 2**20
READY = Path(__file__).parent / "mappings"


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
        flight: columns that tell flights apart; a table may lack them.
    """

    name: str
    files: tuple[str, ...]
    messages: tuple[str, ...]
    layout: Layout
    columns: tuple[str, ...]
    signature: str
    flight: tuple[str, ...]
    time: TimeSpec | None
    topics: tuple[TopicSpec, ...]

    def wanted(self) -> dict[str, bool]:
        """Return the columns that are read, and whether the table may lack each."""
        found = dict.fromkeys(self.time.columns() if self.time else (), False)
        for topic in self.topics:
            for name, optional in topic.columns().items():
                found[name] = optional and found.get(name, True)
        return dict.fromkeys(self.flight, True) | found


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
    where = f"the mapping {name!r}"
    content = config.read_toml(octets, where, ConversionError)
    settings = config.read(MappingSettings, content, where, error=ConversionError)
    tables = tuple(_table(where, *item) for item in settings.table.items())
    if not tables:
        raise ConversionError(f"{where} has no [table.<name>]")
    topics = [topic.topic for table in tables for topic in table.topics]
    duplicated = next((topic for topic in topics if topics.count(topic) > 1), None)
    if duplicated:
        raise ConversionError(
            f"{where} has the topic {duplicated!r} twice: join the tables first, or give each a "
            "source of its own"
        )
    return Mapping(
        name,
        settings.about,
        settings.clock,
        settings.recognise,
        {f"source/{source}": dict(record) for source, record in settings.source.items()},
        tables,
        _anchor(where, settings.anchor, [table.name for table in tables]),
        folder,
    )


def _anchor(where: str, settings: AnchorSettings | None, tables: list[str]) -> Anchor | None:
    if settings is None:
        return None
    where = f"{where}, [anchor]"
    if settings.table not in tables:
        hint = config.did_you_mean(settings.table, tables)
        raise ConversionError(f"{where}: table = {settings.table!r} is no table{hint}")
    return Anchor(settings.table, _time(where, settings.time), settings.rtklib_tags or None)


def _table(where: str, name: str, content: abc.Mapping[str, object]) -> TableSpec:
    section = f"table.{config.bare_key(name)}"
    topics = {key: value for key, value in content.items() if key.startswith("/")}
    own = {key: value for key, value in content.items() if key not in topics}
    settings = config.read(TableSettings, own, where, section=section, error=ConversionError)
    if not topics:
        raise ConversionError(f'{where}, [{section}] has no topic, such as [{section}."/imu0/imu"]')
    return TableSpec(
        name,
        as_tuple(settings.files),
        as_tuple(settings.messages),
        Layout(
            settings.format,
            settings.delimiter,
            settings.header,
            settings.comment or None,
            settings.skip_lines,
            settings.decimal_comma,
            settings.encoding,
            settings.variable or None,
            settings.index or None,
        ),
        as_tuple(settings.columns),
        settings.signature,
        as_tuple(settings.flight),
        _time(f"{where}, [{section}.time]", settings.time),
        tuple(_topic(where, section, *item) for item in topics.items()),
    )


def _time(where: str, settings: TimeSettings | None) -> TimeSpec | None:
    if settings is None:
        return None
    try:
        return time_spec(settings)
    except (ValueError, ConversionError) as error:
        raise ConversionError(f"{where}: {error}") from error


def _topic(where: str, table: str, topic: str, content: object) -> TopicSpec:
    section = f"{table}.{config.bare_key(topic)}"
    here = f"{where}, [{section}]"
    try:
        _, kind = split_topic(topic)
    except RecordingError as error:
        raise ConversionError(f"{here}: {error}") from error
    if kind in ("truth/attack", "truth/clean"):
        raise ConversionError(
            f"{here} cannot be converted: attacks are made, or labelled, not logged"
        )
    if not isinstance(content, dict):
        raise ConversionError(f"{here}: {content!r} must be a table of the topic's fields")
    settings: TopicSettings = config.read(
        topic_settings(kind), content, where, section=section, error=ConversionError
    )
    try:
        fields = field_specs(settings, list(content), kind)
    except (ValueError, ConversionError) as error:
        raise ConversionError(f"{here}: {error}") from error
    times = (getattr(settings, key, None) for key in ("claims", "receive_time_ns"))
    claims, receive_time = (_time(here, time) for time in times)
    return TopicSpec(
        topic,
        kind,
        _conditions(settings.where),
        _conditions(settings.unless),
        as_tuple(settings.changes),
        fields,
        claims,
        receive_time,
    )


def _conditions(cells: abc.Mapping[str, Cells]) -> tuple[tuple[str, tuple[str, ...]], ...]:
    return tuple((column, cells_as_text(each)) for column, each in cells.items())
