"""Tables to an MCAP file: chunks of about 1 MiB, compressed by a small pool of threads, written in
order.
"""

import contextlib
import os
import threading
import zlib
from collections import defaultdict, deque
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Literal, Self

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.records import Metadata as MetadataRecord
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from spoofbench import __version__
from spoofbench.arrays import Ints, Octets
from spoofbench.codec.channels import ENCODING, LOCATION_SUFFIX, descriptor_set
from spoofbench.codec.encode import BytesEncoder, MessageEncoder, TableEncoder, location_fixes
from spoofbench.codec.records import INDEX_ENTRY
from spoofbench.errors import RecordingError
from spoofbench.recording import Metadata, Recording
from spoofbench.schema import split_topic
from spoofbench.table import Table

Compression = Literal["zstd", "lz4", "none"]

CHUNK_BYTES = 1 << 20
_THREADS = min(4, os.cpu_count() or 1)


def write(
    recording: Recording, path: Path, *, compression: Compression = "zstd", level: int = 3
) -> None:
    """Write a recording in strict order of time over its topics; the same rows give the same bytes.

    Each topic of kind ``gnss/pvt`` gets a derived one for maps, ``/<source>/location_fix``.

    Args:
        recording: what to write.
        path: of the file; its folder must exist.
        compression: of the chunks.
        level: of zstd.

    Raises:
        RecordingError: the file cannot be created, or a row cannot be expressed.
    """
    with Writer(path, compression=compression, level=level) as writer:
        writer.describe(recording.metadata)
        writer._add_merged(recording)


