"""Where another parser, or the manifest, disagrees with us on a log."""

import math
import re
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from benchmarks.agreement import gpsd, peers
from benchmarks.agreement.logs import SampleLog
from benchmarks.agreement.ours import Ours, measures
from spoofbench.conversion import Source

_EXPLANATIONS = Path(__file__).with_name("explanations.toml")
_TRACK_TOLERANCE = {
    "epochs": 0.0,
    "epochs_fix": 0.0,
    "duration_s": 0.005,
    "distance_m": 0.02,
    "max_speed_mps": 0.01,
}
_LEAST_DISTANCE_M = 1000.0
"""The manifests leave out steps within the noise; so much of a track do they tell something of."""
_GPSD_LIMITS = {
    "position_m": 0.02,
    "height_m": 0.11,
    "height_msl_m": 0.11,
    "speed_mps": 0.006,
    "course_deg": 0.011,
}
"""Differences above these are more than gpsd's last digit and the log's."""


@dataclass(frozen=True, slots=True)
class Disagreement:
    """What a peer and we say differently of a log, and why; ``explanation`` is empty where nobody
    has looked yet.
    """

    file: str
    kind: str
    ours: str
    theirs: str
    explanation: str


def compare(log: SampleLog, ours: Ours) -> tuple[list[Disagreement], gpsd.Agreement | None]:
    """Compare a conversion with all that applies to the log; also return gpsd's agreement where
    there is its JSON.
    """
    found: gpsd.Agreement | None = None
    said = [*_frames(log, ours), *_bag(log, ours), *_tables(log, ours), *_manifest(log, ours)]
    chk = log.path.with_name(log.path.name + ".chk")
    if chk.exists() and ours.recording is not None and ours.pvt is not None:
        found = gpsd.agreement(chk, ours.recording, ours.pvt)
        said += _gpsd(found)
    elif chk.exists() and gpsd.epochs(chk)[0].size:
        said.append(("gpsd epochs", "no PVT", f"{gpsd.epochs(chk)[0].size} epochs"))
    return [
        Disagreement(log.name, kind, mine, theirs, explanation(log.name, kind))
        for kind, mine, theirs in said
    ], found


_Said = tuple[str, str, str]


def _frames(log: SampleLog, ours: Ours) -> Iterator[_Said]:
    source = Source.of(log.path)
    stream = ours.format in ("ubx", "nmea") or (
        ours.recording is None and log.manifest.get("format", "").startswith(("ubx", "nmea"))
    )
    if log.path.is_dir() or source.is_archive or not stream:
        return
    octets = peers.unpacked(log.path)
    if ours.recording is not None:
        yield from _counted("reference frames", ours.frames, peers.reference(octets))
    expected = ours.frames or peers.reference(octets)
    ubx = Counter({raw: n for raw, n in expected.items() if raw[:1] == b"\xb5"})
    nmea = Counter({raw: n for raw, n in expected.items() if raw[:1] in (b"$", b"!")})
    if ubx:
        yield from _counted("pyubx2 frames", ubx, peers.pyubx2(octets))
    if nmea:
        yield from _counted("pynmeagps sentences", nmea, peers.pynmeagps(octets))
        yield from _counted("pynmea2 sentences", nmea, peers.pynmea2(octets))


def _counted(kind: str, ours: Counter[bytes], theirs: Counter[bytes]) -> Iterator[_Said]:
    """Compare frames by their bytes; name the types of those that only one side has."""
    only_ours, only_theirs = ours - theirs, theirs - ours
    if only_ours or only_theirs:
        yield (
            kind,
            f"{ours.total()}; alone {_types(only_ours)}",
            f"{theirs.total()}; alone {_types(only_theirs)}",
        )


def _types(frames: Counter[bytes]) -> str:
    counts: Counter[str] = Counter()
    for raw, number in frames.items():
        counts[type_of(raw)] += number
    return " ".join(f"{name}:{number}" for name, number in counts.most_common(8)) or "none"


def type_of(raw: bytes) -> str:
    """Return what a frame is: ``UBX 01-07`` or ``GNGGA``."""
    if raw[:1] == b"\xb5":
        return f"UBX {raw[2]:02X}-{raw[3]:02X}"
    return re.split(rb"[,*]", raw[1:], maxsplit=1)[0].decode("ascii", "replace")


