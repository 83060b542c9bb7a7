"""Converter of ROS 2 bags in SQLite: a bag folder, or a bare ``.db3``.

Families of messages are modules of their own (see :mod:`spoofbench_converters.rosbag.family`); messages of
other types are counted as skipped. Bags of ROS 1, in MCAP, split or compressed are refused.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from spoofbench.converting import Columns, Extent, Item, Reject, Source
from spoofbench.converting.ordering import take
from spoofbench_converters.rosbag import aspn23, bag, cdr
from spoofbench_converters.rosbag.family import Family, Options, Session
from spoofbench_converters.rosbag.reading import Bag, Payloads, Slab, Topic

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
        conversion = _Conversion(log.topics, options)
        yield Extent(location.declared or log.highest_id())
        for item in log.slabs(conversion.wanted):
            if isinstance(item, Reject):
                yield item
            else:
                yield from conversion.take(item)
        yield from conversion.finish()
        if location.declared is not None and location.declared > log.records:
            yield Reject(log.records, location.declared - log.records, "declared in metadata.yaml but not in the database")
    finally:
        log.close()


class _Conversion:
    """A bag being converted: which session has which topic, and what nobody has."""

    def __init__(self, topics: Sequence[Topic], options: Options) -> None:
        self._by_recorder = options.time == "recorder"
        self._topics = {topic.number: topic for topic in topics}
        self._sessions: dict[int, Session] = {}
        self._all: list[Session] = []
        self._definitions: dict[str, Any] = {}
        for family in _FAMILIES:
            mine = [topic for topic in topics if topic.type in family.TYPES and topic.encoding == "cdr"]
            if mine:
                session = family.open(mine, options)
                self._all.append(session)
                self._sessions |= dict.fromkeys((topic.number for topic in mine), session)
                self._definitions |= family.definitions()
        if options.definitions is not None:
            self._definitions |= cdr.read_folder(Path(options.definitions), [topic.type for topic in topics])
        self._decoders = {number: cdr.Decoder(self._topics[number].type, self._definitions) for number in self._sessions}
        self._unknown: dict[int, tuple[int, int]] = {}

    @property
    def wanted(self) -> frozenset[int]:
        """Numbers of the topics that are understood."""
        return frozenset(self._sessions)

    def take(self, slab: Slab) -> Iterator[Item]:
        """Yield what a slab's messages say."""
        yield from slab.rejects
        for number, payloads in sorted(slab.wanted.items()):
            yield from self._messages(self._topics[number], payloads)
        for session in self._all:
            yield from session.settle()
        for number, (count, first) in slab.others.items():
            before, first = self._unknown.get(number, (0, first))
            self._unknown[number] = (before + count, first)

    def finish(self) -> Iterator[Item]:
        """Yield what the sessions still hold, and what was not understood."""
        for session in self._all:
            yield from session.finish()
        for number, (count, first) in sorted(self._unknown.items()):
            topic = self._topics.get(number)
            what = (
                f"topic {topic.name!r} of type {topic.type!r} ({topic.encoding}) is not understood"
                if topic
                else "the topic is not declared"
            )
            yield Reject(first, count, what)

    def _messages(self, topic: Topic, payloads: Payloads) -> Iterator[Item]:
        """Decode one topic's messages and hand them over in bag order."""
        groups, failures = self._decoders[topic.number].decode(payloads.octets, payloads.starts, payloads.lengths)
        for place, reason in failures:
            yield Reject(int(payloads.records[place]), 1, f"{topic.name}: {reason}")
        session, pieces = self._sessions[topic.number], []
        for group in groups:
            columns, refusals = session.columns(topic, group.rows)
            columns |= {"record": payloads.records[group.index], "receive_time_ns": payloads.stamps_ns[group.index]}
            if self._by_recorder:
                columns["time_ns"] = columns["receive_time_ns"]
            kept = np.ones(group.index.size, bool)
            for refused, reason in refusals:
                yield from (Reject(record, 1, f"{topic.name}: {reason}") for record in columns["record"][refused & kept].tolist())
                kept &= ~refused
            pieces.append(columns if kept.all() else take(columns, kept))
        if pieces:
            yield from session.push(topic, _in_bag_order(pieces))


def _in_bag_order(pieces: Sequence[Columns]) -> Columns:
    if len(pieces) == 1:
        return pieces[0]
    columns = {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}
    return take(columns, np.argsort(columns["record"]))
