"""Checks of time: which clock tells it, and whether it is the one that it is said to be."""

import json
import re

import numpy as np

from spoofbench.doctor.claims import ROLLOVER_S, claimed_gps_s
from spoofbench.doctor.finding import Finding, facts, where
from spoofbench.doctor.motion import Floats, Times
from spoofbench.formatting import counted
from spoofbench.gnss_time import SECOND_NS, leap_seconds
from spoofbench.recording import Recording
from spoofbench.schema import SENSOR_KINDS, split_topic
from spoofbench.table import Table

MODIFIED = "modified_ns"
"""When the log was last written: the doctor adds it to the metadata ``origin`` of a log that it
converts.
"""

QUARTER_S = 900.0
"""Zones of the world are whole multiples of 15 minutes from UTC."""

MOST_ZONE_S = 14 * 3600.0
ZONE_TOLERANCE_S = 30.0
"""Host clocks without network time are off by so much."""

ROLLOVER_TOLERANCE_S = 2 * 86_400.0
EARLIEST_S = 631_152_000.0
"""1990: earlier dates are those that a clock starts with."""

LEAP_TOLERANCE_S = 0.5
DRIFT_WARNING, DRIFT_ERROR = 1e-4, 1e-3
"""Uncompensated quartz stays below 1e-4; above 1e-3 seconds are not seconds."""

DRIFT_LEAST_S = 120.0
STEP_S = 0.5
SLOW_S = 0.05
HEADER_OFFSET_S = 1.0
"""Between measurement and recording lie milliseconds; above, two clocks differ."""


def rollover(recording: Recording) -> list[Finding]:
    """Dates that are whole periods of 1024 weeks away from other evidence: claimed week, receive
    time, name and age of the file.
    """
    findings = []
    for topic, said in _evidence(recording).items():
        for what, offset_s in said.items():
            periods = round(offset_s / ROLLOVER_S)
            if periods and abs(offset_s - periods * ROLLOVER_S) < ROLLOVER_TOLERANCE_S:
                findings.append(
                    Finding(
                        "week-rollover",
                        "error",
                        topic,
                        f"the dates are {-1024 * periods:+} weeks off from {what}",
                        (
                            f"convert again with {1024 * periods:+} weeks (-p "
                            f"week_rollover={periods}), or with --date"
                        ),
                    )
                )
                break
    return findings


def _evidence(recording: Recording) -> dict[str, dict[str, float]]:
    """By topic, evidence minus the rows' own times, s, by what it is."""
    said: dict[str, dict[str, float]] = {}
    for topic in recording.topics("gnss/pvt"):
        table = recording[topic]
        offsets = {
            "the GPS week that the receiver claims": _median(
                claimed_gps_s(table) - table.time_ns / 1e9
            )
        }
        offsets["the times of receipt"] = _median(_received(table))
        said[topic] = {what: offset for what, offset in offsets.items() if np.isfinite(offset)}
    times = [
        recording[topic].time_ns
        for topic in recording
        if split_topic(topic)[1] in SENSOR_KINDS and len(recording[topic])
    ]
    if times:
        start_s = min(int(time[0]) for time in times) / 1e9
        said[""] = {}
        modified = facts(recording, "origin").get(MODIFIED, "")
        if modified.isdecimal() and len(modified) < 20:
            said[""]["the time when the file was last written"] = int(modified) / 1e9 - start_s
        named = _date_in_name(facts(recording, "origin").get("file", ""), start_s)
        if named is not None:
            said[""]["the date in the file's name"] = named - start_s
    return said


