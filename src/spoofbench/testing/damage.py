"""What the checks of converters do to logs: cuts, damage, garbage, strangers and length."""

import json
import shutil
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

_MIB = 2**20
_SHORT_BYTES, _LONG_BYTES = 16 * _MIB, 80 * _MIB
_CUTS, _PLACES = 6, 2


def _noise(seed: int, size: int) -> bytes:
    return np.random.default_rng(seed).bytes(size)


GARBAGE = _noise(1, 3000) + b"\n" + b"not of any format \xff\xfe" * 40 + b"\n"

STRANGERS: tuple[bytes, ...] = (
    b"",
    b"\n",
    bytes(4096),
    _noise(2, 4096),
    _noise(3, 70_000),
    b"Dear Sir, the goods of the 4th have arrived, but two of the seven boxes were wet.\r\n" * 60,
    b"<!doctype html><html><head><title>404</title></head><body>not found</body></html>\n",
    json.dumps({"settings": {"volume": 11}, "names": ["a", "b"]}).encode(),
    b"\x89PNG\r\n\x1a\n" + _noise(4, 2000),
    b"%PDF-1.7\n" + _noise(5, 2000),
    b"\x7fELF" + _noise(6, 2000),
    b"\x1f\x8b\x08\x00" + _noise(7, 200),  # claims to be gzip and is not
    b"PK\x03\x04" + _noise(8, 2000),  # claims to be zip and is not
    zlib.compress(b"nothing of interest " * 400),
)
"""Logs of nobody's format."""


def cuts(size: int) -> list[int]:
    """Return where a log of this size is cut: a few bytes in, at random, and just before the
    end.
    """
    drawn = np.random.default_rng(9).integers(size // 3, size, _CUTS).tolist() if size >= 3 else []
    return sorted(
        {at for at in (0, 1, 16, size // 20, *drawn, size - 2, size - 1) if 0 <= at < size}
    )


def damages(log: bytes) -> Iterator[tuple[str, int, bytes]]:
    """Yield ``(what, where, damaged log)``, in the second and third quarter of the log."""
    rng = np.random.default_rng(10)
    if len(log) < 8:
        return
    for _ in range(_PLACES):
        at = int(rng.integers(len(log) // 4, 3 * len(log) // 4))
        head, tail = log[:at], log[at:]
        yield "a bit flipped", at, head + bytes([tail[0] ^ 1 << int(rng.integers(8))]) + tail[1:]
        yield "16 bytes overwritten", at, head + rng.bytes(16) + tail[16:]
        yield "200 bytes removed", at, head + tail[200:]
        yield "a byte removed", at, head + tail[1:]
        yield "200 bytes inserted", at, head + rng.bytes(200) + tail
        yield "70,000 zeros inserted", at, head + bytes(70_000) + tail
        yield "a line end inserted", at, head + b"\n" + tail


def long_logs(log: bytes, folder: Path) -> Iterator[tuple[str, Path, Path]]:
    """Yield ``(what, short, long)``: paths of a log made 16 MiB and 80 MiB long."""
    for what, beginning, filling in (
        ("repeated", b"", log),
        ("followed by its last byte without end", log[:_MIB], log[-1:] * 4096),
        ("followed by its first byte without end", log[:_MIB], log[:1] * 4096),
    ):
        paths: list[Path] = []
        for size in (_SHORT_BYTES, _LONG_BYTES):
            path = folder / f"{len(paths)}"
            _fill(path, beginning, filling, size)
            paths.append(path)
        yield what, paths[0], paths[1]


def _fill(path: Path, beginning: bytes, filling: bytes, size: int) -> None:
    piece = filling * max(1, _MIB // len(filling))
    with path.open("wb") as file:
        left = size - file.write(beginning[:size])
        while left > 0:
            left -= file.write(piece[:left])


def damaged_logs(path: Path) -> Iterator[tuple[str, bytes]]:
    """Yield ``(what, log)``: a log damaged, cut, and between garbage."""
    log = path.read_bytes()
    yield from ((f"{what} at {at:,}", damaged) for what, at, damaged in damages(log))
    yield from ((f"all after {at:,} bytes cut off", log[:at]) for at in cuts(len(log)))
    yield "garbage before and behind", GARBAGE + log + GARBAGE


def beginnings(path: Path) -> Iterator[bytes]:
    """Yield the first bytes of a file, and the damaged beginning."""
    if path.is_file():
        log = path.read_bytes()[:65_536]
        yield from (log[:at] for at in (1, 3, 7, 20, 100, 1000))
        yield from (damaged for _, _, damaged in damages(log))


@contextmanager
def scratch() -> Iterator[Path]:
    """Provide a folder for a while."""
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


def copy_log(path: Path, place: Path) -> Path:
    """Copy a file or folder and return where it lies."""
    place.parent.mkdir(exist_ok=True)
    if path.is_dir():
        shutil.copytree(path, place)
    else:
        shutil.copyfile(path, place)
    return place
