"""ROS 1 bags, version 2.0: messages in bag order, by topic, read around damage.

After the format's description (wiki.ros.org/Bags/Format/2.0): a file is records, a record a header
of ``name=value`` fields and data; connections and messages are records within chunks. Indexes are
hints that are verified: a bag that was never closed has none.
"""

import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spoofbench.codec.records import gather
from spoofbench.errors import ConversionError
from spoofbench_converters.rosbag.batches import ChunkedLog, LostMessages, RawMessages
from spoofbench_converters.rosbag.definitions import normal_name
from spoofbench_converters.rosbag.layouts import windows
from spoofbench_converters.rosbag.unpacking import MAX_CHUNK_BYTES, unpack

MAGIC = b"#ROSBAG V2.0\n"
MAX_HEADER_BYTES = 65_536
MAXCONNECTION_BYTES = 1_048_576

_BAG, _INDEX, _CHUNK, _INFO = 3, 4, 5, 6
_WINDOW_BYTES = 1 << 20
_MAX_HEADS = 16  # different header layouts in one chunk
_DAMAGED = "the chunk is damaged here"

_Integers = NDArray[np.int64]
_Fields = Mapping[bytes, bytes]
"""What a record's header holds, by name."""

MESSAGE, CONNECTION = 2, 7
START = re.compile(
    rb"(?s)(?=..[\x00\x01]\x00.\x00\x00\x00(?:op|ver|conn|count|compression|size|time|topic|"
    rb"chunk_pos|start_time|end_time)=)"
)
_U4 = struct.Struct("<I")


@dataclass(frozen=True, slots=True)
class _Record:
    """A record of the file: its operation, the fields of its header, and where its data are."""

    op: int
    fields: _Fields
    data_at: int
    size: int


@dataclass(slots=True)
class _Pending:
    """A chunk, and where its index says that messages start in it."""

    record: _Record
    offsets: list[_Integers] = field(default_factory=list)


