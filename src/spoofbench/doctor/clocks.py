"""Checks of time: which clock tells it, and whether it is the one that it is said to be."""

import json
import re
from collections.abc import Iterator

import numpy as np

from spoofbench.arrays import Floats, Times
from spoofbench.doctor.findings import Finding, Severity, extent, metadata_record
from spoofbench.doctor.motion import known_median
from spoofbench.formatting import counted
from spoofbench.gnss_time import GPS_EPOCH_NS, ROLLOVER_NS, SECOND_NS, WEEK_NS
from spoofbench.gnss_time import leap_seconds as leap_seconds_at
from spoofbench.recording import Recording
from spoofbench.schema import SENSOR_KINDS, split_topic
from spoofbench.table import Table

MODIFIED = "modified_ns"
"""When the log was last written: the doctor adds it to the metadata ``origin`` of a log that it
converts.
"""

ROLLOVER_S = ROLLOVER_NS // SECOND_NS
ROLLOVER_TOLERANCE_S = 2 * 86_400.0
EARLIEST_S = 631_152_000.0
"""1990: earlier dates are those that a clock starts with."""

LEAP_TOLERANCE_S = 0.5
QUARTER_S = 900.0
"""Zones of the world are whole multiples of 15 minutes from UTC."""

MAX_ZONE_S = 14 * 3600.0
ZONE_TOLERANCE_S = 30.0
"""Host clocks without network time are off by so much."""

STEP_S = 0.5
DRIFT_WARNING, DRIFT_ERROR = 1e-4, 1e-3
"""Uncompensated quartz stays below 1e-4; above 1e-3 seconds are not seconds."""

MIN_DRIFT_S = 120.0
EARLY_S = 0.05
HEADER_OFFSET_S = 1.0
"""Between measurement and recording lie milliseconds; above, two clocks differ."""


def rollovers(recording: Recording) -> Iterator[Finding]:
    """Dates that are whole periods of 1024 weeks away from other evidence: claimed week, receive
    time, name and age of the file.
    """
    for topic, evidence in _date_evidence(recording).items():
        for name, offset_s in evidence.items():
            periods = round(offset_s / ROLLOVER_S)
            if periods and abs(offset_s - periods * ROLLOVER_S) < ROLLOVER_TOLERANCE_S:
                text = f"the dates are {-1024 * periods:+} weeks off from {name}"
                advice = (
                    f"convert again with {1024 * periods:+} weeks (-p week_rollover={periods}), or "
                    "with --date"
                )
                yield Finding("week-rollover", "error", topic, text, advice)
                break


def _date_evidence(recording: Recording) -> dict[str, dict[str, float]]:
    """Return by topic, and by what it is, evidence minus the rows' own times, s."""
    found: dict[str, dict[str, float]] = {}
    for topic in recording.topics("gnss/pvt"):
        offsets = {
            "the GPS week that the receiver claims": _claimed_offset(recording[topic]),
            "the times of receipt": _receive_offset(recording[topic]),
        }
        found[topic] = {name: offset for name, offset in offsets.items() if np.isfinite(offset)}
    starts_ns = [
        int(recording[topic].time_ns.min())
        for topic in recording
        if split_topic(topic)[1] in SENSOR_KINDS and len(recording[topic])
    ]
    if starts_ns:
        start_s = min(starts_ns) / 1e9
        found[""] = {}
        origin = metadata_record(recording, "origin")
        modified = origin.get(MODIFIED, "")
        if modified.isdecimal() and len(modified) < 20:
            found[""]["the time when the file was last written"] = int(modified) / 1e9 - start_s
        named_s = _date_in_name(origin.get("file", ""), start_s)
        if named_s is not None:
            found[""]["the date in the file's name"] = named_s - start_s
    return found


