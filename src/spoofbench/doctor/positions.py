"""Checks of positions and heights: impossible, held, jumping, or on another surface than they are
named after; and of receivers that rode together against each other.
"""

from collections.abc import Iterator

import numpy as np

from spoofbench.arrays import Bools, Floats, Indices, Times
from spoofbench.doctor.findings import Finding, Severity, extent
from spoofbench.doctor.motion import (
    EARTH_RADIUS_M,
    PositionSteps,
    known_median,
    position_steps,
    runs,
    speed,
)
from spoofbench.formatting import counted
from spoofbench.gnss_time import leap_seconds
from spoofbench.recording import Recording
from spoofbench.table import Table

NULL_ISLAND_DEG = 0.01
MOVING_MPS = 1.0
MIN_HIDDEN_M = 5.0
"""Distance that a held position hides at least: below, the receiver may rightly stand or filter."""

GRAVE_HOLD_S, GRAVE_HOLD_SHARE = 2.0, 0.01
"""Below both, an epoch now and then was late."""

MIN_JUMP_M = 10.0
JUMP_FACTOR, JUMP_MARGIN_MPS = 3.0, 10.0
"""A step is a jump where it is faster than three times the speed that the receiver reports, and by
10 m/s.
"""

UNKNOWN_SPEED_MPS = 100.0
"""Without a speed: faster than any car, slower than a jump."""

GRAVE_JUMP_M = 1000.0
HEIGHT_JUMP_M, HEIGHT_RATE_MPS = 15.0, 20.0
"""Light aircraft and cable cars stay below 20 m/s up or down."""

MAX_SEPARATION_M = 110.0
"""The geoid lies between -107 m and +86 m of the ellipsoid (EGM2008)."""

MIN_EPOCHS = 30
TOGETHER_M = 30.0
"""At the right lag, two receivers in one vehicle are that close in the median."""

LAG_IMPROVEMENT = 3.0
"""How many times closer than without a lag."""

MIN_SEPARATION_M, SEPARATION_TOLERANCE_M = 10.0, 4.0


def impossible(recording: Recording) -> Iterator[Finding]:
    """Latitudes and longitudes that do not exist, and the point where both are 0."""
    for topic in recording.topics("gnss/pvt"):
        table = recording[topic]
        lat, lon = table["lat_deg"], table["lon_deg"]
        outside = (np.abs(lat) > 90) | (np.abs(lon) > 360) | np.isinf(lat) | np.isinf(lon)
        null = (np.abs(lat) < NULL_ISLAND_DEG) & (np.abs(lon) < NULL_ISLAND_DEG)
        for mask, where in (
            (outside, "lie outside the globe"),
            (null, "lie at latitude 0, longitude 0: the receiver had none"),
        ):
            if mask.any():
                text = f"{int(mask.sum())} of {len(table)} positions {where}"
                rows = extent(table.time_ns[mask])
                advice = "leave these epochs out"
                yield Finding("impossible-position", "error", topic, text, advice, **rows)


def held(recording: Recording) -> Iterator[Finding]:
    """Positions repeated while the receiver moves: a slow receiver in a fast table, or fixes that
    were lost without notice.
    """
    for topic in recording.topics("gnss/pvt"):
        table = recording[topic].last_per_time()
        steps = position_steps(table)
        firsts, lengths, hidden_m, held_s = _held_runs(steps)
        bad = hidden_m > MIN_HIDDEN_M
        if not bad.any():
            continue
        longest = int(np.argmax(held_s * bad))
        rows = int(lengths[bad].sum())
        fresh = np.flatnonzero((steps.north_m != 0) | (steps.east_m != 0))
        each = int(np.median(np.diff(fresh))) if fresh.size > 1 else 1
        regular = f"; positions are new in one row of {each}" if each > 1 else ""
        text = (
            f"{counted(rows, 'row')} with the position of the one before while it moves, for "
            f"{held_s[longest]:.1f} s at the longest{regular}"
        )
        advice = (
            "take only rows with a new position (a mapping's 'changes'); treat long holds as gaps"
        )
        grave = held_s[longest] > GRAVE_HOLD_S or rows > GRAVE_HOLD_SHARE * len(table)
        severity: Severity = "warning" if grave else "info"
        start = steps.start_ns[firsts[bad]]
        span = int(start[0]), int(start[-1])
        yield Finding("held-position", severity, topic, text, advice, rows, *span)


