"""Checks of receivers against each other: two that rode together say where they were at one
time.
"""

from collections.abc import Iterator

import numpy as np

from spoofbench.doctor.finding import Finding
from spoofbench.doctor.motion import EARTH_RADIUS_M, Floats
from spoofbench.gnss_time import leap_seconds
from spoofbench.recording import Recording
from spoofbench.table import Table

LEAST_EPOCHS = 30
TOGETHER_M = 30.0
"""At the right lag, two receivers in one vehicle are that close in the median."""

BETTER = 3.0
"""How many times closer than without a lag."""

LEAST_SEPARATION_M, SEPARATION_TOLERANCE_M = 10.0, 4.0


def lags(recording: Recording) -> list[Finding]:
    """A receiver whose times are GPS time beside one whose times are UTC."""
    findings = []
    for topic, other, table in _pairs(recording):
        leap_s = int(leap_seconds(table.time_ns[0]))
        apart_m = {
            lag_s: _apart(table, recording[other], lag_s)
            for lag_s in (0.0, float(leap_s), float(-leap_s))
        }
        best = min(apart_m, key=lambda lag_s: apart_m[lag_s])
        if best and apart_m[best] < TOGETHER_M and apart_m[best] * BETTER < apart_m[0.0]:
            then = f"{leap_s} s {'earlier' if best > 0 else 'later'}"
            text = (
                f"the positions are those of {other} {then}, as if one of them gave GPS time for "
                "UTC"
            )
            advice = f"subtract {leap_s} s from the times of the one that is ahead"
            findings.append(Finding("gps-time-as-utc", "error", topic, text, advice))
    return findings


def datums(recording: Recording) -> list[Finding]:
    """A receiver whose heights are above mean sea level under the name of ellipsoidal ones, or the
    reverse.
    """
    findings = []
    for topic, other, table in _pairs(recording):
        reference = recording[other].last_per_time()
        separation = _median(reference["height_m"] - reference["height_msl_m"])
        for name in ("height_m", "height_msl_m"):
            known = np.isfinite(reference[name])
            if not known.any():
                continue
            off_m = _median(
                table[name]
                - np.interp(
                    table.time_ns, reference.time_ns[known], reference[name][known], np.nan, np.nan
                )
            )
            if (
                abs(separation) > LEAST_SEPARATION_M
                and abs(abs(off_m) - abs(separation)) < SEPARATION_TOLERANCE_M
            ):
                text = (
                    f"{name} is {off_m:+.0f} m from that of {other}, as much as geoid and "
                    "ellipsoid are apart"
                )
                advice = "find out which surface each receiver means before heights are compared"
                findings.append(Finding("height-datum", "warning", topic, text, advice))
    return findings


def _pairs(recording: Recording) -> Iterator[tuple[str, str, Table]]:
    """Yield each further receiver's topic, the primary one's, and the former's rows with a
    position.
    """
    topics = recording.topics("gnss/pvt")
    for topic in topics[1:]:
        table = recording[topic].last_per_time()
        table = table.take(np.isfinite(table["lat_deg"]) & np.isfinite(table["lon_deg"]))
        if len(table) >= LEAST_EPOCHS:
            yield topic, topics[0], table


def _apart(table: Table, other: Table, lag_s: float) -> float:
    """Return the median distance from the other's position ``lag_s`` earlier, m; infinite where
    they hardly overlap.
    """
    other = other.last_per_time()
    known = np.isfinite(other["lat_deg"]) & np.isfinite(other["lon_deg"])
    times = table.time_ns - int(lag_s * 1e9)
    if not known.any():
        return np.inf
    lat, lon = (
        np.interp(times, other.time_ns[known], other[name][known], np.nan, np.nan)
        for name in ("lat_deg", "lon_deg")
    )
    north_m = np.radians(table["lat_deg"] - lat) * EARTH_RADIUS_M
    east_m = np.radians(table["lon_deg"] - lon) * EARTH_RADIUS_M * np.cos(np.radians(lat))
    return _median(np.hypot(north_m, east_m)) if np.isfinite(lat).sum() >= LEAST_EPOCHS else np.inf


def _median(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else np.nan
