"""Motion that a receiver reports: steps between its positions, and checks of velocity, speed and
course against them for units and conventions that were mistaken.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from spoofbench.arrays import Bools, Floats, Indices, Times
from spoofbench.doctor.findings import Finding
from spoofbench.recording import Recording
from spoofbench.table import Table

EARTH_RADIUS_M = 6_371_008.8

WINDOW_S = 5.0
MIN_DISTANCE_M = 20.0
"""In a window: the noise of both ends is then below a tenth."""

MIN_WINDOWS = 10
SPEED_UNITS: Mapping[str, float] = {
    "km/h": 3.6,
    "knots": 1.943844,
    "mph": 2.236936,
    "ft/s": 3.280840,
    "cm/s": 100.0,
    "mm/s": 1000.0,
}
UNIT_TOLERANCE = 0.06
SPEED_TOLERANCE = 0.15
STEADY_MPS = 3.0
"""Above, the bearing of a step of a second is known to some degrees."""

AGREEING = 0.9
"""Length of the mean of unit vectors that point the same way."""

COURSE_OFFSET_DEG = 15.0


@dataclass(frozen=True, slots=True, eq=False)
class PositionSteps:
    """From each row with a position to the next one at a later time; arrays ``(n,)``.

    Attributes:
        rows: index of the step's first row in the table; ``next_rows``: of its last.
        start_ns: time of the first row.
        dt_s: duration.
        north_m, east_m: displacement on a sphere, good to half a percent.
        speed_mps: mean of the speeds at both ends, by velocity or else as the receiver reports it;
            NaN where unknown.
    """

    rows: Indices
    next_rows: Indices
    start_ns: Times
    dt_s: Floats
    north_m: Floats
    east_m: Floats
    speed_mps: Floats

    @property
    def distance_m(self) -> Floats:
        """Length of each step, m."""
        return np.hypot(self.north_m, self.east_m)


def position_steps(pvt: Table) -> PositionSteps:
    """Return the steps of a ``gnss/pvt`` table; checks that ask for the same get them once."""
    return _cached_steps(_ById(pvt))


@dataclass(frozen=True)
class _ById:
    """A table by identity."""

    table: Table

    def __hash__(self) -> int:
        return id(self.table)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _ById) and self.table is other.table


@lru_cache(maxsize=8)
def _cached_steps(key: _ById) -> PositionSteps:
    pvt = key.table
    lat, lon = pvt["lat_deg"], pvt["lon_deg"]
    is_placed = (np.abs(lat) <= 90) & (np.abs(lon) <= 360) & ~((lat == 0) & (lon == 0))
    rows = np.flatnonzero(is_placed)
    rows = rows[np.append(np.diff(pvt.time_ns[rows]) > 0, True)[: rows.size]]
    first, last = rows[:-1], rows[1:]
    dlon_deg = np.remainder(lon[last] - lon[first] + 180, 360) - 180
    middle = np.radians((lat[first] + lat[last]) / 2)
    speed_mps = speed(pvt)
    return PositionSteps(
        first,
        last,
        pvt.time_ns[first],
        np.diff(pvt.time_ns[rows]) / 1e9,
        np.radians(lat[last] - lat[first]) * EARTH_RADIUS_M,
        np.radians(dlon_deg) * np.cos(middle) * EARTH_RADIUS_M,
        (speed_mps[first] + speed_mps[last]) / 2,
    )


def speed(pvt: Table) -> Floats:
    """Return the speed over ground, ``(n,)`` m/s, from the velocity or else as the receiver reports
    it; NaN where neither is known.
    """
    velocity = np.hypot(pvt["vel_n_mps"], pvt["vel_e_mps"])
    return np.asarray(np.where(np.isnan(velocity), pvt["speed_mps"], velocity))


def course(pvt: Table) -> Floats:
    """Return the course over ground, ``(n,)`` rad clockwise from north, from the velocity or else
    as the receiver reports it.
    """
    course_rad = np.arctan2(pvt["vel_e_mps"], pvt["vel_n_mps"])
    return np.asarray(np.where(np.isnan(course_rad), np.radians(pvt["course_deg"]), course_rad))


def wrapped(angle_rad: Floats) -> Floats:
    """Return angles within plus and minus pi, of the same shape."""
    return np.asarray(np.remainder(angle_rad + np.pi, 2 * np.pi) - np.pi)


def runs(mask: Bools) -> tuple[Indices, Indices]:
    """Return first indices and lengths ``(k,)`` of the stretches where a mask ``(n,)`` holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return edges[::2], edges[1::2] - edges[::2]


