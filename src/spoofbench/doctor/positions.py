"""Checks of positions and heights: impossible, held, jumping, or on another surface than they
say.
"""

import numpy as np
from numpy.typing import NDArray

from spoofbench.doctor.finding import Finding, Severity, where
from spoofbench.doctor.motion import Floats, Steps, runs, speed, steps
from spoofbench.formatting import counted
from spoofbench.recording import Recording
from spoofbench.table import Table

NULL_ISLAND_DEG = 0.01
MOVING_MPS = 1.0
HELD_LEAST_M = 5.0
"""Way that a held position hides at least: below, the receiver may rightly stand or filter."""

GRAVE_HOLD_S, GRAVE_HOLD_SHARE = 2.0, 0.01
"""Below both, an epoch now and then was late."""

JUMP_LEAST_M = 10.0
JUMP_FACTOR, JUMP_MARGIN_MPS = 3.0, 10.0
"""A step is a jump where it is faster than three times the speed that the receiver says, and by 10
m/s.
"""

UNKNOWN_SPEED_MPS = 100.0
"""Without a speed: faster than any car, slower than a jump."""

GRAVE_JUMP_M = 1000.0
HEIGHT_JUMP_M, HEIGHT_RATE_MPS = 15.0, 20.0
"""Light aircraft and cable cars stay below 20 m/s up or down."""

MOST_SEPARATION_M = 110.0
"""The geoid lies between -107 m and +86 m of the ellipsoid (EGM2008)."""


def impossible(recording: Recording) -> list[Finding]:
    """Latitudes and longitudes that do not exist, and the point where both are 0."""
    findings = []
    for topic in recording.topics("gnss/pvt"):
        table = recording[topic]
        lat, lon = table["lat_deg"], table["lon_deg"]
        outside = (np.abs(lat) > 90) | (np.abs(lon) > 360) | np.isinf(lat) | np.isinf(lon)
        null = (np.abs(lat) < NULL_ISLAND_DEG) & (np.abs(lon) < NULL_ISLAND_DEG)
        for mask, what in (
            (outside, "lie outside the globe"),
            (null, "lie at latitude 0, longitude 0: the receiver had none"),
        ):
            if mask.any():
                text = f"{int(mask.sum())} of {len(table)} positions {what}"
                findings.append(
                    Finding(
                        "impossible-position",
                        "error",
                        topic,
                        text,
                        "leave these epochs out",
                        **where(table.time_ns[mask]),
                    )
                )
    return findings


def held(recording: Recording) -> list[Finding]:
    """Positions repeated while the receiver moves: a slow receiver in a fast table, or fixes that
    were lost without a word.
    """
    findings = []
    for topic in recording.topics("gnss/pvt"):
        table = recording[topic].last_per_time()
        way = steps(table)
        firsts, lengths, hidden_m, held_s = _held_runs(way)
        bad = hidden_m > HELD_LEAST_M
        if not bad.any():
            continue
        longest = int(np.argmax(held_s * bad))
        rows = int(lengths[bad].sum())
        each = _repetition(way)
        regular = f"; positions are new in one row of {each}" if each > 1 else ""
        hold = f"for {held_s[longest]:.1f} s at the longest{regular}"
        text = f"{counted(rows, 'row')} with the position of the one before while it moves, {hold}"
        start = way.start_ns[firsts[bad]]
        advice = (
            "take only rows with a new position (a mapping's 'changes'); treat long holds as gaps"
        )
        grave = held_s[longest] > GRAVE_HOLD_S or rows > GRAVE_HOLD_SHARE * len(table)
        severity: Severity = "warning" if grave else "info"
        findings.append(
            Finding(
                "held-position", severity, topic, text, advice, rows, int(start[0]), int(start[-1])
            )
        )
    return findings


def _held_runs(way: Steps) -> tuple[NDArray[np.intp], NDArray[np.intp], Floats, Floats]:
    """Return first steps and lengths of the stretches without motion, the way that they hide, m,
    and their durations, s.

    The way is speed times duration where the receiver says a speed; else the step that ends the
    stretch, if that is a leap.
    """
    still = (way.north_m == 0) & (way.east_m == 0)
    firsts, lengths = runs(still)
    total_s = np.concatenate([[0.0], np.cumsum(way.dt_s)])
    said = np.concatenate(
        [[0.0], np.cumsum(np.where(np.isfinite(way.speed_mps), way.speed_mps, 0.0) * way.dt_s)]
    )
    held_s = total_s[firsts + lengths] - total_s[firsts]
    spoken_m = said[firsts + lengths] - said[firsts]
    after = np.minimum(firsts + lengths, max(way.dt_s.size - 1, 0))
    leap_m = np.where(
        firsts + lengths < way.dt_s.size, way.way_m[after] if way.dt_s.size else 0.0, 0.0
    )
    known = np.isfinite(way.speed_mps).any()
    hidden = (
        spoken_m if known else np.where(leap_m / np.maximum(held_s, 1e-9) > MOVING_MPS, leap_m, 0.0)
    )
    moving = hidden > MOVING_MPS * held_s
    return firsts, lengths, np.where(moving, hidden, 0.0), held_s


