"""What an MCAP file holds: its chunks and loose messages in file order, channels, metadata, damage.

:func:`scan` visits the file's top-level records and leaves the rows where they are;
:meth:`McapFile.unpacked` then gives the messages section by section.
"""

import os
import struct
import zlib
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, DataEnd, Footer, Metadata, Schema, Statistics
from mcap.writer import MCAP0_MAGIC

from spoofbench.arrays import Ints, Octets
from spoofbench.codec.container import (
    Chunk,
    ChunkContents,
    MessageRecords,
    ReadLimits,
    checked_chunk_at,
    chunk_contents,
    map_file,
    messages_at,
    parse,
)
from spoofbench.codec.records import INDEX_ENTRY, LOG_TIME, RECORD, gather, record_starts
from spoofbench.errors import FormatError, LimitError

_INDEX = struct.Struct("<HI")
_FOOTER_BYTES = RECORD.size + 20 + len(MCAP0_MAGIC)
_DEFINITIONS_AND_TEXTS: dict[int, Any] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
    Opcode.STATISTICS: Statistics,
}
_NO_OTHERS = np.empty(0, np.int64)
_THREADS = min(4, os.cpu_count() or 1)


@dataclass(slots=True)
class ChunkSection:
    """A chunk, its message indexes (channel, and where the entries are), and the channels that it
    has messages of.
    """

    chunk: Chunk
    indexes: list[tuple[int, slice]] = field(default_factory=list)
    channels: set[int] = field(default_factory=set)


@dataclass(frozen=True, slots=True)
class LooseSection:
    """Messages outside of chunks, between two chunks: where their records start, ``(n,)``."""

    starts: Ints
    channels: frozenset[int]


Section = ChunkSection | LooseSection


