"""Frames of all protocols, made here."""

import importlib.util
from functools import reduce
from pathlib import Path
from types import ModuleType

import pytest


def _slow_scan() -> ModuleType:
    spec = importlib.util.spec_from_file_location("slow_scan", Path(__file__).with_name("slow_scan.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


SLOW = _slow_scan()


@pytest.fixture(scope="session")
def slow() -> ModuleType:
    """The demultiplexer's rule, byte by byte."""
    return SLOW


class Make:
    """Valid frames."""

    @staticmethod
    def ubx(payload: bytes, message: tuple[int, int] = (0x01, 0x07)) -> bytes:
        body = bytes(message) + len(payload).to_bytes(2, "little") + payload
        a = b = 0
        for byte in body:
            a = (a + byte) % 256
            b = (b + a) % 256
        return b"\xb5\x62" + body + bytes([a, b])

    @staticmethod
    def sentence(body: bytes, start: bytes = b"$") -> bytes:
        return start + body + b"*%02X" % reduce(int.__xor__, body)

    @staticmethod
    def rtcm3(payload: bytes) -> bytes:
        message = b"\xd3" + len(payload).to_bytes(2, "big") + payload
        return message + int(SLOW.crc24q(message)).to_bytes(3, "big")


@pytest.fixture(scope="session")
def make() -> type[Make]:
    return Make