class Writer:
    """Writes a recording piece by piece in bounded memory; a context manager.

    The file appears under its name when the block ends, and not at all when it ends by an
    exception. The bytes depend on the rows in the order of the calls, not on how they were cut into
    pieces.

    Args:
        path: of the file; its folder must exist.
        compression: of the chunks.
        level: of zstd.

    Raises:
        RecordingError: the file cannot be created.
    """

    def __init__(self, path: Path, *, compression: Compression = "zstd", level: int = 3) -> None:
        self._path = Path(path)
        if not self._path.name:
            raise RecordingError(f"{str(path)!r} is a folder; name the file to write")
        self._temporary = self._path.with_name(f".{self._path.name}.{os.getpid()}.part")
        self._compress = _ChunkCompressor(compression, level)
        self._compression = "" if compression == "none" else compression
        self._schemas: dict[str, Schema] = {}
        self._channels: dict[str, Channel] = {}
        self._last_ns: dict[str, int] = {}
        self._metadata: dict[str, dict[str, str]] = {}
        self._payload: list[Octets] = []
        self._filled = 0
        self._index: dict[int, list[NDArray[Any]]] = defaultdict(list)
        self._under_way: deque[Future[None]] = deque()
        self._chunks: list[ChunkIndex] = []
        self._counts: dict[int, int] = {}
        self._offset = 0

    def __enter__(self) -> Self:
        if self._path.exists() and not self._path.is_file():
            raise RecordingError(f"{str(self._path)!r} is there and no file; name a file to write")
        try:
            self._stream: IO[bytes] = self._temporary.open("wb")
            self._pool = ThreadPoolExecutor(_THREADS)
            self._in_order = ThreadPoolExecutor(1)
            self._put(MCAP0_MAGIC)
            self._put_records(Header("", f"spoofbench {__version__}"))
        except BaseException as error:  # a signal may end the program before the block begins
            with contextlib.suppress(OSError):
                self._temporary.unlink(missing_ok=True)
            if not isinstance(error, OSError):
                raise
            raise RecordingError(
                f"{str(self._path)!r} cannot be written: {error.strerror}; choose a folder that "
                "exists"
            ) from error
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            if kind is None:
                self._finish()
                self._stream.close()
                self._temporary.replace(self._path)
        except OSError as failure:
            raise RecordingError(
                f"{str(self._path)!r} cannot be written: {failure.strerror}"
            ) from failure
        finally:
            for pool in (self._in_order, self._pool):
                pool.shutdown(cancel_futures=True)
            with contextlib.suppress(OSError):  # what is buffered cannot be written either
                self._stream.close()
            self._temporary.unlink(missing_ok=True)

    def add(self, topic: str, table: Table) -> None:
        """Write a topic's next rows; an empty table makes the topic known.

        Raises:
            RecordingError: the topic is not of the table's kind, or its rows run back in time.
        """
        self._append(self._rows(topic, table))

    def describe(self, metadata: Metadata) -> None:
        """Set metadata records; one of a name that was set before takes its place.

        Raises:
            RecordingError: a value is not text.
        """
        for name, record in metadata.items():
            for key, value in record.items():
                if not isinstance(value, str):
                    raise RecordingError(
                        f"metadata {name!r} holds {value!r} under {key!r}, which must be text"
                    )
            self._metadata[name] = dict(sorted(record.items()))

    def _add_merged(self, recording: Recording) -> None:
        """Write all topics' rows in the order of time; at equal times topics follow each other by
        name.
        """
        self._append([rows for topic in recording for rows in self._rows(topic, recording[topic])])

    def _rows(self, topic: str, table: Table) -> list[MessageEncoder]:
        source, kind = split_topic(topic)
        if table.kind.name != kind:
            raise RecordingError(f"topic {topic!r} cannot take rows of kind {table.kind.name!r}")
        if len(table):
            first, last = int(table.time_ns[0]), self._last_ns.get(topic, 0)
            if first < 0:
                raise RecordingError(
                    f"a row of {topic!r} is stamped {first!r} ns, before 1970, which MCAP cannot "
                    "express"
                )
            if first < last:
                raise RecordingError(
                    f"rows of {topic!r} run back in time, from {last!r} to {first!r} ns"
                )
            self._last_ns[topic] = int(table.time_ns[-1])
        channel = self._channel(topic, table.kind.message)
        rows: list[MessageEncoder] = [TableEncoder(channel, table)]
        if kind == "gnss/pvt":
            from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix

            view = self._channel(f"/{source}{LOCATION_SUFFIX}", LocationFix.DESCRIPTOR)
            rows.append(BytesEncoder(view, *location_fixes(source, table)))
        return rows

    def _channel(self, topic: str, message: Any) -> int:
        """Return the id of a topic's channel, whose record is written when it is new."""
        if topic not in self._channels:
            self._drain(0)
            if message.full_name not in self._schemas:
                schema = Schema(
                    len(self._schemas) + 1, descriptor_set(message), ENCODING, message.full_name
                )
                self._schemas[message.full_name] = schema
                self._put_records(schema)
            channel = Channel(
                len(self._channels) + 1, topic, ENCODING, {}, self._schemas[message.full_name].id
            )
            self._channels[topic] = channel
            self._counts[channel.id] = 0
            self._put_records(channel)
        return self._channels[topic].id

    def _append(self, sources: Sequence[MessageEncoder]) -> None:
        """Write rows merged by time; at equal times those of the earlier source come first."""
        owner = np.repeat(np.arange(len(sources)), [rows.times_ns.size for rows in sources])
        sizes = (
            np.concatenate([rows.sizes for rows in sources]) if sources else np.empty(0, np.int64)
        )
        if len(sources) > 1:
            order = np.argsort(np.concatenate([rows.times_ns for rows in sources]), kind="stable")
            owner, sizes = owner[order], sizes[order]
        ends = np.cumsum(sizes)
        next_rows = [0] * len(sources)
        first = 0
        while first < ends.size:
            before = int(ends[first] - sizes[first])
            last = min(
                int(np.searchsorted(ends, before + CHUNK_BYTES - self._filled)) + 1, ends.size
            )
            out = np.empty(int(ends[last - 1]) - before, np.uint8)
            starts = ends[first:last] - sizes[first:last] - before
            for number, rows in enumerate(sources):
                where = starts if len(sources) == 1 else starts[owner[first:last] == number]
                if where.size:
                    self._take(rows, next_rows[number], out, where)
                    next_rows[number] += where.size
            self._payload.append(out)
            self._filled += out.size
            if self._filled >= CHUNK_BYTES:
                self._finish_chunk()
            first = last

    def _take(self, rows: MessageEncoder, first: int, out: Octets, starts: Ints) -> None:
        last = first + starts.size
        rows.encode(first, last, out, starts)
        index = np.empty(starts.size, INDEX_ENTRY)
        index["time"], index["offset"] = rows.times_ns[first:last], starts + self._filled
        self._index[rows.channel_id].append(index)
        self._counts[rows.channel_id] += starts.size

    def _finish_chunk(self) -> None:
        if not self._filled:
            return
        payload = self._payload[0] if len(self._payload) == 1 else np.concatenate(self._payload)
        spans = [
            (int(part["time"].min()), int(part["time"].max()))
            for parts in self._index.values()
            for part in parts
        ]
        span = min(first for first, _ in spans), max(last for _, last in spans)
        index = {
            channel: b"".join(part.tobytes() for part in parts)
            for channel, parts in sorted(self._index.items())
        }
        chunk = _FinishedChunk(
            self._pool.submit(self._compress, payload), payload.size, span, index
        )
        self._under_way.append(self._in_order.submit(self._put_chunk, chunk))
        self._payload, self._filled = [], 0
        self._index.clear()
        self._drain(2 * _THREADS)

    def _drain(self, limit: int) -> None:
        """Wait until at most ``limit`` chunks are on their way to the file."""
        while len(self._under_way) > limit:
            self._under_way.popleft().result()

    def _put_chunk(self, chunk: "_FinishedChunk") -> None:
        crc, data = chunk.compressed.result()
        start, name = self._offset, self._compression
        head: Any = RecordBuilder()
        head.write1(Opcode.CHUNK)
        head.write8(40 + len(name) + len(data))
        for value in (*chunk.span, chunk.size):
            head.write8(value)
        head.write4(crc)
        head.write_prefixed_string(name)
        head.write8(len(data))
        self._put(head.end(), data)
        length, offsets = self._offset - start, {}
        for channel, entries in chunk.index.items():
            offsets[channel] = self._offset
            head.write1(Opcode.MESSAGE_INDEX)
            head.write8(6 + len(entries))
            head.write2(channel)
            head.write4(len(entries))
            self._put(head.end(), entries)
        self._chunks.append(
            ChunkIndex(
                chunk_length=length,
                chunk_start_offset=start,
                compression=name,
                compressed_size=len(data),
                message_end_time=chunk.span[1],
                message_index_length=self._offset - start - length,
                message_index_offsets=offsets,
                message_start_time=chunk.span[0],
                uncompressed_size=chunk.size,
            )
        )

    def _finish(self) -> None:
        self._finish_chunk()
        self._drain(0)
        indexes = []
        for name, record in sorted(self._metadata.items()):
            start = self._offset
            self._put_records(MetadataRecord(name, record))
            indexes.append(MetadataIndex(start, self._offset - start, name))
        self._put_records(DataEnd(0))
        definitions = list(self._schemas.values()), list(self._channels.values())
        self._put(_end_of_file(self._offset, definitions, self._counts, self._chunks, indexes))

    def _put_records(self, *records: Any) -> None:
        self._put(_encode_records(*records))

    def _put(self, *pieces: Any) -> None:
        try:
            for piece in pieces:
                self._stream.write(piece)
                self._offset += len(piece)
        except OSError as error:
            raise RecordingError(
                f"{str(self._path)!r} cannot be written: {error.strerror}"
            ) from error


