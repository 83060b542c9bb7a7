"""What a receiver's rows say, and the Earth under it (WGS 84).

Fix and velocity, however they are reported; metres per radian, local positions, gravity and
rotation of the Earth. The ellipsoid is pymap3d's. Table and equation numbers are those of NIMA
TR8350.2, third edition (2000).
"""

from functools import cache
from typing import TypeVar

import numpy as np

from spoofbench.arrays import Bools, Floats
from spoofbench.schema.v1 import gnss_pb2
from spoofbench.table import Table

EARTH_RATE_RADPS = 7.292115e-5
"""Rotation of the Earth against inertial space, TR8350.2 Table 3.1."""

_PRINTED_DECIMALS = 14  # of the first eccentricity squared in TR8350.2 Table 3.3
# a dead-reckoned solution is the inertial sensors' own: compared with them, it agrees with itself
_NO_FIX = (gnss_pb2.FIX_TYPE_NONE, gnss_pb2.FIX_TYPE_DEAD_RECKONING, gnss_pb2.FIX_TYPE_TIME_ONLY)
_LARGEST_COURSE_DEG = 1e9

F = TypeVar("F", float, Floats)


def lacks_fix(pvt: Table) -> Bools:
    """Return where the fix type says that GNSS gives no position and velocity, ``(n,)``.

    That is no fix, time alone, or dead reckoning. A row without a fix type is taken for a fix.
    """
    return np.asarray(np.isin(pvt["fix_type"], _NO_FIX) & pvt.valid("fix_type"))


def velocity_ned(pvt: Table, course_deg: Floats | None = None) -> Floats:
    """Return the velocity that a receiver reports, NED, m/s, ``(n, 3)``; NaN is unknown.

    North and east are the reported components; in rows that lack either, they are taken from speed
    and course. Down is as reported, and so unknown where only speed and course are.

    Args:
        pvt: rows of kind ``gnss/pvt``.
        course_deg: clockwise from true north, ``(n,)``, in place of the reported course.
    """
    course = pvt["course_deg"] if course_deg is None else course_deg
    course = np.radians(np.where(np.abs(course) < _LARGEST_COURSE_DEG, course, np.nan))
    north, east, down = (pvt[f"vel_{axis}_mps"] for axis in "ned")
    lacking = np.isnan(north) | np.isnan(east)
    return np.column_stack(
        [
            np.where(lacking, pvt["speed_mps"] * np.cos(course), north),
            np.where(lacking, pvt["speed_mps"] * np.sin(course), east),
            down,
        ]
    )


@cache
def _ellipsoid() -> tuple[float, float]:
    """Return the semi-major axis, m, and the first eccentricity squared as TR8350.2 prints it."""
    from pymap3d.ellipsoid import Ellipsoid

    wgs84 = Ellipsoid.from_name("wgs84")
    return float(wgs84.semimajor_axis), round(float(wgs84.eccentricity) ** 2, _PRINTED_DECIMALS)


def radii_m(lat_rad: F, height_m: F) -> tuple[F, F]:
    """Return metres per radian of latitude, and of longitude divided by cos(latitude).

    The functions of :mod:`pymap3d.rcurve`, but for the last bits of the eccentricity, which is
    taken as it is printed: to the last bit, detectors' scores rest on it.

    Args:
        lat_rad: geodetic latitude, ``(n,)`` or a number.
        height_m: above the ellipsoid, likewise.

    Returns:
        Radius of curvature in the meridian and in the prime vertical, each plus height, m.
    """
    semi_major_m, eccentricity2 = _ellipsoid()
    w2 = 1 - eccentricity2 * np.sin(lat_rad) ** 2
    return semi_major_m * (
        1 - eccentricity2
    ) / w2**1.5 + height_m, semi_major_m / w2**0.5 + height_m


def local_position_ned(lat_deg: Floats, lon_deg: Floats, height_m: Floats) -> Floats:
    """Return positions in the plane that touches the ellipsoid's parallel at the first known one.

    For tracks of a few kilometres: the radii of the first position serve for all. A position rests
    on itself and the first known one alone.

    Args:
        lat_deg, lon_deg: geodetic, ``(n,)``; NaN is unknown.
        height_m: above the ellipsoid, ``(n,)``; NaN is unknown.

    Returns:
        NED, m, ``(n, 3)``; rows that lack any of the three are NaN where they lack it.
    """
    known = np.flatnonzero(~np.isnan(lat_deg + lon_deg + height_m))
    if not known.size:
        return np.full((lat_deg.size, 3), np.nan)
    lat0, lon0, height0 = (values[known[0]] for values in (lat_deg, lon_deg, height_m))
    meridian, normal = radii_m(np.radians(lat0), height0)
    east_deg = (lon_deg - lon0 + 180) % 360 - 180
    north = np.radians(lat_deg - lat0) * meridian
    return np.column_stack(
        [north, np.radians(east_deg) * normal * np.cos(np.radians(lat0)), height0 - height_m]
    )


def travelled_ned(lat_deg: Floats, lon_deg: Floats, height_m: Floats) -> Floats:
    """Return the sum of the steps from position to position, each in its own NED frame.

    For tracks of any length: it is the integral of NED velocities, while one local frame is tens of
    metres off after 50 km. The price is that a way and another to the same place may differ.

    Args:
        lat_deg, lon_deg: geodetic, ``(n,)``; NaN is unknown, and is stepped over.
        height_m: above the ellipsoid, ``(n,)``; NaN is unknown, and counts as 0 in the radii.

    Returns:
        NED, m, ``(n, 3)``, from the first known position, down from the first known height.
    """
    steps = np.full((lat_deg.size, 3), np.nan)
    known = np.flatnonzero(~np.isnan(lat_deg + lon_deg))
    lat, lon = np.radians(lat_deg[known]), np.radians(lon_deg[known])
    height = np.nan_to_num(height_m[known])
    middle = (lat[1:] + lat[:-1]) / 2
    meridian, normal = radii_m(middle, (height[1:] + height[:-1]) / 2)
    east = (np.diff(lon) + np.pi) % (2 * np.pi) - np.pi
    steps[known, :2] = 0.0
    steps[known[1:], 0] = np.cumsum(np.diff(lat) * meridian)
    steps[known[1:], 1] = np.cumsum(east * normal * np.cos(middle))
    level = np.flatnonzero(~np.isnan(height_m))
    steps[level, 2] = height_m[level[:1]] - height_m[level]
    return steps


def normal_gravity_mps2(lat_rad: float, height_m: float) -> float:
    """Return normal gravity (Somigliana, TR8350.2 Eq 4-1), m/s^2, with the free-air gradient."""
    sine2 = np.sin(lat_rad) ** 2
    _, eccentricity2 = _ellipsoid()
    surface = 9.7803253359 * (1 + 0.00193185265241 * sine2) / np.sqrt(1 - eccentricity2 * sine2)
    return float(surface - 3.086e-6 * height_m)
