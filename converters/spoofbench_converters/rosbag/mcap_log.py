"""ROS bags in MCAP: messages in bag order, by topic, read around damage.

After the format's specification (mcap.dev/spec): a file is records, messages are records within chunks or between them.
The summary and the indexes are hints that are verified: a bag that was never closed has no summary.
"""

import struct
import sys
import zlib
from collections.abc import Container, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Footer, Schema, Statistics
from numpy.typing import NDArray

from spoofbench.errors import ConversionError
from spoofbench_converters.rosbag.definitions import normal_name
from spoofbench_converters.rosbag.slabs import SLAB_BYTES, ChunkedLog, Lost, Messages, gather
from spoofbench_converters.rosbag.unpacking import MAX_CHUNK_BYTES, unpack

MAGIC = b"\x89MCAP0\r\n"
MAX_RECORD_BYTES = 4 << 20
MAX_SUMMARY_BYTES = 64 << 20

_HEAD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII")
_MESSAGE_BYTES = 22  # before a message's own
_FOOTER_BYTES = 20
_CHAIN = 3  # records in a row that make a place believable
_WINDOW_BYTES = 1 << 20
_DAMAGED = "the chunk is damaged here"

_Integers = NDArray[np.int64]


@dataclass(slots=True)
class _Pending:
    """A chunk: where its content is in the file, and where its index says that messages start in it."""

    at: int
    size: int
    offsets: list[_Integers] = field(default_factory=list)