@dataclass(slots=True)
class McapFile:
    """What a file holds.

    Attributes:
        path: of the file.
        limits: on what it may ask for.
        buffer: its bytes, uint8 ``(size,)``.
        records: opcode, offset and length of each top-level record, loose messages aside.
        schemas: by id.
        channels: by id.
        metadata: by the record's name.
        sections: chunks and loose messages, in file order.
        statistics: None where the file has none.
        damage: what was wrong with a file that was cut off; empty for a whole file.
    """

    path: Path
    limits: ReadLimits
    buffer: Octets
    records: list[tuple[int, int, int]] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    sections: list[Section] = field(default_factory=list)
    statistics: Statistics | None = None
    damage: dict[str, str] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The path as messages to the user show it."""
        return repr(str(self.path))

    def unpacked(self, sections: Iterable[Section]) -> Iterator[tuple[Section, ChunkContents]]:
        """Yield what is in some sections, in order, while threads unpack the next ones.

        Raises:
            FormatError: a section is damaged.
        """

        def contents(section: Section) -> ChunkContents:
            if isinstance(section, ChunkSection):
                entries = [entries for _, entries in section.indexes]
                return chunk_contents(self.buffer, section.chunk, entries)
            messages = messages_at(self.buffer, section.starts, "the data section")
            return ChunkContents(messages, _NO_OTHERS)

        with ThreadPoolExecutor(_THREADS) as pool:
            pending: deque[tuple[Section, Future[ChunkContents]]] = deque()
            try:
                for section in sections:
                    pending.append((section, pool.submit(contents, section)))
                    if len(pending) > _THREADS + 1:
                        first, future = pending.popleft()
                        yield first, future.result()
                while pending:
                    first, future = pending.popleft()
                    yield first, future.result()
            finally:
                for _, future in pending:
                    future.cancel()

    def times_ns(self, messages: MessageRecords) -> Ints:
        """Return the log times, ``(n,)``.

        Raises:
            FormatError: one is beyond the year 2262.
        """
        times: Ints = gather(messages.buffer, "<u8", messages.starts + LOG_TIME).view(np.int64)
        if times.size and times.min() < 0:
            raise FormatError(
                f"{self.name} holds a message that is stamped "
                f"{int(times.view(np.uint64).max())!r} ns, beyond the year 2262"
            )
        return times

    def check_message_count(self, count: int) -> None:
        """Raise LimitError where these are more messages than the limits allow."""
        if count > self.limits.messages:
            raise LimitError(
                f"{self.name} holds more than the {self.limits.messages} messages that are allowed"
            )

    def define(self, record: Schema | Channel) -> None:
        """Add a schema or channel.

        Raises:
            FormatError: another one has its id.
        """
        known: dict[int, Any] = self.schemas if isinstance(record, Schema) else self.channels
        if known.setdefault(record.id, record) != record:
            raise FormatError(
                f"{self.name} has two {type(record).__name__.lower()}s with the id {record.id!r}"
            )

    def define_from(self, contents: ChunkContents) -> None:
        """Add the schemas and channels within a chunk.

        Raises:
            FormatError: one is damaged, or another one has its id.
        """
        records = contents.messages.buffer
        for start in contents.others.tolist():
            opcode = int(records[start])
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                kind = _DEFINITIONS_AND_TEXTS[opcode]
                self.define(parse(kind, records, start, f"a chunk of {self.name}"))

    def check_data_section(self) -> None:
        """Compare the data section with its checksum where the file has one.

        Raises:
            FormatError: they differ, or the data section has no end.
        """
        ends = [start for opcode, start, _ in self.records if opcode == Opcode.DATA_END]
        if not ends:
            raise FormatError(f"{self.name} is damaged: its data section has no end")
        crc = parse(DataEnd, self.buffer, ends[0], self.name).data_section_crc
        if crc and zlib.crc32(self.buffer[: ends[0]].data) != crc:
            raise FormatError(
                f"{self.name} is damaged: the checksum of its data section is not {crc!r}"
            )


def scan(path: Path, limits: ReadLimits) -> McapFile:
    """Find out what a file holds; chunks are unpacked only where no index tells their channels.

    A file that was cut off gives its complete records, with the fact under ``damage``.

    Raises:
        FormatError: the file is no MCAP file, or is damaged.
        LimitError: it asks for more than the limits allow.
    """
    buffer = map_file(path)
    file = McapFile(path, limits, buffer)
    if bytes(buffer[: len(MCAP0_MAGIC)]) != MCAP0_MAGIC:
        raise FormatError(
            f"{file.name} is not an MCAP file: it does not begin with the magic bytes"
        )
    is_whole = (
        buffer.size >= 2 * len(MCAP0_MAGIC) and bytes(buffer[-len(MCAP0_MAGIC) :]) == MCAP0_MAGIC
    )
    end = buffer.size - len(MCAP0_MAGIC) if is_whole else buffer.size
    starts, stop = record_starts(buffer, len(MCAP0_MAGIC), end)
    if is_whole and stop != end:
        raise FormatError(
            f"{file.name} is damaged: the record at byte {stop} does not end within the file"
        )
    if not is_whole:
        file.damage = {
            "truncated": f"the file has no end; its complete records up to byte {stop} were read",
            "lost_bytes": str(buffer.size - stop),
        }
    _visit(file, starts)
    if is_whole:
        _check_summary(file, int(starts[-1]) if starts.size else 0)
    _check_limits(file)
    _scan_chunks(file, is_whole)
    if len(file.channels) > limits.channels:
        raise LimitError(
            f"{file.name} has {len(file.channels)} channels where at most {limits.channels} are "
            "allowed"
        )
    return file


def _visit(file: McapFile, starts: Ints) -> None:
    """Sort the file's records by what they are."""
    buffer, limits = file.buffer, file.limits
    is_message = buffer[starts] == Opcode.MESSAGE
    loose, others = starts[is_message], starts[~is_message]
    if others.size > limits.records:
        raise LimitError(
            f"{file.name} holds {others.size} records where at most {limits.records} are allowed"
        )
    text_bytes = taken = 0
    for start in others.tolist():
        opcode, length = RECORD.unpack_from(buffer.data, start)
        file.records.append((opcode, start, length))
        if opcode == Opcode.CHUNK:
            taken = _take_loose(file, loose, taken, start)
            file.sections.append(ChunkSection(checked_chunk_at(buffer, start, limits)))
        elif opcode == Opcode.MESSAGE_INDEX:
            _visit_index(file, start, length)
        elif opcode in _DEFINITIONS_AND_TEXTS:
            text_bytes += length
            if text_bytes > limits.text_bytes:
                raise LimitError(
                    f"{file.name} holds more than {limits.text_bytes} bytes of schemas, channels "
                    "and metadata"
                )
            record = parse(_DEFINITIONS_AND_TEXTS[opcode], buffer, start, file.name)
            if isinstance(record, Metadata):
                file.metadata.setdefault(record.name, {}).update(record.metadata)
            elif isinstance(record, Statistics):
                file.statistics = record
            else:
                file.define(record)
    _take_loose(file, loose, taken, buffer.size)


