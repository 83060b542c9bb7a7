"""What a file holds: its chunks and loose messages in file order, channels, metadata and damage."""

import struct
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, DataEnd, Footer, Metadata, Schema, Statistics
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from spoofbench.codec.container import (
    INDEX_ENTRY,
    RECORD,
    Chunk,
    Contents,
    Limits,
    Messages,
    chunk_contents,
    map_file,
    messages_at,
    parse,
    parse_chunk,
    record_starts,
)
from spoofbench.errors import FormatError, LimitError

_INDEX = struct.Struct("<HI")
_FOOTER_BYTES = RECORD.size + 20 + len(MCAP0_MAGIC)


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
    """Messages that stand in no chunk, between two chunks."""

    starts: NDArray[np.int64]
    channels: frozenset[int]


Section = ChunkSection | LooseSection


@dataclass(slots=True)
class Survey:
    """What a file holds.

    ``records`` are opcode, offset and length of what stands at the top level, loose messages aside.
    ``statistics`` is None where the file has none. ``damage`` says what was wrong with a file that
    was cut off; of a whole file it is empty.
    """

    path: Path
    buffer: NDArray[np.uint8]
    records: list[tuple[int, int, int]] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    sections: list[Section] = field(default_factory=list)
    statistics: Statistics | None = None
    damage: dict[str, str] = field(default_factory=dict)

    def messages(self, section: Section) -> Messages:
        """Return the messages of a section.

        Raises:
            FormatError: the section is damaged.
        """
        if isinstance(section, LooseSection):
            return messages_at(self.buffer, section.starts, "the data section")
        return self.contents(section).messages

    def contents(self, section: ChunkSection) -> Contents:
        """Return what is in a chunk.

        Raises:
            FormatError: the chunk is damaged.
        """
        return chunk_contents(
            self.buffer, section.chunk, [entries for _, entries in section.indexes]
        )


def survey(path: Path, limits: Limits) -> Survey:
    """Find out what a file holds; chunks are unpacked only where no index tells their channels.

    A file that was cut off gives its complete records, with the fact under ``damage``.

    Raises:
        FormatError: the file is no MCAP file, or is damaged.
        LimitError: it asks for more than the limits allow.
    """
    buffer = map_file(path)
    found = Survey(path, buffer)
    if bytes(buffer[: len(MCAP0_MAGIC)]) != MCAP0_MAGIC:
        raise FormatError(
            f"{str(path)!r} is not an MCAP file: it does not begin with the magic bytes"
        )
    is_whole = (
        buffer.size >= 2 * len(MCAP0_MAGIC) and bytes(buffer[-len(MCAP0_MAGIC) :]) == MCAP0_MAGIC
    )
    end = buffer.size - len(MCAP0_MAGIC) if is_whole else buffer.size
    starts, stop = record_starts(buffer, len(MCAP0_MAGIC), end)
    if is_whole and stop != end:
        raise FormatError(
            f"{str(path)!r} is damaged: the record at byte {stop} does not end within the file"
        )
    if not is_whole:
        found.damage = {
            "truncated": f"the file has no end; its complete records up to byte {stop} were read",
            "lost_bytes": str(buffer.size - stop),
        }
    _visit(found, starts, limits)
    if is_whole:
        _check_summary(found, int(starts[-1]) if starts.size else 0)
    _check_limits(found, limits)
    _survey_chunks(found, is_whole, limits)
    if len(found.channels) > limits.channels:
        raise LimitError(
            f"{str(found.path)!r} has {len(found.channels)} channels where at most "
            f"{limits.channels} are allowed"
        )
    return found


def _visit(found: Survey, starts: NDArray[np.int64], limits: Limits) -> None:
    """Sort the file's records into the survey."""
    buffer = found.buffer
    is_message = buffer[starts] == Opcode.MESSAGE
    loose, others = starts[is_message], starts[~is_message]
    if others.size > limits.records:
        raise LimitError(
            f"{str(found.path)!r} holds {others.size} records where at most {limits.records} are "
            "allowed"
        )
    text_bytes = taken = 0
    for start in others.tolist():
        opcode, length = RECORD.unpack_from(buffer.data, start)
        found.records.append((opcode, start, length))
        if opcode == Opcode.CHUNK:
            taken = _take_loose(found, loose, taken, start)
            found.sections.append(ChunkSection(parse_chunk(buffer, start, limits)))
        elif opcode == Opcode.MESSAGE_INDEX:
            _visit_index(found, start, length)
        elif opcode in _TEXTS:
            text_bytes += length
            if text_bytes > limits.text_bytes:
                raise LimitError(
                    f"{str(found.path)!r} holds more than {limits.text_bytes} bytes of schemas, "
                    "channels and metadata"
                )
            _visit_text(found, opcode, start)
    _take_loose(found, loose, taken, buffer.size)


_TEXTS: dict[int, Any] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
    Opcode.STATISTICS: Statistics,
}


def _take_loose(found: Survey, loose: NDArray[np.int64], taken: int, before: int) -> int:
    last = int(np.searchsorted(loose, before))
    if last > taken:
        part = loose[taken:last]
        channels = messages_at(found.buffer, part, "the data section").channels
        found.sections.append(LooseSection(part, frozenset(np.unique(channels).tolist())))
    return last


