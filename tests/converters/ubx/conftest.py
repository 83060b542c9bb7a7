"""UBX frames made for tests, and what the decoder makes of frames."""

import gzip
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from spoofbench_converters.serial.contract import ABSENT_NS, EpochRows, Epochs, Frames
from spoofbench_converters.ubx.decoder import UbxDecoder
from spoofbench_converters.ubx.messages import MESSAGES, NUMBER, offset_in
from spoofbench_converters.ubx.names import key_of

from spoofbench.table import Table

LOGS = Path(__file__).parents[4] / "shared" / "data" / "nmea_ubx"


@dataclass
class Decoded:
    """All that a decoder gave: columns of epochs, tables and the epoch of each row by topic, bytes
    rejected by reason.
    """

    offset: NDArray[np.int64]
    claimed_ns: NDArray[np.int64]
    period_ns: NDArray[np.int64]
    receive_time_ns: NDArray[np.int64]
    used: int
    tables: dict[str, Table]
    epoch: dict[str, NDArray[np.int64]]
    offset_ns: dict[str, NDArray[np.int64]]
    tick_ns: dict[str, NDArray[np.int64]]
    rejected: Counter[str]
    about: dict[str, dict[str, str]]

    def same(self, other: "Decoded") -> bool:
        """Whether all is equal."""
        arrays = ("offset", "claimed_ns", "period_ns", "receive_time_ns")
        by_topic = ("epoch", "offset_ns", "tick_ns")
        return (
            all(np.array_equal(getattr(self, name), getattr(other, name)) for name in arrays)
            and (self.used, self.tables, self.rejected, self.about)
            == (other.used, other.tables, other.rejected, other.about)
            and all(
                getattr(self, name).keys() == getattr(other, name).keys()
                and all(
                    np.array_equal(values, getattr(other, name)[topic])
                    for topic, values in getattr(self, name).items()
                )
                for name in by_topic
            )
        )


def frame(name: str, payload: bytes) -> bytes:
    """Return one frame with its checksum."""
    body = key_of(name).to_bytes(2, "big") + len(payload).to_bytes(2, "little") + payload
    a = b = 0
    for octet in body:
        a = (a + octet) & 255
        b = (b + a) & 255
    return b"\xb5\x62" + body + bytes((a, b))


def payload(name: str, blocks: Sequence[dict[str, Any]] = (), **fields: Any) -> bytes:
    """Return a message's payload with these fields and blocks; all else is 0, the number of blocks
    is told.
    """
    message = MESSAGES[NUMBER[name]]
    head = np.zeros(1, message.head)
    for field_name, value in fields.items():
        head[field_name] = value
    octets = bytearray(head.tobytes())
    if message.count:
        octets[offset_in(message.head, message.count)] = len(blocks)
    for values in blocks:
        block = np.zeros(1, message.block)
        for field_name, value in values.items():
            block[field_name] = value
        octets += block.tobytes()
    return bytes(octets)


def message(name: str, blocks: Sequence[dict[str, Any]] = (), **fields: Any) -> bytes:
    """Return a frame of these fields and blocks."""
    return frame(name, payload(name, blocks, **fields))


def split(octets: bytes) -> list[bytes]:
    """Return the valid frames of a log, found one by one."""
    found, start = [], 0
    while (start := octets.find(b"\xb5\x62", start)) >= 0 and start + 8 <= len(octets):
        end = start + 8 + int.from_bytes(octets[start + 4 : start + 6], "little")
        if end <= len(octets) and octets[start:end] == _with_checksum(octets[start : end - 2]):
            found.append(octets[start:end])
            start = end
        else:
            start += 1
    return found


def _with_checksum(start: bytes) -> bytes:
    body = np.frombuffer(start, np.uint8)[2:].astype(np.int64)
    return start + bytes((int(body.sum()) & 255, int(np.cumsum(body).sum()) & 255))


