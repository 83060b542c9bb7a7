"""Recordings: frozen tables of numpy columns by topic, and metadata.

Columns are read-only views of immutable ``bytes``, so no detector can alter, or be made to alter,
what the next one sees. Whatever looks like a change returns a new object.
"""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spoofbench.errors import RecordingError
from spoofbench.schema import KINDS, SCHEMA_VERSION, SENSOR_KINDS, Field, Kind, split_topic

Metadata = Mapping[str, Mapping[str, str]]
"""Records of text by name, as in MCAP. A key whose value is unknown is left out; others than these
may stand beside them.

recording       ``schema_version``; ``session_id``: recordings of one session share it; ``clock``:
                what ``time_ns`` is told by:
                ``sensor`` (the devices, when they measured), ``recorder`` (the host, when it
                received) or ``gnss`` (there was no
                clock: the first valid claimed time and nominal intervals); ``clock_steps`` as JSON
                and ``clock_step_count``:
                where the log's clock stepped and the axis did not follow; ``reference_date`` and
                ``week_rollover`` as the user
                gave them; ``leap_seconds`` as the log told them; ``times_without_zone``: stamps
                that were not used
primary         by kind, the source that a detector gets when it asks for that kind
source/<name>   ``topic``: where the log had it; ``device``; ``axes``: where x, y and z of a sensor
                point, such as ``frd``;
                ``interval_s`` of an IMU's averages; ``antenna_position_m``; ``time_basis``,
                ``counter_offset_s`` and
                ``counter_spread_s`` of a sensor's own counter laid on the axis; ``header_offset_s``
                of a message's stamp;
                ``solution``: ``gnss``, or ``fused`` with inertial sensors; ``<key>_basis``: how the
                converter knows. That of the reference is ``source/reference``
origin          ``file``, ``size``, ``sha256`` of the log; ``converter``, its ``converter_version``
                and ``converter_distribution``,
                ``options`` as JSON
ledger          :meth:`spoofbench.conversion.Ledger.as_metadata`
unread          by topic, what a file's messages are that are no rows of ours; reading gives it
damage          ``truncated`` and ``lost_bytes`` of a file that was cut off; reading gives it
"""

Rows = slice | NDArray[np.bool_] | NDArray[np.intp]

_NEUTRAL_METADATA: Mapping[str, frozenset[str]] = {
    "recording": frozenset({"schema_version", "clock"}),
    "primary": frozenset(SENSOR_KINDS),
}
_NEUTRAL_SOURCE_METADATA = frozenset({"axes", "antenna_position_m", "solution"})