def _date_in_name(name: str, start_s: float) -> float | None:
    """Unix time of the date in a file's name; of a year alone, the day one or two rollovers on that
    lies in it.
    """
    found = re.search(
        r"(?<!\d)(20\d\d)[-_.]?(0[1-9]|1[0-2])[-_.]?(0[1-9]|[12]\d|3[01])(?!\d{2}(?!\d))", name
    )
    if found:
        try:
            date = np.datetime64("-".join(found.groups()))
        except ValueError:
            return None
        return float(date.astype("datetime64[s]").astype(np.int64))
    year = re.search(r"(?<!\d)(20\d\d)(?!\d)", name)
    for periods in (1, 2):
        later_s = start_s + periods * ROLLOVER_S
        if year and str(np.datetime64(int(later_s), "s"))[:4] == year.group(1):
            return later_s
    return None


def default_dates(recording: Recording) -> Iterator[Finding]:
    """Times before 1990, and the week 0 that receivers claim before they know better."""
    early = {}
    for topic in recording:
        times = recording[topic].time_ns
        early[topic] = times[times < EARLIEST_S * 1e9]
    count = sum(times.size for times in early.values())
    if count == sum(len(recording[topic]) for topic in recording) > 0:
        text = (
            "all times are before 1990: they count from when the device was switched on, or "
            "another start"
        )
        advice = "convert again with --date where the date matters"
        yield Finding("no-date", "warning", "", text, advice)
        return
    for topic, times in early.items():
        if times.size:
            text = f"{counted(times.size, 'row')} before 1990: the clock had no date yet"
            advice = "convert again with --date"
            yield Finding("default-date", "error", topic, text, advice, **extent(times))
    for topic in recording.topics("gnss/pvt"):
        table = recording[topic]
        is_zero = table.valid("gps_week") & (table["gps_week"] == 0)
        if is_zero.any():
            text = f"the receiver claims GPS week 0 in {counted(int(is_zero.sum()), 'epoch')}"
            advice = "leave them out where time of week or date matters"
            rows = extent(table.time_ns[is_zero])
            yield Finding("default-date", "warning", topic, text, advice, **rows)


def leap_seconds(recording: Recording) -> Iterator[Finding]:
    """GPS time passed off as UTC, or the leap seconds of another year."""
    for topic in recording.topics("gnss/pvt"):
        table = recording[topic]
        if not len(table):
            continue
        leap_s = int(leap_seconds_at(table.time_ns[0]))
        offset_s = _claimed_offset(table)
        if np.isfinite(offset_s) and abs(offset_s) < 60:
            if abs(offset_s) < LEAP_TOLERANCE_S < leap_s:
                text = (
                    f"the times equal the GPS time that the receiver claims: they are {leap_s} s "
                    "ahead of UTC"
                )
                advice = f"subtract {leap_s} s, or say in the mapping that it is GPS time"
                yield Finding("gps-time-as-utc", "error", topic, text, advice)
            elif _clock(recording) == "gnss" and abs(offset_s - leap_s) > LEAP_TOLERANCE_S:
                text = (
                    f"GPS time is {offset_s:.1f} s ahead of the times where leap seconds make it "
                    f"{leap_s} s"
                )
                advice = "do not mix these times with those of other devices"
                yield Finding("leap-seconds", "warning", topic, text, advice)
        ahead_s = -_receive_offset(table)
        if leap_s and leap_s - 2 < ahead_s < leap_s + LEAP_TOLERANCE_S:
            text = (
                f"rows are dated {ahead_s:.1f} s after their receipt, as GPS time is ahead of UTC "
                f"by {leap_s} s"
            )
            advice = f"subtract {leap_s} s if the host kept UTC"
            yield Finding("gps-time-as-utc", "warning", topic, text, advice)