def decode(
    frames: Sequence[bytes], cuts: Sequence[int] = (), received: Sequence[int] | None = None
) -> Decoded:
    """Decode frames in the pieces that end before the frames numbered ``cuts``; between frames lies
    one byte of noise.
    """
    decoder = UbxDecoder()
    given: list[Any] = []
    base = 0
    for start, end in zip([0, *cuts], [*cuts, len(frames)], strict=True):
        octets = b"".join(b"\x00" + one for one in frames[start:end])
        lengths = np.array([len(one) for one in frames[start:end]], np.int64)
        starts = np.cumsum(lengths + 1) - lengths
        times = (
            np.full(end - start, ABSENT_NS)
            if received is None
            else np.array(received[start:end], np.int64)
        )
        given += decoder.push(
            Frames(np.frombuffer(octets, np.uint8), starts, lengths, base, lengths, times)
        )
        base += len(octets)
    given += decoder.finish()
    return _gather(given, decoder)


@dataclass
class _Gathered:
    parts: dict[str, list[Any]] = field(default_factory=dict)

    def add(self, topic: str, value: Any) -> None:
        self.parts.setdefault(topic, []).append(value)

    def joined(self) -> dict[str, NDArray[np.int64]]:
        return {topic: np.concatenate(parts) for topic, parts in self.parts.items()}


def _gather(given: list[Any], decoder: UbxDecoder) -> Decoded:
    epochs = [one for one in given if isinstance(one, Epochs)]
    rejected: Counter[str] = Counter()
    for one in given:
        if not isinstance(one, Epochs):
            rejected[one.reason] += int(one.lengths.sum())
    rows, epoch, offsets, ticks = _Gathered(), _Gathered(), _Gathered(), _Gathered()
    before = 0
    for one in epochs:
        for table in one.rows:
            topic = f"/{table.source}/{table.kind}"
            rows.add(topic, table)
            epoch.add(topic, table.epoch + before)
            offsets.add(
                topic,
                np.zeros(table.epoch.size, np.int64)
                if table.offset_ns is None
                else table.offset_ns,
            )
            if table.tick_ns is not None:
                ticks.add(topic, table.tick_ns)
        before += one.offset.size
    whole = {
        name: _joined([getattr(one, name) for one in epochs])
        for name in ("offset", "claimed_ns", "period_ns", "receive_time_ns")
    }
    tables = {topic: _table(parts) for topic, parts in rows.parts.items()}
    used = sum(int(one.used.sum()) for one in epochs)
    about = {source: dict(told) for source, told in decoder.about().items()}
    return Decoded(
        **whole,
        used=used,
        tables=tables,
        epoch=epoch.joined(),
        offset_ns=offsets.joined(),
        tick_ns=ticks.joined(),
        rejected=rejected,
        about=about,
    )


def _joined(parts: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    return np.concatenate(parts) if parts else np.zeros(0, np.int64)


def _table(parts: list[EpochRows]) -> Table:
    """Join the rows of one topic, without times."""
    return Table.concat(
        [Table(part.kind, np.zeros(part.epoch.size, np.int64), part.columns) for part in parts]
    )


@pytest.fixture(scope="session")
def ubx() -> SimpleNamespace:
    """The functions of this module."""
    return SimpleNamespace(frame=frame, payload=payload, message=message, decode=decode)


@pytest.fixture(scope="session")
def real_logs() -> dict[str, list[bytes]]:
    """The frames of each log in ``../shared/data`` that has any."""
    if not LOGS.is_dir():
        pytest.skip(f"no logs in {LOGS.name}: they are not part of the project")
    return dict(_read_logs())


def _read_logs() -> Iterator[tuple[str, list[bytes]]]:
    for path in sorted(LOGS.iterdir()):
        if path.suffix in (".chk", ".csv", ".pos"):
            continue
        octets = path.read_bytes()
        frames = split(gzip.decompress(octets) if path.suffix == ".gz" else octets)
        if frames:
            yield path.name, frames
