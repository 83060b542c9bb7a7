"""A whole MCAP file checked: structure, checksums, indexes, statistics, and that every row of ours
decodes.
"""

import zlib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

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

from spoofbench.codec.channels import topic_channels
from spoofbench.codec.container import ChunkContents, MessageRecords, ReadLimits, parse
from spoofbench.codec.decode import ChannelDecoder, decode_categories, empty_categories
from spoofbench.codec.records import INDEX_ENTRY, RECORD
from spoofbench.codec.scan import ChunkSection, LooseSection, McapFile, scan
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


def validate(path: Path, limits: ReadLimits = ReadLimits()) -> None:  # noqa: B008
    """Check a whole file: magic, record structure, checksums, indexes, statistics, and that every
    row of ours decodes.

    Args:
        path: of the file.
        limits: on what the file may ask for.

    Raises:
        FormatError: the file is damaged; names the offset and the reason.
        LimitError: it asks for more than the limits allow.
    """
    file = scan(Path(path), limits)
    if file.damage:
        raise FormatError(f"{file.name} is cut off: {file.damage['truncated']}")
    _check_order(file)
    file.check_data_section()
    counts, span = _check_messages(file)
    _check_statistics(file, counts, span)
    _check_indexes(file)


def _wrong(file: McapFile, offset: int, reason: str) -> FormatError:
    return FormatError(f"{file.name} is damaged at byte {offset}: {reason}")


def _records(file: McapFile, *opcodes: Opcode) -> Iterator[tuple[int, int]]:
    """Offset and whole length of the top-level records with these opcodes."""
    return (
        (start, RECORD.size + length) for opcode, start, length in file.records if opcode in opcodes
    )


def _check_order(file: McapFile) -> None:
    """Check that each record is where the format allows it."""
    if not file.records or file.records[0][:2] != (Opcode.HEADER, 8):
        raise _wrong(file, 8, "no header follows the magic bytes")
    parse(Header, file.buffer, 8, file.name)
    allowed = _DATA
    for opcode, start, _ in file.records[1:]:
        if opcode not in allowed and opcode < _PRIVATE:
            raise _wrong(file, start, f"a record with opcode {opcode!r} is not allowed here")
        if opcode == Opcode.DATA_END:
            allowed = _SUMMARY
    ends = [start for start, _ in _records(file, Opcode.DATA_END)]
    if not ends:
        raise _wrong(file, file.buffer.size, "the data section has no end")
    for section in file.sections:
        if isinstance(section, LooseSection) and section.starts[-1] > ends[0]:
            raise _wrong(file, int(section.starts[-1]), "a message follows the data section")


def _check_messages(file: McapFile) -> tuple[Counter[int], tuple[int, int] | None]:
    """Check every message: the number of each channel's, and the first and last time, None where
    there is none.
    """
    decoders, categories = {}, []
    for number, channel in topic_channels(file)[0].items():
        own = empty_categories(channel.kind)
        decoders[number] = ChannelDecoder(channel, own)
        categories += [(channel.kind.fields[name], values) for name, values in own.items()]
    counts: Counter[int] = Counter()
    spans = []
    for section, contents in file.unpacked(file.sections):
        if isinstance(section, ChunkSection):
            _check_chunk(file, section, contents)
        times = file.times_ns(contents.messages)
        if times.size:
            spans.append((int(times.min()), int(times.max())))
        for number, messages in contents.messages.by_channel():
            if number not in file.channels:
                raise FormatError(
                    f"{file.name} has messages of channel {number!r}, which it does not define"
                )
            counts[number] += messages.starts.size
            file.check_message_count(counts.total())
            if number in decoders:
                decoders[number].decode(messages, file.name)
    for field, values in categories:
        decode_categories(field, values)
    if not spans:
        return counts, None
    return counts, (min(first for first, _ in spans), max(last for _, last in spans))


def _check_chunk(file: McapFile, section: ChunkSection, contents: ChunkContents) -> None:
    """Check a chunk's span and message indexes against its messages."""
    chunk, messages = section.chunk, contents.messages
    for start in contents.others.tolist():
        if messages.buffer[start] not in (Opcode.SCHEMA, Opcode.CHANNEL):
            raise _wrong(
                file,
                chunk.offset,
                f"the chunk holds a record with opcode {int(messages.buffer[start])!r}",
            )
    file.define_from(contents)
    times = file.times_ns(messages)
    if times.size and (chunk.start_ns, chunk.end_ns) != (times.min(), times.max()):
        raise _wrong(
            file,
            chunk.offset,
            f"the chunk does not span {chunk.start_ns!r} to {chunk.end_ns!r} ns as it says",
        )
    if section.indexes:
        _check_message_index(file, section, messages)


