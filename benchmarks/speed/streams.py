"""What the benchmarks of UBX and NMEA share: logs of 50 MB, columns of ours, and rows that a peer
writes.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.fuzz.seeds import nmea_lines, ubx_log
from spoofbench.conversion import Block, Source, convert

BYTES = 50_000_000
_DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "nmea_ubx"

Columns = dict[str, np.ndarray[Any, Any]]


def log_of(names: Sequence[str], folder: Path, suffix: str) -> tuple[Path, str]:
    """Return a log of 50 MB and what it is: real logs one after the other, again and again; a made
    one where they are absent.
    """
    paths = [_DATA / name for name in names]
    if all(path.exists() for path in paths):
        unit = b"".join(path.read_bytes() for path in paths)
        what = f"{', '.join(path.stem for path in paths)}, again and again"
    else:
        unit = ubx_log(40_000) if suffix == "ubx" else b"\r\n".join(nmea_lines(40_000)) + b"\r\n"
        what = "a made log, as there are no real ones, again and again"
    path = folder / f"log.{suffix}"
    path.write_bytes(unit * (BYTES // len(unit) + 1))
    return path, f"{path.stat().st_size / 1e6:.0f} MB ({what})"


def part_of(log: Path, size: int) -> tuple[Path, float]:
    """Return the beginning of a log of about this size, up to a line end, and its share of the
    whole.
    """
    octets = log.read_bytes()[:size]
    octets = octets[: octets.rfind(b"\n") + 1] or octets
    path = log.with_name(f"{size}{log.suffix}")
    path.write_bytes(octets)
    return path, len(octets) / log.stat().st_size


def columns(converter: Any, log: Path) -> Columns:
    """Return all columns that a converter makes of a log."""
    parts: dict[str, list[np.ndarray[Any, Any]]] = defaultdict(list)
    for item in converter.convert(Source.of(log), converter.Options()):
        if isinstance(item, Block):
            for name, values in {"time_ns": item.table.time_ns, **item.table}.items():
                parts[f"{item.topic} {name}"].append(values)
    return {name: np.concatenate(values) for name, values in parts.items()}


def file(log: Path, out: Path, converter: str) -> Path:
    """Convert a log to a recording."""
    convert(log, out, format=converter)
    return out


Message = tuple[str, int, Any]
"""Topic, time and protobuf message."""


def pair_file(messages: Callable[[], Iterator[Message]], out: Path) -> Path:
    """Write messages with mcap-protobuf-support, zstd as its default has it."""
    from mcap_protobuf.writer import Writer

    with out.open("wb") as stream, Writer(stream) as writer:
        for topic, time_ns, message in messages():
            writer.write_message(topic, message, time_ns, time_ns)
    return out
