"""What several checks derive from a receiver's rows."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from spoofbench.table import Table

EARTH_RADIUS_M = 6_371_008.8

Floats = NDArray[np.float64]
Times = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """From each row with a position to the next one at a later time; arrays ``(n,)``.

    Attributes:
        rows: place of the step's first row in the table; ``next_rows``: of its last.
        start_ns: time of the first row.
        dt_s: duration.
        north_m, east_m: displacement on a sphere, good to half a percent.
        speed_mps: mean of the speeds at both ends, by velocity or else as the receiver says it; NaN
            where unknown.
    """

    rows: NDArray[np.intp]
    next_rows: NDArray[np.intp]
    start_ns: NDArray[np.int64]
    dt_s: Floats
    north_m: Floats
    east_m: Floats
    speed_mps: Floats

    @property
    def way_m(self) -> Floats:
        return np.hypot(self.north_m, self.east_m)


def speed(pvt: Table) -> Floats:
    """Return the speed over ground, ``(n,)`` m/s, from the velocity or else as the receiver says
    it; NaN where neither is known.
    """
    velocity = np.hypot(pvt["vel_n_mps"], pvt["vel_e_mps"])
    return np.asarray(np.where(np.isnan(velocity), pvt["speed_mps"], velocity))


def course(pvt: Table) -> Floats:
    """Return the course over ground, ``(n,)`` rad clockwise from north, from the velocity or else
    as the receiver says it.
    """
    course_rad = np.arctan2(pvt["vel_e_mps"], pvt["vel_n_mps"])
    return np.asarray(np.where(np.isnan(course_rad), np.radians(pvt["course_deg"]), course_rad))


@lru_cache(maxsize=8)
def _steps(pvt: "_Same") -> Steps:
    return _steps_of(pvt.table)


@dataclass(frozen=True)
class _Same:
    """A table by identity: checks that ask for the same steps get them once."""

    table: Table

    def __hash__(self) -> int:
        return id(self.table)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and self.table is other.table


def steps(pvt: Table) -> Steps:
    """Return the steps of a ``gnss/pvt`` table."""
    return _steps(_Same(pvt))


def _steps_of(pvt: Table) -> Steps:
    lat, lon = pvt["lat_deg"], pvt["lon_deg"]
    placed = (np.abs(lat) <= 90) & (np.abs(lon) <= 360) & ~((lat == 0) & (lon == 0))
    rows = np.flatnonzero(placed)
    rows = rows[np.append(np.diff(pvt.time_ns[rows]) > 0, True)[: rows.size]]
    first, last = rows[:-1], rows[1:]
    turn = np.remainder(lon[last] - lon[first] + 180, 360) - 180
    middle = np.radians((lat[first] + lat[last]) / 2)
    velocity = speed(pvt)
    return Steps(
        first,
        last,
        pvt.time_ns[first],
        np.diff(pvt.time_ns[rows]) / 1e9,
        np.radians(lat[last] - lat[first]) * EARTH_RADIUS_M,
        np.radians(turn) * np.cos(middle) * EARTH_RADIUS_M,
        (velocity[first] + velocity[last]) / 2,
    )


def wrapped(angle_rad: Floats) -> Floats:
    """Return angles within plus and minus pi."""
    return np.asarray(np.remainder(angle_rad + np.pi, 2 * np.pi) - np.pi)


def runs(mask: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return first places and lengths of the stretches where a mask holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return edges[::2], edges[1::2] - edges[::2]
