"""What a receiver measured, as the filter takes it: position and velocity in metres, NED, with
variances.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spoofbench.schema.v1 import gnss_pb2
from spoofbench.table import Table

Floats = NDArray[np.float64]

EARTH_RATE_RADPS = 7.292115e-5
_SEMI_MAJOR_M, _ECCENTRICITY2 = 6378137.0, 6.69437999014e-3  # WGS 84
_ABSURD = 1e9  # metres, metres per second or degrees, which no receiver measures
_NO_FIX = (gnss_pb2.FIX_TYPE_NONE, gnss_pb2.FIX_TYPE_DEAD_RECKONING, gnss_pb2.FIX_TYPE_TIME_ONLY)


@dataclass(frozen=True, slots=True, eq=False)
class Measurements:
    """Epochs of distinct times.

    Attributes:
        time_ns: ``(m,)``.
        values: position about the first one known, m, and velocity, m/s, NED, ``(m, 6)``; NaN where
            there is none. The two horizontal components of either are there together or not at all.
        variances: of the values, ``(m, 6)``; equal in north and east.
        lat_rad, height_m: of the epochs, ``(m,)``; NaN where unknown.
    """

    time_ns: NDArray[np.int64]
    values: Floats
    variances: Floats
    lat_rad: Floats
    height_m: Floats


def measurements(
    pvt: Table, floor: tuple[float, float, float, float], reported: bool
) -> Measurements:
    """Return the epochs of a receiver.

    Velocity comes from speed and course where there is no vector; down is then not measured. Where
    the first height is not above the ellipsoid, that above mean sea level takes its place. Epochs
    without a fix, and those whose position or velocity is the receiver's own dead reckoning,
    measure nothing; nor do values beyond 1e9.

    Args:
        pvt: rows of kind ``gnss/pvt``; of several at one time the last counts.
        floor: standard deviations per axis of position, horizontal and vertical, m, and of
            velocity, likewise, m/s.
        reported: whether the receiver's own accuracy, where it has one and it is worse, takes the
            floor's place.
    """
    pvt = pvt.last_per_time()
    refused = np.isin(pvt["fix_type"], _NO_FIX) & pvt.valid("fix_type")
    first = (
        np.argmax(pvt.valid("height_m") | pvt.valid("height_msl_m")) if len(pvt) else 0
    )  # later rows must not decide
    height = "height_m" if pvt.valid("height_m")[first : first + 1].any() else "height_msl_m"
    lat_deg, lon_deg, height_m = (
        np.where(refused | ~(np.abs(pvt[name]) < _ABSURD), np.nan, pvt[name])
        for name in ("lat_deg", "lon_deg", height)
    )
    position = _position(lat_deg, lon_deg, height_m)
    velocity = np.column_stack([pvt[f"vel_{axis}_mps"] for axis in "ned"])
    course = np.radians(np.where(np.abs(pvt["course_deg"]) < _ABSURD, pvt["course_deg"], np.nan))
    polar = pvt["speed_mps"][:, None] * np.column_stack([np.cos(course), np.sin(course)])
    velocity[:, :2] = np.where(
        np.isnan(velocity[:, :2]).any(axis=1, keepdims=True), polar, velocity[:, :2]
    )
    values = np.concatenate([position, velocity], axis=1)
    values[refused] = np.nan
    values[~(np.abs(values) < _ABSURD)] = np.nan
    for pair in (slice(0, 2), slice(3, 5)):
        values[np.isnan(values[:, pair]).any(axis=1), pair] = np.nan
    deviations = np.tile(np.array(floor), (len(pvt), 1))
    if reported:
        deviations = np.fmin(np.fmax(deviations, _reported(pvt)), _ABSURD)
    return Measurements(
        pvt.time_ns, values, deviations[:, [0, 0, 1, 2, 2, 3]] ** 2, np.radians(lat_deg), height_m
    )


def _reported(pvt: Table) -> Floats:
    """The receiver's own standard deviations per axis, ``(m, 4)``, from covariances or else from
    its accuracies.
    """
    horizontal, vertical, speed = (
        pvt["h_acc_m"] / np.sqrt(2),
        pvt["v_acc_m"],
        pvt["s_acc_mps"] / np.sqrt(3),
    )
    with np.errstate(invalid="ignore"):
        spread = [
            np.sqrt(
                np.stack(
                    [
                        (pvt[f"cov_{part}nn_{unit}"] + pvt[f"cov_{part}ee_{unit}"]) / 2,
                        pvt[f"cov_{part}dd_{unit}"],
                    ]
                )
            )
            for part, unit in (("", "m2"), ("vel_", "m2ps2"))
        ]
    stated = np.stack([horizontal, vertical, speed, speed])
    return np.where(np.isnan(covariances := np.concatenate(spread)), stated, covariances).T


def _position(lat_deg: Floats, lon_deg: Floats, height_m: Floats) -> Floats:
    """Sum of the steps from epoch to epoch, each in its own NED frame, so that it is the integral
    of NED velocities; ``(m, 3)``.
    """
    steps = np.full((lat_deg.size, 3), np.nan)
    known = np.flatnonzero(~np.isnan(lat_deg + lon_deg))
    lat, lon = np.radians(lat_deg[known]), np.radians(lon_deg[known])
    height = np.nan_to_num(height_m[known])
    middle, above = (lat[1:] + lat[:-1]) / 2, (height[1:] + height[:-1]) / 2
    w2 = 1 - _ECCENTRICITY2 * np.sin(middle) ** 2
    meridian, normal = (
        _SEMI_MAJOR_M * (1 - _ECCENTRICITY2) / w2**1.5 + above,
        _SEMI_MAJOR_M / w2**0.5 + above,
    )
    east = (np.diff(lon) + np.pi) % (2 * np.pi) - np.pi
    steps[known, :2] = 0.0
    steps[known[1:], 0], steps[known[1:], 1] = (
        np.cumsum(np.diff(lat) * meridian),
        np.cumsum(east * normal * np.cos(middle)),
    )
    level = np.flatnonzero(~np.isnan(height_m))
    steps[level, 2] = height_m[level[:1]] - height_m[level]
    return steps


def gravity_mps2(lat_rad: float, height_m: float) -> float:
    """Normal gravity on WGS 84 (Somigliana), with the free-air gradient."""
    sine2 = np.sin(lat_rad) ** 2
    surface = 9.7803253359 * (1 + 0.00193185265241 * sine2) / np.sqrt(1 - _ECCENTRICITY2 * sine2)
    return float(surface - 3.086e-6 * height_m)
