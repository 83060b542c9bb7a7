"""The demultiplexer's rule, byte by byte."""

from functools import reduce

MAX_SENTENCE = 1024


def scan(log: bytes, checksum: str = "required") -> list[tuple[str, int, int]]:
    """Return protocol, start and end of each frame, from left to right."""
    found, place = [], 0
    while place < len(log):
        for protocol, length in (
            ("ubx", ubx(log, place)),
            ("nmea", sentence(log, place, checksum)),
            ("rtcm", rtcm3(log, place)),
        ):
            if length:
                found.append((protocol, place, place + length))
                place += length
                break
        else:
            place += 1
    return found


def ubx(log: bytes, start: int) -> int:
    """Length of the valid UBX frame that starts here, else 0."""
    if log[start : start + 2] != b"\xb5\x62" or start + 8 > len(log):
        return 0
    length = int.from_bytes(log[start + 4 : start + 6], "little")
    if start + length + 8 > len(log):
        return 0
    a = b = 0
    for byte in log[start + 2 : start + 6 + length]:
        a = (a + byte) % 256
        b = (b + a) % 256
    return length + 8 if log[start + 6 + length : start + 8 + length] == bytes([a, b]) else 0


def sentence(log: bytes, start: int, checksum: str) -> int:
    """Length of the valid sentence that starts here, else 0."""
    if log[start] not in b"$!" or not (b"A" <= log[start + 1 : start + 2] <= b"Z"):
        return 0
    end = start + 1
    while (
        end < len(log)
        and end - start < MAX_SENTENCE
        and 0x20 <= log[end] <= 0x7E
        and log[end] not in b"$!*"
    ):
        end += 1
    if end == len(log) or end - start >= MAX_SENTENCE:
        return 0
    if log[end] in b"\r\n":
        return 0 if checksum == "required" else end - start
    told = log[end + 1 : end + 3]
    if (
        log[end] != ord("*")
        or len(told) < 2
        or any(digit not in b"0123456789abcdefABCDEF" for digit in told)
    ):
        return 0
    agrees = int(told, 16) == reduce(int.__xor__, log[start + 1 : end])
    return end + 3 - start if agrees or checksum == "ignored" else 0


def rtcm3(log: bytes, start: int) -> int:
    """Length of the valid RTCM 3 message that starts here, else 0."""
    if log[start] != 0xD3 or start + 6 > len(log) or log[start + 1] > 3:
        return 0
    length = log[start + 1] * 256 + log[start + 2] + 6
    if start + length > len(log):
        return 0
    return 0 if crc24q(log[start : start + length]) else length


def crc24q(message: bytes) -> int:
    crc = 0
    for byte in message:
        crc ^= byte << 16
        for _ in range(8):
            crc = (crc << 1) ^ (0x1864CFB if crc & 0x800000 else 0)
    return crc
