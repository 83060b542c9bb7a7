"""Mutations of logs: blind ones, and ones that keep a format's checksums right so that they reach
what lies behind.
"""

import io
import re
import struct
import zipfile
from collections.abc import Callable, Sequence
from functools import reduce

import numpy as np

from benchmarks.fuzz.reference import frames

MOST_BYTES = 2**19
"""Longest input that is made."""

_NUMBERS = (
    0,
    1,
    0x7F,
    0x80,
    0xFF,
    0x7FFF,
    0x8000,
    0xFFFF,
    0x7FFFFFFF,
    0x80000000,
    0xFFFFFFFF,
    2**63 - 1,
    2**63,
    2**64 - 1,
)
_WIDTHS = "BHIQ"

TOKENS: dict[str, Sequence[bytes]] = {
    "nmea": (
        b"$",
        b"!",
        b"*",
        b",",
        b"\r\n",
        b"$GPRMC,",
        b"$GNGGA,",
        b"$GPGSV,3,1,11,",
        b"*00",
        b"$$",
        b"240000",
        b"235960.99",
        b"311299",
        b"NaN",
        b"NMEA,",
        b"\\c:1234567890*hh\\",
        b"-0",
        b"9" * 40,
        b"1e308",
        b".",
        b"99999999999",
        b"\xb5\x62",
        b"\xd3\x00",
    ),
    "ubx": (
        b"\xb5\x62",
        b"\xb5\x62\x01\x07\x5c\x00",
        b"\xb5\x62\x01\x35\xff\xff",
        b"\xb5\x62\x02\x15",
        b"\xb5\x62\x10\x02",
        b"\xff\xff",
        b"\xd3\x00",
        b"\xd3\x03\xff",
        b"$GNRMC,",
        b"\x00" * 16,
        b"\xff" * 16,
    ),
    "phone": (
        b"Raw,",
        b"Fix,",
        b"Nav,",
        b"UncalAccel,",
        b"# ",
        b"# Raw,",
        b"\n",
        b"\r\n",
        b",",
        b'"',
        b'"\n',
        b"\x00",
        b"NaN",
        b"inf",
        b"-",
        b"1e400",
        b"9223372036854775807",
        b"-9223372036854775808",
        b"1676559153000",
        b";",
        b"\xef\xbb\xbf",
        b"time,seconds_elapsed,z,y,x\n",
    ),
    "table": (
        b",",
        b";",
        b"\t",
        b"\n",
        b"\r",
        b'"',
        b'""',
        b'"\n"',
        b"\x00",
        b"NaN",
        b"inf",
        b"1e999",
        b"-",
        b"9" * 400,
        b"\xff\xfe",
        b"\xef\xbb\xbf",
        b"#",
    ),
    "rosbag": (
        b"#ROSBAG V2.0\n",
        b"\x89MCAP0\r\n",
        b"SQLite format 3\x00",
        b"sensor_msgs/msg/Imu",
        b"std_msgs/Header",
        b"op=\x02",
        b"op=\x05",
        b"\xff" * 8,
    ),
    "mcap": (
        b"\x89MCAP0\r\n",
        b"\x06",
        b"\x05",
        b"\x02",
        b"\x0f",
        b"zstd",
        b"lz4",
        b"\xff" * 8,
        b"\x00" * 8,
        b"protobuf",
        b"log_time",
    ),
}

Mutation = Callable[[np.random.Generator, bytes, Sequence[bytes], Sequence[bytes]], bytes]


def mutate(
    rng: np.random.Generator, log: bytes, others: Sequence[bytes], tokens: Sequence[bytes]
) -> bytes:
    """Return a log after one to eight mutations; ``others`` are what may be spliced in."""
    if log.startswith(b"PK\x03\x04") and rng.random() < 0.9:
        return _within_archive(rng, log, others, tokens)
    for _ in range(1 << int(rng.integers(4))):
        chosen = _MUTATIONS[int(rng.integers(len(_MUTATIONS)))]
        log = chosen(rng, log, others, tokens)[:MOST_BYTES]
    return log


def _span(rng: np.random.Generator, log: bytes) -> tuple[int, int]:
    """Draw a part of a log, short ones more often."""
    start = int(rng.integers(len(log) + 1))
    return start, min(len(log), start + (1 << int(rng.integers(14))) - int(rng.integers(2)))


def _flip(rng: np.random.Generator, log: bytes, _: Sequence[bytes], __: Sequence[bytes]) -> bytes:
    changed = bytearray(log)
    for place in (
        rng.integers(max(len(log), 1), size=int(rng.integers(1, 9))).tolist() if log else ()
    ):
        changed[place] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def _write_number(
    rng: np.random.Generator, log: bytes, _: Sequence[bytes], __: Sequence[bytes]
) -> bytes:
    """Write what a length may be taken for."""
    width = _WIDTHS[int(rng.integers(4))]
    size = struct.calcsize(width)
    number = _NUMBERS[int(rng.integers(len(_NUMBERS)))] % (1 << 8 * size)
    place = int(rng.integers(max(len(log) - size, 0) + 1))
    return (
        log[:place] + struct.pack("<>"[int(rng.integers(2))] + width, number) + log[place + size :]
    )


