"""ROS bags in MCAP: messages in bag order, by topic, read around damage.

After the format's specification (mcap.dev/spec): a file is records, messages are records within
chunks or between them. The summary and the indexes are hints that are verified: a bag that was
never closed has no summary.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Footer, Schema
from numpy.typing import NDArray

from spoofbench.arrays import Ints, Octets
from spoofbench.codec.container import chunk_at
from spoofbench.codec.records import (
    CHAIN,
    CHUNK,
    INDEX_ENTRY,
    MESSAGE,
    RECORD,
    gather,
    indexed_starts,
    is_plausible,
    possible_starts,
    record_starts,
    surviving_records,
)
from spoofbench.errors import ConversionError, FormatError
from spoofbench_converters.rosbag.batches import BATCH_BYTES, ChunkedLog, LostMessages, RawMessages
from spoofbench_converters.rosbag.definitions import normal_name
from spoofbench_converters.rosbag.unpacking import MAX_CHUNK_BYTES, unpack

MAGIC = b"\x89MCAP0\r\n"
MAX_RECORD_BYTES = 4 << 20
MAX_SUMMARY_BYTES = 64 << 20

_FOOTER_BYTES = 20
_INDEX_HEAD_BYTES = 6
_MESSAGE_BYTES = MESSAGE.itemsize - RECORD.size  # before a message's own
_NO_OFFSETS = np.empty(0, np.uint64)
_WALK_BYTES = 1 << 16  # of the file at a time, from record to record
_SEARCH_BYTES = 1 << 20  # of the file at a time, for the next record behind damage
_COUNTS = struct.Struct("<QHI")  # statistics begin with those of messages, schemas and channels
_MOST_MESSAGES_PER_BYTE = 64  # a larger count is damaged
_DAMAGED = "the chunk is damaged here"


@dataclass(slots=True)
class _Pending:
    """A chunk: where its content is in the file, and where its index says that messages start in
    it.
    """

    at: int
    size: int
    offsets: list[NDArray[np.uint64]] = field(default_factory=list)


class McapLog(ChunkedLog):
    """An open file; see :class:`spoofbench_converters.rosbag.batches.MessageLog`."""

    def __init__(self, path: Path) -> None:
        """Open a file and learn its topics, from its summary or by reading all of it.

        Raises:
            ConversionError: it is no MCAP file.
        """
        super().__init__()
        self._file = path.open("rb", _SEARCH_BYTES)
        self._bytes = path.stat().st_size
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, int] = {}
        if self._file.read(len(MAGIC)) != MAGIC:
            self._file.close()
            raise ConversionError(f"{path.name!r} is no MCAP file")
        if not self._read_summary():
            for _ in self.parts():
                pass

    def close(self) -> None:
        """See :class:`spoofbench_converters.rosbag.batches.MessageLog`."""
        self._file.close()

    def parts(self) -> Iterator[RawMessages | LostMessages]:
        """See :class:`spoofbench_converters.rosbag.batches.ChunkedLog`."""
        self.unverified = 0
        pending: _Pending | None = None
        loose: list[tuple[int, int]] = []
        for item in self._records(len(MAGIC)):
            opcode, at, size = (0, 0, 0) if isinstance(item, LostMessages) else item
            if opcode == Opcode.MESSAGE_INDEX:
                if pending is not None:
                    pending.offsets.append(self._offsets(at, size))
                continue
            if pending is not None:
                yield from self._chunk(pending)
                pending = None
            if opcode == Opcode.MESSAGE and (not loose or at + size - loose[0][0] < BATCH_BYTES):
                loose.append((at, size))
                continue
            if loose:
                yield self._loose(loose)
                loose = [(at, size)] if opcode == Opcode.MESSAGE else []
            if isinstance(item, LostMessages):
                yield item
            elif opcode == Opcode.CHUNK:
                pending = _Pending(at, size)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._learn(opcode, self._read(at, min(size, MAX_RECORD_BYTES)))
            elif opcode == Opcode.DATA_END:
                break
        if pending is not None:
            yield from self._chunk(pending)
        if loose:
            yield self._loose(loose)

    def _read(self, at: int, size: int) -> bytes:
        self._file.seek(at)
        return self._file.read(size)

    def _octets(self, at: int, size: int) -> Octets:
        return np.frombuffer(self._read(at, size), np.uint8)

    def _read_summary(self) -> bool:
        """Learn the topics from the end of the file; return whether they are there."""
        tail = self._read(
            max(self._bytes - len(MAGIC) - _FOOTER_BYTES - RECORD.size, 0),
            _FOOTER_BYTES + RECORD.size + len(MAGIC),
        )
        if (
            len(tail) < _FOOTER_BYTES + RECORD.size + len(MAGIC)
            or not tail.endswith(MAGIC)
            or tail[0] != Opcode.FOOTER
        ):
            return False
        footer = Footer.read(
            ReadDataStream(BytesIO(tail[RECORD.size : RECORD.size + _FOOTER_BYTES]))
        )
        size = self._bytes - len(MAGIC) - _FOOTER_BYTES - RECORD.size - footer.summary_start
        if not footer.summary_start or not 0 < size <= MAX_SUMMARY_BYTES:
            return False
        summary = self._read(footer.summary_start, size)
        if (
            footer.summary_crc
            and zlib.crc32(tail[: RECORD.size + 16], zlib.crc32(summary)) != footer.summary_crc
        ):
            return False
        records = np.frombuffer(summary, np.uint8)
        starts, end = record_starts(records, 0, size, only_plausible=True)
        channels = 0
        for start in starts.tolist():
            opcode, content = _content(summary, start)
            self._learn(opcode, content)
            if opcode == Opcode.STATISTICS and len(content) >= _COUNTS.size:
                messages, _, channels = _COUNTS.unpack_from(content)
                self.expected = messages if messages <= _MOST_MESSAGES_PER_BYTE * self._bytes else 0
        return end == len(summary) and bool(self._channels) and len(self._channels) >= channels

    def _records(self, at: int) -> Iterator[tuple[int, int, int] | LostMessages]:
        """Yield opcode, offset and size of the content of the file's records from an offset on, and
        where there is something else.
        """
        while at < self._bytes:
            window = self._octets(at, _WALK_BYTES)
            starts, walked = record_starts(window, 0, window.size, only_plausible=True)
            for start in starts.tolist():
                opcode, size = RECORD.unpack_from(window.data, start)
                yield opcode, at + start + RECORD.size, size
            at += walked
            # Here is a record beyond the window, or none.
            if self._bytes - at == len(MAGIC) and self._read(at, len(MAGIC)) == MAGIC:
                return
            if at >= self._bytes:
                return
            opcode, size = self._head(at)
            begin, end = at + RECORD.size, at + RECORD.size + size
            if end <= self._bytes and is_plausible(opcode, size):
                yield opcode, begin, size
                at = end
                continue
            found = self._find(at + 1)
            if opcode == Opcode.CHUNK and size > CHUNK.size:  # cut off, or a length that is wrong
                yield opcode, begin, found - begin
            else:
                is_cut = found >= self._bytes
                yield LostMessages(1, f"the bag is {'cut off' if is_cut else 'damaged'} here")
            at = found

    def _head(self, at: int) -> tuple[int, int]:
        head = self._read(at, RECORD.size)
        if len(head) < RECORD.size:
            return 0, 0
        opcode, size = RECORD.unpack(head)
        return int(opcode), int(size)

    def _find(self, at: int) -> int:
        """Return where the next records start that follow one another, the end of the file if
        nowhere.
        """
        while at < self._bytes:
            for start in possible_starts(self._octets(at, _SEARCH_BYTES + RECORD.size)).tolist():
                if self._follows(at + start):
                    return at + int(start)
            at += _SEARCH_BYTES
        return self._bytes

    def _follows(self, at: int) -> bool:
        """Whether records follow one another from here."""
        for _ in range(CHAIN):
            opcode, size = self._head(at)
            if not is_plausible(opcode, size) or at + RECORD.size + size > self._bytes:
                return False
            at += RECORD.size + size
            if opcode == Opcode.FOOTER or at == self._bytes:
                return True
        return True

    def _learn(self, opcode: int, content: bytes) -> None:
        """Learn of a schema or a channel."""
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(ReadDataStream(BytesIO(content)))
                self._schemas.setdefault(schema.id, schema)
            elif opcode == Opcode.CHANNEL:
                self._add(Channel.read(ReadDataStream(BytesIO(content))))
        except (McapError, struct.error, ValueError):
            return

    def _add(self, channel: Channel) -> None:
        if channel.id in self._channels:
            return
        schema = self._schemas.get(channel.schema_id)
        kind, form, data = (schema.name, schema.encoding, schema.data) if schema else ("?", "", b"")
        text = data.decode("utf-8", "replace") if form in ("ros2msg", "ros1msg", "ros2idl") else ""
        self._channels[channel.id] = self.topic_number(
            channel.topic, normal_name(kind), channel.message_encoding, text, form
        )

    def _offsets(self, at: int, size: int) -> NDArray[np.uint64]:
        """Return where a message index says that messages start in their chunk, ``(n,)``."""
        size = max(min(size, MAX_CHUNK_BYTES) - _INDEX_HEAD_BYTES, 0)
        entries = self._read(at + _INDEX_HEAD_BYTES, size)
        count = len(entries) // INDEX_ENTRY.itemsize
        return np.frombuffer(entries, INDEX_ENTRY, count)["offset"] if count else _NO_OFFSETS

    def _loose(self, records: list[tuple[int, int]]) -> RawMessages:
        """Return messages that lie between the chunks, one after the other."""
        begin, (last, size) = records[0][0] - RECORD.size, records[-1]
        octets = np.frombuffer(self._read(begin, last + size - begin), np.uint8)
        return self._messages(
            octets, np.array([at for at, _ in records], np.int64) - RECORD.size - begin
        )

    def _chunk(self, pending: _Pending) -> Iterator[RawMessages | LostMessages]:
        """Yield a chunk's messages, and what of it is lost."""
        declared = sum(part.size for part in pending.offsets)
        record = self._octets(
            pending.at - RECORD.size, RECORD.size + min(pending.size, MAX_CHUNK_BYTES)
        )
        try:
            chunk = chunk_at(record, 0, record.size)
        except FormatError:
            chunk = None
        if chunk is None or max(chunk.size, pending.size) > MAX_CHUNK_BYTES:
            yield LostMessages(
                max(declared, 1),
                f"the chunk does not have a size of at most {MAX_CHUNK_BYTES:,} bytes",
            )
            return
        unpacked, wrong = unpack(bytes(record[chunk.data]), chunk.compression, chunk.size)
        if not wrong and chunk.crc and zlib.crc32(unpacked) != chunk.crc:
            if chunk.compression:  # what was unpacked from damaged bytes is anything
                yield LostMessages(max(declared, 1), "the chunk is damaged: its checksum is wrong")
                return
            self.unverified += 1
        octets, gaps = np.frombuffer(unpacked, np.uint8), 0
        starts = None if wrong else indexed_starts(octets, pending.offsets)
        if starts is None:
            starts, gaps = surviving_records(octets, self._channels)
            is_message = octets[starts] == Opcode.MESSAGE
            for start in starts[~is_message].tolist():
                self._learn(*_content(unpacked, start))
            starts = starts[is_message]
        messages = self._messages(octets, starts)
        yield messages
        lost = declared - messages.numbers.size if declared else gaps or int(wrong is not None)
        if lost > 0:
            yield LostMessages(lost, f"the chunk is damaged: {wrong}" if wrong else _DAMAGED)

    def _messages(self, octets: Octets, starts: Ints) -> RawMessages:
        records = gather(octets, MESSAGE, starts)
        channels, inverse = np.unique(records["channel"], return_inverse=True)
        numbers = np.array([self._channels.get(id_, -1) for id_ in channels.tolist()], np.int64)
        return RawMessages(
            octets,
            numbers[inverse],
            records["log_time"].astype(np.int64),
            starts + MESSAGE.itemsize,
            records["length"].astype(np.int64) - _MESSAGE_BYTES,
        )


def _content(octets: bytes, start: int) -> tuple[int, bytes]:
    """Return opcode and content of the record that starts at an offset."""
    opcode, length = RECORD.unpack_from(octets, start)
    return opcode, octets[start + RECORD.size : start + RECORD.size + length]
