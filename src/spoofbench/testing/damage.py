"""What every converter must keep of a damaged or a long log, and the damage that is done to it."""

import json
import shutil
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from spoofbench.table import Table
from spoofbench.testing.converter_cases import ConverterOutcome, ConverterUnderTest
from spoofbench.testing.isolation import convert_alone
from spoofbench.testing.kit import require

HELD_S = 10.0
"""How long a converter may hold rows: so much before damage or a log's end may differ."""
SHARE = 0.5
"""Least share of the rows to be expected by bytes that a cut log must give."""
AFTER_SHARE = 0.9
"""Least share of the rows beyond damage that must be there."""
MEMORY_SHARE = 0.5
"""Most of what a log is longer than another that memory may grow by."""

_MIB = 2**20
_SHORT_BYTES, _LONG_BYTES = 16 * _MIB, 80 * _MIB
_CUTS, _PLACES = 6, 2


def keeps_what_stands_before_a_cut(subject: ConverterUnderTest) -> None:
    """A log cut at any byte gives the rows of the whole, but for the last :data:`HELD_S`, and its
    share of them.

    The share is :data:`SHARE` of what the bytes that are left make one expect. A log cut within its
    first third may be refused.
    """
    for path, log, whole in subject.streams() if subject.streamed else ():
        for at in cuts(len(log)):
            cut = subject.convert_bytes(path.name, log[:at])
            what = f"{path.name!r} cut to {at:,} of {len(log):,} bytes"
            require(cut.error is None or 3 * at < len(log), f"{what} is refused: {cut.error}")
            if cut.error is None:
                _require_before(whole, cut, cut.latest_ns, what)
                least = SHARE * whole.rows * (at / len(log) - 1 / 3)
                require(cut.rows >= least, f"{what} gives {cut.rows} rows of {whole.rows}")


def _require_before(
    whole: ConverterOutcome, damaged: ConverterOutcome, latest_ns: int | None, what: str
) -> None:
    if latest_ns is None:
        return
    sure_ns = latest_ns - int(HELD_S * 1e9)
    for topic in sorted({*whole.tables, *damaged.tables}):
        rows, given = (found.tables.get(topic) for found in (whole, damaged))
        before = None if rows is None else rows.until(sure_ns)
        kept = None if given is None else given.until(sure_ns)
        count = [0 if table is None else len(table) for table in (before, kept)]
        require(
            count[0] == count[1],
            f"{what} gives {count[1]} rows of {topic} up to {sure_ns}, the whole log {count[0]}",
        )
        if before is not None and kept is not None and count[0]:
            require(
                before == kept,
                f"{what} gives other rows of {topic} up to {sure_ns}: {_difference(before, kept)}",
            )


def _difference(one: Table, other: Table) -> str:
    if not np.array_equal(one.time_ns, other.time_ns):
        row = int(np.argmax(one.time_ns != other.time_ns))
        return f"row {row} is of time {int(other.time_ns[row])}, not {int(one.time_ns[row])}"
    names = [
        name
        for name in one.kind.fields
        if Table(one.kind.name, one.time_ns, {name: one.column(name)})
        != other.replace(**dict.fromkeys(set(other) - {name}))
    ]
    return f"{names} differ"


def keeps_what_stands_around_damage(subject: ConverterUnderTest) -> None:
    """Flipped, inserted or removed bytes leave the rows of the whole before them, and
    :data:`AFTER_SHARE` of those after.
    """
    for path, log, whole in subject.streams() if subject.streamed else ():
        for what, at, damaged in damages(log):
            found = subject.convert_bytes(path.name, damaged)
            what = f"{path.name!r} with {what} at {at:,}"
            require(found.error is None, f"{what} is refused: {found.error}")
            latest = subject.convert_bytes(path.name, log[:at]).latest_ns
            _require_before(whole, found, latest, what)
            if latest is not None:
                after_ns = latest + int(HELD_S * 1e9)
                expected, given = (
                    sum(int((t.time_ns > after_ns).sum()) for t in o.tables.values())
                    for o in (whole, found)
                )
                require(
                    given >= AFTER_SHARE * expected,
                    f"{what} gives {given} of {expected} rows after it",
                )


def survives_garbage(subject: ConverterUnderTest) -> None:
    """Garbage behind a log costs no row; before it, none where the log is still recognised."""
    for path, log, whole in subject.streams() if subject.streamed else ():
        behind = subject.convert_bytes(path.name, log + GARBAGE)
        require(
            behind.error is None, f"{path.name!r} with garbage behind it is refused: {behind.error}"
        )
        require(
            behind.rows >= whole.rows,
            f"{path.name!r} with garbage behind it gives {behind.rows} rows of {whole.rows}",
        )
        with scratch() as folder:
            before = folder / path.name
            before.write_bytes(GARBAGE + log)
            if subject.sniff(before) > 0:
                found = subject.convert(before)
                require(
                    found.error is None,
                    (
                        f"{path.name!r} with garbage before it is recognised, but refused: "
                        f"{found.error}"
                    ),
                )
                require(
                    found.rows >= whole.rows,
                    f"{path.name!r} with garbage before it gives {found.rows} rows of {whole.rows}",
                )


def raises_only_its_errors(subject: ConverterUnderTest) -> None:
    """Whatever it is given, it yields items or raises one :class:`SpoofbenchError`."""
    for path in subject.samples:
        for what, log in damaged_logs(path) if path.is_file() else ():
            found = subject.convert_bytes(path.name, log)
            require(
                found.error is None or bool(found.error.strip()),
                f"{path.name!r} with {what} is refused without a reason",
            )
        for foreign in (b"", *FOREIGN_FILES):
            subject.convert_bytes(path.name, foreign)


def keeps_memory_bounded(subject: ConverterUnderTest) -> None:
    """Memory does not grow with the log: a longer log takes at most :data:`MEMORY_SHARE` of the
    difference more.
    """
    for path, log, _ in subject.streams() if subject.streamed else ():
        with scratch() as folder:
            for what, short, long in long_logs(log, folder):
                first, second = (
                    alone.peak_bytes
                    for alone in convert_alone(
                        subject.given, [short, long], subject.options, keep=False
                    )
                )
                most = MEMORY_SHARE * (long.stat().st_size - short.stat().st_size)
                require(
                    second - first <= most,
                    f"{path.name!r} {what} takes {first / 2**20:.0f} MiB at "
                    f"{short.stat().st_size / 2**20:.0f} MiB "
                    f"and {second / 2**20:.0f} MiB at {long.stat().st_size / 2**20:.0f} MiB",
                )


def _noise(seed: int, size: int) -> bytes:
    return np.random.default_rng(seed).bytes(size)


GARBAGE = _noise(1, 3000) + b"\n" + b"not of any format \xff\xfe" * 40 + b"\n"

FOREIGN_FILES: tuple[bytes, ...] = (
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
