"""Chunks and messages of MCAP, found within declared limits.

Nothing that a file says of itself is believed unchecked: every length must end within the file,
every chunk must unpack to exactly the size and the checksum it declares, and indexes serve as hints
that are verified.
"""

import mmap
import struct
import threading
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from numpy.typing import NDArray

from spoofbench.arrays import Ints, Octets
from spoofbench.codec.records import (
    CHUNK,
    INDEX_ENTRY,
    MESSAGE,
    RECORD,
    gather,
    group_by_value,
    indexed_starts,
    record_starts,
)
from spoofbench.errors import FormatError, LimitError

_thread = threading.local()
"""Holds a zstd context for each thread."""


@dataclass(frozen=True, slots=True)
class ReadLimits:
    """What a file may ask for; asking for more is a :class:`~spoofbench.errors.LimitError`.

    Attributes:
        chunk_bytes: decompressed size of one chunk.
        total_bytes: decompressed size of all chunks.
        messages: in the whole file.
        records: at the top level of the file and in chunks that no index describes, messages aside.
        channels: in the whole file; each is a topic that is read by itself.
        text_bytes: all records but messages, chunks and indexes: schemas, channels, metadata,
            statistics.
    """

    chunk_bytes: int = 128 << 20
    total_bytes: int = 16 << 30
    messages: int = 200_000_000
    records: int = 2_000_000
    channels: int = 4096
    text_bytes: int = 64 << 20


@dataclass(frozen=True, slots=True)
class Chunk:
    """A chunk record: its offset in the file, its fields, and where its compressed data are."""

    offset: int
    start_ns: int
    end_ns: int
    size: int
    crc: int
    compression: str
    data: slice


@dataclass(frozen=True, slots=True, eq=False)
class MessageRecords:
    """Message records within a buffer: where each starts, how long it is with its head, and its
    channel, ``(n,)`` each.
    """

    buffer: Octets
    starts: Ints
    sizes: Ints
    channels: NDArray[np.uint16]

    def by_channel(self) -> Iterator[tuple[int, "MessageRecords"]]:
        """Yield each channel's messages, in file order."""
        for channel, rows in group_by_value(self.channels):
            if rows is None:
                yield channel, self
            else:
                part = self.starts[rows], self.sizes[rows], self.channels[rows]
                yield channel, MessageRecords(self.buffer, *part)


@dataclass(frozen=True, slots=True, eq=False)
class ChunkContents:
    """What is in a chunk: its messages, and where its other records start in their buffer."""

    messages: MessageRecords
    others: Ints


def map_file(path: Path) -> Octets:
    """Return a file's bytes, read as they are used.

    Raises:
        FormatError: the file cannot be read.
    """
    try:
        with path.open("rb") as stream:
            return np.frombuffer(mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ), np.uint8)
    except ValueError:
        return np.empty(0, np.uint8)
    except OSError as error:
        raise FormatError(f"{str(path)!r} cannot be read: {error.strerror}") from error


def messages_at(buffer: Octets, starts: Ints, where: str) -> MessageRecords:
    """Return the message records that start at these offsets, ``(n,)``.

    Raises:
        FormatError: one is too short to be a message.
    """
    sizes = gather(buffer, "<u8", starts + 1).astype(np.int64) + RECORD.size
    if sizes.size and sizes.min() < MESSAGE.itemsize:
        raise FormatError(
            f"{where} holds a message record of {int(sizes.min())!r} bytes, too short for its head"
        )
    return MessageRecords(buffer, starts, sizes, gather(buffer, "<u2", starts + RECORD.size))


def chunk_at(buffer: Octets, offset: int, end: int) -> Chunk:
    """Return the chunk record at an offset whose content ends at ``end``; its data may end later.

    Raises:
        FormatError: its fields do not fit within.
    """
    begin = offset + RECORD.size
    if end - begin < CHUNK.size + 8:
        raise FormatError(f"the chunk at byte {offset} is only {end - begin!r} bytes long")
    start_ns, end_ns, size, crc, name_length = CHUNK.unpack_from(buffer.data, begin)
    data = begin + CHUNK.size + name_length + 8
    if data > end:
        raise FormatError(
            f"the chunk at byte {offset} has a compression name of {name_length!r} bytes, beyond "
            "its end"
        )
    name = bytes(buffer[begin + CHUNK.size : data - 8]).decode("utf-8", "replace")
    (data_length,) = struct.unpack_from("<Q", buffer.data, data - 8)
    return Chunk(offset, start_ns, end_ns, size, crc, name, slice(data, data + data_length))