def time_zones(recording: Recording) -> Iterator[Finding]:
    """Local time passed off as UTC: whole quarters of an hour between two clocks."""
    found = False
    for topic in recording:
        offsets = {"the times of receipt": _receive_offset(recording[topic])}
        if split_topic(topic)[1] == "gnss/pvt":
            offsets["the GPS time that the receiver claims"] = _claimed_offset(recording[topic])
        for name, offset_s in offsets.items():
            if _is_zone(offset_s):
                found = True
                yield _time_zone(topic, offset_s, name)
                break
    if not found:
        yield from _zones_between_sources(recording)


def _zones_between_sources(recording: Recording) -> Iterator[Finding]:
    """The same between two sources that were switched on and off together but never overlap."""
    topics = [
        topic
        for topic in recording
        if split_topic(topic)[1] in ("imu", "gnss/pvt") and len(recording[topic]) > 1
    ]
    for topic in topics[1:]:
        first, other = recording[topics[0]].time_ns, recording[topic].time_ns
        start_s, end_s = ((int(other[i]) - int(first[i])) / 1e9 for i in (0, -1))
        is_apart = other[0] > first[-1] or first[0] > other[-1]
        are_zones = _is_zone(start_s) and _is_zone(end_s)
        if is_apart and are_zones and abs(start_s - end_s) < ZONE_TOLERANCE_S:
            yield _time_zone(topic, -(start_s + end_s) / 2, f"those of {topics[0]}")
            return


def _is_zone(offset_s: float) -> bool:
    """Whether an offset is a time zone's."""
    if not QUARTER_S / 2 < abs(offset_s) <= MAX_ZONE_S + ZONE_TOLERANCE_S:
        return False
    return abs(offset_s - round(offset_s / QUARTER_S) * QUARTER_S) < ZONE_TOLERANCE_S


def _time_zone(topic: str, offset_s: float, reference: str) -> Finding:
    hours = round(offset_s / QUARTER_S) / 4
    text = f"the times are {-hours:+g} h off from {reference}, which is a time zone"
    advice = "convert again with the zone declared"
    return Finding("local-time-as-utc", "error", topic, text, advice)


def clock_steps(recording: Recording) -> Iterator[Finding]:
    """Steps of the claimed or logged clock: those that the converter noted, else those against the
    rows' times.
    """
    noted = metadata_record(recording, "recording")
    count = noted.get("clock_step_count", "0")
    if count.isdecimal() and len(count) < 10 and int(count):
        step_s = _first_step(noted.get("clock_steps", "[]"))
        first = f", first by {step_s:+.3f} s" if np.isfinite(step_s) else ""
        text = f"the clock that the log claims makes {counted(int(count), 'step')}{first}"
        advice = (
            "see recording.clock_steps for where; if rows were skipped for it, --append-clock "
            "keeps them"
        )
        yield Finding("clock-step", "warning", "", text, advice, int(count))
        return
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
            rows = extent(table.time_ns[known[1:][jumps]])
            yield Finding("clock-step", "warning", topic, text, advice, **rows)


def _first_step(steps: str) -> float:
    """Return the first step of those noted as JSON, s; NaN where it cannot be read."""
    try:
        first = json.loads(steps)[0]
        return (float(first["to_ns"]) - float(first["from_ns"])) / 1e9
    except (ValueError, TypeError, LookupError, OverflowError, RecursionError):
        return np.nan


def drifts(recording: Recording) -> Iterator[Finding]:
    """A recorder's or sensor's second that is not a second of GNSS time."""
    if _clock(recording) == "gnss":  # made of the claimed time itself
        return
    for topic in recording.topics("gnss/pvt"):
        table = recording[topic].last_per_time()
        rate = _drift(table.time_ns, claimed_gps_s(table))
        if np.isfinite(rate) and abs(rate) > DRIFT_WARNING:
            text = (
                f"the recording's clock runs at {1 / (1 + rate):.5f} of GNSS time"
                if rate > -1
                else "the GNSS time that is claimed stands still, or runs back"
            )
            advice = (
                "all rates and intervals of its sensors are off by as much: scale their times "
                "before comparing with GNSS"
            )
            severity: Severity = "error" if abs(rate) > DRIFT_ERROR else "warning"
            yield Finding("clock-drift", severity, topic, text, advice)


