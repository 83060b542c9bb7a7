"""Checks of inertial sensors and magnetometers by themselves: unit and sign of gravity, range,
samples that froze, and the size of the Earth's magnetic field.
"""

from collections.abc import Iterator

import numpy as np

from spoofbench.arrays import Bools, Floats
from spoofbench.doctor.findings import Finding, Severity, extent, metadata_record
from spoofbench.doctor.motion import runs, speed
from spoofbench.recording import Recording
from spoofbench.schema import split_topic
from spoofbench.table import Table

GRAVITY_MPS2 = 9.80665
ACCEL = ("accel_x_mps2", "accel_y_mps2", "accel_z_mps2")
GYRO = ("gyro_x_radps", "gyro_y_radps", "gyro_z_radps")
FIELD = ("field_x_ut", "field_y_ut", "field_z_ut")
AXES = ("x", "y", "z")

STOPPED_MPS = 0.3
MIN_SAMPLES = 50
"""Samples that give a mean."""

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

MAX_RATE_RADPS = 36.0
"""The widest range of the usual sensors is 2000 deg/s, 34.9 rad/s."""

FULL_SCALES = {
    "accel": np.array([2, 4, 8, 16]) * GRAVITY_MPS2,
    "gyro": np.radians([125, 245, 250, 500, 1000, 2000]),
}
FULL_SCALE_TOLERANCE = 0.015
MIN_CLIPPED = 3
FROZEN_ROWS = 10
"""Rows in which all axes repeat: the noise of any sensor changes some digit sooner."""

EARTH_FIELD = "the Earth's is 22 to 67"
"""In uT, at the surface (IGRF-13; Alken et al., Earth, Planets and Space 73, 2021)."""

MIN_FIELD_UT, MAX_FIELD_UT = 10.0, 110.0
"""With what iron near a sensor adds or takes away."""

FIELD_UNITS = {
    "it is in mT": 1e-3,
    "it is in gauss": 1e-2,
    "it is in milligauss": 10.0,
    "it is in nT": 1e3,
    "it is in gauss, but declared in tesla": 1e4,
    "it is in uT, but declared in tesla": 1e6,
    "it is in milligauss, but declared in tesla": 1e7,
    "it is in nT, but declared in tesla": 1e9,
    "it is in tesla": 1e-6,
}
MAX_BIAS = 50
"""Iron near a sensor adds less than so many times the Earth's field: a factor above it is a unit.
"""

MAX_FIELD_SPAN_UT = 2 * MAX_FIELD_UT
"""What turning in the Earth's field can change of one axis, whatever is added to it."""


def gravity(recording: Recording) -> Iterator[Finding]:
    """Specific force at rest that is not gravity: another unit, or acceleration without gravity."""
    for topic in recording.topics("imu"):
        table = recording[topic]
        if not table.has(*ACCEL):
            continue
        force = np.stack([table[name] for name in ACCEL], axis=1)
        known = np.isfinite(force).all(axis=1)
        resting = known & _at_rest(recording, table)
        is_resting = int(resting.sum()) >= MIN_SAMPLES
        rows = resting if is_resting else known
        if int(rows.sum()) < MIN_SAMPLES:
            continue
        size_mps2 = float(np.median(np.linalg.norm(force[rows], axis=1)))
        finding = _gravity_size(topic, size_mps2, is_resting) or _vertical_axis(
            recording, topic, np.median(force[rows], axis=0)
        )
        if finding is not None:
            yield finding


def _at_rest(recording: Recording, table: Table) -> Bools:
    """Return which rows lie between epochs at which the primary receiver stands, ``(n,)``; none
    where no receiver reports a speed.
    """
    topics = recording.topics("gnss/pvt")
    if not topics:
        return np.zeros(len(table), bool)
    pvt = recording[topics[0]].last_per_time()
    speed_mps = speed(pvt)
    if np.isfinite(speed_mps).sum() < 2:
        return np.zeros(len(table), bool)
    index = np.searchsorted(pvt.time_ns, table.time_ns)
    before, after = np.clip(index - 1, 0, len(pvt) - 1), np.clip(index, 0, len(pvt) - 1)
    near = (table.time_ns - pvt.time_ns[before] < 2e9) & (pvt.time_ns[after] - table.time_ns < 2e9)
    stopped = (speed_mps[before] < STOPPED_MPS) & (speed_mps[after] < STOPPED_MPS)
    return np.asarray(near & stopped)


def _gravity_size(topic: str, size_mps2: float, is_resting: bool) -> Finding | None:
    """Return what is wrong with the magnitude of the specific force, None where nothing is."""
    when = "at rest" if is_resting else "in the median"
    text = f"the specific force is {size_mps2:.3g} m/s2 {when}"
    off = abs(size_mps2 / GRAVITY_MPS2 - 1)
    if off < (REST_TOLERANCE if is_resting else MOVING_TOLERANCE):
        return None
    for mistake, factor in GRAVITY_UNITS.items():
        if abs(size_mps2 / (factor * GRAVITY_MPS2) - 1) < MOVING_TOLERANCE:
            advice = "convert again with the right unit"
            return Finding("accel-unit", "error", topic, f"{text}: {mistake}", advice)
    if size_mps2 < FREE_MPS2:
        text = f"{text}: gravity is not in it"
        advice = (
            "it belongs to linear_accel_*: convert again, with the sensor that includes gravity if "
            "the device logged one"
        )
        return Finding("accel-without-gravity", "error", topic, text, advice)
    if off < MOVING_TOLERANCE:
        text = f"{text}, {size_mps2 - GRAVITY_MPS2:+.2f} from gravity"
        return Finding(
            "accel-scale", "info", topic, text, "estimate bias and scale before integrating"
        )
    advice = "check unit, scale and bias of the accelerometer"
    return Finding("accel-scale", "warning", topic, text, advice)


