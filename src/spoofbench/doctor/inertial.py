"""Checks of inertial data by themselves: unit and sign of gravity, range, samples that froze."""

import numpy as np

from spoofbench.doctor.finding import Finding, facts, where
from spoofbench.doctor.motion import Bools, Floats, runs, speed
from spoofbench.recording import Recording
from spoofbench.schema import split_topic
from spoofbench.table import Table

GRAVITY_MPS2 = 9.80665
ACCEL = ("accel_x_mps2", "accel_y_mps2", "accel_z_mps2")
GYRO = ("gyro_x_radps", "gyro_y_radps", "gyro_z_radps")
AXES = ("x", "y", "z")

STOPPED_MPS = 0.3
LEAST_REST = 50
"""Samples at rest that give a mean."""

REST_TOLERANCE, MOVING_TOLERANCE = 0.04, 0.12
"""Of gravity: a consumer sensor's bias and scale; and of the median over a drive."""

GRAVITY_UNITS = {
    "it is in g": 1 / GRAVITY_MPS2,
    "it was multiplied by 9.81 twice": GRAVITY_MPS2,
    "it is in cm/s2": 100.0,
    "it is in mg": 1000.0 / GRAVITY_MPS2,
    "it is in ft/s2": 1 / 0.3048,
}
FREE_MPS2 = 3.0
"""A magnitude below it, in the median, has no gravity in it."""

UPRIGHT = 0.8
"""Share of gravity on one axis that makes it the vertical one."""

FASTEST_RADPS = 36.0
"""The widest range of the usual sensors is 2000 deg/s, 34.9 rad/s."""

FULL_SCALES = {
    "accel": np.array([2, 4, 8, 16]) * GRAVITY_MPS2,
    "gyro": np.radians([125, 245, 250, 500, 1000, 2000]),
}
AT_FULL_SCALE = 0.015
LEAST_CLIPPED = 3
FROZEN_ROWS = 10
"""Rows in which all six axes repeat: the noise of any sensor changes some digit sooner."""


def gravity(recording: Recording) -> list[Finding]:
    """Specific force at rest that is not gravity: another unit, or acceleration without gravity."""
    findings = []
    for topic in recording.topics("imu"):
        table = recording[topic]
        if not table.has(*ACCEL):
            continue
        force = np.stack([table[name] for name in ACCEL], axis=1)
        rest = at_rest(recording, table)
        known = np.isfinite(force).all(axis=1)
        resting = rest is not None and int((rest & known).sum()) >= LEAST_REST
        rows = known & rest if resting and rest is not None else known
        if int(rows.sum()) < LEAST_REST:
            continue
        size = float(np.median(np.linalg.norm(force[rows], axis=1)))
        findings += _gravity(topic, size, resting)
        if not findings or findings[-1].topic != topic:
            findings += _vertical(recording, topic, np.median(force[rows], axis=0))
    return findings


def _gravity(topic: str, size: float, resting: bool) -> list[Finding]:
    when = "at rest" if resting else "in the median"
    text = f"the specific force is {size:.3g} m/s2 {when}"
    if abs(size / GRAVITY_MPS2 - 1) < (REST_TOLERANCE if resting else MOVING_TOLERANCE):
        return []
    for mistake, factor in GRAVITY_UNITS.items():
        if abs(size / (factor * GRAVITY_MPS2) - 1) < MOVING_TOLERANCE:
            return [
                Finding(
                    "accel-unit",
                    "error",
                    topic,
                    f"{text}: {mistake}",
                    "convert again with the right unit",
                )
            ]
    if size < FREE_MPS2:
        advice = (
            "it belongs to linear_accel_*: convert again, with the sensor that includes gravity if "
            "the device logged one"
        )
        return [
            Finding(
                "accel-without-gravity", "error", topic, f"{text}: gravity is not in it", advice
            )
        ]
    if abs(size / GRAVITY_MPS2 - 1) < MOVING_TOLERANCE:
        return [
            Finding(
                "accel-scale",
                "info",
                topic,
                f"{text}, {size - GRAVITY_MPS2:+.2f} from gravity",
                "estimate bias and scale before integrating",
            )
        ]
    return [
        Finding(
            "accel-scale", "warning", topic, text, "check unit, scale and bias of the accelerometer"
        )
    ]


