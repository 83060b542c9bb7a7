"""What our converters make of a log."""

import json
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.agreement.logs import SampleLog
from spoofbench.codec import read
from spoofbench.conversion import Ledger, Source, convert
from spoofbench.errors import SpoofbenchError
from spoofbench.recording import Recording
from spoofbench.table import Table

_EARTH_M = 6_371_008.8
REFERENCE_DATE = "2024-01-01"


@dataclass(frozen=True)
class Ours:
    """One log's conversion: the ledger and the recording, or why there is none; ``date`` where one
    had to be given.
    """

    ledger: Ledger | None
    recording: Recording | None
    seconds: float
    error: str | None = None
    date: str | None = None
    frames: Counter[bytes] = field(default_factory=Counter)

    @property
    def format(self) -> str:
        return self.recording.metadata["origin"]["converter"] if self.recording else "-"

    @property
    def pvt(self) -> Table | None:
        return (
            self.recording.primary("gnss/pvt")
            if self.recording and self.recording.topics("gnss/pvt")
            else None
        )


def converted(log: SampleLog, out: Path) -> Ours:
    """Convert a log; where it is refused for want of a date, say so and give
    :data:`REFERENCE_DATE`.
    """
    refusal: str | None = None
    for options in (log.options, {**log.options, "date": REFERENCE_DATE}):
        begin = time.perf_counter()
        try:
            ledger = convert(log.path, out, format=log.format, options=options)
        except SpoofbenchError as error:
            if "--date" not in str(error) or refusal:
                return Ours(None, None, time.perf_counter() - begin, refusal or str(error))
            refusal = str(error)
        else:
            seconds = time.perf_counter() - begin
            recording = read(out)
            return Ours(
                ledger, recording, seconds, refusal, options.get("date"), frames_found(log.path)
            )
    return Ours(None, None, 0.0, refusal)


def frames_found(path: Path, piece_bytes: int = 4 * 2**20) -> Counter[bytes]:
    """Return the UBX frames and sentences that our demultiplexer finds in pieces of this size, each
    by its bytes.
    """
    from spoofbench_converters.serial.demux import demultiplex
    from spoofbench_converters.serial.host_timestamps import HostTimestamps

    found: Counter[bytes] = Counter()
    source = Source.of(path)
    if path.is_file() and not source.is_archive:
        with source.open() as stream:
            for piece in demultiplex(
                stream, HostTimestamps(zone_is_utc=False), piece_bytes=piece_bytes
            ):
                for frames in (piece.ubx, piece.nmea):
                    octets = frames.octets.tobytes()
                    found.update(
                        octets[a : a + n]
                        for a, n in zip(
                            frames.starts.tolist(), frames.lengths.tolist(), strict=True
                        )
                    )
    return found


def measures(table: Table) -> dict[str, float]:
    """Return a track's rows, rows with a position, duration, length and highest speed."""
    known = np.isfinite(table["lat_deg"]) & np.isfinite(table["lon_deg"])
    lat, lon = np.radians(table["lat_deg"][known]), np.radians(table["lon_deg"][known])
    speed = np.fmax(table["speed_mps"], np.hypot(table["vel_n_mps"], table["vel_e_mps"]))
    steps = np.hypot(np.diff(lat), np.diff(lon) * np.cos(lat[1:])) * _EARTH_M
    seconds = (table.time_ns[-1] - table.time_ns[0]) / 1e9 if len(table) else 0.0
    fastest = float(np.nanmax(speed)) if np.isfinite(speed).any() else float("nan")
    return {
        "epochs": len(table),
        "epochs_fix": int(known.sum()),
        "duration_s": round(float(seconds), 3),
        "distance_m": round(float(steps.sum()), 1),
        "max_speed_mps": round(fastest, 2),
    }


def as_dict(ours: Ours) -> Mapping[str, Any]:
    """Return what is to be shown of a conversion."""
    shown: dict[str, Any] = {
        "format": ours.format,
        "seconds": round(ours.seconds, 3),
        "refused": ours.error,
        "date_given": ours.date,
    }
    if ours.ledger is not None and ours.recording is not None:
        ledger = ours.ledger
        shown |= {"unit": ledger.unit, "used": ledger.used, "skipped": ledger.skipped}
        shown |= {
            "rows": dict(sorted(ledger.rows.items())),
            "rejects": dict(ledger.reasons.most_common()),
        }
        shown |= {"clock": ours.recording.metadata["recording"].get("clock")}
        shown |= {
            "clock_steps": len(
                json.loads(ours.recording.metadata["recording"].get("clock_steps", "[]"))
            )
        }
    if ours.pvt is not None:
        shown |= {"track": measures(ours.pvt)}
    return shown