def _drift(time_ns: Times, claimed_s: Floats) -> float:
    """Return how much faster than the rows' times the claimed time runs: the median over ten
    stretches, so that steps do not count.
    """
    known = np.isfinite(claimed_s)
    times_s, claimed = (time_ns[known] - time_ns[:1]) / 1e9, claimed_s[known]
    if times_s.size < 20 or times_s[-1] - times_s[0] < MIN_DRIFT_S:
        return np.nan
    ends = np.unique(np.linspace(0, times_s.size - 1, 11).astype(int))
    durations_s = np.diff(times_s[ends])
    return (
        float(np.median(np.diff(claimed[ends])[durations_s > 0] / durations_s[durations_s > 0])) - 1
    )


def clock_offsets(recording: Recording) -> Iterator[Finding]:
    """Offsets between clocks that the converter measured: a host's from GNSS time, message headers'
    from the recorder's.
    """
    host_s = _float(metadata_record(recording, "recording").get("gnss_minus_clock_ns")) / 1e9
    if abs(host_s) > STEP_S:
        text = f"GNSS time is {host_s:+.3f} s from the recording's clock"
        advice = "do not compare the times with those of other devices"
        yield Finding("host-clock", "info", "", text, advice)
    for name in recording.metadata:
        source = metadata_record(recording, name)
        offset_s = _float(source.get("header_offset_s"))
        if name.startswith("source/") and abs(offset_s) > HEADER_OFFSET_S:
            used = source.get("time", "not said which were used")
            text = (
                f"the stamps in {name.removeprefix('source/')}'s messages are {offset_s:+,.3f} s "
                f"from the recorder's ({used})"
            )
            advice = "a lag to the other sensors may be left: see imu-lag"
            yield Finding("header-offset", "warning", "", text, advice)


def early_receipt(recording: Recording) -> Iterator[Finding]:
    """Rows that were received before they were measured."""
    offsets = {topic: _receive_offset(recording[topic]) for topic in recording}
    early = {topic: offset_s for topic, offset_s in offsets.items() if -60 < offset_s < -EARLY_S}
    if early:
        topic = min(early, key=lambda topic: early[topic])
        also = "" if len(early) == 1 else f" (and so in {len(early) - 1} other topics)"
        text = (
            f"rows are received {-early[topic]:.3f} s before they are measured: the two clocks "
            f"differ{also}"
        )
        advice = "do not read delays from these two times"
        yield Finding("early-receipt", "info", topic, text, advice)


def claimed_gps_s(table: Table) -> Floats:
    """Return the GPS time that a ``gnss/pvt`` table claims, in seconds since 1970 as if it were
    UTC; ``(n,)``, NaN where unknown.
    """
    week = np.where(table.valid("gps_week"), table["gps_week"].astype(np.float64), np.nan)
    return np.asarray(GPS_EPOCH_NS / SECOND_NS + week * (WEEK_NS / SECOND_NS) + table["tow_s"])


def _claimed_offset(table: Table) -> float:
    """Return claimed GPS time minus the rows' times, s: the median; NaN where unknown."""
    return known_median(claimed_gps_s(table) - table.time_ns / 1e9)


def _receive_offset(table: Table) -> float:
    """Return times of receipt minus the rows' times, s: the median; NaN where unknown."""
    if "receive_time_ns" not in table:
        return np.nan
    offsets_s = (table["receive_time_ns"] - table.time_ns) / SECOND_NS
    return known_median(offsets_s[table.valid("receive_time_ns")])


def _clock(recording: Recording) -> str:
    return metadata_record(recording, "recording").get("clock", "")


def _float(text: str | None) -> float:
    try:
        return float(text or "nan")
    except ValueError:
        return np.nan