def _vertical(recording: Recording, topic: str, force: Floats) -> list[Finding]:
    """Say which axis carries gravity, where the metadata do not, and contradict them where they are
    wrong.
    """
    share = force / np.linalg.norm(force)
    axis = int(np.argmax(np.abs(share)))
    if abs(share[axis]) < UPRIGHT:
        return []
    found = f"{'+' if share[axis] > 0 else '-'}{AXES[axis]}"
    axes = facts(recording, f"source/{split_topic(topic)[0]}").get("axes", "").lower()
    text = (
        f"specific force at rest is along {found}, so that this axis points "
        f"{'up' if share[axis] > 0 else 'down'}"
    )
    if not (len(axes) == 3 and set(axes) <= set("frdlbu")):
        advice = (
            "axes are not known: a mounting has to be estimated before axes are compared with "
            "motion"
        )
        return [
            Finding(
                "vertical-axis",
                "info",
                topic,
                f"{text.replace(', so that this axis points', ' (pointing')})",
                advice,
            )
        ]
    said = next(
        (
            f"{'+' if letter == 'u' else '-'}{AXES[i]}"
            for i, letter in enumerate(axes)
            if letter in "ud"
        ),
        None,
    )
    if said is None or said == found:
        return []
    advice = "the sign convention of the accelerometer, or the axes, are not what was declared"
    return [
        Finding(
            "accel-sign",
            "error",
            topic,
            f"{text}, but with axes {axes} it has to be along {said}",
            advice,
        )
    ]


def at_rest(recording: Recording, table: Table) -> Bools | None:
    """Return which rows lie between epochs at which the primary receiver stands; None where no
    receiver says a speed.
    """
    topics = recording.topics("gnss/pvt")
    if not topics:
        return None
    pvt = recording[topics[0]].last_per_time()
    said = speed(pvt)
    if np.isfinite(said).sum() < 2:
        return None
    place = np.searchsorted(pvt.time_ns, table.time_ns)
    before, after = np.clip(place - 1, 0, len(pvt) - 1), np.clip(place, 0, len(pvt) - 1)
    near = (table.time_ns - pvt.time_ns[before] < 2e9) & (pvt.time_ns[after] - table.time_ns < 2e9)
    return np.asarray(near & (said[before] < STOPPED_MPS) & (said[after] < STOPPED_MPS))


def ranges(recording: Recording) -> list[Finding]:
    """Angular rates beyond any sensor, and samples that stop at the end of a sensor's range."""
    findings = []
    for topic in recording.topics("imu"):
        table = recording[topic]
        for name in (*ACCEL, *GYRO):
            size = np.abs(table[name])
            if not np.isfinite(size).any():
                continue
            most = float(np.nanmax(size))
            if name in GYRO and most > FASTEST_RADPS:
                text = (
                    f"{name} reaches {most:.0f} rad/s, more than sensors measure: it may be in "
                    "degrees"
                )
                findings.append(
                    Finding("gyro-range", "warning", topic, text, "check the unit of the gyroscope")
                )
                break
            clipped = _clipped(size, most, FULL_SCALES[name.partition("_")[0]])
            if clipped.any():
                text = (
                    f"{name} stops at {most:.4g} in {int(clipped.sum())} samples: the sensor's "
                    "range ended there"
                )
                advice = "do not integrate over these samples"
                findings.append(
                    Finding(
                        "imu-saturated",
                        "warning",
                        topic,
                        text,
                        advice,
                        **where(table.time_ns[clipped]),
                    )
                )
    return findings


def _clipped(size: Floats, most: float, scales: Floats) -> Bools:
    """Which samples stand at the largest value, one of the usual ranges, several in a row."""
    at_most = size >= most * (1 - 1e-9)
    if not np.any(np.abs(most / scales - 1) < AT_FULL_SCALE) or not np.any(
        runs(at_most)[1] >= LEAST_CLIPPED
    ):
        return np.zeros(size.size, bool)
    return np.asarray(at_most)


def frozen(recording: Recording) -> list[Finding]:
    """Inertial samples that repeat in all axes, and axes that are all zero."""
    findings = []
    for topic in recording.topics("imu"):
        table = recording[topic]
        for sensor, names in (("accelerometer", ACCEL), ("gyroscope", GYRO)):
            if not table.has(*names):
                continue
            values = np.stack([table[name] for name in names], axis=1)
            known = np.isfinite(values).all(axis=1)
            values, times = values[known], table.time_ns[known]
            still = (values == 0).all(axis=0)
            if still.any() and times.size >= LEAST_REST:
                which = ", ".join(AXES[i] for i in np.flatnonzero(still))
                text = f"the {sensor} says 0 in all rows on {which}"
                findings.append(
                    Finding(
                        "all-zero",
                        "error" if still.all() else "warning",
                        topic,
                        text,
                        "absent was written as 0: leave it out",
                    )
                )
                continue
            firsts, lengths = runs((np.diff(values, axis=0) == 0).all(axis=1))
            long = lengths >= FROZEN_ROWS
            if long.any():
                rows = int(lengths[long].sum())
                held_s = float((times[firsts + lengths] - times[firsts])[long].max()) / 1e9
                text = (
                    f"the {sensor} repeats its sample in {rows} rows, for {held_s:.2g} s at the "
                    "longest"
                )
                advice = "treat these stretches as gaps"
                span = where(times[firsts[long]]) | {"count": rows}
                findings.append(Finding("frozen-imu", "warning", topic, text, advice, **span))
    return findings
