"""Where frames may stand in a stretch of bytes: every start of a UBX frame, a sentence or an RTCM 3
message, and what its checksum says.

All times are linear in the stretch, whatever it holds: checksums over any number of overlapping
candidates come from running sums over the whole.
"""

from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from spoofbench.arrays import Bools, Ints, Octets

Checksum = Literal["required", "missing-allowed", "ignored"]

MAX_SENTENCE = 1024
"""Longest sentence, from ``$`` to before ``*``. NMEA 0183 allows 82 characters; vendors' own
sentences are longer.
"""

MAX_FRAME = 65_535 + 8
"""Longest UBX frame: what its 16-bit length allows."""

VALID, WRONG, MISSING, BROKEN, CUT = range(5)
"""What becomes of a candidate: valid; wrong checksum; sentence up to the end of its line without a
checksum; sentence broken off by another start, by a byte that no sentence has, or by length; cut
off by the end of the log."""

_MAX_RTCM = 1023 + 6
_CRC24Q = 0x1864CFB
_STRIDE = 1024
_WINDOW = _STRIDE + _MAX_RTCM
_WINDOWS_AT_ONCE = 512
_LF, _CR, _BANG, _DOLLAR, _STAR = b"\n\r!$*"


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Stretches that begin like a frame, in order of their starts.

    Attributes:
        starts, ends: int64 ``(k,)``, ``[start, end)`` of each.
        verdicts: uint8 ``(k,)``, one of the five above.
    """

    starts: Ints
    ends: Ints
    verdicts: NDArray[np.uint8]

    def before(self, limit: int) -> "Candidates":
        """Return those that start before an offset."""
        return self.take(slice(0, int(np.searchsorted(self.starts, limit))))

    def valid(self) -> "Candidates":
        """Return the valid ones."""
        return self.take(self.verdicts == VALID)

    def take(self, which: "slice | Bools") -> "Candidates":
        """Return those that a slice or mask ``(k,)`` selects."""
        return Candidates(self.starts[which], self.ends[which], self.verdicts[which])


def ubx(octets: Octets) -> Candidates:
    """Return every ``B5 62`` in bytes ``(n,)`` (u-blox interface descriptions, UBX frame structure;
    checksum: 8-bit Fletcher, RFC 1145).
    """
    starts = np.flatnonzero(octets[:-1] == 0xB5)
    starts = starts[octets[starts + 1] == 0x62]
    lengths = np.zeros(starts.size, np.int64)
    has_length = starts + 6 <= octets.size
    low, high = octets[starts[has_length] + 4], octets[starts[has_length] + 5]
    lengths[has_length] = low + high.astype(np.int64) * 256
    ends = starts + lengths + 8
    whole = has_length & (ends <= octets.size)
    verdicts = np.full(starts.size, CUT, np.uint8)
    if whole.any():
        verdicts[whole] = np.where(
            _fletcher_agrees(octets, starts[whole] + 2, ends[whole] - 2), VALID, WRONG
        )
    return Candidates(starts, ends, verdicts)


def _fletcher_agrees(octets: Octets, starts: Ints, ends: Ints) -> Bools:
    """Whether the two bytes at each end are the Fletcher checksum of ``[start, end)``: modulo 256,
    the sum of the bytes, and that of the bytes times their distance from the end."""
    first = int(starts[0])
    here, before, after = octets[first : int(ends.max()) + 1], starts - first, ends - first
    if int((ends - starts).sum()) <= 2 * here.size:
        index = np.tile(np.arange(256, dtype=np.uint8), here.size // 256 + 1)[: here.size]
        a = _reduced(np.add, here, before, after)
        b = after.astype(np.uint8) * a - _reduced(np.add, here * index, before, after)
        return np.asarray((a == octets[ends]) & (b == octets[ends + 1]))
    sums = np.zeros((2, here.size + 1), np.uint32)
    np.cumsum(here.astype(np.uint32), out=sums[0, 1:])
    np.cumsum(sums[0, 1:], out=sums[1, 1:])
    a = sums[0, after] - sums[0, before]
    b = sums[1, after] - sums[1, before] - (after - before).astype(np.uint32) * sums[0, before]
    return np.asarray(
        (a.astype(np.uint8) == octets[ends]) & (b.astype(np.uint8) == octets[ends + 1])
    )


def sentences(octets: Octets, checksum: Checksum) -> Candidates:
    """Return every ``$`` or ``!`` before a capital letter in bytes ``(n,)`` (IEC 61162-1; checksum:
    XOR of what stands between start and ``*``).

    A candidate ends after ``*hh``; one without ``*`` at the end of its line, if it comes to one.
    """
    marks = np.flatnonzero((octets == _DOLLAR) | (octets == _BANG))
    if not marks.size:
        return Candidates(marks, marks, np.zeros(0, np.uint8))
    begins = _at(octets, marks + 1) - np.uint8(ord("A")) < 26
    starts, limits = marks[begins], np.append(marks[1:], octets.size)[begins]
    limits = np.minimum(limits, starts + MAX_SENTENCE)
    stars = _next(np.flatnonzero(octets == _STAR), starts, octets.size)
    lines = _next(np.flatnonzero((octets == _LF) | (octets == _CR)), starts, octets.size)
    ends = np.minimum(stars, lines)
    fits = ends < limits
    fits[fits] = _printable(octets, starts[fits], ends[fits])
    starred = fits & (stars < lines)
    verdicts = np.where(fits, MISSING if checksum == "required" else VALID, BROKEN).astype(np.uint8)
    verdicts[~fits & (np.minimum(ends, limits) == octets.size)] = CUT
    verdicts[starred] = _checked(octets, starts[starred], ends[starred], checksum)
    return Candidates(starts, np.where(starred & (verdicts == VALID), ends + 3, ends), verdicts)


def _checked(octets: Octets, starts: Ints, stars: Ints, checksum: Checksum) -> NDArray[np.uint8]:
    """Return the verdicts on sentences that end with ``*``."""
    if not starts.size:
        return np.zeros(0, np.uint8)
    high, low = _hex_values()[_at(octets, stars + 1)], _hex_values()[_at(octets, stars + 2)]
    is_hex = (high < 16) & (low < 16)
    agrees = is_hex
    if checksum != "ignored":
        agrees = is_hex & (
            _reduced(np.bitwise_xor, octets, starts + 1, stars) == high * np.uint8(16) + low
        )
    return np.where(agrees, VALID, np.where(stars + 2 >= octets.size, CUT, WRONG)).astype(np.uint8)


def rtcm3(octets: Octets, outside: Candidates | None) -> Candidates:
    """Return every valid RTCM 3 message in bytes ``(n,)`` that does not start within one of the
    frames ``outside`` (RTCM 10403, transport layer; CRC-24Q).
    """
    starts = np.flatnonzero(octets[:-5] == 0xD3) if octets.size > 5 else np.zeros(0, np.int64)
    starts = starts[octets[starts + 1] < 4]
    if outside is not None:
        starts = starts[
            starts >= np.append(0, outside.ends)[np.searchsorted(outside.starts, starts)]
        ]
    ends = starts + 6 + octets[starts + 1].astype(np.int64) * 256 + octets[starts + 2]
    whole = ends <= octets.size
    starts, ends = starts[whole], ends[whole]
    rows = starts // _STRIDE
    agrees = np.zeros(starts.size, bool)
    for first in range(0, int(rows[-1]) + 1 if rows.size else 0, _WINDOWS_AT_ONCE):
        here = slice(*np.searchsorted(rows, (first, first + _WINDOWS_AT_ONCE)))
        if here.start < here.stop:
            agrees[here] = _crc_agrees(octets, starts[here], ends[here])
    return Candidates(starts[agrees], ends[agrees], np.zeros(int(agrees.sum()), np.uint8))


def _crc_agrees(octets: Octets, starts: Ints, ends: Ints) -> Bools:
    """Whether the CRC-24Q over message and checksum is zero.

    A CRC is the remainder of a sum of one term per byte. Terms are scaled by a power of x as if
    each window were one message; x is invertible, so the running sums before and after a message
    are equal just if its own remainder is zero.
    """
    windows, row = np.unique(starts // _STRIDE, return_inverse=True)
    offsets = windows[:, None] * _STRIDE + np.arange(_WINDOW)
    terms = _crc_terms()[np.arange(_WINDOW), octets.take(offsets, mode="clip")]
    sums = np.zeros((windows.size, _WINDOW + 1), np.uint32)
    np.bitwise_xor.accumulate(terms, axis=1, out=sums[:, 1:])
    origin = windows[row] * _STRIDE
    return np.asarray(sums[row, starts - origin] == sums[row, ends - origin])


@cache
def _crc_terms() -> NDArray[np.uint32]:
    """Return what each byte value adds to the remainder at each offset of a window, uint32
    ``(window, 256)``.
    """
    by_byte = np.arange(256, dtype=np.uint32) << 16
    for _ in range(8):
        by_byte = (by_byte << 1) ^ np.where(by_byte & 0x800000, np.uint32(_CRC24Q), np.uint32(0))
    terms = np.zeros((_WINDOW, 256), np.uint32)
    terms[-1] = np.arange(256)
    for index in range(_WINDOW - 1, 0, -1):
        terms[index - 1] = (terms[index] << 8 & 0xFFFFFF) ^ by_byte[terms[index] >> 16]
    return terms


@cache
def _hex_values() -> Octets:
    """Return the value of each byte as a hexadecimal digit, 255 where it is none."""
    values = np.full(256, 255, np.uint8)
    for value, digits in enumerate(zip(b"0123456789ABCDEF", b"0123456789abcdef", strict=True)):
        values[list(digits)] = value
    return values


def chosen(starts: Ints, ends: Ints) -> Bools:
    """Return which valid candidates a scan from left to right takes, bool ``(k,)``: each that
    starts at or after the end of the one taken before.

    Args:
        starts, ends: int64 ``(k,)``, in order of the starts.
    """
    taken = np.ones(starts.size, bool)
    if np.any(starts[1:] < ends[:-1]):
        reached = 0
        for index, (start, end) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
            taken[index] = start >= reached
            reached = end if start >= reached else reached
    return taken


def line_ends(octets: Octets, ends: Ints) -> Ints:
    """Return where the line end after each offset ends, int64 ``(k,)``: up to two carriage returns
    and a line feed, if there are any.

    Args:
        octets: the stretch, ``(n,)``.
        ends: int64 ``(k,)``.
    """
    for byte in (_CR, _CR, _LF):
        ends = ends + (_at(octets, ends) == byte)
    return ends


def _at(octets: Octets, offsets: Ints) -> Octets:
    """Return the bytes at these offsets, zeros beyond the end."""
    return np.where(
        offsets < octets.size, octets[np.minimum(offsets, octets.size - 1)], np.uint8(0)
    )


def _next(marks: Ints, offsets: Ints, none: int) -> Ints:
    """Return the first mark after each offset."""
    return np.append(marks, none)[np.searchsorted(marks, offsets)]


def _printable(octets: Octets, starts: Ints, ends: Ints) -> Bools:
    """Whether all bytes of ``[start, end)`` are printable ASCII; the stretches do not overlap."""
    return np.asarray(_reduced(np.maximum, octets - np.uint8(0x20), starts, ends) <= 0x7E - 0x20)


def _reduced(ufunc: np.ufunc, octets: Octets, starts: Ints, ends: Ints) -> Octets:
    """Reduce each stretch ``[start, end)`` modulo 256, none empty; all end before the last byte."""
    if not starts.size:
        return np.zeros(0, np.uint8)
    pairs = np.stack([starts, ends], 1).reshape(-1)
    return np.asarray(ufunc.reduceat(octets, pairs, dtype=np.uint8)[::2])
