"""Checks of inertial data against the receiver: unit and sign of the gyroscope, and the lag between
both.

The rate of turn about the vertical is the angular rate along the specific force, which points up
when averaged over ten seconds; so no mounting has to be known. Clockwise from above is positive, as
for a course.
"""

from dataclasses import dataclass

import numpy as np

from spoofbench.doctor.finding import Finding
from spoofbench.doctor.inertial import ACCEL, GYRO
from spoofbench.doctor.motion import Floats, Steps, course, speed, steps, wrapped
from spoofbench.gnss_time import leap_seconds
from spoofbench.recording import Recording
from spoofbench.table import Table

SLOWEST_MPS = 2.5
LONGEST_STEP_S = 3.0
LEG_M, LONGEST_LEG_S, CREEPING_MPS = 6.0, 8.0, 0.7
"""A course from positions alone needs some metres, in a few seconds, and no standing still."""

LEAST_TURN_RAD = 0.02
LEAST_STEPS = 20
LEAST_TURNED_RAD = 2.0
"""Turned in sum, there has to be something to compare."""

UP_SECONDS = 10.0
MOST_LAG_S, COARSE_S = 22.0, 0.5
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


def turning(recording: Recording) -> list[Finding]:
    """Compare the primary receiver's turns with each gyroscope's."""
    topics = recording.topics("gnss/pvt")
    if not topics:
        return []
    pvt = recording[topics[0]].last_per_time()
    findings = []
    for topic in recording.topics("imu"):
        imu = recording[topic].last_per_time()
        if not imu.has(*ACCEL, *GYRO) or len(imu) < LEAST_STEPS or len(pvt) < LEAST_STEPS:
            continue
        turns = _turns(pvt, int(imu.time_ns[0]))
        heading_s, heading = _heading(imu)
        if turns is not None and heading.size:
            findings += _compared(
                topic, turns, heading_s, heading, int(leap_seconds(pvt.time_ns[0]))
            )
    return findings


def _compared(
    topic: str, turns: _Turns, heading_s: Floats, heading: Floats, leap_s: int
) -> list[Finding]:
    """Find the lag at which turns agree best: the gyroscope's heading shifted by it; positive where
    the gyroscope is ahead.
    """
    coarse = _best(
        turns, heading_s, heading, np.arange(-MOST_LAG_S, MOST_LAG_S + COARSE_S / 2, COARSE_S)
    )
    if not np.isfinite(coarse):
        return []
    lag_s = _best(turns, heading_s, heading, coarse + np.arange(-5, 6) * COARSE_S / 5)
    correlation, scale = _agreement(turns, heading_s + lag_s, heading)
    now = abs(_agreement(turns, heading_s, heading)[0])
    if abs(correlation) < CORRELATED:
        return []
    findings = _unit(topic, correlation, scale)
    if LAG_S < abs(lag_s) < MOST_LAG_S - COARSE_S and not abs(correlation) < now + GAIN:
        agreement = f"(correlation {abs(correlation):.2f}, {now:.2f} unshifted)"
        leap = (
            ", as if one of them gave GPS time for UTC"
            if abs(abs(lag_s) - leap_s) < GRAVE_LAG_S
            else ""
        )
        text = (
            f"the gyroscope turns {abs(lag_s):.1f} s {'ahead of' if lag_s > 0 else 'behind'} the "
            f"receiver's course {agreement}{leap}"
        )
        advice = "align the two clocks, or use a detector that estimates the lag"
        findings.append(
            Finding(
                "imu-lag", "error" if abs(lag_s) > GRAVE_LAG_S else "warning", topic, text, advice
            )
        )
    return findings


def _best(turns: _Turns, heading_s: Floats, heading: Floats, lags_s: Floats) -> float:
    """Return the lag of the largest correlation, NaN where there is none."""
    found = np.abs([_agreement(turns, heading_s + lag_s, heading)[0] for lag_s in lags_s])
    return float(lags_s[np.nanargmax(found)]) if np.isfinite(found).any() else np.nan