def _visit_index(found: Survey, start: int, length: int) -> None:
    """Note a message index as a hint for the chunk before it; one that makes no sense is no
    hint.
    """
    chunk = found.sections[-1] if found.sections else None
    begin = start + RECORD.size
    if isinstance(chunk, ChunkSection) and length >= _INDEX.size:
        channel, size = _INDEX.unpack_from(found.buffer.data, begin)
        if size % INDEX_ENTRY.itemsize == 0 and 0 < size <= length - _INDEX.size:
            chunk.channels.add(channel)
            chunk.indexes.append((channel, slice(begin + _INDEX.size, begin + _INDEX.size + size)))


def _visit_text(found: Survey, opcode: int, start: int) -> None:
    record = parse(_TEXTS[opcode], found.buffer, start, repr(str(found.path)))
    if isinstance(record, Metadata):
        found.metadata.setdefault(record.name, {}).update(record.metadata)
    elif isinstance(record, Statistics):
        found.statistics = record
    else:
        _learn_definition(found, record)


def _learn_definition(found: Survey, record: Schema | Channel) -> None:
    """Add a schema or channel to the survey.

    Raises:
        FormatError: another one has its id.
    """
    known: dict[int, Any] = found.schemas if isinstance(record, Schema) else found.channels
    if known.setdefault(record.id, record) != record:
        raise FormatError(
            f"{str(found.path)!r} has two {type(record).__name__.lower()}s with the id "
            f"{record.id!r}"
        )


def _check_summary(found: Survey, footer_at: int) -> None:
    buffer, path = found.buffer, str(found.path)
    if footer_at + _FOOTER_BYTES != buffer.size or buffer[footer_at] != Opcode.FOOTER:
        raise FormatError(f"{path!r} is damaged: no footer stands before its end")
    footer = parse(Footer, buffer, footer_at, repr(path))
    if footer.summary_crc:
        begin = footer.summary_start or footer_at
        if (
            begin > footer_at
            or zlib.crc32(buffer[begin : footer_at + RECORD.size + 16].data) != footer.summary_crc
        ):
            raise FormatError(
                f"{path!r} is damaged: the checksum of its summary at byte {begin} is not "
                f"{footer.summary_crc!r}"
            )
    if any(isinstance(section, LooseSection) for section in found.sections):
        check_data_section(found)


def check_data_section(found: Survey) -> None:
    """Compare the data section with its checksum where the file has one.

    Raises:
        FormatError: they differ.
    """
    ends = [start for opcode, start, _ in found.records if opcode == Opcode.DATA_END]
    if not ends:
        raise FormatError(f"{str(found.path)!r} is damaged: its data section has no end")
    end = parse(DataEnd, found.buffer, ends[0], repr(str(found.path)))
    if end.data_section_crc and zlib.crc32(found.buffer[: ends[0]].data) != end.data_section_crc:
        raise FormatError(
            f"{str(found.path)!r} is damaged: the checksum of its data section is not "
            f"{end.data_section_crc!r}"
        )


def _check_limits(found: Survey, limits: Limits) -> None:
    total = sum(
        section.chunk.size for section in found.sections if isinstance(section, ChunkSection)
    )
    if total > limits.total_bytes:
        raise LimitError(
            f"{str(found.path)!r} declares {total!r} bytes in chunks where at most "
            f"{limits.total_bytes} are allowed"
        )
    messages = max(
        found.statistics.message_count if found.statistics else 0,
        sum(section.starts.size for section in found.sections if isinstance(section, LooseSection)),
    )
    if messages > limits.messages:
        raise LimitError(
            f"{str(found.path)!r} declares {messages!r} messages where at most {limits.messages} "
            "are allowed"
        )


def _survey_chunks(found: Survey, is_whole: bool, limits: Limits) -> None:
    """Unpack the chunks whose channels no index tells, for the channels in them."""
    is_indexed = (
        is_whole
        and found.statistics is not None
        and found.statistics.channel_count == len(found.channels)
    )
    others = len(found.records)
    for section in found.sections:
        if isinstance(section, ChunkSection) and section.chunk.size:
            if is_indexed and section.indexes and section.channels <= found.channels.keys():
                continue
            contents = chunk_contents(found.buffer, section.chunk)
            others += contents.others.size
            if others > limits.records:
                raise LimitError(
                    f"{str(found.path)!r} holds {others} records where at most {limits.records} "
                    "are allowed"
                )
            learn_definitions(found, contents)
            section.channels = set(np.unique(contents.messages.channels).tolist())


def learn_definitions(found: Survey, contents: Contents) -> None:
    """Add the schemas and channels within a chunk to the survey.

    Raises:
        FormatError: one is damaged, or another one has its id.
    """
    records = contents.messages.buffer
    for start in contents.others.tolist():
        opcode = int(records[start])
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            _learn_definition(
                found, parse(_TEXTS[opcode], records, start, f"a chunk of {str(found.path)!r}")
            )
