"""Checks of velocity, speed and course against the way between positions: units and conventions
that were mistaken.
"""

from collections.abc import Mapping

import numpy as np

from spoofbench.doctor.finding import Finding
from spoofbench.doctor.motion import Bools, Floats, Steps, steps, wrapped
from spoofbench.recording import Recording
from spoofbench.table import Table

WINDOW_S = 5.0
LEAST_WAY_M = 20.0
"""In a window: the noise of both ends is then below a tenth."""

LEAST_WINDOWS = 10
UNITS: Mapping[str, float] = {
    "km/h": 3.6,
    "knots": 1.943844,
    "mph": 2.236936,
    "ft/s": 3.280840,
    "cm/s": 100.0,
    "mm/s": 1000.0,
}
UNIT_TOLERANCE = 0.06
DISAGREES = 0.15
STEADY_MPS = 3.0
"""Above, the course of a way of a second is known to some degrees."""

AGREEING = 0.9
"""Length of the mean of unit vectors that point the same way."""

COURSE_OFFSET_DEG = 15.0


def speeds(recording: Recording) -> list[Finding]:
    """Speed that is no m/s, or does not belong to the positions."""
    findings = []
    for topic in recording.topics("gnss/pvt"):
        table = recording[topic].last_per_time()
        for name, said in _said_speeds(table).items():
            ratios = _ratios(steps(table), said, table)
            if ratios.size < LEAST_WINDOWS:
                continue
            ratio = float(np.median(ratios))
            unit = next(
                (
                    unit
                    for unit, factor in _factors().items()
                    if abs(ratio / factor - 1) < UNIT_TOLERANCE
                ),
                None,
            )
            if unit is not None:
                text = (
                    f"{name} is {ratio:.3f} times the way per second of the positions, as if {unit}"
                )
                findings.append(
                    Finding(
                        "speed-unit",
                        "error",
                        topic,
                        text,
                        "convert again with the right unit",
                        ratios.size,
                    )
                )
            elif abs(ratio - 1) > DISAGREES:
                text = f"{name} is {ratio:.2f} times the way per second of the positions"
                advice = (
                    "find out which of the two is right: positions may be smoothed, held or scaled"
                )
                findings.append(
                    Finding("speed-disagrees", "warning", topic, text, advice, ratios.size)
                )
    return findings


def _said_speeds(table: Table) -> dict[str, Floats]:
    said = {
        "the velocity": np.hypot(table["vel_n_mps"], table["vel_e_mps"]),
        "speed_mps": table["speed_mps"],
    }
    return {name: values for name, values in said.items() if np.isfinite(values).any()}


def _factors() -> dict[str, float]:
    """Said over true speed, by what the mistake is called."""
    return {f"{unit} were taken for m/s": factor for unit, factor in UNITS.items()} | {
        f"m/s were taken for {unit}": 1 / factor for unit, factor in UNITS.items()
    }


def _ratios(way: Steps, said: Floats, table: Table) -> Floats:
    """Return said way over way between the positions, of each window in which the receiver
    moves.
    """
    if not way.dt_s.size:
        return np.zeros(0)
    mean = (said[way.rows] + said[way.next_rows]) / 2
    window = ((table.time_ns[way.rows] - table.time_ns[way.rows[0]]) / (WINDOW_S * 1e9)).astype(int)
    usable = np.isfinite(mean) & (way.dt_s <= WINDOW_S)
    said_m = np.bincount(window[usable], (mean * way.dt_s)[usable])
    gone_m = np.bincount(window[usable], way.way_m[usable])
    chord_m = np.hypot(
        np.bincount(window[usable], way.north_m[usable]),
        np.bincount(window[usable], way.east_m[usable]),
    )
    moving = (gone_m > LEAST_WAY_M) & (chord_m > gone_m / 2)
    return np.asarray(said_m[moving] / gone_m[moving])