def known_median(values: Floats) -> float:
    """Return the median of the finite values of ``(n,)``, NaN where there are none."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else np.nan


def speeds(recording: Recording) -> Iterator[Finding]:
    """Speed that is not in m/s, or does not belong to the positions."""
    for topic in recording.topics("gnss/pvt"):
        table = recording[topic].last_per_time()
        reported = {
            "the velocity": np.hypot(table["vel_n_mps"], table["vel_e_mps"]),
            "speed_mps": table["speed_mps"],
        }
        for name, speed_mps in reported.items():
            if not np.isfinite(speed_mps).any():
                continue
            ratios = _speed_ratios(table, speed_mps)
            if ratios.size < MIN_WINDOWS:
                continue
            ratio = float(np.median(ratios))
            unit = _unit_mistake(ratio)
            if unit is not None:
                text = (
                    f"{name} is {ratio:.3f} times the distance per second of the positions, as if "
                    f"{unit}"
                )
                advice = "convert again with the right unit"
                yield Finding("speed-unit", "error", topic, text, advice, ratios.size)
            elif abs(ratio - 1) > SPEED_TOLERANCE:
                text = f"{name} is {ratio:.2f} times the distance per second of the positions"
                advice = (
                    "find out which of the two is right: positions may be smoothed, held or scaled"
                )
                yield Finding("speed-disagrees", "warning", topic, text, advice, ratios.size)


def _unit_mistake(ratio: float) -> str | None:
    """Return which mistake of units gives this ratio of reported to true speed."""
    factors = {f"{unit} were taken for m/s": factor for unit, factor in SPEED_UNITS.items()} | {
        f"m/s were taken for {unit}": 1 / factor for unit, factor in SPEED_UNITS.items()
    }
    return next(
        (name for name, factor in factors.items() if abs(ratio / factor - 1) < UNIT_TOLERANCE), None
    )


def _speed_ratios(table: Table, speed_mps: Floats) -> Floats:
    """Return reported over true distance, of each window in which the receiver moves, ``(k,)``."""
    steps = position_steps(table)
    if not steps.dt_s.size:
        return np.zeros(0)
    mean = (speed_mps[steps.rows] + speed_mps[steps.next_rows]) / 2
    since_ns = table.time_ns[steps.rows] - table.time_ns[steps.rows[0]]
    window = (since_ns / (WINDOW_S * 1e9)).astype(int)
    usable = np.isfinite(mean) & (steps.dt_s <= WINDOW_S)
    reported_m = np.bincount(window[usable], (mean * steps.dt_s)[usable])
    moved_m = np.bincount(window[usable], steps.distance_m[usable])
    chord_m = np.hypot(
        np.bincount(window[usable], steps.north_m[usable]),
        np.bincount(window[usable], steps.east_m[usable]),
    )
    moving = (moved_m > MIN_DISTANCE_M) & (chord_m > moved_m / 2)
    return np.asarray(reported_m[moving] / moved_m[moving])


def velocity_frames(recording: Recording) -> Iterator[Finding]:
    """Velocity components that do not point along the track: north and east exchanged, or a
    sign.
    """
    for topic in recording.topics("gnss/pvt"):
        table = recording[topic].last_per_time()
        if table.has("vel_n_mps", "vel_e_mps"):
            direction = np.arctan2(table["vel_e_mps"], table["vel_n_mps"])
            mistakes = {
                "north and east are exchanged": np.pi / 2 - direction,
                "north has the wrong sign": np.pi - direction,
                "east has the wrong sign": -direction,
                "both have the wrong sign": direction + np.pi,
            }
            yield from _direction(topic, table, "velocity", "velocity-frame", direction, mistakes)


def courses(recording: Recording) -> Iterator[Finding]:
    """Course that is in radians, counted the other way, from east, or otherwise not along the
    track.
    """
    for topic in recording.topics("gnss/pvt"):
        table = recording[topic].last_per_time()
        if table.has("course_deg"):
            reported = np.radians(table["course_deg"])
            mistakes = {
                "it is in radians": table["course_deg"],
                "it counts anticlockwise from north": -reported,
                "it counts anticlockwise from east": np.pi / 2 - reported,
                "it points backwards": reported + np.pi,
            }
            yield from _direction(topic, table, "course_deg", "course-unit", reported, mistakes)


def _direction(
    topic: str,
    table: Table,
    name: str,
    code: str,
    reported: Floats,
    mistakes: Mapping[str, Floats],
) -> Iterator[Finding]:
    """Compare directions ``(n,)`` rad with the bearings of the steps between positions, as they are
    and as each mistake would have them.
    """
    steps = position_steps(table)
    # Fast enough to have a direction, and short enough to have one only.
    fast = (steps.distance_m > STEADY_MPS * steps.dt_s) & ~(steps.speed_mps < STEADY_MPS)
    moving = fast & (steps.distance_m > STEADY_MPS) & (steps.dt_s <= WINDOW_S)
    first, last = steps.rows[moving], steps.next_rows[moving]
    bearing = np.arctan2(steps.east_m, steps.north_m)[moving]

    def mean_error(direction: Floats) -> tuple[float, float, int]:
        halfway = direction[first] + wrapped(direction[last] - direction[first]) / 2
        return _mean_direction(halfway - bearing)

    offset, length, count = mean_error(reported)
    if count < MIN_WINDOWS or (length > AGREEING and abs(np.degrees(offset)) < COURSE_OFFSET_DEG):
        return
    for mistake, corrected in mistakes.items():
        turn, agreement, _ = mean_error(corrected)
        if (
            agreement > AGREEING
            and abs(np.degrees(turn)) < COURSE_OFFSET_DEG
            and agreement > length + 0.1 * (abs(offset) < 0.5)
        ):
            text = f"{name} does not point along the track of the positions, but would if {mistake}"
            yield Finding(code, "error", topic, text, f"convert again: {mistake}", count)
            return
    if length > AGREEING:
        text = f"{name} is turned by {np.degrees(offset):+.0f} degrees from the positions' track"
        advice = "find out whether it is a heading, or magnetic"
        yield Finding("course-disagrees", "warning", topic, text, advice, count)
    elif length < AGREEING - 0.3:
        text = f"{name} hardly follows the track of the positions (agreement {length:.2f} of 1)"
        yield Finding("course-disagrees", "warning", topic, text, "do not use both together", count)


def _mean_direction(angles: Floats) -> tuple[float, float, int]:
    """Return direction and length of the mean of unit vectors, and how many are known."""
    known = angles[np.isfinite(angles)]
    if not known.size:
        return np.nan, 0.0, 0
    mean = np.exp(1j * known).mean()
    return float(np.angle(mean)), float(np.abs(mean)), int(known.size)