def _date_in_name(name: str, start_s: float) -> float | None:
    """Unix time of the date in a file's name; of a year alone, the day one or two rollovers on that
    lies in it.
    """
    found = re.search(
        r"(?<!\d)(20\d\d)[-_.]?(0[1-9]|1[0-2])[-_.]?(0[1-9]|[12]\d|3[01])(?!\d{2}(?!\d))", name
    )
    if found:
        try:
            return float(
                np.datetime64("-".join(found.groups())).astype("datetime64[s]").astype(np.int64)
            )
        except ValueError:
            return None
    year = re.search(r"(?<!\d)(20\d\d)(?!\d)", name)
    for periods in (1, 2):
        later_s = start_s + periods * ROLLOVER_S
        if year and str(np.datetime64(int(later_s), "s"))[:4] == year.group(1):
            return later_s
    return None


def default_dates(recording: Recording) -> list[Finding]:
    """Times before 1990, and the week 0 that receivers claim before they know better."""
    early = {
        topic: recording[topic].time_ns[recording[topic].time_ns < EARLIEST_S * 1e9]
        for topic in recording
    }
    if (
        sum(times.size for times in early.values())
        == sum(len(recording[topic]) for topic in recording)
        > 0
    ):
        text = (
            "all times are before 1990: they count from when the device was switched on, or "
            "another start"
        )
        return [
            Finding(
                "no-date", "warning", "", text, "convert again with --date where the date matters"
            )
        ]
    findings = []
    for topic, times in early.items():
        if times.size:
            text = f"{counted(times.size, 'row')} before 1990: the clock had no date yet"
            findings.append(
                Finding(
                    "default-date",
                    "error",
                    topic,
                    text,
                    "convert again with --date",
                    **where(times),
                )
            )
    for topic in recording.topics("gnss/pvt"):
        table = recording[topic]
        zero = table.valid("gps_week") & (table["gps_week"] == 0)
        if zero.any():
            text = f"the receiver claims GPS week 0 in {counted(int(zero.sum()), 'epoch')}"
            advice = "leave them out where time of week or date matters"
            findings.append(
                Finding(
                    "default-date", "warning", topic, text, advice, **where(table.time_ns[zero])
                )
            )
    return findings


def leaps(recording: Recording) -> list[Finding]:
    """GPS time passed off as UTC, or the leap seconds of another year."""
    findings = []
    for topic in recording.topics("gnss/pvt"):
        table = recording[topic]
        offset_s = _median(claimed_gps_s(table) - table.time_ns / 1e9)
        if len(table) and np.isfinite(offset_s) and abs(offset_s) < 60:
            right = int(leap_seconds(table.time_ns[0]))
            if abs(offset_s) < LEAP_TOLERANCE_S < right:
                text = (
                    f"the times equal the GPS time that the receiver claims: they are {right} s "
                    "ahead of UTC"
                )
                findings.append(
                    Finding(
                        "gps-time-as-utc",
                        "error",
                        topic,
                        text,
                        f"subtract {right} s, or say in the mapping that it is GPS time",
                    )
                )
            elif _clock(recording) == "gnss" and abs(offset_s - right) > LEAP_TOLERANCE_S:
                text = (
                    f"GPS time is {offset_s:.1f} s ahead of the times where leap seconds make it "
                    f"{right} s"
                )
                findings.append(
                    Finding(
                        "leap-seconds",
                        "warning",
                        topic,
                        text,
                        "do not mix these times with those of other devices",
                    )
                )
        received_s = -_median(_received(table))
        right = int(leap_seconds(table.time_ns[0])) if len(table) else 0
        if right and right - 2 < received_s < right + LEAP_TOLERANCE_S:
            text = (
                f"rows are dated {received_s:.1f} s after their receipt, as GPS time is ahead of "
                f"UTC by {right} s"
            )
            findings.append(
                Finding(
                    "gps-time-as-utc",
                    "warning",
                    topic,
                    text,
                    f"subtract {right} s if the host kept UTC",
                )
            )
    return findings


