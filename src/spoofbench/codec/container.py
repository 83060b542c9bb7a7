"""The MCAP container: where a file's records and messages are, found within declared limits.

Nothing that a file says of itself is believed unchecked: every length must end within the file,
every chunk must unpack to exactly the size and the checksum it declares, and indexes serve as hints
that are verified.
"""

import mmap
import struct
import threading
import zlib
from array import array
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

from spoofbench.errors import FormatError, LimitError

RECORD = struct.Struct("<BQ")
MESSAGE = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
"""What precedes the data of a message record, its opcode and length included."""

LOG_TIME = 15
"""Where the log time of a message record is; the publish time follows."""

INDEX_ENTRY = np.dtype([("time", "<u8"), ("offset", "<u8")])
"""An entry of a message index: log time, and where the record starts in the unpacked chunk."""

_HEAD = np.dtype([("opcode", "u1"), ("length", "<u8")])
_CHUNK = struct.Struct("<QQQII")
_REPEATS = 8

_thread = threading.local()
"""Holds a zstd context for each thread."""


@dataclass(frozen=True, slots=True)
class Limits:
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

    buffer: NDArray[np.uint8]
    starts: NDArray[np.int64]
    sizes: NDArray[np.int64]
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
    others: NDArray[np.int64]


def map_file(path: Path) -> NDArray[np.uint8]:
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


def record_starts(
    buffer: NDArray[np.uint8], first: int, last: int
) -> tuple[NDArray[np.int64], int]:
    """Walk from record to record: the offsets of those that end by ``last``, and where the last of
    them ends.
    """
    view = buffer.data
    runs: list[NDArray[np.int64]] = []
    singles = array("q")
    at, before, equal = first, (0, 0), 0
    while at + RECORD.size <= last:
        head = RECORD.unpack_from(view, at)
        after = at + RECORD.size + head[1]
        if after > last:
            break
        singles.append(at)
        at = after
        equal = equal + 1 if head == before else 0
        before = head
        if equal >= _REPEATS:
            size = RECORD.size + head[1]
            count = _repeats(buffer, at, last, head)
            runs += [np.frombuffer(singles, np.int64), at + size * np.arange(count, dtype=np.int64)]
            at, singles, equal = at + size * count, array("q"), 0
    return np.concatenate([*runs, np.frombuffer(singles, np.int64)]), at


def _repeats(buffer: NDArray[np.uint8], at: int, last: int, head: tuple[int, int]) -> int:
    """Count the records from ``at`` on that have this opcode and length."""
    opcode, length = head
    size = RECORD.size + length
    limit, count, step = (last - at) // size, 0, 64
    while count < limit:
        step = min(step, limit - count)
        block: NDArray[Any] = np.ndarray(step, _HEAD, buffer.data, at + count * size, (size,))
        same = (block["opcode"] == opcode) & (block["length"] == length)
        if not same.all():
            return count + int(np.argmin(same))
        count, step = count + step, 8 * step
    return count


def gather(buffer: NDArray[np.uint8], dtype: Any, starts: NDArray[np.int64]) -> NDArray[Any]:
    """Return the values of a type that start at these offsets, ``(n,)``."""
    itemsize = np.dtype(dtype).itemsize
    if not starts.size:
        return np.empty(0, dtype)
    every: NDArray[Any] = np.ndarray(buffer.size - itemsize + 1, dtype, buffer.data, strides=(1,))
    return every[starts]


def group_by_value(values: NDArray[Any]) -> Iterator[tuple[int, NDArray[np.intp] | None]]:
    """Yield each value and its indices, ascending; None where all values are the same."""
    if not values.size:
        return
    if np.all(values == values[0]):
        yield int(values[0]), None
        return
    order = np.argsort(values, kind="stable")
    in_order = values[order]
    for rows in np.split(order, np.flatnonzero(in_order[1:] != in_order[:-1]) + 1):
        yield int(values[rows[0]]), rows


def messages_at(buffer: NDArray[np.uint8], starts: NDArray[np.int64], where: str) -> MessageRecords:
    """Return the message records that start at these offsets.

    Raises:
        FormatError: one is too short to be a message.
    """
    sizes = gather(buffer, "<u8", starts + 1).astype(np.int64) + RECORD.size
    if sizes.size and sizes.min() < MESSAGE.itemsize:
        raise FormatError(
            f"{where} holds a message record of {int(sizes.min())!r} bytes, too short for its head"
        )
    return MessageRecords(buffer, starts, sizes, gather(buffer, "<u2", starts + RECORD.size))


