"""A whole MCAP file checked: structure, checksums, indexes, statistics, and that every row of ours
decodes.
"""

import zlib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    ChunkIndex,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    SummaryOffset,
)

from spoofbench.codec.columns import decoded
from spoofbench.codec.container import INDEX_ENTRY, RECORD, Contents, Limits, Messages, parse
from spoofbench.codec.reading import ahead, by_channel, check_count, readings_of, times_of
from spoofbench.codec.survey import (
    ChunkSection,
    LooseSection,
    Section,
    Survey,
    check_data_section,
    learn_definitions,
    survey,
)
from spoofbench.codec.unpacking import Decoder
from spoofbench.errors import FormatError

_DATA = {
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.CHUNK,
    Opcode.MESSAGE_INDEX,
    Opcode.ATTACHMENT,
    Opcode.METADATA,
    Opcode.DATA_END,
}
_SUMMARY = {
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.STATISTICS,
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
    Opcode.SUMMARY_OFFSET,
    Opcode.FOOTER,
}
_PRIVATE = 0x80


def validate(path: Path, limits: Limits = Limits()) -> None:  # noqa: B008
    """Check a whole file: magic, record structure, checksums, indexes, statistics, and that every
    row of ours decodes.

    Args:
        path: of the file.
        limits: on what the file may ask for.

    Raises:
        FormatError: the file is damaged; names the offset and the reason.
        LimitError: it asks for more than the limits allow.
    """
    found = survey(Path(path), limits)
    if found.damage:
        raise FormatError(f"{str(path)!r} is cut off: {found.damage['truncated']}")
    _check_order(found)
    check_data_section(found)
    counts, span = _check_messages(found, limits)
    _check_statistics(found, counts, span)
    _check_indexes(found)


def _wrong(found: Survey, offset: int, reason: str) -> FormatError:
    return FormatError(f"{str(found.path)!r} is damaged at byte {offset}: {reason}")


def _records(found: Survey, *opcodes: Opcode) -> Iterator[tuple[int, int]]:
    """Offset and whole length of the top-level records with these opcodes."""
    return (
        (start, RECORD.size + length)
        for opcode, start, length in found.records
        if opcode in opcodes
    )


def _check_order(found: Survey) -> None:
    """Check that each record is where the format allows it."""
    if not found.records or found.records[0][:2] != (Opcode.HEADER, 8):
        raise _wrong(found, 8, "no header follows the magic bytes")
    parse(Header, found.buffer, 8, repr(str(found.path)))
    allowed = _DATA
    for opcode, start, _ in found.records[1:]:
        if opcode not in allowed and opcode < _PRIVATE:
            raise _wrong(found, start, f"a record with opcode {opcode!r} must not stand here")
        if opcode == Opcode.DATA_END:
            allowed = _SUMMARY
    ends = [start for start, _ in _records(found, Opcode.DATA_END)]
    if not ends:
        raise _wrong(found, found.buffer.size, "the data section has no end")
    for section in found.sections:
        if isinstance(section, LooseSection) and section.starts[-1] > ends[0]:
            raise _wrong(found, int(section.starts[-1]), "a message stands after the data section")


def _check_messages(found: Survey, limits: Limits) -> tuple[Counter[int], tuple[int, int] | None]:
    """Check every message: the number of each channel's, and the first and last time, None where
    there is none.
    """
    decoders: dict[int, Decoder] = {}
    words: list[tuple[Any, dict[bytes, int]]] = []
    readings = readings_of(found)[0]
    for channel, reading in readings.items():
        own: dict[str, dict[bytes, int]] = {
            f.name: {} for f in reading.kind.fields.values() if f.category in ("text", "bytes")
        }
        decoders[channel] = Decoder(reading, own)
        words += [(reading.kind.fields[name], own[name]) for name in own]
    counts: Counter[int] = Counter()
    spans = []

    def contents(section: Section) -> tuple[Section, Contents]:
        others = np.empty(0, np.int64)
        return section, found.contents(section) if isinstance(section, ChunkSection) else Contents(
            found.messages(section), others
        )

    for section, content in ahead(contents, found.sections):
        messages = content.messages
        if isinstance(section, ChunkSection):
            _check_chunk(found, section, content)
        times = times_of(found, messages)
        if times.size:
            spans.append((int(times.min()), int(times.max())))
        for channel, part in by_channel(messages):
            if channel not in found.channels:
                raise FormatError(
                    f"{str(found.path)!r} has messages of channel {channel!r}, which it does not "
                    "define"
                )
            counts[channel] += part.starts.size
            check_count(found, counts.total(), limits)
            if channel in decoders:
                decoders[channel].decode(part, repr(str(found.path)))
    for field, own_words in words:
        decoded(field, own_words)
    return counts, (
        min(first for first, _ in spans),
        max(last for _, last in spans),
    ) if spans else None