def zones(recording: Recording) -> list[Finding]:
    """Local time passed off as UTC: whole quarters of an hour between two clocks."""
    findings = []
    for topic in recording:
        table = recording[topic]
        said = {"the times of receipt": _median(_received(table))}
        if split_topic(topic)[1] == "gnss/pvt":
            said["the GPS time that the receiver claims"] = _median(
                claimed_gps_s(table) - table.time_ns / 1e9
            )
        findings += [
            _zone(topic, offset, what) for what, offset in said.items() if _is_zone(offset)
        ][:1]
    return findings or _zones_between(recording)


def _zones_between(recording: Recording) -> list[Finding]:
    """The same between two sources that were switched on and off together but never overlap."""
    topics = [
        topic
        for topic in recording
        if split_topic(topic)[1] in ("imu", "gnss/pvt") and len(recording[topic]) > 1
    ]
    for topic in topics[1:]:
        one, other = recording[topics[0]].time_ns, recording[topic].time_ns
        starts_s, ends_s = (
            (int(other[0]) - int(one[0])) / 1e9,
            (int(other[-1]) - int(one[-1])) / 1e9,
        )
        apart = other[0] > one[-1] or one[0] > other[-1]
        if (
            apart
            and _is_zone(starts_s)
            and _is_zone(ends_s)
            and abs(starts_s - ends_s) < ZONE_TOLERANCE_S
        ):
            return [_zone(topic, -(starts_s + ends_s) / 2, f"those of {topics[0]}")]
    return []


def _is_zone(offset_s: float) -> bool:
    if (
        not np.isfinite(offset_s)
        or not QUARTER_S / 2 < abs(offset_s) <= MOST_ZONE_S + ZONE_TOLERANCE_S
    ):
        return False
    return abs(offset_s - round(offset_s / QUARTER_S) * QUARTER_S) < ZONE_TOLERANCE_S


def _zone(topic: str, offset_s: float, what: str) -> Finding:
    hours = round(offset_s / QUARTER_S) / 4
    text = f"the times are {-hours:+g} h off from {what}, which is a time zone"
    return Finding(
        "local-time-as-utc", "error", topic, text, "convert again with the zone declared"
    )


def steps_of_clock(recording: Recording) -> list[Finding]:
    """Steps of the claimed or logged clock: those that the converter noted, else those against the
    rows' times.
    """
    noted = facts(recording, "recording")
    count = noted.get("clock_step_count", "0")
    if count.isdecimal() and len(count) < 10 and int(count):
        first = next(iter(_list(noted.get("clock_steps", "[]"))), {})
        step_s = (_number(first.get("to_ns")) - _number(first.get("from_ns"))) / 1e9
        text = f"the clock that the log claims makes {counted(int(count), 'step')}" + (
            f", first by {step_s:+.3f} s" if np.isfinite(step_s) else ""
        )
        advice = (
            "see recording.clock_steps for where; if rows were skipped for it, --append-clock "
            "keeps them"
        )
        return [Finding("clock-step", "warning", "", text, advice, int(count))]
    findings = []
    for topic in recording.topics("gnss/pvt"):
        table = recording[topic].last_per_time()
        offsets = claimed_gps_s(table) - table.time_ns / 1e9
        known = np.flatnonzero(np.isfinite(offsets))
        jumps = np.abs(np.diff(offsets[known])) > STEP_S
        if jumps.any():
            text = (
                f"the GPS time that the receiver claims makes {counted(int(jumps.sum()), 'step')} "
                "against the rows' times"
            )
            advice = "a receiver that was restarted, or an attack on time: look at these epochs"
            findings.append(
                Finding(
                    "clock-step",
                    "warning",
                    topic,
                    text,
                    advice,
                    **where(table.time_ns[known[1:][jumps]]),
                )
            )
    return findings