def _bag(log: SampleLog, ours: Ours) -> Iterator[_Said]:
    if ours.format != "rosbag" or ours.ledger is None or ours.recording is None:
        return
    theirs = peers.rosbags(log.path)
    if theirs is None:
        yield "rosbags messages", f"{ours.ledger.used + ours.ledger.skipped}", "refused"
        return
    if sum(theirs.values()) != ours.ledger.used + ours.ledger.skipped:
        yield (
            "rosbags messages",
            f"{ours.ledger.used + ours.ledger.skipped}",
            f"{sum(theirs.values())}",
        )
    for topic, rows in sorted(ours.ledger.rows.items()):
        source = (
            topic.split("/")[1]
            if topic.count("/") > 2 or not topic.startswith("/reference")
            else "reference"
        )
        names = ours.recording.metadata.get(f"source/{source}", {}).get("topic", "").split()
        counts = {name: theirs[name] for name in names if name in theirs}
        if rows not in counts.values():
            yield (
                "rosbags rows",
                f"{topic} {rows}",
                " ".join(f"{name} {count}" for name, count in counts.items()) or "no such topic",
            )


def _tables(log: SampleLog, ours: Ours) -> Iterator[_Said]:
    if ours.format not in ("phone", "table") or ours.ledger is None:
        return
    theirs = {f"pandas rows of {name}": rows for name, rows in peers.pandas(log.path).items()}
    theirs |= {f"lines of {name}": rows for name, rows in peers.lines(log.path).items()}
    for name, rows in theirs.items():
        if rows not in ours.ledger.rows.values():
            nearest = min(ours.ledger.rows.items(), key=lambda item: abs(item[1] - rows))
            yield name, f"nearest {nearest[0]} {nearest[1]}", f"{rows}"


def _manifest(log: SampleLog, ours: Ours) -> Iterator[_Said]:
    row = log.manifest
    if row and ours.recording is None:
        yield "conversion", f"refused: {ours.error}", row.get("format", "")
    if ours.pvt is None or not row:
        return
    mine = measures(ours.pvt)
    for name, tolerance in _TRACK_TOLERANCE.items():
        text = row.get(name, "")
        if not re.fullmatch(r"[0-9.]+", text):
            continue
        if name == "distance_m" and float(text) < _LEAST_DISTANCE_M:
            continue
        theirs, unit = float(text), 10.0 ** -len(text.partition(".")[2])
        candidates = [mine[name], *_durations(ours)] if name == "duration_s" else [mine[name]]
        if not any(
            abs(value - theirs) <= max(tolerance * theirs, unit) or math.isnan(value)
            for value in candidates
        ):
            yield f"manifest {name}", f"{mine[name]:g}", f"{theirs:g}"


def _durations(ours: Ours) -> list[float]:
    """Seconds that each topic spans, and all together."""
    tables = [ours.recording[topic] for topic in ours.recording] if ours.recording else []
    spans = [(int(table.time_ns[0]), int(table.time_ns[-1])) for table in tables if len(table)]
    spans += [(min(first for first, _ in spans), max(last for _, last in spans))] if spans else []
    return [(last - first) / 1e9 for first, last in spans]


def _gpsd(found: gpsd.Agreement) -> Iterator[_Said]:
    if found.matched < found.epochs:
        yield "gpsd epochs", f"{found.matched} of the same time", f"{found.epochs}"
    for name, values in found.differences.items():
        far = values[values > _GPSD_LIMITS[name]]
        if far.size:
            yield f"gpsd {name}", f"{far.size} of {values.size} differ", f"by up to {far.max():.4g}"
    if any(found.modes):
        yield (
            "gpsd fix",
            f"{found.modes[1]} positions where gpsd has no fix",
            f"{found.modes[0]} fixes where we have no position",
        )
    both, theirs, ours = found.satellites
    if both + theirs and theirs + ours:
        yield "gpsd satellites", f"{both} the same, {ours} alone", f"{theirs} alone"


def explanation(file: str, kind: str) -> str:
    """Return what was found out about a disagreement; empty where nobody has looked.

    ``explanations.toml`` has tables ``[[explanation]]`` with ``files`` and ``kinds`` (patterns as
    of a shell) and ``text``.
    """
    for entry in _explanations():
        if any(fnmatchcase(file, p) for p in entry["files"]) and any(
            fnmatchcase(kind, p) for p in entry["kinds"]
        ):
            return str(entry["text"])
    return ""


def _explanations() -> list[Mapping[str, Any]]:
    with _EXPLANATIONS.open("rb") as file:
        return list(tomllib.load(file).get("explanation", []))