def _vertical_axis(recording: Recording, topic: str, force: Floats) -> Finding | None:
    """Return which axis carries gravity where the metadata do not say so or contradict it.

    ``force`` is ``(3,)``.
    """
    share = force / np.linalg.norm(force)
    axis = int(np.argmax(np.abs(share)))
    if abs(share[axis]) < UPRIGHT:
        return None
    is_up = share[axis] > 0
    found, direction = f"{'+' if is_up else '-'}{AXES[axis]}", "up" if is_up else "down"
    text = f"specific force at rest is along {found}"
    axes = metadata_record(recording, f"source/{split_topic(topic)[0]}").get("axes", "").lower()
    if not (len(axes) == 3 and set(axes) <= set("frdlbu")):
        text = f"{text} (pointing {direction})"
        advice = (
            "axes are not known: a mounting has to be estimated before axes are compared with "
            "motion"
        )
        return Finding("vertical-axis", "info", topic, text, advice)
    verticals = [(i, letter) for i, letter in enumerate(axes) if letter in "ud"]
    if not verticals:
        return None
    i, letter = verticals[0]
    declared = f"{'+' if letter == 'u' else '-'}{AXES[i]}"
    if declared == found:
        return None
    text = (
        f"{text}, so that this axis points {direction}, but with axes {axes} it has to be along "
        f"{declared}"
    )
    advice = "the sign convention of the accelerometer, or the axes, are not what was declared"
    return Finding("accel-sign", "error", topic, text, advice)


def ranges(recording: Recording) -> Iterator[Finding]:
    """Angular rates beyond any sensor, and samples that stop at the end of a sensor's range."""
    for topic in recording.topics("imu"):
        table = recording[topic]
        for name in (*ACCEL, *GYRO):
            size = np.abs(table[name])
            if not np.isfinite(size).any():
                continue
            largest = float(np.nanmax(size))
            if name in GYRO and largest > MAX_RATE_RADPS:
                text = (
                    f"{name} reaches {largest:.0f} rad/s, more than sensors measure: it may be in "
                    "degrees"
                )
                advice = "check the unit of the gyroscope"
                yield Finding("gyro-range", "warning", topic, text, advice)
                break
            clipped = size >= largest * (1 - 1e-9)
            scales = FULL_SCALES[name.partition("_")[0]]
            is_full_scale = bool(np.any(np.abs(largest / scales - 1) < FULL_SCALE_TOLERANCE))
            if is_full_scale and np.any(runs(clipped)[1] >= MIN_CLIPPED):
                text = (
                    f"{name} stops at {largest:.4g} in {int(clipped.sum())} samples: the sensor's "
                    "range ended there"
                )
                rows = extent(table.time_ns[clipped])
                advice = "do not integrate over these samples"
                yield Finding("imu-saturated", "warning", topic, text, advice, **rows)


def frozen(recording: Recording) -> Iterator[Finding]:
    """Inertial samples that repeat in all axes, and axes that are all zero."""
    for topic in recording.topics("imu"):
        table = recording[topic]
        for sensor, names in (("accelerometer", ACCEL), ("gyroscope", GYRO)):
            if not table.has(*names):
                continue
            values = np.stack([table[name] for name in names], axis=1)
            known = np.isfinite(values).all(axis=1)
            values, times = values[known], table.time_ns[known]
            is_zero = (values == 0).all(axis=0)
            if is_zero.any() and times.size >= MIN_SAMPLES:
                which = ", ".join(AXES[i] for i in np.flatnonzero(is_zero))
                text = f"the {sensor} reports 0 in all rows on {which}"
                severity: Severity = "error" if is_zero.all() else "warning"
                advice = "absent was written as 0: leave it out"
                yield Finding("all-zero", severity, topic, text, advice)
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
                span = extent(times[firsts[long]]) | {"count": rows}
                yield Finding("frozen-imu", "warning", topic, text, advice, **span)


def magnetic_fields(recording: Recording) -> Iterator[Finding]:
    """Magnetic flux densities that are not of the Earth's size: another unit, or a bias."""
    for topic in recording.topics("mag"):
        field = np.stack([recording[topic][name] for name in FIELD], axis=1)
        field = field[np.isfinite(field).all(axis=1)]
        if len(field) < MIN_SAMPLES:
            continue
        size = float(np.median(np.linalg.norm(field, axis=1)))
        if size == 0 or MIN_FIELD_UT <= size <= MAX_FIELD_UT:
            continue
        text = (
            f"the magnetic flux density is {size:,.{0 if size > 10 else 4}f} uT in the median "
            f"where {EARTH_FIELD}"
        )
        span = float(np.ptp(np.percentile(field, (1, 99), axis=0), axis=0).max())
        if MAX_FIELD_UT < size < MAX_BIAS * MAX_FIELD_UT and span <= MAX_FIELD_SPAN_UT:
            text = f"{text}, but changes like it"
            advice = (
                "estimate the bias, such as of iron near the sensor, before headings are taken "
                "from it"
            )
            yield Finding("mag-bias", "info", topic, text, advice)
            continue
        units = [
            unit
            for unit, factor in FIELD_UNITS.items()
            if MIN_FIELD_UT <= size / factor <= MAX_FIELD_UT
        ]
        if units:
            advice = "convert again with the right unit"
            yield Finding("mag-unit", "error", topic, f"{text}: {units[0]}", advice)
        else:
            advice = "check unit and scale of the magnetometer"
            yield Finding("mag-scale", "warning", topic, text, advice)
