"""Sentences and frames for tests: a slow, plain framer, and checksums."""

import gzip
import re
import sys
from collections.abc import Iterator, Sequence
from functools import reduce
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from spoofbench_converters.nmea.decoder import DecoderOptions, NmeaDecoder
from spoofbench_converters.serial.contract import ABSENT_NS, Epochs, Frames

from spoofbench.conversion import Rejects
from spoofbench.table import Column

FOLDER = Path(__file__).parents[4] / "shared" / "data" / "nmea_ubx"
_SENTENCE = re.compile(rb"[$!][^$!\r\n*]{3,200}\*([0-9A-Fa-f]{2})")


@pytest.fixture(scope="session")
def nmea() -> ModuleType:
    """This module."""
    return sys.modules[__name__]


def real_logs() -> dict[str, Path]:
    """Real logs with at least one valid sentence, by name; none where they are not beside the
    project.
    """
    paths = sorted(FOLDER.glob("*")) if FOLDER.is_dir() else []
    logs = [
        path
        for path in paths
        if path.suffix not in (".chk", ".csv", ".pos") and not path.name.endswith(".csv.gz")
    ]
    return {path.name: path for path in logs if frames(content(path)).starts.size}


def content(path: Path) -> bytes:
    octets = path.read_bytes()
    return gzip.decompress(octets) if path.suffix == ".gz" else octets


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "real_log" in metafunc.fixturenames:
        logs = real_logs()
        absent = pytest.param(
            None, marks=pytest.mark.skip(reason="the real logs are not beside the project")
        )
        metafunc.parametrize(
            "real_log", list(logs.values()) or [absent], ids=list(logs) or ["absent"]
        )


def checksum(body: str) -> str:
    return f"{reduce(lambda a, b: a ^ b, body.encode(), 0):02X}"


def sentence(body: str) -> bytes:
    """A line of a log: ``GPGGA,...`` with ``$``, checksum and line end."""
    return f"${body}*{checksum(body)}\r\n".encode()


def log(*bodies: str) -> bytes:
    return b"".join(sentence(body) for body in bodies)


def frames(octets: bytes, base: int = 0, stamps: Sequence[int] | None = None) -> Frames:
    """The valid sentences of a piece, each with its line end."""
    found = [
        match
        for match in _SENTENCE.finditer(octets)
        if int(match[1], 16) == reduce(lambda a, b: a ^ b, match[0][1:-3])
    ]
    starts = np.array([match.start() for match in found], np.int64)
    lengths = np.array([len(match[0]) for match in found], np.int64)
    used = np.array(
        [len(match[0]) + 2 * octets.startswith(b"\r\n", match.end()) for match in found], np.int64
    )
    received = np.full(starts.size, ABSENT_NS) if stamps is None else np.array(stamps, np.int64)
    return Frames(np.frombuffer(octets, np.uint8), starts, lengths, base, used, received)


def pieces(octets: bytes, cuts: Sequence[int]) -> Iterator[Frames]:
    """The same sentences cut into pieces at or after these offsets, where lines end."""
    begin = 0
    for cut in [*sorted(cuts), len(octets)]:
        end = octets.find(b"\n", max(cut - 1, begin)) + 1 or len(octets)
        if end > begin:
            yield frames(octets[begin:end], begin)
            begin = end


def decode(
    parts: Sequence[Frames], source: str | None = None
) -> tuple[list[Epochs], list[Rejects], NmeaDecoder]:
    decoder = NmeaDecoder(DecoderOptions(source))
    found: list[Any] = [item for part in parts for item in decoder.push(part)] + list(
        decoder.finish()
    )
    return (
        [item for item in found if isinstance(item, Epochs)],
        [item for item in found if isinstance(item, Rejects)],
        decoder,
    )


def values(column: Column) -> list[Any]:
    """A column as a list, None where absent."""
    if column.categories is not None:
        return [None if code < 0 else column.categories[code] for code in column.values.tolist()]
    valid = np.ones(column.values.size, bool) if column.valid is None else column.valid
    return [
        value if there and value == value else None
        for value, there in zip(column.values.tolist(), valid.tolist(), strict=True)
    ]


def rows(epochs: Sequence[Epochs], source: str, kind: str) -> list[dict[str, Any]]:
    """All rows of a source and kind: their values, ``epoch`` over all, ``offset_ns`` and what the
    epoch claims.
    """
    found, before = [], 0
    for part in epochs:
        for table in part.rows:
            if (table.source, table.kind) == (source, kind):
                columns = {name: values(column) for name, column in table.columns.items()}
                for place, epoch in enumerate(table.epoch.tolist()):
                    row = {name: column[place] for name, column in columns.items()}
                    row["epoch"] = before + epoch
                    row["claimed_ns"], row["period_ns"] = (
                        int(part.claimed_ns[epoch]),
                        int(part.period_ns[epoch]),
                    )
                    row["offset_ns"] = 0 if table.offset_ns is None else int(table.offset_ns[place])
                    found.append(row)
        before += part.offset.size
    return found
