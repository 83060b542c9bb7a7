"""Motion that a receiver's rows tell: speed over ground, acceleration and climb.

A value at a row rests on that row and earlier ones. Unknown is NaN.
"""

from dataclasses import dataclass

import numpy as np

from spoofbench.arrays import Bools, Floats, Ints, Times
from spoofbench.navigation.gnss import lacks_fix, travelled_ned, velocity_ned
from spoofbench.table import Table

SHORTEST_STEP_S = 0.5
"""Accelerations are taken over at least this time: at high rates, noise is divided by little."""

_BEYOND_ANY = 1e6  # metres and metres per second


@dataclass(frozen=True, slots=True)
class ReportedMotion:
    """How the receiver says it moves at each row, ``(n,)``.

    Attributes:
        speed_mps: over ground.
        acceleration_mps2: norm of the change of the level velocity.
        climb_mps: up or down, without sign.
        height_m: above mean sea level or, where that is unknown, above the ellipsoid. What a
            converter of ADS-B puts there is pressure altitude.
    """

    speed_mps: Floats
    acceleration_mps2: Floats
    climb_mps: Floats
    height_m: Floats


def reported_motion(pvt: Table, baseline_s: float, longest_gap_s: float) -> ReportedMotion:
    """Return the motion of each row, from velocities where they are reported, else from positions.

    Args:
        pvt: rows of kind ``gnss/pvt``, one per time.
        baseline_s: positions and heights are differenced over at least this time.
        longest_gap_s: and over at most this.
    """
    time_ns, has_fix = pvt.time_ns, ~lacks_fix(pvt)
    velocity = np.where(has_fix[:, None], _credible(velocity_ned(pvt)), np.nan)
    level, down = velocity[:, :2], velocity[:, 2]
    height_m = np.where(np.isnan(pvt["height_msl_m"]), pvt["height_m"], pvt["height_msl_m"])
    height_m = np.where(has_fix, _credible(height_m), np.nan)
    steps = _travelled(pvt, height_m, has_fix)
    differenced_mps = _rates(time_ns, steps[:, :2], baseline_s, longest_gap_s)
    stated_mps = np.where(has_fix, _credible(pvt["speed_mps"]), np.nan)
    speed_mps = _first_known(
        np.linalg.norm(level, axis=1), stated_mps, np.linalg.norm(differenced_mps, axis=1)
    )
    climb = _rates(time_ns, height_m[:, None], baseline_s, longest_gap_s)[:, 0]
    return ReportedMotion(
        speed_mps=speed_mps,
        acceleration_mps2=np.linalg.norm(
            _rates(time_ns, level, SHORTEST_STEP_S, longest_gap_s), axis=1
        ),
        climb_mps=np.abs(_first_known(down, climb)),
        height_m=height_m,
    )


def held(ratio: Floats, time_ns: Times, hold_s: float, longest_gap_s: float) -> Floats:
    """Return what a ratio, ``(n,)``, did not fall below for at least ``hold_s`` up to each row.

    It is the least of the ratios from the latest row that is ``hold_s`` old onwards: above 1 where
    a violation has lasted so long. It is NaN where no row reaches so far back without a gap longer
    than ``longest_gap_s``.
    """
    known = np.flatnonzero(~np.isnan(ratio))
    times, values = time_ns[known], ratio[known]
    first = np.searchsorted(times, times - round(hold_s * 1e9), "right") - 1
    run = np.cumsum(np.append(False, np.diff(times) > round(longest_gap_s * 1e9))[: times.size])
    reaches = (first >= 0) & (run[np.maximum(first, 0)] == run)
    least = _least(values, np.maximum(first, 0), np.arange(known.size))
    result = np.full(ratio.size, np.nan)
    result[known] = np.where(reaches, least, np.nan)
    return result


def _least(values: Floats, first: Ints, last: Ints) -> Floats:
    """Return the least of ``values[first:last + 1]``, ``(n,)``: of two overlapping stretches whose
    lengths are a power of two.
    """
    length = last - first + 1
    power = np.frexp(length)[1] - 1
    result, table = np.empty(values.size), values
    for level in range(int(power.max(initial=-1)) + 1):
        if level:
            half = 1 << (level - 1)
            table = np.minimum(table[:-half], table[half:])
        rows = power == level
        result[rows] = np.minimum(table[first[rows]], table[last[rows] - (1 << level) + 1])
    return result


def _travelled(pvt: Table, height_m: Floats, has_fix: Bools) -> Floats:
    """Return the way from the first position, NED, m, ``(n, 3)``."""
    lat_deg, lon_deg = pvt["lat_deg"], pvt["lon_deg"]
    usable = has_fix & (np.abs(lat_deg) <= 90) & (np.abs(lon_deg) <= 360)
    return travelled_ned(
        np.where(usable, lat_deg, np.nan), np.where(usable, lon_deg, np.nan), height_m
    )


def _rates(time_ns: Times, values: Floats, at_least_s: float, at_most_s: float) -> Floats:
    """Return the mean rate of change of values, ``(n, k)``, since the latest earlier row that has
    them and lies between these times before.
    """
    rates = np.full(values.shape, np.nan)
    known = np.flatnonzero(~np.isnan(values).any(axis=1))
    times = time_ns[known]
    before = np.searchsorted(times, times - round(at_least_s * 1e9), "right") - 1
    step_s = (times - times[np.maximum(before, 0)]) / 1e9
    there = (before >= 0) & (step_s <= at_most_s)
    rows, earlier = known[there], known[before[there]]
    rates[rows] = (values[rows] - values[earlier]) / step_s[there, None]
    return rates


def _credible(values: Floats) -> Floats:
    return np.where(np.abs(values) < _BEYOND_ANY, values, np.nan)


def _first_known(*choices: Floats) -> Floats:
    """Return at each row the first choice that is known."""
    chosen = choices[0]
    for choice in choices[1:]:
        chosen = np.where(np.isnan(chosen), choice, chosen)
    return chosen