def parse_chunk(buffer: NDArray[np.uint8], offset: int, limits: Limits) -> Chunk:
    """Return the chunk record at an offset.

    Raises:
        FormatError: its lengths do not fit together.
        LimitError: it declares more than the limits allow.
    """
    begin, length = offset + RECORD.size, RECORD.unpack_from(buffer.data, offset)[1]
    end = begin + length
    if length < _CHUNK.size + 8:
        raise FormatError(f"the chunk at byte {offset} is only {length!r} bytes long")
    start_ns, end_ns, size, crc, name_length = _CHUNK.unpack_from(buffer.data, begin)
    data = begin + _CHUNK.size + name_length + 8
    if data > end:
        raise FormatError(
            f"the chunk at byte {offset} has a compression name of {name_length!r} bytes, beyond "
            "its end"
        )
    name = bytes(buffer[begin + _CHUNK.size : data - 8]).decode("utf-8", "replace")
    (data_length,) = struct.unpack_from("<Q", buffer.data, data - 8)
    if data + data_length > end:
        raise FormatError(
            f"the chunk at byte {offset} declares {data_length!r} bytes of data, beyond its end"
        )
    if size > limits.chunk_bytes:
        raise LimitError(
            f"the chunk at byte {offset} declares {size!r} bytes where at most "
            f"{limits.chunk_bytes} are allowed"
        )
    return Chunk(offset, start_ns, end_ns, size, crc, name, slice(data, data + data_length))


def unpack(buffer: NDArray[np.uint8], chunk: Chunk) -> NDArray[np.uint8]:
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


def decompress(
    data: NDArray[np.uint8], compression: str, size: int, where: str
) -> NDArray[np.uint8]:
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


def _from_zstd(data: NDArray[np.uint8], size: int, where: str) -> NDArray[np.uint8]:
    declared = zstandard.frame_content_size(data.data)
    if declared not in (-1, size):
        raise FormatError(f"{where} declares {size!r} bytes but its zstd frame {declared!r}")
    if not hasattr(_thread, "zstd"):
        _thread.zstd = zstandard.ZstdDecompressor()
    return np.frombuffer(_thread.zstd.decompress(data, max_output_size=size), np.uint8)


def _from_lz4(data: NDArray[np.uint8], size: int, where: str) -> NDArray[np.uint8]:
    unpacker = lz4.frame.LZ4FrameDecompressor()
    records = unpacker.decompress(bytes(data), max_length=size)
    if not unpacker.eof and unpacker.decompress(b"", max_length=1):
        raise FormatError(f"{where} unpacks to more than the {size!r} bytes that it declares")
    return np.frombuffer(records, np.uint8)


def chunk_contents(
    buffer: NDArray[np.uint8], chunk: Chunk, indexes: Sequence[slice] = ()
) -> ChunkContents:
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
    starts = _indexed_starts(buffer, records, indexes)
    if starts is not None:
        return ChunkContents(messages_at(records, starts, where), np.empty(0, np.int64))
    starts, end = record_starts(records, 0, records.size)
    if end != records.size:
        raise FormatError(f"{where} holds a record at its byte {end} that does not end within it")
    is_message = records[starts] == Opcode.MESSAGE
    return ChunkContents(messages_at(records, starts[is_message], where), starts[~is_message])


def _indexed_starts(
    buffer: NDArray[np.uint8], records: NDArray[np.uint8], indexes: Sequence[slice]
) -> NDArray[np.int64] | None:
    """Return where a message index says the messages are if that is all there is in the chunk, else
    None.
    """
    entries = [np.frombuffer(buffer[index], INDEX_ENTRY)["offset"] for index in indexes]
    if not entries or not sum(part.size for part in entries):
        return None
    offsets = entries[0] if len(entries) == 1 else np.sort(np.concatenate(entries), kind="stable")
    if offsets[0] != 0 or offsets[-1] > records.size - min(records.size, MESSAGE.itemsize):
        return None
    starts = offsets.astype(np.int64)
    if np.any(starts[1:] <= starts[:-1]) or not np.all(records[starts] == Opcode.MESSAGE):
        return None
    lengths = gather(records, "<u8", starts + 1)
    ends = np.append(starts[1:], records.size) - RECORD.size
    return starts if np.array_equal(lengths, (ends - starts).astype(np.uint64)) else None


class _ExactStream(ReadDataStream):
    """Reads of a record that must not run over its end."""

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) != length:
            raise EndOfFile
        return data


def parse(record: Any, buffer: NDArray[np.uint8], start: int, where: str) -> Any:
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
