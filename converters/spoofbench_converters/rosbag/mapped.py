"""Messages of types that a mapping describes, or that hold messages of ROS.

A mapping (:mod:`spoofbench_converters.table.mapping`) says by paths of fields what the messages of
a type hold; one applies where the type has every field that it reads. A type without one that has,
say, a sensor_msgs/Imu among its fields is read for that, under its own header's stamp.
"""

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from spoofbench.conversion import Columns
from spoofbench.errors import ConversionError
from spoofbench.gnss_time import GPS_EPOCH_NS, SECOND_NS, WEEK_NS, leap_seconds_at_gps
from spoofbench.schema import KINDS
from spoofbench_converters.rosbag.batches import BagTopic
from spoofbench_converters.rosbag.contract import DecodedMessages, DecodedRows
from spoofbench_converters.rosbag.definitions import Definitions
from spoofbench_converters.rosbag.fields import Fields, Integers, paths_of
from spoofbench_converters.rosbag.messages import EMBEDDED, Reader, Spec

if TYPE_CHECKING:
    from spoofbench_converters.table.fields import FieldSpec, TimeSpec
    from spoofbench_converters.table.mapping import Mapping as TableMapping
    from spoofbench_converters.table.mapping import TableSpec, TopicSpec

_HEADER = "std_msgs/msg/Header"
_VELOCITIES = frozenset({"vel_n_mps", "vel_e_mps", "speed_mps"})


def specs(
    topics: Sequence[BagTopic], types: Mapping[int, Definitions], mapping: str | None
) -> dict[int, Spec]:
    """Return how topics' messages are read, by number, for those that a mapping describes or that
    hold messages of ROS.

    Raises:
        ConversionError: the mapping that is named cannot be read, or describes none of the topics.
    """
    given: list[TableMapping] = []
    if mapping is not None:
        from spoofbench_converters.table.mapping import load_mapping

        given.append(load_mapping(mapping))
    found: dict[int, Spec] = {}
    for topic in topics:
        paths = paths_of(topic.type, types[topic.number])
        tables = [
            (each, table)
            for each in given
            for table in each.tables
            if _describes(table, topic, paths)
        ]
        if not tables and topic.type.partition("/")[0] not in _OF_ROS:
            tables = [
                (each, table)
                for each in _ready()
                for table in each.tables
                if _describes(table, topic, paths)
            ]
        if tables:
            found[topic.number] = _spec(*tables[0], paths)
        elif topic.type.partition("/")[0] not in _OF_ROS and (embedded := _embedded(paths)):
            found[topic.number] = embedded
    if given and not any(number in found for number in (topic.number for topic in topics)):
        raise ConversionError(
            f"the mapping {mapping!r} describes no topic of the bag; its types are "
            f"{sorted({topic.type for topic in topics})}"
        )
    return found


_OF_ROS = frozenset(
    {
        "sensor_msgs",
        "geometry_msgs",
        "nav_msgs",
        "std_msgs",
        "gps_common",
        "gps_msgs",
        "nmea_msgs",
        "ublox_msgs",
    }
)


@cache
def _ready() -> "tuple[TableMapping, ...]":
    """Return the mappings that come with the converter."""
    from spoofbench_converters.table.mapping import read_mapping

    folder = files(__package__) / "mappings"
    paths = sorted(
        (path for path in folder.iterdir() if path.name.endswith(".toml")),
        key=lambda path: path.name,
    )
    return tuple(read_mapping(path.read_bytes(), path.name.removesuffix(".toml")) for path in paths)


def _describes(table: "TableSpec", topic: BagTopic, paths: Mapping[str, str]) -> bool:
    """Whether a table is of a topic's type, and the type has all the fields that it names."""
    name = topic.type.replace("/msg/", "/")
    needed = [*table.columns, *(path for path, optional in table.wanted().items() if not optional)]
    return any(
        fnmatchcase(name, pattern.replace("/msg/", "/")) for pattern in table.messages
    ) and all(_path(path)[0].partition("[")[0] in paths for path in needed)


def _path(column: str) -> tuple[str, int]:
    """Return the path of a column, and -1 where a minus stands before it."""
    return (column[1:], -1) if column.startswith("-") else (column, 1)


def _spec(mapping: "TableMapping", table: "TableSpec", paths: Mapping[str, str]) -> Spec:
    kinds = tuple(topic.kind for topic in table.topics)
    if len(set(kinds)) < len(kinds) or any(
        topic.changes or topic.receive_time for topic in table.topics
    ):
        raise ConversionError(
            f"the table {table.name!r} of the mapping {mapping.name!r} cannot be used for "
            "messages: "
            "it may have each kind once, and neither 'changes' nor 'receive_time_ns'"
        )
    time = table.time
    if time is not None and (
        time.unit is None or time.is_relative or time.date is not None or time.wraps
    ):
        raise ConversionError(
            f"the time of the table {table.name!r} of the mapping {mapping.name!r} cannot be used "
            "for messages: it must be a number "
            "that counts since unix, gps, matlab, a date or a week; without a time, the header's "
            "stamps are taken"
        )
    header = next(
        (path for path, base in paths.items() if base == _HEADER and "." not in path), None
    )

    def read(fields: Fields) -> DecodedMessages:
        parts = [_part(topic, fields) for topic in table.topics]
        return DecodedMessages(parts, _stamp(table.time, header, fields))

    about = {
        topic.kind: mapping.sources.get(f"source/{topic.source}", {}) for topic in table.topics
    }
    names = {
        field.name for topic in table.topics if topic.kind == "gnss/pvt" for field in topic.fields
    }
    side = (
        ""
        if "lat_deg" in names and names & _VELOCITIES
        else "position"
        if "lat_deg" in names
        else "velocity"
        if names
        else ""
    )
    return Spec(
        kinds,
        read,
        side,
        {kind: {**record, "mapping": mapping.name} for kind, record in about.items()},
    )