@dataclass(frozen=True, slots=True, order=True)
class Interval:
    """Half-open interval ``[start_ns, end_ns)`` on the recording's clock."""

    start_ns: int
    end_ns: int

    def __post_init__(self) -> None:
        if self.end_ns < self.start_ns:
            raise RecordingError(f"an interval ends before it starts: {self!r}")

    @property
    def duration_s(self) -> float:
        return (self.end_ns - self.start_ns) / 1e9

    def covers(self, time_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which of these times lie within."""
        return (time_ns >= self.start_ns) & (time_ns < self.end_ns)


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """Values of one field, shape ``(n,)``.

    Floats say absence by NaN and have no mask. ``valid`` is None where every row has a value. Text
    and bytes hold codes into ``words``, -1 where absent.
    """

    values: NDArray[Any]
    valid: NDArray[np.bool_] | None = None
    words: tuple[str, ...] | tuple[bytes, ...] | None = None


def frozen(array: NDArray[Any]) -> NDArray[Any]:
    """Return the array as a read-only view of immutable bytes, without a copy where it is one
    already.
    """
    root: Any = array
    while isinstance(root, np.ndarray):
        root = root.base
    if isinstance(root, bytes) and not array.flags.writeable:
        return array
    return np.frombuffer(array.tobytes(), array.dtype)


def encode_words(values: Sequence[str | None] | Sequence[bytes | None]) -> Column:
    """Dictionary-code a sequence of texts (or of byte strings); None is absent."""
    words: dict[Any, int] = {}
    codes = np.fromiter(
        (-1 if value is None else words.setdefault(value, len(words)) for value in values),
        np.int32,
        len(values),
    )
    return Column(codes, None, tuple(words))


class Table(Mapping[str, NDArray[Any]]):
    """Rows of one kind: ``time_ns`` and one read-only array per field that is present.

    ``table[name]`` gives the values of any field of the kind, shape ``(n,)``: floats with NaN where
    absent, zeros where an absent number, flag or enum is masked by :meth:`valid`, codes into
    :meth:`words` for text.

    Args:
        kind: name of a kind of the schema.
        time_ns: int64 ``(n,)``, non-decreasing.
        columns: by field name; an array, a :class:`Column`, or for text a sequence of ``str |
            None``.

    Raises:
        RecordingError: unknown kind or field, shapes that differ, values that do not fit, or time
            running backwards.
    """

    __slots__ = ("_columns", "kind", "time_ns")
    kind: Kind
    time_ns: NDArray[np.int64]
    _columns: Mapping[str, Column]

    def __init__(
        self,
        kind: str,
        time_ns: ArrayLike,
        columns: Mapping[str, ArrayLike | Column | Sequence[Any]],
    ) -> None:
        if kind not in KINDS:
            raise RecordingError(
                f"{kind!r} is not a kind of the schema; the kinds are {sorted(KINDS)}"
            )
        times = np.asarray(time_ns)
        if times.ndim != 1 or times.dtype != np.int64:
            raise RecordingError(
                f"time_ns of a {kind} table must be int64 of shape (n,), not {times.dtype} of "
                f"shape {times.shape}"
            )
        if times.size and np.any(times[1:] < times[:-1]):
            raise RecordingError(
                f"time_ns of a {kind} table runs backwards at row "
                f"{int(np.argmax(times[1:] < times[:-1])) + 1}"
            )
        fields = KINDS[kind].fields
        unknown = set(columns) - set(fields)
        if unknown:
            raise RecordingError(f"a {kind} table has no field {sorted(unknown)[0]!r}")
        self.kind = KINDS[kind]
        self.time_ns = frozen(times)
        self._columns = MappingProxyType(
            {
                name: _column(field, columns[name], times.size)
                for name, field in fields.items()
                if name in columns
            }
        )

    @classmethod
    def _of(cls, kind: Kind, time_ns: NDArray[np.int64], columns: Mapping[str, Column]) -> "Table":
        table = cls.__new__(cls)
        table.kind, table.time_ns, table._columns = kind, time_ns, MappingProxyType(dict(columns))
        return table

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuild_table, (
            self.kind.name,
            self.time_ns.tobytes(),
            {
                name: (c.values.tobytes(), None if c.valid is None else c.valid.tobytes(), c.words)
                for name, c in self._columns.items()
            },
        )

    def __len__(self) -> int:
        """Number of rows."""
        return self.time_ns.size

    def __bool__(self) -> bool:
        return True

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __contains__(self, name: object) -> bool:
        return name in self._columns

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.column(name).values

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Table):
            return NotImplemented
        return (
            self.kind.name == other.kind.name
            and np.array_equal(self.time_ns, other.time_ns)
            and all(
                _same(self.column(name), other.column(name))
                for name in self._columns.keys() | other._columns.keys()
            )
        )

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"Table({self.kind.name!r}, {len(self)} rows, {', '.join(self)})"

    def column(self, name: str) -> Column:
        """Return one field's column, all absent where no row has it.

        Raises:
            RecordingError: the kind has no such field.
        """
        if name in self._columns:
            return self._columns[name]
        if name not in self.kind.fields:
            raise RecordingError(f"a {self.kind.name} table has no field {name!r}")
        return _absent(self.kind.fields[name], len(self))

    def valid(self, name: str) -> NDArray[np.bool_]:
        """Which rows have the field, bool ``(n,)``."""
        column = self.column(name)
        if column.values.dtype.kind == "f":
            return np.asarray(~np.isnan(column.values))
        if column.words is not None:
            return np.asarray(column.values >= 0)
        return np.ones(len(self), bool) if column.valid is None else column.valid

    def has(self, *names: str) -> bool:
        """Whether each of these fields is present in at least one row."""
        return all(name in self._columns and bool(self.valid(name).any()) for name in names)

    def words(self, name: str) -> list[Any]:
        """Return a text or bytes field's values, None where absent."""
        column = self.column(name)
        if column.words is None:
            raise RecordingError(f"field {name!r} of a {self.kind.name} table is not text")
        return [None if code < 0 else column.words[code] for code in column.values.tolist()]

    def take(self, rows: Rows) -> "Table":
        """Return the rows that a slice, mask or index array selects; their order must stay that of
        time.
        """
        columns = {
            name: _compact(
                Column(c.values[rows], None if c.valid is None else c.valid[rows], c.words)
            )
            for name, c in self._columns.items()
        }
        if isinstance(rows, slice) and (rows.step or 1) > 0:
            return Table._of(self.kind, self.time_ns[rows], columns)
        return Table(self.kind.name, self.time_ns[rows], columns)

    def replace(self, **columns: ArrayLike | Column | Sequence[Any] | None) -> "Table":
        """Return the table with these fields' columns exchanged; None takes a field away."""
        kept = {
            name: column
            for name, column in self._columns.items()
            if columns.get(name, column) is not None
        }
        return Table(
            self.kind.name,
            self.time_ns,
            {**kept, **{name: c for name, c in columns.items() if c is not None}},
        )

    def until(self, time_ns: int) -> "Table":
        """Return the rows at or before a time."""
        return self.take(slice(0, int(np.searchsorted(self.time_ns, time_ns, "right"))))

    def between(self, start_ns: int, end_ns: int) -> "Table":
        """Return the rows within ``[start_ns, end_ns)``."""
        first, last = np.searchsorted(self.time_ns, (start_ns, end_ns), "left")
        return self.take(slice(int(first), int(last)))

    def last_per_time(self) -> "Table":
        """Return one row per time: of rows that bear the same time, the last."""
        last = np.append(self.time_ns[1:] > self.time_ns[:-1], True)[: len(self)]
        return self if last.all() else self.take(last)


class Recording(Mapping[str, Table]):
    """Tables by topic, loaded when first used, and metadata.

    Args:
        tables: by topic; a table, or a function without arguments that returns it.
        metadata: records of text by name. ``primary`` gives the source of each kind that a detector
            gets when it asks for that kind.

    Raises:
        RecordingError: a topic is not one of the schema.
    """

    __slots__ = ("_digest", "_tables", "metadata")

    def __init__(
        self,
        tables: Mapping[str, Table | Callable[[], Table]],
        metadata: Metadata = MappingProxyType({}),
    ) -> None:
        for topic in tables:
            split_topic(topic)
        self._tables: dict[str, Table | Callable[[], Table]] = dict(sorted(tables.items()))
        self.metadata: Metadata = MappingProxyType(
            {name: MappingProxyType(dict(record)) for name, record in sorted(metadata.items())}
        )
        self._digest: str | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        return Recording, (
            dict(self.items()),
            {name: dict(record) for name, record in self.metadata.items()},
        )

    def __getitem__(self, topic: str) -> Table:
        table = self._tables[topic]
        if not isinstance(table, Table):
            table = self._tables[topic] = table()
        return table

    def __iter__(self) -> Iterator[str]:
        return iter(self._tables)

    def __len__(self) -> int:
        return len(self._tables)

    def __repr__(self) -> str:
        return f"Recording({', '.join(self._tables)})"

    @property
    def kinds(self) -> frozenset[str]:
        """The kinds that some source has."""
        return frozenset(split_topic(topic)[1] for topic in self)

    @property
    def span(self) -> Interval:
        """From the first row of any sensor to just after the last one.

        Raises:
            RecordingError: there is no row.
        """
        times = [self[topic].time_ns for topic in self if split_topic(topic)[1] in SENSOR_KINDS]
        times = [time for time in times if time.size]
        if not times:
            raise RecordingError("the recording has no rows")
        return Interval(
            min(int(time[0]) for time in times), max(int(time[-1]) for time in times) + 1
        )

    def topics(self, kind: str) -> tuple[str, ...]:
        """The topics of a kind, the primary source's first."""
        topics = [topic for topic in self if split_topic(topic)[1] == kind]
        primary = self.metadata.get("primary", {}).get(kind)
        return tuple(sorted(topics, key=lambda topic: split_topic(topic)[0] != primary))

    def primary(self, kind: str) -> Table:
        """Return the primary source's table of a kind.

        Raises:
            RecordingError: no source has this kind.
        """
        topics = self.topics(kind)
        if not topics:
            raise RecordingError(f"the recording has no {kind!r}; it has {sorted(self.kinds)}")
        return self[topics[0]]

    def replace(self, tables: Mapping[str, Table | None]) -> "Recording":
        """Return the recording with these topics' tables exchanged or added; None takes a topic
        away.
        """
        kept = {topic: table for topic, table in self._tables.items() if topic not in tables}
        return Recording(
            {**kept, **{topic: table for topic, table in tables.items() if table is not None}},
            self.metadata,
        )

    def with_metadata(self, metadata: Metadata) -> "Recording":
        """Return the recording with these metadata records exchanged or added."""
        return Recording(self._tables, {**self.metadata, **metadata})

    def until(self, time_ns: int) -> "Recording":
        """Return all rows at or before a time: what was known then."""
        return Recording({topic: self[topic].until(time_ns) for topic in self}, self.metadata)

    def between(self, start_ns: int, end_ns: int) -> "Recording":
        """Return all rows within ``[start_ns, end_ns)``."""
        return Recording(
            {topic: self[topic].between(start_ns, end_ns) for topic in self}, self.metadata
        )

    def blind(self) -> "Recording":
        """Return what a detector may see: an allow-list of sensor kinds and neutral metadata.

        No truth, reference, file name, device, session, attack or seed is in it.
        """
        metadata = {}
        for name, record in self.metadata.items():
            allowed = (
                _NEUTRAL_SOURCE_METADATA
                if name.startswith("source/")
                else _NEUTRAL_METADATA.get(name, frozenset())
            )
            neutral = {key: value for key, value in record.items() if key in allowed}
            if neutral:
                metadata[name] = neutral
        return Recording(
            {t: table for t, table in self._tables.items() if split_topic(t)[1] in SENSOR_KINDS},
            metadata,
        )

    def digest(self) -> str:
        """SHA-256 of the decoded rows of every topic, the schema version and the neutral
        metadata.
        """
        if self._digest is None:
            self._digest = self._digested()
        return self._digest

    def _digested(self) -> str:
        digest = hashlib.sha256()
        header = {
            "schema": SCHEMA_VERSION,
            "metadata": {name: dict(record) for name, record in self.blind().metadata.items()},
        }
        digest.update(json.dumps(header, sort_keys=True).encode())
        for topic in self:
            _digest_table(digest, topic, self[topic])
        return digest.hexdigest()


def _digest_table(digest: Any, topic: str, table: Table) -> None:
    digest.update(json.dumps([topic, len(table)]).encode())
    digest.update(table.time_ns.tobytes())
    for name in table:
        if not table.has(name):
            continue
        column = table.column(name)
        values, words = column.values, column.words
        if values.dtype.kind == "f":
            values = np.where(np.isnan(values), np.array(np.nan, values.dtype), values)
        digest.update(
            json.dumps([name, None if words is None else [repr(word) for word in words]]).encode()
        )
        digest.update(np.packbits(table.valid(name)).tobytes() + values.tobytes())


def _column(field: Field, given: Any, rows: int) -> Column:
    if field.category in ("text", "bytes"):
        column = given if isinstance(given, Column) else encode_words(given)
        if column.words is None or not all(
            isinstance(word, str if field.category == "text" else bytes) for word in column.words
        ):
            raise RecordingError(f"field {field.name!r} must be {field.category}")
        column = _compact(column)
    else:
        column = given if isinstance(given, Column) else Column(np.asarray(given))
    dtype, values = np.dtype(field.dtype), column.values
    if values.shape != (rows,) or (column.valid is not None and column.valid.shape != (rows,)):
        raise RecordingError(
            f"field {field.name!r} has shape {values.shape} where the table has {rows} rows"
        )
    if values.dtype != dtype:
        with np.errstate(invalid="ignore", over="ignore"):
            cast = values.astype(dtype)
        if dtype.kind != "f" and not np.array_equal(cast, values):
            raise RecordingError(f"field {field.name!r} has values that do not fit {dtype}")
        values = cast
    valid = column.valid
    if dtype.kind == "f":
        if valid is not None:
            values, valid = np.where(valid, values, np.array(np.nan, dtype)), None
    elif valid is not None:
        values, valid = (
            (values, None)
            if valid.all()
            else (np.where(valid, values, np.zeros((), dtype)), frozen(valid.astype(bool)))
        )
    return Column(frozen(values), valid, column.words)


def _compact(column: Column) -> Column:
    """Number a text column's words by first use and drop the unused, so that rows alone decide the
    column.
    """
    if column.words is None:
        return column
    codes = column.values
    used, first, inverse = np.unique(codes, return_index=True, return_inverse=True)
    by_first_use = np.argsort(first)
    by_first_use = by_first_use[used[by_first_use] >= 0]
    new = np.full(used.size, -1, np.int32)
    new[by_first_use] = np.arange(by_first_use.size, dtype=np.int32)
    words: Any = tuple(column.words[code] for code in used[by_first_use].tolist())
    return Column(
        frozen(new[inverse.reshape(codes.shape)] if codes.size else codes.astype(np.int32)),
        None,
        words,
    )


def _absent(field: Field, rows: int) -> Column:
    if field.category in ("text", "bytes"):
        return Column(frozen(np.full(rows, -1, np.int32)), None, ())
    dtype = np.dtype(field.dtype)
    if dtype.kind == "f":
        return Column(frozen(np.full(rows, np.nan, dtype)))
    return Column(frozen(np.zeros(rows, dtype)), frozen(np.zeros(rows, bool)))


def _same(a: Column, b: Column) -> bool:
    if a.words is not None or b.words is not None:
        return a.words == b.words and np.array_equal(a.values, b.values)
    if a.values.dtype.kind == "f":
        return np.array_equal(a.values, b.values, equal_nan=True)
    valid_a, valid_b = (
        np.ones(a.values.size, bool) if c.valid is None else c.valid for c in (a, b)
    )
    return np.array_equal(a.values, b.values) and np.array_equal(valid_a, valid_b)


def _rebuild_table(
    kind: str, time_ns: bytes, columns: Mapping[str, tuple[bytes, bytes | None, Any]]
) -> Table:
    fields = KINDS[kind].fields
    return Table._of(
        KINDS[kind],
        np.frombuffer(time_ns, np.int64),
        {
            name: Column(
                np.frombuffer(values, fields[name].dtype),
                None if valid is None else np.frombuffer(valid, bool),
                words,
            )
            for name, (values, valid, words) in columns.items()
        },
    )
