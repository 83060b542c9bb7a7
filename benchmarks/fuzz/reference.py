"""A slow reading of streams of UBX, NMEA and RTCM 3, one byte after the other: what the
demultiplexer must find.

Written from the specifications alone: u-blox interface descriptions ("UBX frame structure", "UBX
checksum"), NMEA 0183 (IEC 61162-1, section 7) and RTCM 10403.3 (section 4, transport layer). It
shares nothing with the demultiplexer.
"""

import re
from collections import Counter
from collections.abc import Iterator
from functools import reduce
from typing import Literal, NamedTuple

Protocol = Literal["ubx", "nmea", "rtcm3"]

_STARTS = re.compile(rb"\xb5\x62|[$!]|\xd3[\x00-\x03]")
_SENTENCE = re.compile(rb"[$!][A-Z][^$!*\x00-\x1f\x7f-\xff]*\*([0-9A-Fa-f]{2})")
_CRC24Q = 0x1864CFB


class Frame(NamedTuple):
    """A valid frame: its protocol, where it starts, and its length."""

    protocol: Protocol
    start: int
    length: int


def frames(log: bytes, max_ubx: int = 65_535, max_nmea: int = 1024) -> Iterator[Frame]:
    """Yield the frames of a log: at each byte from left to right the first valid one wins, else
    one byte is skipped.

    Args:
        max_ubx: longest payload of a UBX frame.
        max_nmea: longest sentence, from its first byte to before the ``*``.
    """
    index = 0
    while found := _STARTS.search(log, index):
        index = found.start()
        lead = log[index]
        if lead == 0xB5:
            protocol, length = "ubx", _ubx_length(log, index, max_ubx)
        elif lead == 0xD3:
            protocol, length = "rtcm3", _rtcm3_length(log, index)
        else:
            protocol, length = "nmea", _nmea_length(log, index, max_nmea)
        if length:
            yield Frame(protocol, index, length)  # type: ignore[arg-type]
        index += length or 1


def _ubx_length(log: bytes, index: int, limit: int) -> int:
    size = int.from_bytes(log[index + 4 : index + 6], "little")
    if size > limit or index + 8 + size > len(log):
        return 0
    a = b = 0
    for octet in log[index + 2 : index + 6 + size]:
        a = (a + octet) & 255
        b = (b + a) & 255
    return 8 + size if log[index + 6 + size : index + 8 + size] == bytes([a, b]) else 0


def _nmea_length(log: bytes, index: int, limit: int) -> int:
    found = _SENTENCE.match(log, index)
    if found is None or found.start(1) - 1 - index > limit:
        return 0
    body = log[index + 1 : found.start(1) - 1]
    return len(found[0]) if reduce(lambda a, b: a ^ b, body, 0) == int(found[1], 16) else 0


def _rtcm3_length(log: bytes, index: int) -> int:
    size = int.from_bytes(log[index + 1 : index + 3], "big")
    end = index + 6 + size
    if end > len(log):
        return 0
    crc = 0
    for octet in log[index : end - 3]:
        crc ^= octet << 16
        for _ in range(8):
            crc <<= 1
            if crc & 0x1000000:
                crc ^= _CRC24Q
    return 6 + size if crc == int.from_bytes(log[end - 3 : end], "big") else 0


def types(log: bytes, found: Iterator[Frame]) -> Counter[str]:
    """Count frames by type: ``UBX 01-07``, ``NMEA GNGGA``, ``RTCM3 1077``."""
    counts: Counter[str] = Counter()
    for protocol, start, length in found:
        if protocol == "ubx":
            name = f"UBX {log[start + 2]:02X}-{log[start + 3]:02X}"
        elif protocol == "rtcm3":
            name = f"RTCM3 {int.from_bytes(log[start + 3 : start + 5], 'big') >> 4}"
        else:
            name = "NMEA " + re.split(rb"[,*]", log[start + 1 : start + length], maxsplit=1)[
                0
            ].decode("ascii")
        counts[name] += 1
    return counts