def frames(recording: Recording) -> list[Finding]:
    """Velocity components whose direction is not that of the way: north and east exchanged, or a
    sign.
    """
    findings = []
    for topic in recording.topics("gnss/pvt"):
        table = recording[topic].last_per_time()
        if table.has("vel_n_mps", "vel_e_mps"):
            way, moving = _moving(table)
            direction = np.arctan2(table["vel_e_mps"], table["vel_n_mps"])
            bearing = np.arctan2(way.east_m, way.north_m)[moving]
            mistakes = {
                "north and east are exchanged": np.pi / 2 - direction,
                "north has the wrong sign": np.pi - direction,
            }
            mistakes |= {
                "east has the wrong sign": -direction,
                "both have the wrong sign": direction + np.pi,
            }
            findings += _direction(
                topic,
                "velocity",
                "velocity-frame",
                _between(direction, way, moving),
                bearing,
                _each(mistakes, way, moving),
            )
    return findings


def courses(recording: Recording) -> list[Finding]:
    """Course that is in radians, counted the other way, from east, or otherwise not along the
    way.
    """
    findings = []
    for topic in recording.topics("gnss/pvt"):
        table = recording[topic].last_per_time()
        if table.has("course_deg"):
            way, moving = _moving(table)
            said = np.radians(table["course_deg"])
            bearing = np.arctan2(way.east_m, way.north_m)[moving]
            mistakes = {
                "it is in radians": table["course_deg"],
                "it counts anticlockwise from north": -said,
            }
            mistakes |= {
                "it counts anticlockwise from east": np.pi / 2 - said,
                "it points backwards": said + np.pi,
            }
            findings += _direction(
                topic,
                "course_deg",
                "course-unit",
                _between(said, way, moving),
                bearing,
                _each(mistakes, way, moving),
            )
    return findings


def _moving(table: Table) -> tuple[Steps, Bools]:
    """Return the steps, and which of them are fast enough to have a direction and short enough to
    have one only.
    """
    way = steps(table)
    fast = (way.way_m > STEADY_MPS * way.dt_s) & ~(way.speed_mps < STEADY_MPS)
    return way, fast & (way.way_m > STEADY_MPS) & (way.dt_s <= WINDOW_S)


def _between(angles: Floats, way: Steps, moving: Bools) -> Floats:
    """Return the direction half way between the ends of each step."""
    first, last = angles[way.rows[moving]], angles[way.next_rows[moving]]
    return np.asarray(first + wrapped(last - first) / 2)


def _each(angles: Mapping[str, Floats], way: Steps, moving: Bools) -> dict[str, Floats]:
    return {name: _between(values, way, moving) for name, values in angles.items()}


def _direction(
    topic: str, what: str, code: str, said: Floats, bearing: Floats, mistakes: Mapping[str, Floats]
) -> list[Finding]:
    """Compare directions with the bearing of the way, as they are and as each mistake would have
    them.
    """
    offset, length, count = _mean(said - bearing)
    if count < LEAST_WINDOWS or (length > AGREEING and abs(np.degrees(offset)) < COURSE_OFFSET_DEG):
        return []
    for mistake, corrected in mistakes.items():
        turn, agreement, _ = _mean(corrected - bearing)
        if (
            agreement > AGREEING
            and abs(np.degrees(turn)) < COURSE_OFFSET_DEG
            and agreement > length + 0.1 * (abs(offset) < 0.5)
        ):
            text = f"{what} is not along the way of the positions, but would be if {mistake}"
            return [Finding(code, "error", topic, text, f"convert again: {mistake}", count)]
    if length > AGREEING:
        text = (
            f"{what} is turned by {np.degrees(offset):+.0f} degrees against the way of the "
            "positions"
        )
        return [
            Finding(
                "course-disagrees",
                "warning",
                topic,
                text,
                "find out whether it is a heading, or magnetic",
                count,
            )
        ]
    if length < AGREEING - 0.3:
        text = (
            f"{what} has little to do with the way of the positions (agreement {length:.2f} of 1)"
        )
        return [
            Finding("course-disagrees", "warning", topic, text, "do not use both together", count)
        ]
    return []


def _mean(angles: Floats) -> tuple[float, float, int]:
    """Return direction and length of the mean of unit vectors, and how many there are."""
    known = angles[np.isfinite(angles)]
    if not known.size:
        return np.nan, 0.0, 0
    mean = np.exp(1j * known).mean()
    return float(np.angle(mean)), float(np.abs(mean)), int(known.size)
