"""Frames of all protocols, made here."""

import importlib.util
import struct
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import reduce
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from spoofbench.conversion import Block, Item, Rejects, SourceMetadata, Used
from spoofbench.recording import Recording
from spoofbench.table import Table

START = datetime(2023, 5, 6, 23, 59, 50, tzinfo=UTC)
GPS_EPOCH = datetime(1980, 1, 6, tzinfo=UTC)


def _slow_scan() -> ModuleType:
    spec = importlib.util.spec_from_file_location(
        "slow_scan", Path(__file__).with_name("slow_scan.py")
    )
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

    @classmethod
    def nav_pvt(cls, time: datetime, lat_deg: float = 51.0) -> bytes:
        """A 3D fix that moves north at 2 m/s."""
        tow_ms = round(((time - GPS_EPOCH).total_seconds() + 18) * 1000) % 604_800_000
        clock = (time.year, time.month, time.day, time.hour, time.minute, time.second)
        position = (round(13e7), round(lat_deg * 1e7), 100_000, 54_000)
        fix = (0x37, 20, time.microsecond * 1000, 3, 1, 0, 12)
        payload = struct.pack(
            "<IH6BIi4B4i", tow_ms, *clock[:6], fix[0], fix[1], fix[2], *fix[3:], *position
        )
        payload += struct.pack(
            "<2I5i2IHH4xihH", 900, 1500, 2000, 0, 0, 2000, 0, 200, 10_000, 120, 0, 0, 0, 0
        )
        return cls.ubx(payload)

    @classmethod
    def esf_meas(cls, tick_ms: int, accel_mg: tuple[int, int, int] = (0, 0, 1000)) -> bytes:
        """Specific force on three axes, at a tick of the sensor's counter."""
        words = [
            kind << 24 | (round(value * 9.80665e-3 * 1024) & 0xFFFFFF)
            for kind, value in zip((16, 17, 18), accel_mg, strict=True)
        ]
        return cls.ubx(
            struct.pack(f"<IHH{len(words)}I", tick_ms, len(words) << 11, 0, *words), (0x10, 0x02)
        )

    @classmethod
    def gga(cls, time: datetime) -> bytes:
        clock = f"{time:%H%M%S}.{time.microsecond // 10_000:02d}"
        return (
            cls.sentence(
                f"GPGGA,{clock},5100.0000,N,01300.0000,E,1,10,0.9,54.0,M,46.0,M,,".encode()
            )
            + b"\r\n"
        )

    @classmethod
    def rmc(cls, time: datetime) -> bytes:
        clock = f"{time:%H%M%S}.{time.microsecond // 10_000:02d}"
        return (
            cls.sentence(
                f"GPRMC,{clock},A,5100.0000,N,01300.0000,E,3.888,0.0,{time:%d%m%y},,,A".encode()
            )
            + b"\r\n"
        )

    @classmethod
    def mixed(cls, seconds: int = 20, ticks: int = 10) -> bytes:
        """UBX and NMEA of a drive across midnight, an IMU that is sampled between epochs, and RTCM
        messages.
        """
        log = []
        for second in range(seconds):
            time = START + timedelta(seconds=second)
            log += [
                cls.nav_pvt(time, 51.0 + second * 2e-5),
                cls.rmc(time),
                cls.gga(time),
                cls.rtcm3(b"station %d" % second),
            ]
            log += [
                cls.esf_meas(7_000_000 + second * 1000 + tick * (1000 // ticks))
                for tick in range(ticks)
            ]
        return b"".join(log)


@pytest.fixture(scope="session")
def gathered() -> Any:
    """Makes a result of what a converter yields."""
    return gather


@pytest.fixture(scope="session")
def make() -> type[Make]:
    return Make


@dataclass(frozen=True)
class Result:
    """What a conversion of a log yields, rejects sorted by offset."""

    recording: Recording
    rejects: list[tuple[int, int, str]]
    used: int

    @property
    def accounted(self) -> int:
        return self.used + sum(length for _, length, _ in self.rejects)

    @property
    def reasons(self) -> Counter[str]:
        counts: Counter[str] = Counter()
        for _, length, reason in self.rejects:
            counts[reason] += length
        return counts


def gather(items: Iterable[Item]) -> Result:
    """Return what a converter yields."""
    blocks: dict[str, list[Table]] = {}
    facts: dict[str, dict[str, str]] = {}
    rejects: list[tuple[int, int, str]] = []
    used = 0
    for item in items:
        if isinstance(item, Block):
            used += item.used
            blocks.setdefault(item.topic, []).append(item.table)
        elif isinstance(item, Used):
            used += item.units
        elif isinstance(item, Rejects):
            rejects += [
                (o, n, item.reason)
                for o, n in zip(item.offsets.tolist(), item.lengths.tolist(), strict=True)
            ]
        elif isinstance(item, SourceMetadata):
            for name, record in item.metadata.items():
                facts.setdefault(name, {}).update(record)
    return Result(
        Recording({topic: Table.concat(tables) for topic, tables in blocks.items()}, facts),
        sorted(rejects),
        used,
    )
