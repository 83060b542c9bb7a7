"""Converter of ROS 2 bags in SQLite: a bag folder, or a bare ``.db3``.

Families of messages are modules of their own (see :mod:`spoofbench_converters.rosbag.family`); messages of
other types are counted as skipped. Bags of ROS 1, in MCAP, split or compressed are refused.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from itertools import compress
from pathlib import Path
from typing import Any, Literal

import numpy as np

from spoofbench.converting import Extent, Item, Reject, Source
from spoofbench_converters.rosbag import aspn23, bag, cdr
from spoofbench_converters.rosbag.bag import Bag, Slab, Topic
from spoofbench_converters.rosbag.family import Family, Options, Session

__all__ = ["UNIT", "VERSION", "Options", "convert", "sniff"]

VERSION = "1"
UNIT: Literal["records"] = "records"

_FAMILIES: tuple[Family, ...] = (aspn23,)
_ROS1_MAGIC = b"#ROSBAG"


def sniff(source: Source) -> float:
    """Return 1 for a ROS 2 bag folder, an SQLite database with a bag's tables, or a ROS 1 bag, else 0."""
    if source.head.startswith(_ROS1_MAGIC):
        return 1.0
    if source.path.is_dir() or source.head.startswith(bag.SQLITE_MAGIC):
        return float(bag.is_bag(source.path))
    return 0.0


def convert(source: Source, options: Options) -> Iterator[Item]:
    """Yield what a bag holds; see :class:`spoofbench.converting.Converter`."""
    location = bag.locate(source.path)
    log = Bag(location.database)
    try:
        reading = _Reading(log, options)
        yield Extent(location.declared or log.highest_id())
        for item in log.slabs(reading.wanted):
            if isinstance(item, Reject):
                reading.records += item.length
                yield item
            else:
                yield from reading.slab(item)
        yield from reading.finish()
        if location.declared is not None and location.declared > reading.records:
            yield Reject(reading.records, location.declared - reading.records, "declared in metadata.yaml but not in the database")
    finally:
        log.close()


class _Reading:
    """A bag being read: which session has which topic, and what was seen."""

    def __init__(self, log: Bag, options: Options) -> None:
        self.records = 0
        self._by_recorder = options.time == "recorder"
        self._topics = {topic.number: topic for topic in log.topics}
        self._sessions: dict[int, Session] = {}
        self._all: list[Session] = []
        self._definitions: dict[str, Any] = {}
        for family in _FAMILIES:
            topics = [topic for topic in log.topics if topic.type in family.TYPES and topic.encoding == "cdr"]
            if topics:
                session = family.open(topics, options)
                self._all.append(session)
                self._sessions |= dict.fromkeys((topic.number for topic in topics), session)
                self._definitions |= family.definitions()
        if options.definitions is not None:
            self._definitions |= cdr.read_folder(Path(options.definitions), [topic.type for topic in log.topics])
        self._unknown: Counter[int] = Counter()
        self._first_unknown: dict[int, int] = {}

    @property
    def wanted(self) -> frozenset[int]:
        """Numbers of the topics that are understood."""
        return frozenset(self._sessions)

    def slab(self, slab: Slab) -> Iterator[Item]:
        """Yield what a slab's messages say."""
        self.records = slab.first + len(slab.topics)
        numbers = np.array(slab.topics)
        for number in np.unique(numbers).tolist():
            mine = numbers == number
            if number in self._sessions:
                yield from self._messages(self._topics[number], slab, mine)
            else:
                self._unknown[number] += int(mine.sum())
                self._first_unknown.setdefault(number, slab.first + int(np.argmax(mine)))
        for session in self._all:
            yield from session.settle()

    def finish(self) -> Iterator[Item]:
        """Yield what the sessions still hold, and what was not understood."""
        for session in self._all:
            yield from session.finish()
        for number, count in sorted(self._unknown.items()):
            topic = self._topics.get(number)
            what = (
                f"topic {topic.name!r} of type {topic.type!r} ({topic.encoding}) is not understood"
                if topic
                else "the topic is not declared"
            )
            yield Reject(self._first_unknown[number], count, what)

    def _messages(self, topic: Topic, slab: Slab, mine: Any) -> Iterator[Item]:
        """Decode one topic's messages of a slab and hand them over in bag order."""
        records = slab.first + np.flatnonzero(mine)
        chosen = mine.tolist()
        payloads = list(compress(slab.payloads, chosen))
        stamps = list(compress(slab.stamps_ns, chosen))
        if set(map(type, payloads)) != {bytes} or set(map(type, stamps)) != {int}:
            good = np.array([isinstance(p, bytes) and isinstance(s, int) for p, s in zip(payloads, stamps, strict=True)])
            for record in records[~good].tolist():
                yield Reject(record, 1, f"{topic.name}: the message or its stamp is not of the type that a bag has")
            records, payloads, stamps = records[good], list(compress(payloads, good)), list(compress(stamps, good))
        groups, failures = cdr.decode(payloads, topic.type, self._definitions)
        for place, reason in failures:
            yield Reject(int(records[place]), 1, f"{topic.name}: {reason}")
        received = np.array(stamps, np.int64)
        session, pieces = self._sessions[topic.number], []
        for group in groups:
            columns, refusals = session.columns(topic, group.rows)
            columns |= {"record": records[group.index], "receive_time_ns": received[group.index]}
            if self._by_recorder:
                columns["time_ns"] = columns["receive_time_ns"]
            kept = np.ones(group.index.size, bool)
            for refused, reason in refusals:
                yield from (Reject(record, 1, f"{topic.name}: {reason}") for record in columns["record"][refused & kept].tolist())
                kept &= ~refused
            pieces.append(columns if kept.all() else {name: values[kept] for name, values in columns.items()})
        if pieces:
            yield from session.push(topic, _in_bag_order(pieces))


def _in_bag_order(pieces: list[dict[str, Any]]) -> dict[str, Any]:
    if len(pieces) == 1:
        return pieces[0]
    columns: Mapping[str, Any] = {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}
    order = np.argsort(columns["record"])
    return {name: values[order] for name, values in columns.items()}
