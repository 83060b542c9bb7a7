"""Checks of rates: gaps, changes, repeated epochs, and inertial data too slow to be of use."""

import numpy as np

from spoofbench.doctor.finding import Finding, where
from spoofbench.doctor.motion import Floats, Times, runs
from spoofbench.formatting import counted
from spoofbench.recording import Recording
from spoofbench.schema import split_topic

REGULAR = ("imu", "gnss/pvt", "mag", "baro", "ins/pva")
"""Kinds that come at a rate; others come when there is something to say."""

GAP_FACTOR = 1.75
"""An interval longer than so many medians lacks an epoch."""

GRAVE_SHARE, GRAVE_GAP_S = 0.01, 10.0
"""Of the time without rows, and of the longest gap: what a detector has to be told about."""

BLOCK = 25
"""Intervals whose median is one reading of the rate."""

HARMLESS_GAP_S = 0.1
"""In a sensor's rows: vehicles hardly change their motion in it, and phones sample as irregularly.
"""

SLIGHT_SHARE, SLIGHT_GAP_S = 1e-3, 1.0
"""Below both there is nothing to say: a lost sample of a fast sensor."""

CHANGE_FACTOR, LASTING_SHARE = 1.5, 0.05
"""A rate is another one from half as much again, for a twentieth of the time."""

SLOW_IMU_HZ = 10.0
"""Below, fewer than ten samples fall between two epochs at 1 Hz: accelerations of a vehicle reach
to some hertz.
"""


def gaps(recording: Recording) -> list[Finding]:
    """Intervals in which one epoch is missing, or more."""
    findings = []
    for topic in _regular(recording):
        times = np.unique(recording[topic].time_ns)
        steps = np.diff(times)
        if steps.size < BLOCK:
            continue
        median = float(np.median(steps))
        least = 0.0 if split_topic(topic)[1] == "gnss/pvt" else HARMLESS_GAP_S * 1e9
        long = steps > np.maximum(GAP_FACTOR * _local_median(steps), least)
        missing_s = float((steps[long] - median).sum()) / 1e9
        longest_s = float(steps.max()) / 1e9
        share = missing_s * 1e9 / float(times[-1] - times[0])
        if not long.any() or (share < SLIGHT_SHARE and longest_s < SLIGHT_GAP_S):
            continue
        grave = (share > GRAVE_SHARE or longest_s > GRAVE_GAP_S) and topic == recording.topics(
            split_topic(topic)[1]
        )[0]
        usual = f"the longest {longest_s:.3g} s where rows come every {median / 1e9:.3g} s"
        text = f"{counted(int(long.sum()), 'gap')}, {missing_s:.1f} s without rows, {usual}"
        advice = "count these epochs as unavailable, and look whether the log was cut"
        findings.append(
            Finding(
                "rate-gap",
                "warning" if grave else "info",
                topic,
                text,
                advice,
                **where(times[1:][long]),
            )
        )
    return findings


def changes(recording: Recording) -> list[Finding]:
    """Rates that change for good: another setting, or a device that could not keep up."""
    findings = []
    for topic in _regular(recording):
        times = np.unique(recording[topic].time_ns)
        medians = _medians(np.diff(times))
        if medians.size < 4:
            continue
        usual = float(np.median(medians))
        other = (medians > CHANGE_FACTOR * usual) | (medians < usual / CHANGE_FACTOR)
        firsts, lengths = runs(other)
        lasting = np.array(
            [float(medians[a : a + n].sum()) for a, n in zip(firsts, lengths, strict=True)]
        ) * (lengths > 1)
        if lasting.size and lasting.max() > LASTING_SHARE * float(medians.sum()):
            longest = int(np.argmax(lasting))
            first, count = int(firsts[longest]), int(lengths[longest])
            rates = (
                f"{1e9 / usual:.3g} Hz, and "
                f"{1e9 / float(np.median(medians[first : first + count])):.3g} Hz"
            )
            text = (
                f"the rate is {rates} for {100 * float(lasting[longest] / medians.sum()):.0f} % of "
                "the time"
            )
            span = {
                "start_ns": int(times[first * BLOCK]),
                "end_ns": int(times[(first + count) * BLOCK]),
            }
            advice = "cut the log where the rate changes, or resample on purpose"
            findings.append(
                Finding("rate-change", "warning", topic, text, advice, count * BLOCK, **span)
            )
    return findings


def repeated_epochs(recording: Recording) -> list[Finding]:
    """Rows of one receiver that bear the same time."""
    findings = []
    for topic in recording.topics("gnss/pvt"):
        table = recording[topic]
        same = np.flatnonzero(np.diff(table.time_ns) == 0)
        if not same.size:
            continue
        differ = (table["lat_deg"][same] != table["lat_deg"][same + 1]) | (
            table["lon_deg"][same] != table["lon_deg"][same + 1]
        )
        text = (
            f"{same.size} epochs have more than one row, {int(differ.sum())} with different "
            "positions"
        )
        advice = (
            "the last row of a time counts; a log of two receivers has to be converted with "
            "--source"
        )
        findings.append(
            Finding(
                "repeated-epoch",
                "warning" if differ.any() else "info",
                topic,
                text,
                advice,
                **where(table.time_ns[same]),
            )
        )
    return findings


def slow_imu(recording: Recording) -> list[Finding]:
    """Inertial data that were decimated."""
    findings = []
    for topic in recording.topics("imu"):
        table = recording[topic]
        steps_s = np.diff(np.unique(table.time_ns)) / 1e9
        if steps_s.size < BLOCK or np.median(steps_s) <= 1 / SLOW_IMU_HZ:
            continue
        step_s = float(np.median(steps_s))
        averaged = table.has("interval_s") and float(np.nanmedian(table["interval_s"])) > step_s / 2
        how = (
            "averages" if averaged else "samples, so that vibration between them aliases into them"
        )
        text = f"the IMU comes at {1 / step_s:.3g} Hz as {how}"
        advice = "do not judge detectors by it that integrate inertial data between epochs"
        findings.append(Finding("slow-imu", "info" if averaged else "warning", topic, text, advice))
    return findings


def _regular(recording: Recording) -> list[str]:
    return [topic for topic in recording if split_topic(topic)[1] in REGULAR]


def _medians(steps: Times) -> Floats:
    """Return the median of each whole block of intervals."""
    return np.asarray(np.median(steps[: steps.size // BLOCK * BLOCK].reshape(-1, BLOCK), axis=1))


def _local_median(steps: Times) -> Floats:
    """Return the median interval of each one's block, so that a slower stretch is not all gaps."""
    medians = _medians(steps)
    return np.repeat(
        medians, BLOCK + (np.arange(medians.size) == medians.size - 1) * (steps.size % BLOCK)
    )