def _repetition(way: Steps) -> int:
    """Return after how many rows a moving receiver's position is new: the median."""
    fresh = np.flatnonzero((way.north_m != 0) | (way.east_m != 0))
    return int(np.median(np.diff(fresh))) if fresh.size > 1 else 1


def jumping(recording: Recording) -> list[Finding]:
    """Steps of the position beyond what the speed allows."""
    findings = []
    for topic in recording.topics("gnss/pvt"):
        table = recording[topic].last_per_time()
        way, jump = jumps(table)
        if jump.any():
            largest = int(np.argmax(way.way_m * jump))
            size_m = float(way.way_m[largest])
            said = (
                f"where the receiver says {way.speed_mps[largest]:.1f} m/s"
                if np.isfinite(way.speed_mps[largest])
                else "with no speed said"
            )
            text = (
                f"{counted(int(jump.sum()), 'jump')}, the largest {size_m:,.0f} m in "
                f"{way.dt_s[largest]:.3g} s {said}"
            )
            advice = (
                "look whether the fix was lost, two receivers are mixed, or an attack begins or "
                "ends there"
            )
            ends = table.time_ns[way.next_rows[jump]]
            findings.append(
                Finding(
                    "position-jump",
                    "error" if size_m > GRAVE_JUMP_M else "warning",
                    topic,
                    text,
                    advice,
                    **where(ends),
                )
            )
    return findings


def jumps(table: Table) -> tuple[Steps, NDArray[np.bool_]]:
    """Return the steps of a ``gnss/pvt`` table and which of them are jumps."""
    way = steps(table)
    rate = way.way_m / way.dt_s
    said = speed(table)
    most = np.fmax(said[way.rows], said[way.next_rows])
    allowed = np.where(np.isfinite(most), JUMP_FACTOR * most + JUMP_MARGIN_MPS, UNKNOWN_SPEED_MPS)
    after_hold = (
        np.concatenate([[False], (way.way_m[:-1] == 0)]) if way.way_m.size else np.zeros(0, bool)
    )
    return way, (way.way_m > JUMP_LEAST_M) & (rate > allowed) & ~(
        after_hold & (rate < UNKNOWN_SPEED_MPS)
    )


def heights(recording: Recording) -> list[Finding]:
    """Heights that jump."""
    findings = []
    for topic in recording.topics("gnss/pvt"):
        table = recording[topic].last_per_time()
        for name in ("height_m", "height_msl_m"):
            rows = np.flatnonzero(np.isfinite(table[name]))
            rise, dt_s = np.diff(table[name][rows]), np.diff(table.time_ns[rows]) / 1e9
            fall = np.abs(table["vel_d_mps"][rows])
            most = np.where(
                np.isfinite(fall[1:]),
                JUMP_FACTOR * np.fmax(fall[1:], fall[:-1]) + JUMP_MARGIN_MPS,
                HEIGHT_RATE_MPS,
            )
            jump = (np.abs(rise) > HEIGHT_JUMP_M) & (np.abs(rise) > most * dt_s)
            if jump.any():
                text = (
                    f"{counted(int(jump.sum()), 'jump')} of {name}, by "
                    f"{float(rise[np.argmax(np.abs(rise) * jump)]):+,.0f} m at the most"
                )
                advice = (
                    "look at the fix type there: a 2D fix holds its height, a first fix has none"
                )
                findings.append(
                    Finding(
                        "height-jump",
                        "warning",
                        topic,
                        text,
                        advice,
                        **where(table.time_ns[rows[1:]][jump]),
                    )
                )
                break
    return findings


def datums(recording: Recording) -> list[Finding]:
    """Ellipsoidal height and height above mean sea level that are one number, or further apart than
    geoid and ellipsoid are.
    """
    findings = []
    for topic in recording.topics("gnss/pvt"):
        table = recording[topic]
        separation = table["height_m"] - table["height_msl_m"]
        known = separation[np.isfinite(separation)]
        if known.size < 10:
            continue
        middle = float(np.median(known))
        if np.all(known == 0):
            text = (
                "ellipsoidal height and height above mean sea level are equal in all rows: one of "
                "them is not what it is called"
            )
        elif abs(middle) > MOST_SEPARATION_M:
            text = (
                f"ellipsoidal height minus height above mean sea level is {middle:.0f} m, more "
                "than anywhere on Earth"
            )
        else:
            continue
        advice = "find out which surface the receiver means before heights are compared"
        findings.append(Finding("height-datum", "warning", topic, text, advice))
    return findings
