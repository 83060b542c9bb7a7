"""Records of MCAP within bytes: walked one after the other, and found again after damage.

After the format's specification (https://mcap.dev/spec): a record is an opcode, the length of its
content, and the content. The codec's own reader walks whole files and chunks, where anything that
does not fit is an error; converters of foreign logs read on behind damage.
"""

import struct
import sys
from array import array
from collections.abc import Container, Iterator, Sequence
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from spoofbench.arrays import Indices, Ints, Octets

RECORD = struct.Struct("<BQ")
"""What precedes the content of a record: opcode and length."""

CHUNK = struct.Struct("<QQQII")
"""How the content of a chunk begins: start and end time, size and checksum of what is in it, length
of the name of the compression.
"""

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

CHANNEL, LOG_TIME = 9, 15
"""Where channel and log time of a message record are; the publish time follows."""

INDEX_ENTRY = np.dtype([("time", "<u8"), ("offset", "<u8")])
"""An entry of a message index: log time, and where the record starts in the unpacked chunk."""

CHAIN = 3
"""Records in a row that make an offset believable as the start of one."""

_HEAD = np.dtype([("opcode", "u1"), ("length", "<u8")])
_MESSAGE = int(Opcode.MESSAGE)  # numpy compares arrays with it faster than with the enum
_REPEATS = 8
_WINDOW_BYTES = 1 << 20
_MIN_LENGTHS = {
    **{int(opcode): 0 for opcode in Opcode},
    int(Opcode.MESSAGE): MESSAGE.itemsize - RECORD.size,
    int(Opcode.CHUNK): CHUNK.size + 8,
    int(Opcode.SCHEMA): 14,
    int(Opcode.CHANNEL): 16,
    int(Opcode.MESSAGE_INDEX): 6,
}
_ANY_LENGTH = [0] * 256
_PLAUSIBLE_LENGTH = [_MIN_LENGTHS.get(opcode, sys.maxsize) for opcode in range(256)]
_KNOWN = np.isin(np.arange(256), list(_MIN_LENGTHS))


def is_plausible(opcode: int, length: int) -> bool:
    """Whether a record may have this opcode, one of the specification, and this length."""
    return length >= _PLAUSIBLE_LENGTH[opcode]


def record_starts(
    buffer: Octets, first: int, last: int, *, only_plausible: bool = False
) -> tuple[Ints, int]:
    """Walk from record to record: the offsets of those that end by ``last``, ``(n,)``, and where
    the last of them ends.

    Args:
        buffer: bytes, uint8 ``(size,)``.
        first: where the first record starts.
        last: where the walk ends at the latest.
        only_plausible: end the walk before a record that is not :func:`is_plausible`; else an
            unknown opcode is one of a later version, as the specification wants it.
    """
    view = buffer.data
    min_lengths = _PLAUSIBLE_LENGTH if only_plausible else _ANY_LENGTH
    runs: list[Ints] = []
    singles = array("q")
    at, before, equal = first, (0, 0), 0
    while at + RECORD.size <= last:
        head = RECORD.unpack_from(view, at)
        after = at + RECORD.size + head[1]
        if after > last or head[1] < min_lengths[head[0]]:
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


def _repeats(buffer: Octets, at: int, last: int, head: tuple[int, int]) -> int:
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


def indexed_starts(records: Octets, offsets: Sequence[NDArray[np.uint64]]) -> Ints | None:
    """Return where message indexes say that a chunk's messages are, ``(n,)``, if those are all that
    is in it, else None.

    Args:
        records: of the chunk, unpacked; uint8 ``(size,)``.
        offsets: those of each index.
    """
    if not offsets:
        return None
    # Offsets ascend within each index: a stable sort merges them.
    ordered = offsets[0] if len(offsets) == 1 else np.sort(np.concatenate(offsets), kind="stable")
    last = records.size - MESSAGE.itemsize
    if not ordered.size or last < 0 or ordered[0] != 0 or ordered[-1] > last:
        return None
    starts = ordered.astype(np.int64)
    if len(offsets) == 1 and ((starts[1:] <= starts[:-1]).any()):
        return None
    if (records[starts] != _MESSAGE).any():
        return None
    ends = starts + RECORD.size + gather(records, "<i8", starts + 1)
    return starts if ends[-1] == records.size and (ends[:-1] == starts[1:]).all() else None


def possible_starts(buffer: Octets) -> Indices:
    """Return where a record may start, ``(n,)``: a known opcode, and a length below 16 MiB, of a
    chunk below 4 GiB.
    """
    offsets = np.flatnonzero(_KNOWN[buffer[: max(buffer.size - RECORD.size, 0)]])
    for byte in (8, 7, 6, 5):
        offsets = offsets[buffer[offsets + byte] == 0]
    return np.asarray(offsets[(buffer[offsets + 4] == 0) | (buffer[offsets] == Opcode.CHUNK)])


def surviving_records(records: Octets, channels: Container[int]) -> tuple[Ints, int]:
    """Walk a chunk's records and read on behind damage, from messages of known channels that follow
    one another.

    Args:
        records: of the chunk, unpacked as far as it goes; uint8 ``(size,)``.
        channels: those known.

    Returns:
        Where records start, ``(n,)``, and at how many offsets there is something else.
    """
    starts, end = record_starts(records, 0, records.size, only_plausible=True)
    parts, gaps = [starts], 0
    while end < records.size:
        gaps += 1
        end = _next_messages(records, end + 1, channels)
        starts, end = record_starts(records, end, records.size, only_plausible=True)
        parts.append(starts)
    return np.concatenate(parts), gaps


def _next_messages(records: Octets, at: int, channels: Container[int]) -> int:
    """Return where the next messages start that follow one another, the end if nowhere."""
    while at < records.size:
        window = records[at : at + _WINDOW_BYTES + RECORD.size]
        for start in (at + possible_starts(window)).tolist():
            if records[start] == _MESSAGE and _is_chain(records, start):
                channel = int.from_bytes(records[start + CHANNEL : start + CHANNEL + 2], "little")
                if channel in channels:
                    return int(start)
        at += _WINDOW_BYTES
    return records.size


def _is_chain(records: Octets, at: int) -> bool:
    """Whether records follow one another from here, up to the end where it is near."""
    for _ in range(CHAIN):
        if at + RECORD.size > records.size:
            return False
        opcode, length = RECORD.unpack_from(records.data, at)
        at += RECORD.size + length
        if not is_plausible(opcode, length) or at > records.size:
            return False
        if at == records.size:
            return True
    return True


def gather(buffer: Octets, dtype: Any, starts: Ints) -> NDArray[Any]:
    """Return the values of a type that start at these offsets, ``(n,)``."""
    itemsize = np.dtype(dtype).itemsize
    if not starts.size:
        return np.empty(0, dtype)
    every: NDArray[Any] = np.ndarray(buffer.size - itemsize + 1, dtype, buffer.data, strides=(1,))
    return every[starts]


def group_by_value(values: NDArray[Any]) -> Iterator[tuple[int, Indices | None]]:
    """Yield each value of ``(n,)`` and its indices ``(m,)``, ascending; None where all values are
    the same.
    """
    if not values.size:
        return
    if np.all(values == values[0]):
        yield int(values[0]), None
        return
    order = np.argsort(values, kind="stable")
    in_order = values[order]
    for rows in np.split(order, np.flatnonzero(in_order[1:] != in_order[:-1]) + 1):
        yield int(values[rows[0]]), rows
