"""Recordings: frozen tables by topic, and metadata."""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench.errors import RecordingError
from spoofbench.schema import CLEAN_TOPIC, SCHEMA_VERSION, SENSOR_KINDS, TRUTH_TOPIC, split_topic
from spoofbench.table import Table

Metadata = Mapping[str, Mapping[str, str]]
"""Records of text by name, as in MCAP. A key whose value is unknown is left out; others than these
may stand beside them.

recording       ``schema_version``; ``session_id``: recordings of one session share it; ``clock``:
                what ``time_ns`` is told by: ``sensor`` (the devices, when they measured),
                ``recorder`` (the host, when it received) or ``gnss`` (there was no clock: the first
                valid claimed time and nominal intervals); ``clock_steps`` as JSON and
                ``clock_step_count``: where the log's clock stepped and the axis did not follow;
                ``reference_date`` and ``week_rollover`` as the user gave them; ``leap_seconds`` as
                the log gave them; ``times_without_zone``: stamps that were not used
primary         by kind, the source that a detector gets when it asks for that kind
source/<name>   ``topic``: where the log had it; ``device``; ``axes``: where x, y and z of a sensor
                point, such as ``frd``; ``interval_s`` of an IMU's averages; ``antenna_position_m``;
                ``time_basis``, ``counter_offset_s`` and ``counter_spread_s`` of a sensor's own
                counter laid on the axis; ``header_offset_s`` of a message's stamp; ``solution``:
                ``gnss``, or ``fused`` with inertial sensors; ``<key>_basis``: how the converter
                knows. That of the reference is ``source/reference``
origin          ``file``, ``size``, ``sha256`` of the log; ``converter``, its ``converter_version``
                and ``converter_distribution``, ``options`` as JSON
ledger          :meth:`spoofbench.conversion.Ledger.as_metadata`
unread          by topic, what a file's messages are that are no rows of ours; reading gives it
damage          ``truncated`` and ``lost_bytes`` of a file that was cut off; reading gives it
"""

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
        """Which of these times, ``(n,)``, lie within."""
        return (time_ns >= self.start_ns) & (time_ns < self.end_ns)


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


def is_really_attacked(recording: Recording) -> bool:
    """Return whether the recording has labels of a real attack: then it has no clean twin."""
    return TRUTH_TOPIC in recording and "real" in recording[TRUTH_TOPIC].texts("provenance")


def attacked_intervals(recording: Recording) -> tuple[Interval, ...]:
    """Return the attack intervals, in the order of time."""
    return _intervals(recording, TRUTH_TOPIC)


def clean_intervals(recording: Recording) -> tuple[Interval, ...]:
    """Return the intervals that were reviewed and found clean, in the order of time."""
    return _intervals(recording, CLEAN_TOPIC)


def _intervals(recording: Recording, topic: str) -> tuple[Interval, ...]:
    if topic not in recording:
        return ()
    starts, ends = (recording[topic][name].tolist() for name in ("start_ns", "end_ns"))
    return tuple(sorted(map(Interval, starts, ends)))


def _digest_table(digest: Any, topic: str, table: Table) -> None:
    digest.update(json.dumps([topic, len(table)]).encode())
    digest.update(table.time_ns.tobytes())
    for name in table:
        if not table.has(name):
            continue
        column = table.column(name)
        values, words = column.values, column.categories
        if values.dtype.kind == "f":
            values = np.where(np.isnan(values), np.array(np.nan, values.dtype), values)
        digest.update(
            json.dumps([name, None if words is None else [repr(word) for word in words]]).encode()
        )
        digest.update(np.packbits(table.valid(name)).tobytes() + values.tobytes())
