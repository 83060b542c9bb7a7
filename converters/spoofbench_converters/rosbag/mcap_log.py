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

from spoofbench.errors import ConversionError
from spoofbench_converters.rosbag.definitions import normal_name
from spoofbench_converters.rosbag.mcap_records import (
    CHAIN,
    CHUNK,
    HEAD,
    KNOWN,
    LEAST,
    MESSAGE_BYTES,
    WINDOW_BYTES,
    candidates,
    chunk_head,
    indexed,
    walk,
    walk_on,
)
from spoofbench_converters.rosbag.slabs import SLAB_BYTES, ChunkedLog, Lost, Messages, gather
from spoofbench_converters.rosbag.unpacking import MAX_CHUNK_BYTES, unpack

MAGIC = b"\x89MCAP0\r\n"
MAX_RECORD_BYTES = 4 << 20
MAX_SUMMARY_BYTES = 64 << 20

_FOOTER_BYTES = 20
_COUNTS = struct.Struct("<QHI")  # statistics begin with those of messages, schemas and channels
_MOST_MESSAGES_PER_BYTE = 64  # a larger count is damaged
_DAMAGED = "the chunk is damaged here"

_Integers = NDArray[np.int64]


@dataclass(slots=True)
class _Pending:
    """A chunk: where its content is in the file, and where its index says that messages start in
    it.
    """

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
        self._file = path.open("rb", WINDOW_BYTES)
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
        tail = self._read(
            max(self._bytes - len(MAGIC) - _FOOTER_BYTES - HEAD.size, 0),
            _FOOTER_BYTES + HEAD.size + len(MAGIC),
        )
        if (
            len(tail) < _FOOTER_BYTES + HEAD.size + len(MAGIC)
            or not tail.endswith(MAGIC)
            or tail[0] != Opcode.FOOTER
        ):
            return False
        footer = Footer.read(ReadDataStream(BytesIO(tail[HEAD.size : HEAD.size + _FOOTER_BYTES])))
        size = self._bytes - len(MAGIC) - _FOOTER_BYTES - HEAD.size - footer.summary_start
        if not footer.summary_start or not 0 < size <= MAX_SUMMARY_BYTES:
            return False
        summary = self._read(footer.summary_start, size)
        if (
            footer.summary_crc
            and zlib.crc32(tail[: HEAD.size + 16], zlib.crc32(summary)) != footer.summary_crc
        ):
            return False
        starts, end = walk(summary)
        channels = 0
        for start in starts.tolist():
            opcode, length = HEAD.unpack_from(summary, start)
            content = summary[start + HEAD.size : start + HEAD.size + length]
            self._learn(opcode, content)
            if opcode == Opcode.STATISTICS and length >= _COUNTS.size:
                messages, _, channels = _COUNTS.unpack_from(content)
                self.expected = messages if messages <= _MOST_MESSAGES_PER_BYTE * self._bytes else 0
        return end == len(summary) and bool(self._channels) and len(self._channels) >= channels

    def _records(self, at: int) -> Iterator[tuple[int, int, int] | Lost]:
        """Yield opcode, place and size of the content of the file's records from a place on, and
        where there is something else.
        """
        while at < self._bytes:
            opcode, size = self._head(at)
            if self._bytes - at == len(MAGIC) and self._read(at, len(MAGIC)) == MAGIC:
                return
            begin, end = at + HEAD.size, at + HEAD.size + size
            if end <= self._bytes and opcode in KNOWN and size >= LEAST.get(opcode, 0):
                yield opcode, begin, size
                at = end
                continue
            found = self._find(at + 1)
            if opcode == Opcode.CHUNK and size > CHUNK.size:  # cut off, or a length that is wrong
                yield opcode, begin, found - begin
            else:
                yield Lost(
                    1,
                    "the bag is damaged here" if found < self._bytes else "the bag is cut off here",
                )
            at = found

    def _head(self, at: int) -> tuple[int, int]:
        head = self._read(at, HEAD.size)
        if len(head) < HEAD.size:
            return 0, 0
        opcode, size = HEAD.unpack(head)
        return int(opcode), int(size)

    def _find(self, at: int) -> int:
        """Return where the next records start that follow one another, the end of the file if
        nowhere.
        """
        while at < self._bytes:
            window = np.frombuffer(self._read(at, WINDOW_BYTES + HEAD.size), np.uint8)
            for place in candidates(window).tolist():
                if self._follows(at + place):
                    return at + int(place)
            at += WINDOW_BYTES
        return self._bytes

    def _follows(self, at: int) -> bool:
        """Whether records follow one another from here."""
        for _ in range(CHAIN):
            opcode, size = self._head(at)
            if (
                opcode not in KNOWN
                or at + HEAD.size + size > self._bytes
                or size < LEAST.get(opcode, 0)
            ):
                return False
            at += HEAD.size + size
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

    def _offsets(self, at: int, size: int) -> _Integers:
        entries = np.frombuffer(
            self._read(at + 6, min(size, MAX_CHUNK_BYTES) - 6 if size > 6 else 0), np.uint8
        )
        return entries[: entries.size // 16 * 16].view("<u8")[1::2].astype(np.int64)

    def _loose(self, records: list[tuple[int, int]]) -> Messages:
        """Return messages that lie between the chunks, one after the other."""
        begin, (last, size) = records[0][0] - HEAD.size, records[-1]
        octets = np.frombuffer(self._read(begin, last + size - begin), np.uint8)
        return self._messages(
            octets, np.array([at for at, _ in records], np.int64) - HEAD.size - begin
        )

    def _chunk(self, pending: _Pending) -> Iterator[Messages | Lost]:
        """Yield a chunk's messages, and what of it is lost."""
        declared = sum(part.size for part in pending.offsets)
        content = self._read(pending.at, min(pending.size, MAX_CHUNK_BYTES))
        head = chunk_head(content)
        if head is None or pending.size > MAX_CHUNK_BYTES:
            yield Lost(
                max(declared, 1),
                f"the chunk does not have a size of at most {MAX_CHUNK_BYTES:,} bytes",
            )
            return
        size, crc, packing, data = head
        unpacked, wrong = unpack(data, packing, size)
        if not wrong and crc and zlib.crc32(unpacked) != crc:
            if packing:  # what was unpacked from damaged bytes is anything
                yield Lost(max(declared, 1), "the chunk is damaged: its checksum is wrong")
                return
            self.unverified += 1
        octets, gaps = np.frombuffer(unpacked, np.uint8), 0
        starts = None if wrong else indexed(octets, pending.offsets)
        if starts is None:
            starts, gaps = walk_on(unpacked, self._channels)
            for start in starts[octets[starts] != Opcode.MESSAGE].tolist():
                self._learn(
                    int(octets[start]),
                    unpacked[
                        start + HEAD.size : start + HEAD.size + HEAD.unpack_from(unpacked, start)[1]
                    ],
                )
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
        numbers = np.array(
            [self._channels.get(channel, -1) for channel in known.tolist()], np.int64
        )[inverse]
        return Messages(
            octets, numbers, stamps, starts + HEAD.size + MESSAGE_BYTES, lengths - MESSAGE_BYTES
        )
