"""Check of the gyroscope against the receiver: its unit and sign, and the lag between both.

The rate of turn about the vertical is the angular rate along the specific force, which points up
when averaged over ten seconds; so no mounting has to be known. Clockwise from above is positive, as
for a course.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from spoofbench.arrays import Floats
from spoofbench.doctor.findings import Finding, Severity
from spoofbench.doctor.inertial import ACCEL, GYRO
from spoofbench.doctor.motion import PositionSteps, course, position_steps, speed, wrapped
from spoofbench.gnss_time import leap_seconds
from spoofbench.recording import Recording
from spoofbench.table import Table

MIN_SPEED_MPS = 2.5
MAX_STEP_S = 3.0
LEG_M, MAX_LEG_S, CREEPING_MPS = 6.0, 8.0, 0.7
"""A course from positions alone needs some metres, in a few seconds, and no standing still."""

MIN_TURN_RAD = 0.02
MIN_STEPS = 20
MIN_TURNED_RAD = 2.0
"""Turned in sum, there has to be something to compare."""

UP_SECONDS = 10.0
MAX_LAG_S, COARSE_S = 22.0, 0.5
"""Beyond the leap seconds between GPS time and UTC, in steps shorter than a turn."""

CORRELATED = 0.75
LAG_S, GRAVE_LAG_S = 0.5, 2.0
"""Receivers filter their velocity by some tenths of a second."""

GAIN = 0.03
"""How much better the correlation at a lag has to be than that at none."""

SCALE_TOLERANCE = 0.15


@dataclass(frozen=True, slots=True, eq=False)
class _Turns:
    """Changes of course over the receiver's steps, ``(n,)`` rad, and the times of both ends in
    seconds of the IMU's axis.
    """

    start_s: Floats
    end_s: Floats
    turn: Floats


@dataclass(frozen=True, slots=True, eq=False)
class _Heading:
    """What the gyroscope adds up to, ``(m,)`` rad clockwise, and seconds since the IMU's first
    row.
    """

    time_s: Floats
    heading: Floats


def turns(recording: Recording) -> Iterator[Finding]:
    """Compare the primary receiver's turns with each gyroscope's."""
    topics = recording.topics("gnss/pvt")
    if not topics:
        return
    pvt = recording[topics[0]].last_per_time()
    for topic in recording.topics("imu"):
        imu = recording[topic].last_per_time()
        if not imu.has(*ACCEL, *GYRO) or len(imu) < MIN_STEPS or len(pvt) < MIN_STEPS:
            continue
        of_receiver = _turns(pvt, int(imu.time_ns[0]))
        of_gyro = _heading(imu)
        if of_receiver is not None and of_gyro is not None:
            leap_s = int(leap_seconds(pvt.time_ns[0]))
            yield from _compared(topic, of_receiver, of_gyro, leap_s)


def _compared(topic: str, turns: _Turns, heading: _Heading, leap_s: int) -> Iterator[Finding]:
    """Find the lag at which turns agree best: the gyroscope's heading shifted by it; positive where
    the gyroscope is ahead.
    """
    coarse_s = _best_lag(turns, heading, np.arange(-MAX_LAG_S, MAX_LAG_S + COARSE_S / 2, COARSE_S))
    if not np.isfinite(coarse_s):
        return
    lag_s = _best_lag(turns, heading, coarse_s + np.arange(-5, 6) * COARSE_S / 5)
    correlation, scale = _agreement(turns, heading, lag_s)
    unshifted = abs(_agreement(turns, heading, 0.0)[0])
    if abs(correlation) < CORRELATED:
        return
    yield from _scale(topic, correlation, scale)
    if LAG_S < abs(lag_s) < MAX_LAG_S - COARSE_S and not abs(correlation) < unshifted + GAIN:
        is_leap = abs(abs(lag_s) - leap_s) < GRAVE_LAG_S
        text = (
            f"the gyroscope turns {abs(lag_s):.1f} s {'ahead of' if lag_s > 0 else 'behind'} the "
            f"receiver's course (correlation {abs(correlation):.2f}, {unshifted:.2f} unshifted)"
            f"{', as if one of them gave GPS time for UTC' if is_leap else ''}"
        )
        severity: Severity = "error" if abs(lag_s) > GRAVE_LAG_S else "warning"
        advice = "align the two clocks, or use a detector that estimates the lag"
        yield Finding("imu-lag", severity, topic, text, advice)


def _scale(topic: str, correlation: float, scale: float) -> Iterator[Finding]:
    """Report a scale that is a mistaken unit, a sign, or otherwise not 1."""
    text = (
        f"the gyroscope's turns are {scale:.4g} times those of the receiver's course (correlation "
        f"{correlation:.2f})"
    )
    mistakes = {
        "deg/s were taken for rad/s": np.degrees(1),
        "it was multiplied by pi/180 twice": np.radians(1),
    }
    for mistake, factor in mistakes.items():
        if abs(abs(scale) / factor - 1) < 2 * SCALE_TOLERANCE:
            advice = "convert again with the right unit"
            yield Finding("gyro-unit", "error", topic, f"{text}: {mistake}", advice)
            return
    if correlation < 0:
        advice = (
            "the sign convention of the accelerometer or of the gyroscope is not that of the "
            "schema: one of both frames is mirrored"
        )
        yield Finding("gyro-sign", "warning", topic, text, advice)
    elif abs(scale - 1) > SCALE_TOLERANCE and abs(correlation) > 0.9:
        advice = "check scale and times of the gyroscope"
        yield Finding("gyro-scale", "warning", topic, text, advice)


def _best_lag(turns: _Turns, heading: _Heading, lags_s: Floats) -> float:
    """Return the lag of the largest correlation, NaN where there is none."""
    found = np.abs([_agreement(turns, heading, lag_s)[0] for lag_s in lags_s])
    return float(lags_s[np.nanargmax(found)]) if np.isfinite(found).any() else np.nan


def _agreement(turns: _Turns, heading: _Heading, lag_s: float) -> tuple[float, float]:
    """Return correlation and slope of the gyroscope's turns, shifted by a lag, over the
    receiver's.
    """
    time_s = heading.time_s + lag_s
    inside = (turns.start_s >= time_s[0]) & (turns.end_s <= time_s[-1])
    if inside.sum() < MIN_STEPS:
        return np.nan, np.nan
    start, end = (
        np.interp(at_s[inside], time_s, heading.heading) for at_s in (turns.start_s, turns.end_s)
    )
    by_gyro, by_receiver = end - start, turns.turn[inside]
    both = float(by_receiver @ by_gyro)
    norm = float(np.linalg.norm(by_receiver) * np.linalg.norm(by_gyro))
    return (both / norm, both / float(by_receiver @ by_receiver)) if norm else (np.nan, np.nan)


def _turns(pvt: Table, origin_ns: int) -> _Turns | None:
    """Return the receiver's turns by its course, or else by its positions; None where it does not
    turn enough.
    """
    course_rad, usable = course(pvt), speed(pvt) > MIN_SPEED_MPS
    times_s = (pvt.time_ns - origin_ns) / 1e9
    max_step_s = MAX_STEP_S
    if (np.isfinite(course_rad) & usable).sum() < MIN_STEPS:
        course_rad, times_s = _leg_bearings(position_steps(pvt), origin_ns)
        usable, max_step_s = np.isfinite(course_rad), 2 * MAX_LEG_S
    change = np.diff(course_rad)
    both = usable[:-1] & usable[1:] & np.isfinite(change) & (np.diff(times_s) <= max_step_s)
    turn = wrapped(change)[both]
    if both.sum() < MIN_STEPS or np.abs(turn[np.abs(turn) > MIN_TURN_RAD]).sum() < MIN_TURNED_RAD:
        return None
    return _Turns(times_s[:-1][both], times_s[1:][both], turn)


def _leg_bearings(steps: PositionSteps, origin_ns: int) -> tuple[Floats, Floats]:
    """Return bearings of legs between positions some metres apart, ``(k,)`` rad, NaN where a leg
    took long, and their middle times, s.
    """
    is_moving = steps.distance_m > CREEPING_MPS * steps.dt_s
    moved_m = np.cumsum(np.where(is_moving, steps.distance_m, 0.0))
    if moved_m.size < MIN_STEPS:
        return np.zeros(0), np.zeros(0)
    ends = np.unique(np.searchsorted(moved_m, np.arange(0.0, float(moved_m[-1]), LEG_M)))
    north_m, east_m = (
        np.diff(np.cumsum(steps.north_m)[ends]),
        np.diff(np.cumsum(steps.east_m)[ends]),
    )
    ends_s = ((steps.start_ns - origin_ns) / 1e9 + steps.dt_s)[ends]
    clear = (np.hypot(north_m, east_m) > LEG_M / 2) & (np.diff(ends_s) < MAX_LEG_S)
    return np.where(clear, np.arctan2(east_m, north_m), np.nan), (ends_s[1:] + ends_s[:-1]) / 2


def _heading(imu: Table) -> _Heading | None:
    """Return the heading that the gyroscope adds up to; None where there are too few samples."""
    force_s, force = _known(imu, ACCEL)
    times_s, rate = _known(imu, GYRO)
    if min(force_s.size, times_s.size) < MIN_STEPS:
        return None
    smooth = _smoothed(force, force_s)
    up = np.stack([np.interp(times_s, force_s, smooth[:, axis]) for axis in range(3)], axis=1)
    turn_rate = -(rate * up).sum(axis=1) / np.linalg.norm(up, axis=1)
    dt_s = np.minimum(np.diff(times_s), 1.0)  # a gap adds no more than is known
    turned = (turn_rate[1:] + turn_rate[:-1]) / 2 * dt_s
    return _Heading(times_s, np.concatenate([[0.0], np.cumsum(turned)]))


def _known(imu: Table, names: tuple[str, ...]) -> tuple[Floats, Floats]:
    """Return times of a sensor's samples, s since the first row, and the samples, ``(n, 3)``: each
    sensor may have rows of its own.
    """
    values = np.stack([imu[name] for name in names], axis=1)
    known = np.isfinite(values).all(axis=1)
    return (imu.time_ns[known] - imu.time_ns[0]) / 1e9, values[known]


def _smoothed(values: Floats, times_s: Floats) -> Floats:
    """Return the mean of the values within ten seconds around each time, ``(n, 3)``."""
    from scipy.ndimage import uniform_filter1d

    step_s = float(np.median(np.diff(times_s)))
    width = int(np.clip(UP_SECONDS / max(step_s, 1e-3), 1, values.shape[0]))
    return np.asarray(uniform_filter1d(values, width, axis=0, mode="nearest"))