def _held_runs(steps: PositionSteps) -> tuple[Indices, Indices, Floats, Floats]:
    """Return first steps and lengths of the stretches without motion, the distance that they hide,
    m, and their durations, s, ``(k,)`` each.

    The distance is speed times duration where the receiver reports a speed; else the step that ends
    the stretch, if it is faster than walking.
    """
    firsts, lengths = runs((steps.north_m == 0) & (steps.east_m == 0))
    ends = firsts + lengths
    total_s = np.concatenate([[0.0], np.cumsum(steps.dt_s)])
    held_s = total_s[ends] - total_s[firsts]
    is_known = np.isfinite(steps.speed_mps)
    if is_known.any():
        by_speed_m = np.where(is_known, steps.speed_mps, 0.0) * steps.dt_s
        total_m = np.concatenate([[0.0], np.cumsum(by_speed_m)])
        hidden_m = total_m[ends] - total_m[firsts]
    else:
        next_m = np.append(steps.distance_m, 0.0)[ends]
        hidden_m = np.where(next_m / np.maximum(held_s, 1e-9) > MOVING_MPS, next_m, 0.0)
    return firsts, lengths, np.where(hidden_m > MOVING_MPS * held_s, hidden_m, 0.0), held_s


def jumping(recording: Recording) -> Iterator[Finding]:
    """Steps of the position beyond what the speed allows."""
    for topic in recording.topics("gnss/pvt"):
        table = recording[topic].last_per_time()
        steps, jump = jumps(table)
        if jump.any():
            largest = int(np.argmax(steps.distance_m * jump))
            size_m, speed_mps = float(steps.distance_m[largest]), steps.speed_mps[largest]
            reported = (
                f"where the receiver reports {speed_mps:.1f} m/s"
                if np.isfinite(speed_mps)
                else "with no speed reported"
            )
            text = (
                f"{counted(int(jump.sum()), 'jump')}, the largest {size_m:,.0f} m in "
                f"{steps.dt_s[largest]:.3g} s {reported}"
            )
            advice = (
                "look whether the fix was lost, two receivers are mixed, or an attack begins or "
                "ends there"
            )
            severity: Severity = "error" if size_m > GRAVE_JUMP_M else "warning"
            rows = extent(table.time_ns[steps.next_rows[jump]])
            yield Finding("position-jump", severity, topic, text, advice, **rows)


def jumps(table: Table) -> tuple[PositionSteps, Bools]:
    """Return the steps of a ``gnss/pvt`` table and which of them are jumps, ``(n,)``."""
    steps = position_steps(table)
    rate = steps.distance_m / steps.dt_s
    reported = speed(table)
    limit = np.fmax(reported[steps.rows], reported[steps.next_rows])
    allowed = np.where(np.isfinite(limit), JUMP_FACTOR * limit + JUMP_MARGIN_MPS, UNKNOWN_SPEED_MPS)
    after_hold = np.concatenate([[False], steps.distance_m == 0])[: rate.size]
    is_caught_up = after_hold & (rate < UNKNOWN_SPEED_MPS)
    return steps, (steps.distance_m > MIN_JUMP_M) & (rate > allowed) & ~is_caught_up


def heights(recording: Recording) -> Iterator[Finding]:
    """Heights that jump."""
    for topic in recording.topics("gnss/pvt"):
        table = recording[topic].last_per_time()
        for name in ("height_m", "height_msl_m"):
            rows = np.flatnonzero(np.isfinite(table[name]))
            rise, dt_s = np.diff(table[name][rows]), np.diff(table.time_ns[rows]) / 1e9
            sink_mps = np.abs(table["vel_d_mps"][rows])
            limit_mps = np.where(
                np.isfinite(sink_mps[1:]),
                JUMP_FACTOR * np.fmax(sink_mps[1:], sink_mps[:-1]) + JUMP_MARGIN_MPS,
                HEIGHT_RATE_MPS,
            )
            jump = (np.abs(rise) > HEIGHT_JUMP_M) & (np.abs(rise) > limit_mps * dt_s)
            if jump.any():
                largest_m = float(rise[np.argmax(np.abs(rise) * jump)])
                text = (
                    f"{counted(int(jump.sum()), 'jump')} of {name}, by {largest_m:+,.0f} m at most"
                )
                advice = (
                    "look at the fix type there: a 2D fix holds its height, a first fix has none"
                )
                at = extent(table.time_ns[rows[1:]][jump])
                yield Finding("height-jump", "warning", topic, text, advice, **at)
                break