def drift(recording: Recording) -> list[Finding]:
    """A recorder's or sensor's second that is not a second of GNSS time."""
    findings: list[Finding] = []
    if _clock(recording) == "gnss":  # made of the claimed time itself
        return findings
    for topic in recording.topics("gnss/pvt"):
        table = recording[topic].last_per_time()
        rate = _drift(table.time_ns, claimed_gps_s(table))
        if np.isfinite(rate) and abs(rate) > DRIFT_WARNING:
            runs = f"the recording's clock runs at {1 / (1 + rate):.5f} of GNSS time"
            text = runs if rate > -1 else "the GNSS time that is claimed stands still, or runs back"
            advice = (
                "all rates and intervals of its sensors are off by as much: scale their times "
                "before comparing with GNSS"
            )
            findings.append(
                Finding(
                    "clock-drift",
                    "error" if abs(rate) > DRIFT_ERROR else "warning",
                    topic,
                    text,
                    advice,
                )
            )
    return findings


def _drift(time_ns: Times, claimed_s: Floats) -> float:
    """Return how much faster than the rows' times the claimed time runs: the median over ten
    stretches, so that steps do not count.
    """
    known = np.isfinite(claimed_s)
    times_s, claimed = (time_ns[known] - time_ns[:1]) / 1e9, claimed_s[known]
    if times_s.size < 20 or times_s[-1] - times_s[0] < DRIFT_LEAST_S:
        return np.nan
    marks = np.unique(np.linspace(0, times_s.size - 1, 11).astype(int))
    ways = np.diff(times_s[marks])
    return float(np.median(np.diff(claimed[marks])[ways > 0] / ways[ways > 0])) - 1


def offsets(recording: Recording) -> list[Finding]:
    """Offsets between clocks that the converter measured: a host's from GNSS time, message headers'
    from the recorder's.
    """
    findings = []
    host_s = _float(facts(recording, "recording").get("gnss_minus_clock_ns")) / 1e9
    if abs(host_s) > STEP_S:
        text = f"GNSS time is {host_s:+.3f} s from the recording's clock"
        findings.append(
            Finding(
                "host-clock",
                "info",
                "",
                text,
                "do not compare the times with those of other devices",
            )
        )
    for name in recording.metadata:
        offset_s = _float(facts(recording, name).get("header_offset_s"))
        if name.startswith("source/") and abs(offset_s) > HEADER_OFFSET_S:
            how = facts(recording, name).get("time", "not said which were used")
            text = (
                f"the stamps in {name.removeprefix('source/')}'s messages are {offset_s:+,.3f} s "
                f"from the recorder's ({how})"
            )
            advice = "a lag to the other sensors may be left: see imu-lag"
            findings.append(Finding("header-offset", "warning", "", text, advice))
    return findings


def early_receipt(recording: Recording) -> list[Finding]:
    """Rows that were received before they were measured."""
    delays = {topic: _median(_received(recording[topic])) for topic in recording}
    early = {topic: delay_s for topic, delay_s in delays.items() if -60 < delay_s < -SLOW_S}
    if not early:
        return []
    most = min(early, key=lambda topic: early[topic])
    text = f"rows are received {-early[most]:.3f} s before they are measured: the two clocks differ"
    alike = "" if len(early) == 1 else f" (and so in {len(early) - 1} other topics)"
    return [
        Finding(
            "early-receipt", "info", most, text + alike, "do not read delays from these two times"
        )
    ]


def _received(table: Table) -> Floats:
    if "receive_time_ns" not in table:
        return np.full(len(table), np.nan)
    return np.where(
        table.valid("receive_time_ns"),
        (table["receive_time_ns"] - table.time_ns) / SECOND_NS,
        np.nan,
    )


def _median(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else np.nan


def _clock(recording: Recording) -> str:
    return facts(recording, "recording").get("clock", "")


def _list(text: str) -> list[dict[str, object]]:
    try:
        found = json.loads(text)
    except ValueError:
        return []
    return [item for item in found if isinstance(item, dict)] if isinstance(found, list) else []


def _float(text: str | None) -> float:
    try:
        return float(text or "nan")
    except ValueError:
        return np.nan


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else np.nan
