"""gpsd's JSON beside a log (``*.chk``) against our rows of the same times."""

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench.recording import Recording
from spoofbench.table import Table

_EARTH_M = 6_371_008.8
_WEEK_NS = 604_800_000_000_000
_OURS = (
    "lat_deg",
    "lon_deg",
    "height_m",
    "height_msl_m",
    "speed_mps",
    "course_deg",
    "vel_n_mps",
    "vel_e_mps",
)
_FIELDS = ("lat", "lon", "altHAE", "altMSL", "speed", "track", "mode")


@dataclass(frozen=True)
class Agreement:
    """One log's agreement: epochs that gpsd has with a time, those of them in which we have the
    same time, and differences there.

    Attributes:
        differences: by ``position_m``, ``height_m``, ``height_msl_m``, ``speed_mps``,
            ``course_deg``: absolute, one per epoch that has both.
        modes: epochs in which gpsd has a fix and we have no position, and the reverse.
        satellites: distinct (constellation, number, elevation, azimuth, C/N0) that both have, that
            gpsd alone has, that we alone have.
    """

    epochs: int
    matched: int
    differences: Mapping[str, NDArray[np.float64]]
    modes: tuple[int, int]
    satellites: tuple[int, int, int]


def reports(path: Path) -> Iterator[dict[str, Any]]:
    """Yield gpsd's reports of a log in order."""
    for line in path.read_bytes().splitlines():
        if line.startswith(b"{"):
            try:
                yield json.loads(line)
            except ValueError:
                continue


def epochs(path: Path) -> tuple[NDArray[np.int64], dict[str, NDArray[np.float64]]]:
    """Return the times (Unix ns) of gpsd's TPV reports and their fields, one for successive reports
    of a time; NaN where absent.
    """
    times: list[int] = []
    found: list[dict[str, Any]] = []
    for report in reports(path):
        if report["class"] == "TPV" and "time" in report:
            time_ns = _nanoseconds(report["time"])
            if not times or times[-1] != time_ns:
                times.append(time_ns)
                found.append({})
            found[-1].update({name: report[name] for name in _FIELDS if name in report})
    return np.array(times, np.int64), {
        name: np.array([float(one.get(name, np.nan)) for one in found]) for name in _FIELDS
    }


def _nanoseconds(text: str) -> int:
    return round(datetime.fromisoformat(text).timestamp() * 1000) * 1_000_000


def claimed_ns(pvt: Table) -> NDArray[np.int64]:
    """Return the times that the receiver claims: those of the rows, but for the steps of its clock
    that these do not follow.

    The steps show in week and time of week against the row's time; rows without them are taken to
    continue the last that has them.
    """
    known = pvt.valid("gps_week") & np.isfinite(pvt["tow_s"])
    if not known.any():
        return pvt.time_ns
    gps_ns = (
        pvt["gps_week"].astype(np.int64) * _WEEK_NS
        + np.round(np.nan_to_num(pvt["tow_s"]) * 1000).astype(np.int64) * 1_000_000
    )
    ahead_ns = (gps_ns - pvt.time_ns)[known]
    last = np.maximum(np.cumsum(known) - 1, 0)
    return np.asarray(pvt.time_ns + (ahead_ns - ahead_ns[0])[last])


def agreement(chk: Path, recording: Recording, pvt: Table) -> Agreement:
    """Compare gpsd's reports with the rows of our primary receiver that claim the same times, to
    the millisecond.

    A time that occurs again, after a step of the clock, is matched by its occurrence.
    """
    times, theirs = epochs(chk)
    ours = (claimed_ns(pvt) + 500_000) // 1_000_000 * 1_000_000
    mine, other = _matched(ours, times)
    rows = {name: pvt[name][mine] for name in _OURS}
    peer = {name: values[other] for name, values in theirs.items()}
    north = np.radians(rows["lat_deg"] - peer["lat"])
    east = np.radians((rows["lon_deg"] - peer["lon"] + 180) % 360 - 180) * np.cos(
        np.radians(peer["lat"])
    )
    speed = np.where(
        np.isnan(rows["speed_mps"]),
        np.hypot(rows["vel_n_mps"], rows["vel_e_mps"]),
        rows["speed_mps"],
    )
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
        satellites(chk, recording),
    )


def _matched(
    ours: NDArray[np.int64], theirs: NDArray[np.int64]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the places in both of the same times and occurrences."""
    places = [
        {key: place for place, key in enumerate(_occurrences(times))} for times in (ours, theirs)
    ]
    both = [key for key in places[0] if key in places[1]]
    return np.array([places[0][key] for key in both], np.intp), np.array(
        [places[1][key] for key in both], np.intp
    )


def _occurrences(times: NDArray[np.int64]) -> Iterator[tuple[int, int]]:
    counts: Counter[int] = Counter()
    for time in times.tolist():
        yield time, counts[time]
        counts[time] += 1


def satellites(chk: Path, recording: Recording) -> tuple[int, int, int]:
    """Count what was said of satellites in view: by both, by gpsd alone, by us alone; degrees and
    dB-Hz are whole numbers.
    """
    theirs, ours = gpsd_satellites(chk), our_satellites(recording)
    return len(theirs & ours), len(theirs - ours), len(ours - theirs)


_Satellite = tuple[int, int, int | None, int | None, int | None]


def gpsd_satellites(chk: Path) -> set[_Satellite]:
    """Return the distinct satellites of gpsd's SKY reports; its gnssid is our constellation less
    one. Zero C/N0 is none.
    """
    found: set[_Satellite] = set()
    for report in reports(chk):
        for one in report.get("satellites", ()) if report["class"] == "SKY" else ():
            if "svid" in one:
                place = (
                    None if one.get(name) is None else round(one[name]) for name in ("el", "az")
                )
                found.add((one["gnssid"] + 1, one["svid"], *place, round(one.get("ss", 0)) or None))
    return found


def our_satellites(recording: Recording) -> set[_Satellite]:
    """Return the distinct satellites of all our signals."""
    found: set[_Satellite] = set()
    for topic in recording.topics("gnss/signal"):
        table = recording[topic]
        columns = [
            table[name].tolist()
            for name in ("constellation", "svid", "elevation_deg", "azimuth_deg", "cn0_dbhz")
        ]
        for constellation, svid, *values in zip(*columns, strict=True):
            elevation, azimuth, cn0 = (None if value != value else round(value) for value in values)
            found.add((constellation, svid, elevation, azimuth, cn0 or None))
    return found


def as_dict(found: Agreement) -> dict[str, Any]:
    """Return the agreement of one log as numbers."""
    return {
        "epochs": found.epochs,
        "matched": found.matched,
        "gpsd_fix_we_none": found.modes[0],
        "we_position_gpsd_none": found.modes[1],
        "satellites": dict(
            zip(("both", "gpsd_alone", "ours_alone"), found.satellites, strict=True)
        ),
        **{name: statistics([values]) for name, values in found.differences.items()},
    }


def statistics(parts: Sequence[NDArray[np.float64]]) -> dict[str, float | int]:
    """Return number, median and largest of differences; only the number where there is none."""
    values = np.concatenate(parts) if parts else np.zeros(0)
    if not values.size:
        return {"n": 0}
    return {
        "n": values.size,
        "median": float(f"{np.median(values):.3g}"),
        "max": float(f"{values.max():.3g}"),
    }