def checked_chunk_at(buffer: Octets, offset: int, limits: ReadLimits) -> Chunk:
    """Return the chunk record at an offset.

    Raises:
        FormatError: its lengths do not fit together.
        LimitError: it declares more than the limits allow.
    """
    end = offset + RECORD.size + RECORD.unpack_from(buffer.data, offset)[1]
    chunk = chunk_at(buffer, offset, end)
    if chunk.data.stop > end:
        raise FormatError(
            f"the chunk at byte {offset} declares {chunk.data.stop - chunk.data.start!r} bytes of "
            "data, beyond its end"
        )
    if chunk.size > limits.chunk_bytes:
        raise LimitError(
            f"the chunk at byte {offset} declares {chunk.size!r} bytes where at most "
            f"{limits.chunk_bytes} are allowed"
        )
    return chunk


def unpack(buffer: Octets, chunk: Chunk) -> Octets:
    """Return a chunk's records, of the size and the checksum that it declares; no more than that is
    ever allocated.

    Raises:
        FormatError: it unpacks to something else, or its compression is unknown.
    """
    where = f"the chunk at byte {chunk.offset}"
    records = decompress(buffer[chunk.data], chunk.compression, chunk.size, where)
    if records.size != chunk.size:
        raise FormatError(f"{where} does not unpack to the {chunk.size!r} bytes that it declares")
    if chunk.crc and zlib.crc32(records.data) != chunk.crc:
        raise FormatError(f"{where} is damaged: its checksum is not {chunk.crc!r}")
    return records


def decompress(data: Octets, compression: str, size: int, where: str) -> Octets:
    """Return what data unpack to; no more than the declared size is ever allocated.

    Raises:
        FormatError: they do not unpack, or to more than that, or the compression is unknown.
    """
    if compression == "":
        return data
    if not size:
        return np.empty(0, np.uint8)
    try:
        if compression == "zstd":
            return _from_zstd(data, size, where)
        if compression == "lz4":
            return _from_lz4(data, size, where)
    except (zstandard.ZstdError, RuntimeError) as error:
        raise FormatError(f"{where} does not unpack: {error}") from error
    raise FormatError(f"{where} is compressed by {compression!r}; zstd, lz4 and none can be read")


def _from_zstd(data: Octets, size: int, where: str) -> Octets:
    declared = zstandard.frame_content_size(data.data)
    if declared not in (-1, size):
        raise FormatError(f"{where} declares {size!r} bytes but its zstd frame {declared!r}")
    if not hasattr(_thread, "zstd"):
        _thread.zstd = zstandard.ZstdDecompressor()
    return np.frombuffer(_thread.zstd.decompress(data, max_output_size=size), np.uint8)


def _from_lz4(data: Octets, size: int, where: str) -> Octets:
    unpacker = lz4.frame.LZ4FrameDecompressor()
    records = unpacker.decompress(bytes(data), max_length=size)
    if not unpacker.eof and unpacker.decompress(b"", max_length=1):
        raise FormatError(f"{where} unpacks to more than the {size!r} bytes that it declares")
    return np.frombuffer(records, np.uint8)


def chunk_contents(buffer: Octets, chunk: Chunk, indexes: Sequence[slice] = ()) -> ChunkContents:
    """Return what is in a chunk.

    Args:
        buffer: the file.
        chunk: of the file.
        indexes: where the entries of its message index records are, a hint that spares walking the
            records.

    Raises:
        FormatError: the chunk is damaged.
    """
    records = unpack(buffer, chunk)
    where = f"the chunk at byte {chunk.offset}"
    offsets = [np.frombuffer(buffer[index], INDEX_ENTRY)["offset"] for index in indexes]
    starts = indexed_starts(records, offsets)
    if starts is not None:
        return ChunkContents(messages_at(records, starts, where), np.empty(0, np.int64))
    starts, end = record_starts(records, 0, records.size)
    if end != records.size:
        raise FormatError(f"{where} holds a record at its byte {end} that does not end within it")
    is_message = records[starts] == Opcode.MESSAGE
    return ChunkContents(messages_at(records, starts[is_message], where), starts[~is_message])


class _ExactStream(ReadDataStream):
    """Reads of a record that must not run over its end."""

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) != length:
            raise EndOfFile
        return data


def parse(record: Any, buffer: Octets, start: int, where: str) -> Any:
    """Parse the record that starts at an offset as a class of :mod:`mcap.records`.

    Raises:
        FormatError: it does not parse.
    """
    length = RECORD.unpack_from(buffer.data, start)[1]
    payload = bytes(buffer[start + RECORD.size : start + RECORD.size + length])
    try:
        return record.read(_ExactStream(BytesIO(payload)))
    except (McapError, struct.error, ValueError) as error:
        raise FormatError(
            f"the {record.__name__} record at byte {start} of {where} is damaged"
        ) from error