def height_surfaces(recording: Recording) -> Iterator[Finding]:
    """Ellipsoidal height and height above mean sea level that are one number, or further apart than
    geoid and ellipsoid are.
    """
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
                "them is not what its name says"
            )
        elif abs(middle) > MAX_SEPARATION_M:
            text = (
                f"ellipsoidal height minus height above mean sea level is {middle:.0f} m, more "
                "than anywhere on Earth"
            )
        else:
            continue
        advice = "find out which surface the receiver means before heights are compared"
        yield Finding("height-datum", "warning", topic, text, advice)


def receiver_lags(recording: Recording) -> Iterator[Finding]:
    """A receiver whose times are GPS time beside one whose times are UTC."""
    for topic, primary, table in _further_receivers(recording):
        leap_s = int(leap_seconds(table.time_ns[0]))
        apart_m = {
            lag_s: _distance(table, recording[primary], lag_s)
            for lag_s in (0.0, float(leap_s), float(-leap_s))
        }
        best = min(apart_m, key=lambda lag_s: apart_m[lag_s])
        if best and apart_m[best] < TOGETHER_M and apart_m[best] * LAG_IMPROVEMENT < apart_m[0.0]:
            text = (
                f"the positions are those of {primary} {leap_s} s "
                f"{'earlier' if best > 0 else 'later'}, as if one of them gave GPS time for UTC"
            )
            advice = f"subtract {leap_s} s from the times of the one that is ahead"
            yield Finding("gps-time-as-utc", "error", topic, text, advice)


def receiver_heights(recording: Recording) -> Iterator[Finding]:
    """A receiver whose heights are above mean sea level under the name of ellipsoidal ones, or the
    reverse.
    """
    for topic, primary, table in _further_receivers(recording):
        reference = recording[primary].last_per_time()
        separation_m = abs(known_median(reference["height_m"] - reference["height_msl_m"]))
        for name in ("height_m", "height_msl_m"):
            known = np.isfinite(reference[name])
            if not known.any():
                continue
            off_m = known_median(table[name] - _interpolated(reference, name, known, table.time_ns))
            if (
                separation_m > MIN_SEPARATION_M
                and abs(abs(off_m) - separation_m) < SEPARATION_TOLERANCE_M
            ):
                text = (
                    f"{name} is {off_m:+.0f} m from that of {primary}, as much as geoid and "
                    "ellipsoid are apart"
                )
                advice = "find out which surface each receiver means before heights are compared"
                yield Finding("height-datum", "warning", topic, text, advice)


def _further_receivers(recording: Recording) -> Iterator[tuple[str, str, Table]]:
    """Yield each further receiver's topic, the primary one's, and the former's rows with a
    position.
    """
    topics = recording.topics("gnss/pvt")
    for topic in topics[1:]:
        table = recording[topic].last_per_time()
        table = table.take(np.isfinite(table["lat_deg"]) & np.isfinite(table["lon_deg"]))
        if len(table) >= MIN_EPOCHS:
            yield topic, topics[0], table


def _distance(table: Table, other: Table, lag_s: float) -> float:
    """Return the median distance from the other's position ``lag_s`` earlier, m; infinite where
    they hardly overlap.
    """
    other = other.last_per_time()
    known = np.isfinite(other["lat_deg"]) & np.isfinite(other["lon_deg"])
    times_ns = table.time_ns - int(lag_s * 1e9)
    if not known.any():
        return np.inf
    lat, lon = (_interpolated(other, name, known, times_ns) for name in ("lat_deg", "lon_deg"))
    if np.isfinite(lat).sum() < MIN_EPOCHS:
        return np.inf
    north_m = np.radians(table["lat_deg"] - lat) * EARTH_RADIUS_M
    east_m = np.radians(table["lon_deg"] - lon) * EARTH_RADIUS_M * np.cos(np.radians(lat))
    return known_median(np.hypot(north_m, east_m))


def _interpolated(table: Table, name: str, known: Bools, times_ns: Times) -> Floats:
    """Return a field's known values at other times, ``(m,)``, NaN before the first and after the
    last.
    """
    return np.asarray(np.interp(times_ns, table.time_ns[known], table[name][known], np.nan, np.nan))
