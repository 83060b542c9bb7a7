"""PVT rows as attacks use them: their motion, rows found by time, values taken from other rows.

Attacks compute on latitude, longitude and height and their time derivatives: a linear combination
of coordinates has the same combination of rates as its derivative, so that position and velocity of
an attacked row belong together without a local frame. Metres per radian are the ellipsoid's radii
of curvature at each row.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from spoofbench.arrays import Bools, Floats, Indices, Times, forward_fill
from spoofbench.attacks.laws import CLAIMED_TIME_FIELDS
from spoofbench.errors import NotApplicable
from spoofbench.navigation.gnss import velocity_ned
from spoofbench.recording import Interval, Recording
from spoofbench.table import Column, Table

PVT = "gnss/pvt"
SAME_RATE = 0.02
"""Share by which two nominal intervals of one rate may differ: they are medians of stamps that
jitter.
"""

_NEAR_REGULAR = 0.25
_EXCEPTIONS = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class GeodeticMotion:
    """Geodetic coordinates and rates of PVT rows, NaN where absent.

    Attributes:
        position: ``(n, 3)`` latitude and longitude (rad, longitude without jumps at the
            antimeridian), height (m).
        rate: ``(n, 3)`` their derivatives (rad/s, rad/s, m/s).
    """

    position: Floats
    rate: Floats

    def __getitem__(self, rows: Indices | Bools) -> "GeodeticMotion":
        return GeodeticMotion(self.position[rows], self.rate[rows])


def motion_of(pvt: Table) -> GeodeticMotion:
    """Return the motion that PVT rows report.

    Height is the ellipsoid's where the row has it, else that above mean sea level; velocity without
    components is taken from speed and course, and from the last known course where a row has none.
    """
    longitude = np.radians(pvt["lon_deg"])
    known = np.isfinite(longitude)
    longitude[known] = np.unwrap(longitude[known])
    height = np.where(pvt.valid("height_m"), pvt["height_m"], pvt["height_msl_m"])
    position = np.column_stack([np.radians(pvt["lat_deg"]), longitude, height])
    return GeodeticMotion(position, _velocity(pvt) / metres_per_unit(position))


def with_motion(pvt: Table, moved: GeodeticMotion) -> Table:
    """Return PVT rows with another motion: position, both heights, velocity, speed and course.

    A field that a row lacks stays absent, but the course of a receiver that leaves it out below a
    speed: there the new speed decides. Where the motion is the row's own, or absent, the row stays
    as it is.
    """
    was = motion_of(pvt)
    shift = np.nan_to_num(moved.position - was.position)
    here = np.column_stack([_filled(axis) for axis in was.position.T])
    gain = np.nan_to_num(
        moved.rate * metres_per_unit(here + shift) - was.rate * metres_per_unit(here)
    )
    north, east, _ = (_velocity(pvt) + gain).T
    turned = (gain[:, 0] != 0) | (gain[:, 1] != 0)
    course = np.where(
        (north != 0) | (east != 0), np.degrees(np.arctan2(east, north)) % 360, pvt["course_deg"]
    )
    limit = _fastest_without_course_mps(pvt)
    has_course = pvt.valid("course_deg") if limit is None else np.hypot(north, east) > limit
    longitude = _plus(pvt["lon_deg"], np.degrees(shift[:, 1]))
    columns = {
        "lat_deg": _plus(pvt["lat_deg"], np.degrees(shift[:, 0])),
        "lon_deg": np.where(np.abs(longitude) > 180, (longitude + 180) % 360 - 180, longitude),
        "height_m": _plus(pvt["height_m"], shift[:, 2]),
        "height_msl_m": _plus(pvt["height_msl_m"], shift[:, 2]),
        "vel_n_mps": _plus(pvt["vel_n_mps"], gain[:, 0]),
        "vel_e_mps": _plus(pvt["vel_e_mps"], gain[:, 1]),
        "vel_d_mps": _plus(pvt["vel_d_mps"], gain[:, 2]),
        "speed_mps": np.where(
            turned & pvt.valid("speed_mps"), np.hypot(north, east), pvt["speed_mps"]
        ),
        "course_deg": np.where(turned, np.where(has_course, course, np.nan), pvt["course_deg"]),
    }
    return pvt.replace(**{name: values for name, values in columns.items() if name in pvt})


def _plus(values: Floats, change: Floats) -> Floats:
    """Return the sum; bit for bit the values where there is no change (a zero keeps its sign)."""
    return np.where(change != 0, values + change, values)


def _velocity(pvt: Table) -> Floats:
    """Return the velocity NED, m/s, ``(n, 3)``; in rows without components by the last known
    course, before the first by that.
    """
    course = pvt["course_deg"]
    known = np.isfinite(course)
    held = forward_fill(course, known, course[known][0] if known.any() else np.nan)
    return velocity_ned(pvt, np.where(pvt["speed_mps"] == 0, 0.0, held))


def _fastest_without_course_mps(pvt: Table) -> float | None:
    """Return the level speed up to which the receiver leaves the course out, None where its rows
    show no such limit.
    """
    speed = np.where(
        pvt.valid("speed_mps"), pvt["speed_mps"], np.hypot(pvt["vel_n_mps"], pvt["vel_e_mps"])
    )
    known = np.isfinite(speed)
    order = np.argsort(speed[known])
    speed, blank = speed[known][order], ~pvt.valid("course_deg")[known][order]
    # rows that a limit above the k slowest does not explain: those with a course below it, those
    # without one above it
    strays = np.append(0, np.cumsum(~blank)) + np.append(np.cumsum(blank[::-1])[::-1], 0)
    k = int(np.argmin(strays))
    if not 0 < k < speed.size or strays[k] > _EXCEPTIONS * blank.sum():
        return None
    return float(speed[k - 1])


def metres_per_unit(position: Floats) -> Floats:
    """Return metres north, east and down per radian of latitude, of longitude and per metre of
    height, ``(n, 3)``.

    Rows without a position get the median row's, so that velocities alone can be treated alike.
    """
    from pymap3d.rcurve import meridian, transverse

    latitude, height = (_filled(position[:, axis]) for axis in (0, 2))
    north = meridian(latitude, deg=False) + height
    east = (transverse(latitude, deg=False) + height) * np.cos(latitude)
    return np.column_stack([north, east, np.full(latitude.size, -1.0)])


def _filled(values: Floats) -> Floats:
    known = values[np.isfinite(values)]
    return np.where(np.isfinite(values), values, np.median(known) if known.size else 0.0)


def interval_s(table: Table) -> float:
    """Return the nominal interval of a table's epochs, s: the median of their differences.

    Raises:
        NotApplicable: there are fewer than two epochs.
    """
    steps = np.diff(np.unique(table.time_ns))
    if steps.size == 0:
        raise NotApplicable(f"a {table.kind.name} table of {len(table)} rows has no rate")
    return float(np.median(steps)) / 1e9


def epochs_s(table: Table) -> Floats:
    """Return the times of the receiver's epochs in seconds from the first, ``(n,)``.

    A receiver measures at regular epochs and its stamps jitter: a step within a quarter of the
    nominal interval of a multiple of it is taken for that multiple, any other as it is stamped.
    """
    steps = np.diff(table.time_ns) / 1e9
    nominal = interval_s(table)
    multiple = np.rint(steps / nominal)
    regular = (multiple >= 1) & (np.abs(steps - multiple * nominal) < _NEAR_REGULAR * nominal)
    if regular.any():
        nominal = float(steps[regular].sum() / multiple[regular].sum())
    return np.concatenate([[0.0], np.cumsum(np.where(regular, multiple * nominal, steps))])


def nearest_rows(time_ns: Times, wanted_ns: Times, within_ns: float) -> Indices:
    """Return the row nearest to each wanted time, the earlier of two, -1 where none is within
    ``within_ns``, ``(n,)``.

    Args:
        time_ns: of the rows, increasing, ``(k,)``.
        wanted_ns: ``(n,)``.
        within_ns: how far away the nearest row may be.
    """
    if time_ns.size == 0:
        return np.full(wanted_ns.size, -1, np.intp)
    after = np.clip(np.searchsorted(time_ns, wanted_ns), 0, time_ns.size - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(
        np.abs(wanted_ns - time_ns[before]) <= np.abs(time_ns[after] - wanted_ns), before, after
    )
    return np.where(np.abs(time_ns[nearest] - wanted_ns) <= within_ns, nearest, -1)


def rows_in_step(time_ns: Times, wanted_ns: Times, within_ns: float) -> Indices:
    """Return the nearest rows as :func:`nearest_rows` does, ``(n,)``, once the wanted times are
    moved so that the first of them that has a row meets it.

    Epochs of two times or receivers differ in phase: near half an interval, jitter alone would
    choose between two rows.
    """
    nearest = nearest_rows(time_ns, wanted_ns, within_ns)
    first = np.flatnonzero(nearest >= 0)[:1]
    phase_ns = int((time_ns[nearest[first]] - wanted_ns[first]).sum())
    return nearest_rows(time_ns, wanted_ns + phase_ns, within_ns)


def rows_within(table: Table, window: Interval) -> Indices:
    """Return the indices of the rows within an interval, ``(k,)``."""
    return np.flatnonzero(window.covers(table.time_ns))


def with_rows_of(victim: Table, rows: Indices, donor: Table, sources: Indices) -> Table:
    """Return the victim's table with the values of ``rows``, ``(k,)``, taken from the donor's rows
    ``sources``, ``(k,)``, and deleted where that is -1.

    The victim keeps its times and the fields that claim time; fields that it never reports stay
    absent.

    Raises:
        NotApplicable: the donor never reports a field that the victim does.
    """
    lacking = [
        name
        for name in victim
        if victim.has(name) and name not in CLAIMED_TIME_FIELDS and not donor.has(name)
    ]
    if lacking:
        raise NotApplicable(
            f"the donor's {victim.kind.name} rows lack {lacking[0]!r}, which the victim's have"
        )
    known = sources >= 0
    columns: dict[str, Column] = {}
    for name in victim:
        if name in CLAIMED_TIME_FIELDS or not victim.has(name):
            continue
        values, valid = victim[name].copy(), victim.valid(name).copy()
        values[rows[known]] = donor[name][sources[known]]
        valid[rows[known]] = donor.valid(name)[sources[known]]
        columns[name] = Column(values, None if values.dtype.kind == "f" else valid)
    attacked = victim.replace(**columns)
    return (
        attacked if known.all() else attacked.take(np.delete(np.arange(len(victim)), rows[~known]))
    )


def delayed_rows(table: Table, rows: Indices, delay_s: float) -> Indices:
    """Return the rows in step with the times of ``rows``, ``(k,)``, less a delay, ``(k,)``; -1
    where none is within half a nominal interval.
    """
    wanted_ns = table.time_ns[rows] - round(delay_s * 1e9)
    return rows_in_step(table.time_ns, wanted_ns, interval_s(table) * 0.5e9)


def require_delay(clean: Recording, delay_s: float) -> None:
    """Refuse a delay that the data are too slow for.

    Raises:
        NotApplicable: the delay is shorter than the nominal interval of a source.
    """
    for topic in clean.topics(PVT):
        interval = interval_s(clean[topic])
        # a delay of just one epoch may seem shorter than the median
        if delay_s < (1 - SAME_RATE) * interval:
            raise NotApplicable(
                f"a delay of {delay_s!r} s is shorter than the interval of {topic!r}, "
                f"{interval:.3g} s"
            )


def span_with_history(clean: Recording, history_s: float) -> Interval:
    """Return the interval that begins when the primary receiver has this much history.

    Raises:
        NotApplicable: it never has.
    """
    time_ns = clean.primary(PVT).time_ns if clean.topics(PVT) else np.empty(0, np.int64)
    if not time_ns.size or history_s > (time_ns[-1] - time_ns[0]) / 1e9:
        raise NotApplicable(
            f"the primary {PVT!r} has less than the {history_s:.6g} s of history that the attack "
            "needs"
        )
    return Interval(int(time_ns[0]) + round(history_s * 1e9), clean.span.end_ns)


def require_at_least_0(name: str, value: float) -> None:
    """Refuse a parameter that is negative or not finite.

    Raises:
        ValueError: it is.
    """
    if not (np.isfinite(value) and value >= 0):
        raise ValueError(f"{name} must be finite and at least 0, not {value!r}")


@dataclass(frozen=True, slots=True)
class DelayedAttack:
    """Base of the attacks that are made of what the receiver itself reported ``delay_s`` before."""

    delay_s: float

    models: ClassVar[frozenset[str]] = frozenset({PVT})
    level: ClassVar[str] = "pvt"
    strength_unit: ClassVar[str] = "s"

    def __post_init__(self) -> None:
        require_at_least_0("delay_s", self.delay_s)

    @property
    def strength(self) -> float:
        return self.delay_s