def _check_chunk(found: Survey, section: ChunkSection, contents: Contents) -> None:
    """Check a chunk's span and message indexes against its messages."""
    chunk, messages = section.chunk, contents.messages
    for start in contents.others.tolist():
        if messages.buffer[start] not in (Opcode.SCHEMA, Opcode.CHANNEL):
            raise _wrong(
                found,
                chunk.offset,
                f"the chunk holds a record with opcode {int(messages.buffer[start])!r}",
            )
    learn_definitions(found, contents)
    times = times_of(found, messages)
    if times.size and (chunk.start_ns, chunk.end_ns) != (times.min(), times.max()):
        raise _wrong(
            found,
            chunk.offset,
            f"the chunk does not span {chunk.start_ns!r} to {chunk.end_ns!r} ns as it says",
        )
    if section.indexes:
        _check_message_index(found, section, messages)


def _check_message_index(found: Survey, section: ChunkSection, messages: Messages) -> None:
    times = times_of(found, messages)
    indexed = dict(section.indexes)
    if len(indexed) != len(section.indexes) or indexed.keys() != set(
        np.unique(messages.channels).tolist()
    ):
        raise _wrong(
            found, section.chunk.offset, "the chunk's message indexes are not those of its channels"
        )
    for channel, where in indexed.items():
        entries = np.frombuffer(found.buffer[where], INDEX_ENTRY)
        entries = entries[np.argsort(entries["offset"], kind="stable")]
        mine = messages.channels == channel
        if not (
            np.array_equal(entries["offset"], messages.starts[mine])
            and np.array_equal(entries["time"], times[mine])
        ):
            raise _wrong(
                found,
                where.start,
                f"the message index of channel {channel!r} does not say where its messages are",
            )


def _check_statistics(found: Survey, counts: Counter[int], span: tuple[int, int] | None) -> None:
    statistics = found.statistics
    if statistics is None:
        return
    held = Counter(opcode for opcode, _, _ in found.records)
    truth = {
        "message_count": counts.total(),
        "schema_count": len(found.schemas),
        "channel_count": len(found.channels),
        "attachment_count": held[Opcode.ATTACHMENT],
        "metadata_count": held[Opcode.METADATA],
        "chunk_count": held[Opcode.CHUNK],
        "message_start_time": span[0] if span else 0,
        "message_end_time": span[1] if span else 0,
        "channel_message_counts": dict(counts),
    }
    stated = {name: getattr(statistics, name) for name in truth}
    stated["channel_message_counts"] = {
        channel: count for channel, count in statistics.channel_message_counts.items() if count
    }
    for name, value in truth.items():
        if stated[name] != value:
            start = next(start for start, _ in _records(found, Opcode.STATISTICS))
            raise _wrong(
                found, start, f"the statistics state {name} {stated[name]!r} where it is {value!r}"
            )