def _cut(rng: np.random.Generator, log: bytes, _: Sequence[bytes], __: Sequence[bytes]) -> bytes:
    return log[: int(rng.integers(len(log) + 1))]


def _remove(rng: np.random.Generator, log: bytes, _: Sequence[bytes], __: Sequence[bytes]) -> bytes:
    start, end = _span(rng, log)
    return log[:start] + log[end:]


def _repeat(rng: np.random.Generator, log: bytes, _: Sequence[bytes], __: Sequence[bytes]) -> bytes:
    start, end = _span(rng, log)
    return log[:end] + log[start:end] * (1 << int(rng.integers(6))) + log[end:]


def _move(rng: np.random.Generator, log: bytes, _: Sequence[bytes], __: Sequence[bytes]) -> bytes:
    (start, end), place = _span(rng, log), int(rng.integers(len(log) + 1))
    return log[:place] + log[start:end] + log[place:]


def _splice(
    rng: np.random.Generator, log: bytes, others: Sequence[bytes], __: Sequence[bytes]
) -> bytes:
    other = others[int(rng.integers(len(others)))]
    (start, end), place = _span(rng, other), int(rng.integers(len(log) + 1))
    return log[:place] + other[start:end] + log[place + int(rng.integers(2)) * (end - start) :]


def _insert_token(
    rng: np.random.Generator, log: bytes, _: Sequence[bytes], tokens: Sequence[bytes]
) -> bytes:
    token, place = tokens[int(rng.integers(len(tokens)))], int(rng.integers(len(log) + 1))
    return log[:place] + token + log[place + int(rng.integers(2)) * len(token) :]


def _insert_noise(
    rng: np.random.Generator, log: bytes, _: Sequence[bytes], __: Sequence[bytes]
) -> bytes:
    place = int(rng.integers(len(log) + 1))
    return log[:place] + rng.bytes(1 << int(rng.integers(12))) + log[place:]


def _change_field(
    rng: np.random.Generator, log: bytes, _: Sequence[bytes], tokens: Sequence[bytes]
) -> bytes:
    """Exchange some comma-separated fields."""
    parts = re.split(rb"(,)", log)
    for place in rng.integers(len(parts), size=4).tolist():
        if parts[place] != b",":
            pool = (
                *tokens,
                b"",
                parts[int(rng.integers(len(parts)))],
                parts[place] * 2,
                b"-" + parts[place],
            )
            parts[place] = pool[int(rng.integers(len(pool)))]
    return b"".join(parts)


def _change_frames(
    rng: np.random.Generator, log: bytes, others: Sequence[bytes], tokens: Sequence[bytes]
) -> bytes:
    """Change the inside of some frames and put their checksums right."""
    window = int(rng.integers(max(len(log) - 20_000, 0) + 1))
    found = list(frames(log[window : window + 20_000]))
    inner = (_flip, _write_number, _change_field, _insert_token, _remove)
    for place in (
        sorted({int(rng.integers(len(found))) for _ in range(4)}, reverse=True) if found else ()
    ):
        frame = found[place]
        start = window + frame.start
        raw = log[start : start + frame.length]
        change = inner[int(rng.integers(len(inner)))]
        if frame.protocol == "ubx":
            raw = ubx(raw[2:4], change(rng, raw[6:-2], others, tokens)[:60_000])
        elif frame.protocol == "nmea":
            raw = sentence(change(rng, raw[1:-3], others, tokens)[:1000])
        log = log[:start] + raw + log[start + frame.length :]
    return log


def ubx(kind: bytes, payload: bytes) -> bytes:
    """Return a UBX frame of a class and id."""
    body = kind + len(payload).to_bytes(2, "little") + payload
    a = b = 0
    for octet in body:
        a = (a + octet) & 255
        b = (b + a) & 255
    return b"\xb5\x62" + body + bytes([a, b])


def sentence(body: bytes) -> bytes:
    """Return a sentence with its checksum."""
    return b"$" + body + b"*%02X" % reduce(lambda a, b: a ^ b, body, 0)


def _within_archive(
    rng: np.random.Generator, log: bytes, others: Sequence[bytes], tokens: Sequence[bytes]
) -> bytes:
    """Mutate a file in a zip archive, and pack it again."""
    out = io.BytesIO()
    try:
        with (
            zipfile.ZipFile(io.BytesIO(log)) as archive,
            zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as packed,
        ):
            infos = archive.infolist()
            chosen = int(rng.integers(len(infos))) if infos else 0
            for place, info in enumerate(infos):
                octets = archive.read(info)
                packed.writestr(
                    info.filename,
                    mutate(rng, octets, others, tokens) if place == chosen else octets,
                )
    except (zipfile.BadZipFile, OSError, NotImplementedError, ValueError, RuntimeError):
        return _flip(rng, log, others, tokens)
    return out.getvalue()


_BLIND: tuple[Mutation, ...] = (
    _flip,
    _write_number,
    _cut,
    _remove,
    _repeat,
    _move,
    _splice,
    _insert_token,
    _insert_noise,
)
_MUTATIONS: tuple[Mutation, ...] = (*_BLIND, *[_change_field] * 2, *[_change_frames] * 3)