def _unit(topic: str, correlation: float, scale: float) -> list[Finding]:
    text = (
        f"the gyroscope's turns are {scale:.4g} times those of the receiver's course (correlation "
        f"{correlation:.2f})"
    )
    for mistake, factor in {
        "deg/s were taken for rad/s": np.degrees(1),
        "it was multiplied by pi/180 twice": np.radians(1),
    }.items():
        if abs(abs(scale) / factor - 1) < 2 * SCALE_TOLERANCE:
            return [
                Finding(
                    "gyro-unit",
                    "error",
                    topic,
                    f"{text}: {mistake}",
                    "convert again with the right unit",
                )
            ]
    if correlation < 0:
        advice = (
            "the sign convention of the accelerometer or of the gyroscope is not that of the "
            "schema: one of both frames is mirrored"
        )
        return [Finding("gyro-sign", "warning", topic, text, advice)]
    if abs(scale - 1) > SCALE_TOLERANCE and abs(correlation) > 0.9:
        return [
            Finding("gyro-scale", "warning", topic, text, "check scale and times of the gyroscope")
        ]
    return []


def _turns(pvt: Table, origin_ns: int) -> _Turns | None:
    """Return the receiver's turns by its course, or else by its positions; None where it does not
    turn enough.
    """
    said, usable = course(pvt), speed(pvt) > SLOWEST_MPS
    times_s = (pvt.time_ns - origin_ns) / 1e9
    longest_s = LONGEST_STEP_S
    if (np.isfinite(said) & usable).sum() < LEAST_STEPS:
        said, times_s = _tracked(steps(pvt), origin_ns)
        usable, longest_s = np.isfinite(said), 2 * LONGEST_LEG_S
    both = usable[:-1] & usable[1:] & np.isfinite(np.diff(said)) & (np.diff(times_s) <= longest_s)
    turn = wrapped(np.diff(said))[both]
    if (
        both.sum() < LEAST_STEPS
        or np.abs(turn[np.abs(turn) > LEAST_TURN_RAD]).sum() < LEAST_TURNED_RAD
    ):
        return None
    return _Turns(times_s[:-1][both], times_s[1:][both], turn)


def _tracked(way: Steps, origin_ns: int) -> tuple[Floats, Floats]:
    """Return bearings of legs between positions some metres apart, rad, NaN where a leg took long,
    and their middle times, s.
    """
    gone_m = np.cumsum(np.where(way.way_m > CREEPING_MPS * way.dt_s, way.way_m, 0.0))
    if gone_m.size < LEAST_STEPS:
        return np.zeros(0), np.zeros(0)
    marks = np.unique(np.searchsorted(gone_m, np.arange(0.0, float(gone_m[-1]), LEG_M)))
    north_m, east_m = np.cumsum(way.north_m), np.cumsum(way.east_m)
    ends_s = (way.start_ns - origin_ns) / 1e9 + way.dt_s
    north_m, east_m, ends_s = np.diff(north_m[marks]), np.diff(east_m[marks]), ends_s[marks]
    clear = (np.hypot(north_m, east_m) > LEG_M / 2) & (np.diff(ends_s) < LONGEST_LEG_S)
    return np.where(clear, np.arctan2(east_m, north_m), np.nan), (ends_s[1:] + ends_s[:-1]) / 2


def _heading(imu: Table) -> tuple[Floats, Floats]:
    """Return seconds since the first row, and the heading that the gyroscope adds up to, rad
    clockwise.
    """
    force_s, force = _known(imu, ACCEL)
    times_s, rate = _known(imu, GYRO)
    if min(force_s.size, times_s.size) < LEAST_STEPS:
        return np.zeros(0), np.zeros(0)
    smooth = _smoothed(force, force_s)
    up = np.stack([np.interp(times_s, force_s, smooth[:, axis]) for axis in range(3)], axis=1)
    turn = -(rate * up).sum(axis=1) / np.linalg.norm(up, axis=1)
    way = (
        (turn[1:] + turn[:-1]) / 2 * np.minimum(np.diff(times_s), 1.0)
    )  # a gap adds nothing that is not known
    return times_s, np.concatenate([[0.0], np.cumsum(way)])


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


def _agreement(turns: _Turns, heading_s: Floats, heading: Floats) -> tuple[float, float]:
    """Return correlation and slope of the gyroscope's turns over the receiver's."""
    inside = (turns.start_s >= heading_s[0]) & (turns.end_s <= heading_s[-1])
    if inside.sum() < LEAST_STEPS:
        return np.nan, np.nan
    turned = np.interp(turns.end_s[inside], heading_s, heading) - np.interp(
        turns.start_s[inside], heading_s, heading
    )
    said = turns.turn[inside]
    both = float(said @ turned)
    norm = float(np.linalg.norm(said) * np.linalg.norm(turned))
    return (both / norm, both / float(said @ said)) if norm else (np.nan, np.nan)