def _part(topic: "TopicSpec", fields: Fields) -> DecodedRows:
    columns: Columns = {field.name: _values(field, topic.kind, fields) for field in topic.fields}
    if topic.claims is not None and topic.claims.week is not None and topic.claims.unit is not None:
        columns["gps_week"] = fields.floats(topic.claims.week)
        columns["tow_s"] = topic.claims.unit.to_schema(fields.floats(topic.claims.column))
    if topic.kind == "imu":
        columns.setdefault("interval_s", np.zeros(len(fields)))
    chosen = np.ones(len(fields), bool)
    for conditions, wanted in ((topic.where, True), (topic.unless, False)):
        for path, words in conditions:
            chosen &= np.isin(_words(fields, path), words) == wanted
    if chosen.all():
        return DecodedRows(topic.kind, columns)
    return DecodedRows(
        topic.kind,
        {name: values[chosen] for name, values in columns.items()},
        np.flatnonzero(chosen),
    )


def _values(spec: "FieldSpec", kind: str, fields: Fields) -> NDArray[np.float64] | NDArray[np.str_]:
    """Return a field's values, NaN (of text: empty) where absent."""
    text = KINDS[kind].fields[spec.name].category == "text"
    if spec.column is None:
        return np.full(len(fields), str(spec.constant) if text else float(spec.constant or 0))
    path, sign = _path(spec.column)
    words = _words(fields, path) if text or spec.missing or spec.values else np.empty(0, str)
    absent = np.isin(words, spec.missing) if spec.missing else np.zeros(len(fields), bool)
    if spec.values is not None:
        values = np.full(len(fields), "" if text else np.nan, "U64" if text else float)
        for word, value in spec.values.items():
            values[words == word] = str(value) if text else float(value)
    elif text:
        values = words
    else:
        values = (
            spec.unit.to_schema(fields.floats(path)) * (sign * (-1 if spec.negate else 1))
            + spec.offset
        )
    return np.where(absent, "" if text else np.nan, values)


def _words(fields: Fields, path: str) -> NDArray[np.str_]:
    """Return values as a mapping writes them."""
    whole = fields.integers(path)
    if whole is not None:
        return whole.astype(str)
    return (
        fields.texts(path)
        if fields.texts(path).dtype.itemsize > 4
        else fields.floats(path).astype(str)
    )


def _stamp(time: "TimeSpec | None", header: str | None, fields: Fields) -> Integers | None:
    """Return the messages' own times: as the mapping says, else the stamp of their header."""
    if time is None:
        return None if header is None else fields.stamp_ns(f"{header}.stamp")
    assert time.unit is not None
    path, _ = _path(time.column)
    whole, per_ns = fields.integers(path), time.unit.factor * SECOND_NS
    raw = fields.floats(path)
    if whole is not None and per_ns.denominator == 1:
        ticks: Integers = whole * per_ns.numerator
    else:
        ticks = np.where(np.isnan(raw), 0, np.rint(raw * float(per_ns))).astype(np.int64)
    weeks = fields.integers(time.week) if time.week else None
    own_ns: Integers = (
        ticks
        + (GPS_EPOCH_NS if time.since_ns is None else time.since_ns)
        + (0 if weeks is None else weeks * WEEK_NS)
    )
    if time.scale == "utc":
        return own_ns
    return own_ns - SECOND_NS * (
        leap_seconds_at_gps(own_ns - GPS_EPOCH_NS)
        if time.leap_seconds is None
        else time.leap_seconds
    )


def _embedded(paths: Mapping[str, str]) -> Spec | None:
    """Return how messages of a type are read that has messages of ROS among its fields."""
    held = {
        path: EMBEDDED[base] for path, base in paths.items() if "." not in path and base in EMBEDDED
    }
    kinds = [kind for spec in held.values() for kind in spec.kinds]
    if not held or len(set(kinds)) < len(kinds):
        return None
    header = next(
        (path for path, base in paths.items() if base == _HEADER and "." not in path), None
    )
    return Spec(
        tuple(kinds), _reader(held, header), side="position" if kinds == ["gnss/pvt"] else ""
    )


def _reader(held: Mapping[str, Spec], header: str | None) -> Reader:
    def read(fields: Fields) -> DecodedMessages:
        parts: list[DecodedRows] = []
        stamp = None if header is None else fields.stamp_ns(f"{header}.stamp")
        for path, spec in held.items():
            decoded = spec.read(fields.within(path))
            stamp = decoded.stamp_ns if stamp is None else stamp
            good = (
                ~np.any([mask for mask, _ in decoded.refusals], axis=0)
                if decoded.refusals
                else np.ones(len(fields), bool)
            )
            parts += [
                DecodedRows(
                    part.kind,
                    {name: v[good] for name, v in part.columns.items()},
                    np.flatnonzero(good),
                )
                for part in decoded.parts
            ]
        return DecodedMessages(parts, stamp)

    return read
