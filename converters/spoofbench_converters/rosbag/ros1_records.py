"""Records of ROS 1 bags within bytes: walked, found again after damage, and those that an index
names verified.

After the format's description (wiki.ros.org/Bags/Format/2.0).
"""

import re
import struct
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from spoofbench_converters.rosbag.slabs import gather

MESSAGE, CONNECTION = 2, 7
START = re.compile(
    rb"(?s)(?=..[\x00\x01]\x00.\x00\x00\x00(?:op|ver|conn|count|compression|size|time|topic|chunk_pos|start_time|end_time)=)"
)
_U4 = struct.Struct("<I")

_Integers = NDArray[np.int64]
Fields = Mapping[bytes, bytes]
"""Values by name, of a header."""


def is_message(fields: Fields) -> bool:
    return (
        fields.get(b"op") == bytes([MESSAGE])
        and len(fields.get(b"conn", b"")) == 4
        and len(fields.get(b"time", b"")) == 8
    )


def fields_of(header: bytes) -> Fields | None:
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


def number_of(fields: Fields, name: bytes, size: int) -> int | None:
    value = fields.get(name, b"")
    return int.from_bytes(value, "little") if len(value) == size else None


def data_of(octets: NDArray[np.uint8], start: int) -> bytes:
    header = _U4.unpack_from(octets.data, start)[0]
    size = _U4.unpack_from(octets.data, start + 4 + header)[0]
    return octets[start + 8 + header : start + 8 + header + size].tobytes()


def heads_of(heads: NDArray[np.uint8]) -> tuple[_Integers, _Integers, NDArray[np.bool_]]:
    """Return connection and stamp of those message headers that are laid out as the first is, and
    which those are.
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
    """Return where the index says that messages start if that is all there is in the chunk, else
    None.
    """
    starts = np.sort(np.concatenate(offsets)) if offsets else np.empty(0, np.int64)
    if not starts.size or starts[0] or starts[-1] > octets.size - 8:
        return None
    data = starts + 4 + gather(octets, "<u4", starts)
    if data.max() > octets.size - 4:
        return None
    ends = data + 4 + gather(octets, "<u4", data)
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
