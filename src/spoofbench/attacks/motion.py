"""Motion of PVT rows in geodetic coordinates and their exact rates.

Latitude, longitude and height, and their time derivatives, are what attacks are computed on: a
linear combination of coordinates has the same combination of rates as its derivative, so that
position and velocity of an attacked row belong together without a local frame. Metres per radian
are the ellipsoid's radii of curvature at each row (pymap3d).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spoofbench.errors import NotApplicable
from spoofbench.table import Table

Floats = NDArray[np.float64]

_NEAR_REGULAR = 0.25
_EXCEPTIONS = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Geodetic coordinates and rates of PVT rows, NaN where absent.

    Attributes:
        position: ``(n, 3)`` latitude and longitude (rad, longitude without jumps at the
            antimeridian), height (m).
        rate: ``(n, 3)`` their derivatives (rad/s, rad/s, m/s).
    """

    position: Floats
    rate: Floats

    def __getitem__(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> "Motion":
        return Motion(self.position[rows], self.rate[rows])


def motion_of(pvt: Table) -> Motion:
    """Return the motion that PVT rows tell.

    Height is the ellipsoid's where the row has it, else that above mean sea level; velocity without
    components is taken from speed and course, and from the last known course where a row has none.
    """
    longitude = np.radians(pvt["lon_deg"])
    known = np.isfinite(longitude)
    longitude[known] = np.unwrap(longitude[known])
    height = np.where(pvt.valid("height_m"), pvt["height_m"], pvt["height_msl_m"])
    position = np.column_stack([np.radians(pvt["lat_deg"]), longitude, height])
    return Motion(position, _velocity(pvt) / metres_per_unit(position))


def with_motion(pvt: Table, moved: Motion) -> Table:
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
    """The sum, bit for bit the values where there is no change (a zero keeps its sign)."""
    return np.where(change != 0, values + change, values)


def _velocity(pvt: Table) -> Floats:
    """Velocity NED (m/s), ``(n, 3)``."""
    course = np.radians(np.where(pvt["speed_mps"] == 0, 0.0, _held(pvt["course_deg"])))
    level = pvt.valid("vel_n_mps") & pvt.valid("vel_e_mps")
    north = np.where(level, pvt["vel_n_mps"], pvt["speed_mps"] * np.cos(course))
    east = np.where(level, pvt["vel_e_mps"], pvt["speed_mps"] * np.sin(course))
    return np.column_stack([north, east, pvt["vel_d_mps"]])


def _held(values: Floats) -> Floats:
    """The values, absent ones as the last known one, before the first as that."""
    known = np.flatnonzero(np.isfinite(values))
    return (
        values[known[np.maximum(np.searchsorted(known, np.arange(values.size), "right") - 1, 0)]]
        if known.size
        else values
    )


def _fastest_without_course_mps(pvt: Table) -> float | None:
    """Level speed up to which the receiver leaves the course out, None where its rows show no such
    limit.
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
    """Metres north, east and down per radian of latitude, of longitude and per metre of height,
    ``(n, 3)``.

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
    """Nominal interval of a table's epochs: the median of their differences.

    Raises:
        NotApplicable: there are fewer than two epochs.
    """
    steps = np.diff(np.unique(table.time_ns))
    if steps.size == 0:
        raise NotApplicable(f"a {table.kind.name} table of {len(table)} rows has no rate")
    return float(np.median(steps)) / 1e9


def epochs_s(table: Table) -> Floats:
    """Times of the receiver's epochs in seconds from the first, ``(n,)``.

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