@dataclass(frozen=True, slots=True)
class _FinishedChunk:
    """A full chunk: its payload while it is compressed, and the message index by channel."""

    compressed: "Future[tuple[int, Any]]"
    size: int
    span: tuple[int, int]
    index: dict[int, bytes]


class _ChunkCompressor:
    """Checksum and compression of a payload, by a zstd context per thread."""

    def __init__(self, compression: Compression, level: int) -> None:
        self._compression, self._level = compression, level
        self._thread = threading.local()

    def __call__(self, payload: Octets) -> tuple[int, Any]:
        crc = zlib.crc32(payload.data)
        if self._compression == "none":
            return crc, payload
        if self._compression == "lz4":
            return crc, lz4.frame.compress(payload)
        if not hasattr(self._thread, "context"):
            self._thread.context = zstandard.ZstdCompressor(self._level)
        return crc, self._thread.context.compress(payload)


def _encode_records(*records: McapRecord) -> bytes:
    """Return the bytes of records."""
    builder: Any = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())


def _end_of_file(
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
    statistics = Statistics(
        attachment_count=0,
        channel_count=len(channels),
        channel_message_counts={channel: count for channel, count in counts.items() if count},
        chunk_count=len(chunks),
        message_count=sum(counts.values()),
        message_end_time=max((chunk.message_end_time for chunk in chunks), default=0),
        message_start_time=min((chunk.message_start_time for chunk in chunks), default=0),
        metadata_count=len(metadata),
        schema_count=len(schemas),
    )
    groups: list[tuple[Opcode, Sequence[McapRecord]]] = [
        (Opcode.SCHEMA, schemas),
        (Opcode.CHANNEL, channels),
        (Opcode.STATISTICS, [statistics]),
        (Opcode.CHUNK_INDEX, chunks),
        (Opcode.METADATA_INDEX, metadata),
    ]
    summary, offsets = b"", []
    for opcode, records in groups:
        group = _encode_records(*records)
        if group:
            offsets.append(SummaryOffset(opcode, start + len(summary), len(group)))
        summary += group
    footer = _encode_records(Footer(start, start + len(summary), 0))[:-4]
    summary += _encode_records(*offsets) + footer
    return summary + zlib.crc32(summary).to_bytes(4, "little") + MCAP0_MAGIC
