"""The end of an MCAP file: summary, footer, magic."""

import zlib
from collections.abc import Mapping, Sequence
from typing import Any

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    Footer,
    McapRecord,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC


def encoded(*records: McapRecord) -> bytes:
    """Return the bytes of records."""
    builder: Any = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())


def ending(
    start: int,
    definitions: tuple[Sequence[Schema], Sequence[Channel]],
    counts: Mapping[int, int],
    chunks: Sequence[ChunkIndex],
    metadata: Sequence[MetadataIndex],
) -> bytes:
    """Return what follows the data section.

    A group of the summary that is empty gets no offset record, which validators refuse.

    Args:
        start: offset of the summary in the file.
        definitions: schemas and channels.
        counts: messages by channel id.
        chunks: their indexes, in file order.
        metadata: their indexes, in file order.
    """
    schemas, channels = definitions
    groups: list[tuple[Opcode, Sequence[McapRecord]]] = [
        (Opcode.SCHEMA, schemas),
        (Opcode.CHANNEL, channels),
        (Opcode.STATISTICS, [_statistics(definitions, counts, chunks, len(metadata))]),
        (Opcode.CHUNK_INDEX, chunks),
        (Opcode.METADATA_INDEX, metadata),
    ]
    summary, offsets = b"", []
    for opcode, records in groups:
        group = encoded(*records)
        if group:
            offsets.append(SummaryOffset(opcode, start + len(summary), len(group)))
        summary += group
    footer = encoded(Footer(start, start + len(summary), 0))[:-4]
    summary += encoded(*offsets) + footer
    return summary + zlib.crc32(summary).to_bytes(4, "little") + MCAP0_MAGIC


def _statistics(
    definitions: tuple[Sequence[Schema], Sequence[Channel]],
    counts: Mapping[int, int],
    chunks: Sequence[ChunkIndex],
    metadata_count: int,
) -> Statistics:
    return Statistics(
        attachment_count=0,
        channel_count=len(definitions[1]),
        channel_message_counts={channel: count for channel, count in counts.items() if count},
        chunk_count=len(chunks),
        message_count=sum(counts.values()),
        message_end_time=max((chunk.message_end_time for chunk in chunks), default=0),
        message_start_time=min((chunk.message_start_time for chunk in chunks), default=0),
        metadata_count=metadata_count,
        schema_count=len(definitions[0]),
    )
