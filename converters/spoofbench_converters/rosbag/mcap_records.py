"""Records of MCAP within bytes: walked, found again after damage, and those that an index names
verified.

After the format's specification (mcap.dev/spec).
"""

import struct
import sys
from collections.abc import Container

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from spoofbench_converters.rosbag.slabs import gather
from spoofbench_converters.rosbag.unpacking import MAX_CHUNK_BYTES

CHUNK = struct.Struct("<QQQII")
HEAD = struct.Struct("<BQ")
MESSAGE_BYTES = 22  # before a message's own
CHAIN = 3  # records in a row that make a place believable
WINDOW_BYTES = 1 << 20

_Integers = NDArray[np.int64]

KNOWN = frozenset(int(opcode) for opcode in Opcode)
_KNOWN_OPCODES = np.isin(np.arange(256), list(KNOWN))
LEAST: dict[int, int] = {
    Opcode.MESSAGE: MESSAGE_BYTES,
    Opcode.CHUNK: CHUNK.size + 8,
    Opcode.SCHEMA: 14,
    Opcode.CHANNEL: 16,
    Opcode.MESSAGE_INDEX: 6,
}


def chunk_head(content: bytes) -> tuple[int, int, str, bytes] | None:
    """Return size, checksum, packing and packed bytes of a chunk, None where it is none or too
    large.
    """
    if len(content) < CHUNK.size + 8:
        return None
    _, _, size, crc, name = CHUNK.unpack_from(content)
    data = CHUNK.size + name + 8
    if data > len(content) or size > MAX_CHUNK_BYTES:
        return None
    (length,) = struct.unpack_from("<Q", content, data - 8)
    return (
        size,
        crc,
        content[CHUNK.size : data - 8].decode("utf-8", "replace"),
        content[data : data + length],
    )


def indexed(octets: NDArray[np.uint8], offsets: list[_Integers]) -> _Integers | None:
    """Return where the index says that messages start if that is all there is in the chunk, else
    None.
    """
    starts = np.sort(np.concatenate(offsets)) if offsets else np.empty(0, np.int64)
    if (
        not starts.size
        or starts[0]
        or starts[-1] > octets.size - HEAD.size - MESSAGE_BYTES
        or (octets[starts] != Opcode.MESSAGE).any()
    ):
        return None
    ends = starts + HEAD.size + gather(octets, "<u8", starts + 1)
    return starts if np.array_equal(ends, np.append(starts[1:], octets.size)) else None


def candidates(octets: NDArray[np.uint8]) -> _Integers:
    """Return where a record may start: a known opcode, and a length below 16 MiB, of a chunk below
    4 GiB.
    """
    places = np.flatnonzero(_KNOWN_OPCODES[octets[: max(octets.size - HEAD.size, 0)]])
    for upper in (8, 7, 6, 5):
        places = places[octets[places + upper] == 0]
    return np.asarray(places[(octets[places + 4] == 0) | (octets[places] == Opcode.CHUNK)])


def walk_on(octets: bytes, channels: Container[int]) -> tuple[_Integers, int]:
    """Walk a chunk's records; return where they start, and at how many places there is something
    else.
    """
    starts, end = walk(octets)
    parts, gaps = [starts], 0
    while end < len(octets):
        gaps += 1
        end = _next(octets, end + 1, channels)
        starts, end = walk(octets, end)
        parts.append(starts)
    return np.concatenate(parts), gaps


def _next(octets: bytes, at: int, channels: Container[int]) -> int:
    """Return where the next messages start that follow one another, the end if nowhere."""
    while at < len(octets):
        window = np.frombuffer(octets, np.uint8)[at : at + WINDOW_BYTES + HEAD.size]
        for place in (at + candidates(window)).tolist():
            starts, end = walk(octets, place, CHAIN)
            believable = starts.size == CHAIN or (starts.size > 0 and end == len(octets))
            if (
                believable
                and octets[place] == Opcode.MESSAGE
                and int.from_bytes(octets[place + 9 : place + 11], "little") in channels
            ):
                return int(place)
        at += WINDOW_BYTES
    return len(octets)


def walk(octets: bytes, at: int = 0, most: int = sys.maxsize) -> tuple[_Integers, int]:
    """Walk so many records at most; return where those start that end within, and where the last of
    them ends.
    """
    starts: list[int] = []
    while at + HEAD.size <= len(octets) and len(starts) < most:
        after = at + HEAD.size + HEAD.unpack_from(octets, at)[1]
        if (
            after > len(octets)
            or octets[at] not in KNOWN
            or after - at < HEAD.size + LEAST.get(octets[at], 0)
        ):
            break
        starts.append(at)
        at = after
    return np.array(starts, np.int64), at
