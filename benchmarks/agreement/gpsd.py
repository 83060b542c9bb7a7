"""gpsd's JSON beside a log (``*.chk``) against our rows of the same times."""

import json
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench.recording import Recording, Table

_EARTH_M = 6_371_008.8
_FIELDS = ("lat", "lon", "altHAE", "altMSL", "speed", "track", "mode")


@dataclass(frozen=True)
class Agreement:
    """One log's agreement: epochs that gpsd has with a time, those of them in which we have the same time, and differences there.

    Attributes:
        differences: by ``position_m``, ``height_m``, ``height_msl_m``, ``speed_mps``, ``course_deg``: absolute, one per epoch that
            has both.
        modes: epochs in which gpsd has a fix and we have no position, and the reverse.
        satellites: signals in view that gpsd lists, and we, over all epochs.
    """

    epochs: int
    matched: int
    differences: Mapping[str, NDArray[np.float64]]
    modes: tuple[int, int]
    satellites: tuple[int, int]


def reports(path: Path) -> Iterator[dict[str, Any]]:
    """Yield gpsd's reports of a log in order."""
    for line in path.read_bytes().splitlines():
        if line.startswith(b"{"):
            try:
                yield json.loads(line)
            except ValueError:
                continue


def epochs(path: Path) -> tuple[NDArray[np.int64], dict[str, NDArray[np.float64]]]:
    """Return the times (Unix ns) of gpsd's TPV reports and their fields, the last report of each time; NaN where absent."""
    last: dict[int, dict[str, Any]] = defaultdict(dict)
    for report in reports(path):
        if report["class"] == "TPV" and "time" in report:
            last[_nanoseconds(report["time"])].update({name: report[name] for name in _FIELDS if name in report})
    times = np.array(sorted(last), np.int64)
    return times, {name: np.array([float(last[time].get(name, np.nan)) for time in times.tolist()]) for name in _FIELDS}


def _nanoseconds(text: str) -> int:
    return round(datetime.fromisoformat(text).timestamp() * 1000) * 1_000_000


def agreement(chk: Path, recording: Recording, pvt: Table) -> Agreement:
    """Compare gpsd's reports with the rows of our primary receiver whose times are the same to the millisecond."""
    times, theirs = epochs(chk)
    ours = (pvt.time_ns + 500_000) // 1_000_000 * 1_000_000
    _, mine, other = np.intersect1d(ours, times, return_indices=True)
    rows = {
        name: pvt[name][mine]
        for name in ("lat_deg", "lon_deg", "height_m", "height_msl_m", "speed_mps", "course_deg", "vel_n_mps", "vel_e_mps")
    }
    peer = {name: values[other] for name, values in theirs.items()}
    north = np.radians(rows["lat_deg"] - peer["lat"])
    east = np.radians((rows["lon_deg"] - peer["lon"] + 180) % 360 - 180) * np.cos(np.radians(peer["lat"]))
    speed = np.where(np.isnan(rows["speed_mps"]), np.hypot(rows["vel_n_mps"], rows["vel_e_mps"]), rows["speed_mps"])
    differences = {
        "position_m": np.hypot(north, east) * _EARTH_M,
        "height_m": np.abs(rows["height_m"] - peer["altHAE"]),
        "height_msl_m": np.abs(rows["height_msl_m"] - peer["altMSL"]),
        "speed_mps": np.abs(speed - peer["speed"]),
        "course_deg": np.abs((rows["course_deg"] - peer["track"] + 180) % 360 - 180),
    }
    fixed, known = peer["mode"] >= 2, np.isfinite(rows["lat_deg"])
    return Agreement(
        times.size,
        mine.size,
        {name: values[np.isfinite(values)] for name, values in differences.items()},
        (int((fixed & ~known).sum()), int((known & ~fixed).sum())),
        (_signals(chk), sum(len(recording[topic]) for topic in recording.topics("gnss/signal"))),
    )


def _signals(chk: Path) -> int:
    return sum(len(report.get("satellites", ())) for report in reports(chk) if report["class"] == "SKY")


def as_dict(found: Agreement) -> dict[str, Any]:
    """Return the agreement of one log as numbers."""
    return {
        "epochs": found.epochs,
        "matched": found.matched,
        "gpsd_fix_we_none": found.modes[0],
        "we_position_gpsd_none": found.modes[1],
        "satellites": {"gpsd": found.satellites[0], "ours": found.satellites[1]},
        **{name: statistics([values]) for name, values in found.differences.items()},
    }


def statistics(parts: Sequence[NDArray[np.float64]]) -> dict[str, float | int]:
    """Return number, median and largest of differences; only the number where there is none."""
    values = np.concatenate(parts) if parts else np.zeros(0)
    if not values.size:
        return {"n": 0}
    return {"n": values.size, "median": float(f"{np.median(values):.3g}"), "max": float(f"{values.max():.3g}")}