def _take_loose(file: McapFile, loose: Ints, taken: int, before: int) -> int:
    """Make a section of the loose messages before an offset; return how many are taken."""
    last = int(np.searchsorted(loose, before))
    if last > taken:
        part = loose[taken:last]
        channels = messages_at(file.buffer, part, "the data section").channels
        file.sections.append(LooseSection(part, frozenset(np.unique(channels).tolist())))
    return last


def _visit_index(file: McapFile, start: int, length: int) -> None:
    """Note a message index as a hint for the chunk before it; an invalid one is no hint."""
    chunk = file.sections[-1] if file.sections else None
    begin = start + RECORD.size
    if isinstance(chunk, ChunkSection) and length >= _INDEX.size:
        channel, size = _INDEX.unpack_from(file.buffer.data, begin)
        if size % INDEX_ENTRY.itemsize == 0 and 0 < size <= length - _INDEX.size:
            chunk.channels.add(channel)
            chunk.indexes.append((channel, slice(begin + _INDEX.size, begin + _INDEX.size + size)))


def _check_summary(file: McapFile, footer_at: int) -> None:
    buffer = file.buffer
    if footer_at + _FOOTER_BYTES != buffer.size or buffer[footer_at] != Opcode.FOOTER:
        raise FormatError(f"{file.name} is damaged: it does not end with a footer")
    footer = parse(Footer, buffer, footer_at, file.name)
    if footer.summary_crc:
        begin = footer.summary_start or footer_at
        if (
            begin > footer_at
            or zlib.crc32(buffer[begin : footer_at + RECORD.size + 16].data) != footer.summary_crc
        ):
            raise FormatError(
                f"{file.name} is damaged: the checksum of its summary at byte {begin} is not "
                f"{footer.summary_crc!r}"
            )
    if any(isinstance(section, LooseSection) for section in file.sections):
        file.check_data_section()


def _check_limits(file: McapFile) -> None:
    total = sum(
        section.chunk.size for section in file.sections if isinstance(section, ChunkSection)
    )
    if total > file.limits.total_bytes:
        raise LimitError(
            f"{file.name} declares {total!r} bytes in chunks where at most "
            f"{file.limits.total_bytes} are allowed"
        )
    messages = max(
        file.statistics.message_count if file.statistics else 0,
        sum(section.starts.size for section in file.sections if isinstance(section, LooseSection)),
    )
    if messages > file.limits.messages:
        raise LimitError(
            f"{file.name} declares {messages!r} messages where at most {file.limits.messages} are "
            "allowed"
        )


def _scan_chunks(file: McapFile, is_whole: bool) -> None:
    """Unpack the chunks whose channels no index tells, for the channels in them."""
    is_indexed = (
        is_whole
        and file.statistics is not None
        and file.statistics.channel_count == len(file.channels)
    )
    others = len(file.records)
    for section in file.sections:
        if isinstance(section, ChunkSection) and section.chunk.size:
            if is_indexed and section.indexes and section.channels <= file.channels.keys():
                continue
            contents = chunk_contents(file.buffer, section.chunk)
            others += contents.others.size
            if others > file.limits.records:
                raise LimitError(
                    f"{file.name} holds {others} records where at most {file.limits.records} are "
                    "allowed"
                )
            file.define_from(contents)
            section.channels = set(np.unique(contents.messages.channels).tolist())