class McapLog(ChunkedLog):
    """An open file; see :class:`spoofbench_converters.rosbag.slabs.Log`."""

    def __init__(self, path: Path) -> None:
        """Open a file and learn its topics, from its summary or by reading all of it.

        Raises:
            ConversionError: it is no MCAP file.
        """
        super().__init__()
        self._file = path.open("rb", _WINDOW_BYTES)
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
        """See :class:`spoofbench_converters.rosbag.slabs.Log`."""
        self._file.close()

    def parts(self) -> Iterator[Messages | Lost]:
        """See :class:`spoofbench_converters.rosbag.slabs.ChunkedLog`."""
        self.unverified = 0
        pending: _Pending | None = None
        loose: list[tuple[int, int]] = []
        for item in self._records(len(MAGIC)):
            opcode, at, size = (0, 0, 0) if isinstance(item, Lost) else item
            if opcode == Opcode.MESSAGE_INDEX:
                if pending is not None:
                    pending.offsets.append(self._offsets(at, size))
                continue
            if pending is not None:
                yield from self._chunk(pending)
                pending = None
            if opcode == Opcode.MESSAGE and (not loose or at + size - loose[0][0] < SLAB_BYTES):
                loose.append((at, size))
                continue
            if loose:
                yield self._loose(loose)
                loose = [(at, size)] if opcode == Opcode.MESSAGE else []
            if isinstance(item, Lost):
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

    def _read_summary(self) -> bool:
        """Learn the topics from the end of the file; return whether they are there."""
        tail = self._read(max(self._bytes - len(MAGIC) - _FOOTER_BYTES - _HEAD.size, 0), _FOOTER_BYTES + _HEAD.size + len(MAGIC))
        if len(tail) < _FOOTER_BYTES + _HEAD.size + len(MAGIC) or not tail.endswith(MAGIC) or tail[0] != Opcode.FOOTER:
            return False
        footer = Footer.read(ReadDataStream(BytesIO(tail[_HEAD.size : _HEAD.size + _FOOTER_BYTES])))
        size = self._bytes - len(MAGIC) - _FOOTER_BYTES - _HEAD.size - footer.summary_start
        if not footer.summary_start or not 0 < size <= MAX_SUMMARY_BYTES:
            return False
        summary = self._read(footer.summary_start, size)
        if footer.summary_crc and zlib.crc32(tail[: _HEAD.size + 16], zlib.crc32(summary)) != footer.summary_crc:
            return False
        starts, end = _walk(summary)
        channels = 0
        for start in starts.tolist():
            opcode, length = _HEAD.unpack_from(summary, start)
            content = summary[start + _HEAD.size : start + _HEAD.size + length]
            self._learn(opcode, content)
            if opcode == Opcode.STATISTICS and length >= 42:
                statistics = Statistics.read(ReadDataStream(BytesIO(content)))
                self.expected, channels = statistics.message_count, statistics.channel_count
        return end == len(summary) and bool(self._channels) and len(self._channels) >= channels

    def _records(self, at: int) -> Iterator[tuple[int, int, int] | Lost]:
        """Yield opcode, place and size of the content of the file's records from a place on, and where there is something else."""
        while at < self._bytes:
            opcode, size = self._head(at)
            if self._bytes - at == len(MAGIC) and self._read(at, len(MAGIC)) == MAGIC:
                return
            begin, end = at + _HEAD.size, at + _HEAD.size + size
            if end <= self._bytes and opcode in _KNOWN and size >= _LEAST.get(opcode, 0):
                yield opcode, begin, size
                at = end
                continue
            found = self._find(at + 1)
            if opcode == Opcode.CHUNK and size > _CHUNK.size:  # cut off, or a length that is wrong
                yield opcode, begin, found - begin
            else:
                yield Lost(1, "the bag is damaged here" if found < self._bytes else "the bag is cut off here")
            at = found

    def _head(self, at: int) -> tuple[int, int]:
        head = self._read(at, _HEAD.size)
        if len(head) < _HEAD.size:
            return 0, 0
        opcode, size = _HEAD.unpack(head)
        return int(opcode), int(size)

    def _find(self, at: int) -> int:
        """Return where the next records start that follow one another, the end of the file if nowhere."""
        while at < self._bytes:
            window = np.frombuffer(self._read(at, _WINDOW_BYTES + _HEAD.size), np.uint8)
            for place in _candidates(window).tolist():
                if self._follows(at + place):
                    return at + int(place)
            at += _WINDOW_BYTES
        return self._bytes

    def _follows(self, at: int) -> bool:
        """Whether records follow one another from here."""
        for _ in range(_CHAIN):
            opcode, size = self._head(at)
            if opcode not in _KNOWN or at + _HEAD.size + size > self._bytes or size < _LEAST.get(opcode, 0):
                return False
            at += _HEAD.size + size
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
        self._channels[channel.id] = self.number_of(channel.topic, normal_name(kind), channel.message_encoding, text, form)

    def _offsets(self, at: int, size: int) -> _Integers:
        entries = np.frombuffer(self._read(at + 6, min(size, MAX_CHUNK_BYTES) - 6 if size > 6 else 0), np.uint8)
        return entries[: entries.size // 16 * 16].view("<u8")[1::2].astype(np.int64)

    def _loose(self, records: list[tuple[int, int]]) -> Messages:
        """Return messages that lie between the chunks, one after the other."""
        begin, (last, size) = records[0][0] - _HEAD.size, records[-1]
        octets = np.frombuffer(self._read(begin, last + size - begin), np.uint8)
        return self._messages(octets, np.array([at for at, _ in records], np.int64) - _HEAD.size - begin)

    def _chunk(self, pending: _Pending) -> Iterator[Messages | Lost]:
        """Yield a chunk's messages, and what of it is lost."""
        declared = sum(part.size for part in pending.offsets)
        content = self._read(pending.at, min(pending.size, MAX_CHUNK_BYTES))
        head = _chunk_head(content)
        if head is None or pending.size > MAX_CHUNK_BYTES:
            yield Lost(max(declared, 1), f"the chunk does not have a size of at most {MAX_CHUNK_BYTES:,} bytes")
            return
        size, crc, packing, data = head
        unpacked, wrong = unpack(data, packing, size)
        if not wrong and crc and zlib.crc32(unpacked) != crc:
            if packing:  # what was unpacked from damaged bytes is anything
                yield Lost(max(declared, 1), "the chunk is damaged: its checksum is wrong")
                return
            self.unverified += 1
        octets, gaps = np.frombuffer(unpacked, np.uint8), 0
        starts = None if wrong else _indexed(octets, pending.offsets)
        if starts is None:
            starts, gaps = _walk_on(unpacked, self._channels)
            for start in starts[octets[starts] != Opcode.MESSAGE].tolist():
                self._learn(int(octets[start]), unpacked[start + _HEAD.size : start + _HEAD.size + _HEAD.unpack_from(unpacked, start)[1]])
            starts = starts[octets[starts] == Opcode.MESSAGE]
        messages = self._messages(octets, starts)
        yield messages
        lost = declared - messages.numbers.size if declared else gaps or int(wrong is not None)
        if lost > 0:
            yield Lost(lost, f"the chunk is damaged: {wrong}" if wrong else _DAMAGED)

    def _messages(self, octets: NDArray[np.uint8], starts: _Integers) -> Messages:
        lengths = gather(octets, "<u8", starts + 1)
        channels, stamps = gather(octets, "<u2", starts + 9), gather(octets, "<u8", starts + 15)
        known, inverse = np.unique(channels, return_inverse=True)
        numbers = np.array([self._channels.get(channel, -1) for channel in known.tolist()], np.int64)[inverse]
        return Messages(octets, numbers, stamps, starts + _HEAD.size + _MESSAGE_BYTES, lengths - _MESSAGE_BYTES)


_KNOWN = frozenset(int(opcode) for opcode in Opcode)
_KNOWN_OPCODES = np.isin(np.arange(256), list(_KNOWN))
_LEAST: dict[int, int] = {
    Opcode.MESSAGE: _MESSAGE_BYTES,
    Opcode.CHUNK: _CHUNK.size + 8,
    Opcode.SCHEMA: 14,
    Opcode.CHANNEL: 16,
    Opcode.MESSAGE_INDEX: 6,
}


def _chunk_head(content: bytes) -> tuple[int, int, str, bytes] | None:
    """Return size, checksum, packing and packed bytes of a chunk, None where it is none or too large."""
    if len(content) < _CHUNK.size + 8:
        return None
    _, _, size, crc, name = _CHUNK.unpack_from(content)
    data = _CHUNK.size + name + 8
    if data > len(content) or size > MAX_CHUNK_BYTES:
        return None
    (length,) = struct.unpack_from("<Q", content, data - 8)
    return size, crc, content[_CHUNK.size : data - 8].decode("utf-8", "replace"), content[data : data + length]


def _indexed(octets: NDArray[np.uint8], offsets: list[_Integers]) -> _Integers | None:
    """Return where the index says that messages start if that is all there is in the chunk, else None."""
    starts = np.sort(np.concatenate(offsets)) if offsets else np.empty(0, np.int64)
    if not starts.size or starts[0] or starts[-1] > octets.size - _HEAD.size - _MESSAGE_BYTES or (octets[starts] != Opcode.MESSAGE).any():
        return None
    ends = starts + _HEAD.size + gather(octets, "<u8", starts + 1)
    return starts if np.array_equal(ends, np.append(starts[1:], octets.size)) else None


def _candidates(octets: NDArray[np.uint8]) -> _Integers:
    """Return where a record may start: a known opcode, and a length below 16 MiB, of a chunk below 4 GiB."""
    places = np.flatnonzero(_KNOWN_OPCODES[octets[: max(octets.size - _HEAD.size, 0)]])
    for upper in (8, 7, 6, 5):
        places = places[octets[places + upper] == 0]
    return np.asarray(places[(octets[places + 4] == 0) | (octets[places] == Opcode.CHUNK)])


def _walk_on(octets: bytes, channels: Container[int]) -> tuple[_Integers, int]:
    """Walk a chunk's records; return where they start, and at how many places there is something else."""
    starts, end = _walk(octets)
    parts, gaps = [starts], 0
    while end < len(octets):
        gaps += 1
        end = _next(octets, end + 1, channels)
        starts, end = _walk(octets, end)
        parts.append(starts)
    return np.concatenate(parts), gaps


def _next(octets: bytes, at: int, channels: Container[int]) -> int:
    """Return where the next messages start that follow one another, the end if nowhere."""
    while at < len(octets):
        window = np.frombuffer(octets, np.uint8)[at : at + _WINDOW_BYTES + _HEAD.size]
        for place in (at + _candidates(window)).tolist():
            starts, end = _walk(octets, place, _CHAIN)
            believable = starts.size == _CHAIN or (starts.size > 0 and end == len(octets))
            if believable and octets[place] == Opcode.MESSAGE and int.from_bytes(octets[place + 9 : place + 11], "little") in channels:
                return int(place)
        at += _WINDOW_BYTES
    return len(octets)


def _walk(octets: bytes, at: int = 0, most: int = sys.maxsize) -> tuple[_Integers, int]:
    """Walk so many records at most; return where those start that end within, and where the last of them ends."""
    starts: list[int] = []
    while at + _HEAD.size <= len(octets) and len(starts) < most:
        after = at + _HEAD.size + _HEAD.unpack_from(octets, at)[1]
        if after > len(octets) or octets[at] not in _KNOWN or after - at < _HEAD.size + _LEAST.get(octets[at], 0):
            break
        starts.append(at)
        at = after
    return np.array(starts, np.int64), at