class Ros1Log(ChunkedLog):
    """An open bag; see :class:`spoofbench_converters.rosbag.batches.MessageLog`."""

    def __init__(self, path: Path) -> None:
        """Open a bag and learn its topics, from its index or by reading all of it.

        Raises:
            ConversionError: it is of another version.
        """
        super().__init__()
        self._file = path.open("rb")
        self._bytes = path.stat().st_size
        self._connections: dict[int, int] = {}
        if self._file.read(len(MAGIC)) != MAGIC:
            self._file.close()
            raise ConversionError(
                f"{path.name!r} is a ROS 1 bag of another version than 2.0; bring it up to date "
                "with `rosbag fix`"
            )
        if not self._read_index():
            for _ in self.parts():
                pass

    def close(self) -> None:
        """See :class:`spoofbench_converters.rosbag.batches.MessageLog`."""
        self._file.close()

    def parts(self) -> Iterator[RawMessages | LostMessages]:
        """See :class:`spoofbench_converters.rosbag.batches.ChunkedLog`."""
        pending: _Pending | None = None
        for record in self._records(len(MAGIC)):
            if isinstance(record, _Record) and record.op == _INDEX:
                if pending is not None:
                    pending.offsets.append(self._offsets(record))
                continue
            if pending is not None:
                yield from self._chunk(pending)
                pending = None
            if isinstance(record, LostMessages):
                yield record
            elif record.op == _CHUNK:
                pending = _Pending(record)
            elif record.op == CONNECTION:
                self._connect(record.fields, self._data(record, MAXCONNECTION_BYTES))
        if pending is not None:
            yield from self._chunk(pending)

    def _read_index(self) -> bool:
        """Learn the topics from the end of the file; return whether they are there."""
        bag = self._record_at(len(MAGIC))
        if bag is None or bag.op != _BAG:
            return False
        start, count = (
            number_of(bag.fields, b"index_pos", 8),
            number_of(bag.fields, b"conn_count", 4),
        )
        if not start or start > self._bytes:
            return False
        messages = 0
        for record in self._records(start):
            if isinstance(record, _Record) and record.op == CONNECTION:
                self._connect(record.fields, self._data(record, MAXCONNECTION_BYTES))
            elif isinstance(record, _Record) and record.op == _INFO:
                counts = np.frombuffer(self._data(record, MAXCONNECTION_BYTES), np.uint8)
                messages += int(counts[: counts.size // 8 * 8].view("<u4")[1::2].sum())
            else:
                return False
        self.expected = messages
        return count is not None and len(self._connections) == count

    def _records(self, at: int) -> Iterator[_Record | LostMessages]:
        """Yield the file's records from a place on, and where there is something else."""
        while at < self._bytes:
            record = self._record_at(at)
            if record is None:
                found = self._find(at + 1, frozenset({_INDEX, _CHUNK, _INFO, CONNECTION}))
                yield LostMessages(
                    1,
                    "the bag is damaged here" if found < self._bytes else "the bag is cut off here",
                )
                at = found
                continue
            end = record.data_at + record.size
            if end > self._bytes:  # cut off, or a length that is wrong
                end = self._find(record.data_at, frozenset({_INDEX, _CHUNK}))
                record = _Record(record.op, record.fields, record.data_at, end - record.data_at)
            yield record
            at = end

    def _record_at(self, at: int) -> _Record | None:
        self._file.seek(at)
        head = self._file.read(4)
        length = int.from_bytes(head, "little")
        if len(head) < 4 or not 0 < length <= MAX_HEADER_BYTES:
            return None
        header = self._file.read(length + 4)
        fields = fields_of(header[:length])
        if len(header) < length + 4 or fields is None or len(fields.get(b"op", b"")) != 1:
            return None
        op = fields[b"op"][0]
        return (
            _Record(
                op, fields, at + 8 + length, int.from_bytes(header[length : length + 4], "little")
            )
            if MESSAGE <= op <= CONNECTION
            else None
        )

    def _find(self, at: int, ops: frozenset[int]) -> int:
        """Return where the next record of such an operation starts, the end of the file if
        nowhere.
        """
        while at < self._bytes:
            self._file.seek(at)
            window = self._file.read(_WINDOW_BYTES + 64)
            for match in START.finditer(window, 0, _WINDOW_BYTES + 64):
                record = self._record_at(at + match.start())
                if record is not None and record.op in ops and match.start() < _WINDOW_BYTES:
                    return at + match.start()
            at += _WINDOW_BYTES
        return self._bytes

    def _data(self, record: _Record, most: int) -> bytes:
        self._file.seek(record.data_at)
        return self._file.read(min(record.size, most))

    def _offsets(self, record: _Record) -> _Integers:
        entries = np.frombuffer(self._data(record, MAX_CHUNK_BYTES), np.uint8)
        return entries[: entries.size // 12 * 12].view("<u4")[2::3].astype(np.int64)

    def _connect(self, fields: _Fields, data: bytes) -> None:
        """Learn of a connection."""
        about = fields_of(data)
        number = number_of(fields, b"conn", 4)
        if about is None or number is None:
            return
        name, kind, text = (
            value.decode("utf-8", "replace")
            for value in (
                fields.get(b"topic", b"?"),
                about.get(b"type", b"?"),
                about.get(b"message_definition", b""),
            )
        )
        self._connections.setdefault(
            number, self.topic_number(name, normal_name(kind), "ros1", text, "ros1msg")
        )

    def _chunk(self, pending: _Pending) -> Iterator[RawMessages | LostMessages]:
        """Yield a chunk's messages, and what of it is lost."""
        record = pending.record
        declared = sum(part.size for part in pending.offsets)
        size = number_of(record.fields, b"size", 4)
        if size is None or max(size, record.size) > MAX_CHUNK_BYTES:
            yield LostMessages(
                max(declared, 1),
                f"the chunk does not have a size of at most {MAX_CHUNK_BYTES:,} bytes",
            )
            return
        packing = record.fields.get(b"compression", b"none").decode("ascii", "replace")
        unpacked, wrong = unpack(self._data(record, MAX_CHUNK_BYTES), packing, size)
        octets = np.frombuffer(unpacked, np.uint8)
        starts = None if wrong else indexed(octets, pending.offsets)
        gaps = 0
        if starts is None:
            starts, gaps = walk(unpacked)
        messages, strange = self._messages(octets, starts)
        yield messages
        gaps += strange
        lost = declared - messages.numbers.size if declared else gaps + (wrong is not None)
        if lost > 0:
            yield LostMessages(lost, f"the chunk is damaged: {wrong}" if wrong else _DAMAGED)

    def _messages(self, octets: NDArray[np.uint8], starts: _Integers) -> tuple[RawMessages, int]:
        """Return the messages among records of a chunk, and how many are neither message nor
        connection; learn of the connections.
        """
        parts: list[tuple[_Integers, _Integers, _Integers]] = []
        lengths, strange = _numbers_at(octets, starts), 0
        for length in np.unique(lengths).tolist():
            index = np.flatnonzero(lengths == length)
            while index.size:
                heads = (
                    windows(octets, length)[starts[index] + 4]
                    .view(np.uint8)
                    .reshape(index.size, length)
                )
                fields = fields_of(heads[0].tobytes()) or {}
                if is_message(fields) and len(parts) < _MAX_HEADS:
                    conns, stamps, same = heads_of(heads)
                    parts.append((index[same], conns, stamps))
                    index = index[~same]
                    continue
                if fields.get(b"op") == bytes([CONNECTION]):
                    self._connect(fields, data_of(octets, int(starts[index[0]])))
                else:
                    strange += 1
                index = index[1:]
        if not parts:
            none = np.empty(0, np.int64)
            return RawMessages(octets, none, none, none, none), strange
        index, conns, stamps = (np.concatenate(column) for column in zip(*parts, strict=True))
        order = np.argsort(index)
        index, conns, stamps = index[order], conns[order], stamps[order]
        messages = starts[index] + 8 + lengths[index]
        known, inverse = np.unique(conns, return_inverse=True)
        numbers = np.array([self._connections.get(conn, -1) for conn in known.tolist()], np.int64)[
            inverse
        ]
        return RawMessages(
            octets, numbers, stamps, messages, _numbers_at(octets, messages - 4)
        ), strange


def is_message(fields: _Fields) -> bool:
    return (
        fields.get(b"op") == bytes([MESSAGE])
        and len(fields.get(b"conn", b"")) == 4
        and len(fields.get(b"time", b"")) == 8
    )


def fields_of(header: bytes) -> _Fields | None:
    """Return the fields of a header, None where it is none."""
    fields, at = {}, 0
    while at < len(header):
        if at + 4 > len(header):
            return None
        end = at + 4 + _U4.unpack_from(header, at)[0]
        name, equals, value = header[at + 4 : end].partition(b"=")
        if end > len(header) or not equals:
            return None
        fields[name] = value
        at = end
    return fields


def number_of(fields: _Fields, name: bytes, size: int) -> int | None:
    value = fields.get(name, b"")
    return int.from_bytes(value, "little") if len(value) == size else None


def _numbers_at(octets: NDArray[np.uint8], starts: _Integers) -> _Integers:
    """Return the unsigned 32-bit numbers that start at these offsets, ``(n,)``."""
    return gather(octets, "<u4", starts).astype(np.int64)


def data_of(octets: NDArray[np.uint8], start: int) -> bytes:
    """Return the data of the record that starts at this offset of ``(bytes,)``."""
    header = _U4.unpack_from(octets.data, start)[0]
    size = _U4.unpack_from(octets.data, start + 4 + header)[0]
    return octets[start + 8 + header : start + 8 + header + size].tobytes()


def heads_of(heads: NDArray[np.uint8]) -> tuple[_Integers, _Integers, NDArray[np.bool_]]:
    """Return connection and stamp, ``(m,)``, of those message headers, ``(n, bytes)``, that are
    laid out as the first is, and which those are, ``(n,)``.
    """
    first = heads[0].tobytes()
    values = {name: first.index(name + b"=") + len(name) + 1 for name in (b"conn", b"time")}
    fixed = np.ones(heads.shape[1], bool)
    fixed[values[b"conn"] : values[b"conn"] + 4] = fixed[values[b"time"] : values[b"time"] + 8] = (
        False
    )
    same = (heads[:, fixed] == heads[0, fixed]).all(axis=1)
    mine = heads[same]
    conns, seconds, nanoseconds = (
        np.ascontiguousarray(mine[:, at : at + 4]).view("<u4")[:, 0].astype(np.int64)
        for at in (values[b"conn"], values[b"time"], values[b"time"] + 4)
    )
    return conns, seconds * 1_000_000_000 + nanoseconds, same


def indexed(octets: NDArray[np.uint8], offsets: list[_Integers]) -> _Integers | None:
    """Return where the index says that messages start, ``(n,)``, if that is all there is in the
    chunk, else None.
    """
    starts = np.sort(np.concatenate(offsets)) if offsets else np.empty(0, np.int64)
    if not starts.size or starts[0] or starts[-1] > octets.size - 8:
        return None
    data = starts + 4 + _numbers_at(octets, starts)
    if data.max() > octets.size - 4:
        return None
    ends = data + 4 + _numbers_at(octets, data)
    return starts if np.array_equal(ends, np.append(starts[1:], octets.size)) else None


def walk(octets: bytes) -> tuple[_Integers, int]:
    """Walk a chunk's records; return where they start, and at how many places there is something
    else.
    """
    starts, at, gaps, end = [], 0, 0, len(octets)
    while at < end:
        data = at + 4 + _U4.unpack_from(octets, at)[0] if at + 8 <= end else end
        after = data + 4 + _U4.unpack_from(octets, data)[0] if data + 4 <= end else end + 1
        if after <= end and octets.find(b"op=", at + 4, data) >= 0:
            starts.append(at)
            at = after
            continue
        gaps += 1
        at = _next(octets, at + 1)
    return np.array(starts, np.int64), gaps


def _next(octets: bytes, at: int) -> int:
    """Return where the next message or connection starts, the end if nowhere."""
    for match in START.finditer(octets, at):
        start = match.start()
        length = _U4.unpack_from(octets, start)[0]
        fields = fields_of(octets[start + 4 : start + 4 + length])
        if (
            fields
            and fields.get(b"op") in (bytes([MESSAGE]), bytes([CONNECTION]))
            and b"conn" in fields
        ):
            return start
    return len(octets)