def _check_indexes(found: Survey) -> None:
    """Check what the summary says of chunks, attachments, metadata and itself."""
    _check_chunk_indexes(found)
    where = repr(str(found.path))
    lengths = dict(_records(found, Opcode.METADATA, Opcode.ATTACHMENT))
    named = {}
    for opcode, record in ((Opcode.METADATA, Metadata), (Opcode.ATTACHMENT, Attachment)):
        for start, length in _records(found, opcode):
            named[start] = parse(record, found.buffer, start, where).name
            _check_attachment(found, opcode, start, length)
    for opcode, index in (
        (Opcode.METADATA_INDEX, MetadataIndex),
        (Opcode.ATTACHMENT_INDEX, AttachmentIndex),
    ):
        for start, _ in _records(found, opcode):
            entry = parse(index, found.buffer, start, where)
            if (lengths.get(entry.offset), named.get(entry.offset)) != (entry.length, entry.name):
                raise _wrong(found, start, f"the index of {entry.name!r} does not say where it is")
    _check_summary_offsets(found)


def _check_attachment(found: Survey, opcode: Opcode, start: int, length: int) -> None:
    if opcode == Opcode.ATTACHMENT:
        crc = int.from_bytes(bytes(found.buffer[start + length - 4 : start + length]), "little")
        if crc and zlib.crc32(found.buffer[start + RECORD.size : start + length - 4].data) != crc:
            raise _wrong(found, start, f"the checksum of the attachment is not {crc!r}")


def _check_chunk_indexes(found: Survey) -> None:
    entries = [
        (start, parse(ChunkIndex, found.buffer, start, repr(str(found.path))))
        for start, _ in _records(found, Opcode.CHUNK_INDEX)
    ]
    if not entries:
        return
    truth = {index.chunk_start_offset: index for index in _true_chunk_indexes(found)}
    for start, entry in entries:
        if truth.pop(entry.chunk_start_offset, None) != entry:
            raise _wrong(
                found,
                start,
                f"the index of the chunk at byte {entry.chunk_start_offset!r} is not true of it",
            )
    if truth:
        raise _wrong(found, min(truth), "the summary has no index of the chunk")


def _true_chunk_indexes(found: Survey) -> Iterator[ChunkIndex]:
    """Say of each chunk what its index should."""
    offsets: dict[int, dict[int, int]] = {}
    lengths: Counter[int] = Counter()
    chunk_lengths, last = {}, -1
    for opcode, start, length in found.records:
        if opcode == Opcode.CHUNK:
            last, chunk_lengths[start], offsets[start] = start, RECORD.size + length, {}
        elif opcode == Opcode.MESSAGE_INDEX and last >= 0:
            begin = start + RECORD.size
            offsets[last][int.from_bytes(bytes(found.buffer[begin : begin + 2]), "little")] = start
            lengths[last] += RECORD.size + length
    for section in found.sections:
        if isinstance(section, ChunkSection):
            chunk = section.chunk
            yield ChunkIndex(
                chunk_length=chunk_lengths[chunk.offset],
                chunk_start_offset=chunk.offset,
                compression=chunk.compression,
                compressed_size=chunk.data.stop - chunk.data.start,
                message_end_time=chunk.end_ns,
                message_index_length=lengths[chunk.offset],
                message_index_offsets=offsets[chunk.offset],
                message_start_time=chunk.start_ns,
                uncompressed_size=chunk.size,
            )


def _check_summary_offsets(found: Survey) -> None:
    where = repr(str(found.path))
    summary = {start: (opcode, RECORD.size + length) for opcode, start, length in found.records}
    data_end = next(start + length for start, length in _records(found, Opcode.DATA_END))
    footer_at = found.records[-1][1]
    footer = parse(Footer, found.buffer, footer_at, where)
    if footer.summary_start != (data_end if data_end < footer_at else 0):
        raise _wrong(
            found,
            footer_at,
            (
                f"the footer says that the summary starts at byte {footer.summary_start!r}, not "
                f"{data_end}"
            ),
        )
    for start, _ in _records(found, Opcode.SUMMARY_OFFSET):
        group = parse(SummaryOffset, found.buffer, start, where)
        at, end = group.group_start, group.group_start + group.group_length
        while (
            at < end and at > data_end - 1 and summary.get(at, (None, 0))[0] == group.group_opcode
        ):
            at += summary[at][1]
        if at != end:
            raise _wrong(
                found,
                start,
                (
                    f"the summary offset of opcode {group.group_opcode!r} does not say where its "
                    "records are"
                ),
            )