def _check_message_index(file: McapFile, section: ChunkSection, messages: MessageRecords) -> None:
    times = file.times_ns(messages)
    indexed = dict(section.indexes)
    if len(indexed) != len(section.indexes) or indexed.keys() != set(
        np.unique(messages.channels).tolist()
    ):
        raise _wrong(
            file, section.chunk.offset, "the chunk's message indexes are not those of its channels"
        )
    for channel, where in indexed.items():
        entries = np.frombuffer(file.buffer[where], INDEX_ENTRY)
        entries = entries[np.argsort(entries["offset"], kind="stable")]
        selected = messages.channels == channel
        if not (
            np.array_equal(entries["offset"], messages.starts[selected])
            and np.array_equal(entries["time"], times[selected])
        ):
            raise _wrong(
                file,
                where.start,
                f"the message index of channel {channel!r} does not say where its messages are",
            )


def _check_statistics(file: McapFile, counts: Counter[int], span: tuple[int, int] | None) -> None:
    statistics = file.statistics
    if statistics is None:
        return
    held = Counter(opcode for opcode, _, _ in file.records)
    truth = {
        "message_count": counts.total(),
        "schema_count": len(file.schemas),
        "channel_count": len(file.channels),
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
            start = next(start for start, _ in _records(file, Opcode.STATISTICS))
            raise _wrong(
                file, start, f"the statistics state {name} {stated[name]!r} where it is {value!r}"
            )


def _check_indexes(file: McapFile) -> None:
    """Check what the summary says of chunks, attachments, metadata and itself."""
    _check_chunk_indexes(file)
    where = file.name
    lengths = dict(_records(file, Opcode.METADATA, Opcode.ATTACHMENT))
    named = {}
    for opcode, record in ((Opcode.METADATA, Metadata), (Opcode.ATTACHMENT, Attachment)):
        for start, length in _records(file, opcode):
            named[start] = parse(record, file.buffer, start, where).name
            _check_attachment(file, opcode, start, length)
    for opcode, index in (
        (Opcode.METADATA_INDEX, MetadataIndex),
        (Opcode.ATTACHMENT_INDEX, AttachmentIndex),
    ):
        for start, _ in _records(file, opcode):
            entry = parse(index, file.buffer, start, where)
            if (lengths.get(entry.offset), named.get(entry.offset)) != (entry.length, entry.name):
                raise _wrong(file, start, f"the index of {entry.name!r} does not say where it is")
    _check_summary_offsets(file)


def _check_attachment(file: McapFile, opcode: Opcode, start: int, length: int) -> None:
    if opcode == Opcode.ATTACHMENT:
        crc = int.from_bytes(bytes(file.buffer[start + length - 4 : start + length]), "little")
        if crc and zlib.crc32(file.buffer[start + RECORD.size : start + length - 4].data) != crc:
            raise _wrong(file, start, f"the checksum of the attachment is not {crc!r}")


def _check_chunk_indexes(file: McapFile) -> None:
    entries = [
        (start, parse(ChunkIndex, file.buffer, start, file.name))
        for start, _ in _records(file, Opcode.CHUNK_INDEX)
    ]
    if not entries:
        return
    truth = {index.chunk_start_offset: index for index in _true_chunk_indexes(file)}
    for start, entry in entries:
        if truth.pop(entry.chunk_start_offset, None) != entry:
            raise _wrong(
                file,
                start,
                f"the index of the chunk at byte {entry.chunk_start_offset!r} is not true of it",
            )
    if truth:
        raise _wrong(file, min(truth), "the summary has no index of the chunk")


def _true_chunk_indexes(file: McapFile) -> Iterator[ChunkIndex]:
    """Say of each chunk what its index should."""
    offsets: dict[int, dict[int, int]] = {}
    lengths: Counter[int] = Counter()
    chunk_lengths, last = {}, -1
    for opcode, start, length in file.records:
        if opcode == Opcode.CHUNK:
            last, chunk_lengths[start], offsets[start] = start, RECORD.size + length, {}
        elif opcode == Opcode.MESSAGE_INDEX and last >= 0:
            begin = start + RECORD.size
            offsets[last][int.from_bytes(bytes(file.buffer[begin : begin + 2]), "little")] = start
            lengths[last] += RECORD.size + length
    for section in file.sections:
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


def _check_summary_offsets(file: McapFile) -> None:
    where = file.name
    summary = {start: (opcode, RECORD.size + length) for opcode, start, length in file.records}
    data_end = next(start + length for start, length in _records(file, Opcode.DATA_END))
    footer_at = file.records[-1][1]
    footer = parse(Footer, file.buffer, footer_at, where)
    if footer.summary_start != (data_end if data_end < footer_at else 0):
        raise _wrong(
            file,
            footer_at,
            (
                f"the footer says that the summary starts at byte {footer.summary_start!r}, not "
                f"{data_end}"
            ),
        )
    for start, _ in _records(file, Opcode.SUMMARY_OFFSET):
        group = parse(SummaryOffset, file.buffer, start, where)
        at, end = group.group_start, group.group_start + group.group_length
        while (
            at < end and at > data_end - 1 and summary.get(at, (None, 0))[0] == group.group_opcode
        ):
            at += summary[at][1]
        if at != end:
            raise _wrong(
                file,
                start,
                (
                    f"the summary offset of opcode {group.group_opcode!r} does not say where its "
                    "records are"
                ),
            )
