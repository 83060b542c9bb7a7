"""What a recording holds, at a glance."""

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from spoofbench.arrays import Bools
from spoofbench.codec import read
from spoofbench.conversion import Ledger
from spoofbench.doctor import Finding, examine
from spoofbench.doctor.contents import GAP_FACTOR
from spoofbench.doctor.inertial import STOPPED_MPS
from spoofbench.doctor.motion import speed
from spoofbench.formatting import (
    byte_size,
    counted,
    date_time,
    hours_minutes_seconds,
    printable,
    share_percent,
)
from spoofbench.recording import (
    Recording,
    attacked_intervals,
    clean_intervals,
    is_really_attacked,
)
from spoofbench.schema import LABEL_TOPICS, TRUTH_TOPIC, split_topic
from spoofbench.table import Table

_WIDTH = 80


@dataclass(frozen=True, slots=True)
class TopicSummary:
    """One topic.

    Attributes:
        topic: its name.
        primary: whether its source is the primary one of its kind.
        rows: how many there are.
        start_ns, end_ns: half-open interval of their times; None without rows.
        rate_hz: one over the median interval between distinct times; None below two of them.
        gaps: intervals longer than 1.75 times the median: one epoch is missing, or more.
        longest_gap_s: the longest of those; None where there is none.
    """

    topic: str
    primary: bool
    rows: int
    start_ns: int | None
    end_ns: int | None
    rate_hz: float | None
    gaps: int
    longest_gap_s: float | None


@dataclass(frozen=True, slots=True)
class MotionSummary:
    """How the primary receiver moved, as it reports; None where unknown.

    Attributes:
        distance_m: sum of the distances between epochs of which one at least is faster than
            0.3 m/s.
        top_speed_mps: over ground; infinite speeds and positions count as unknown.
        stopped_share: share of the epochs with a speed that are slower than 0.3 m/s.
    """

    distance_m: float | None
    top_speed_mps: float | None
    stopped_share: float | None


@dataclass(frozen=True, slots=True)
class LabelSummary:
    """What labels of a real attack say.

    Attributes:
        attacked_s, clean_s: how long the recording is labelled so.
        unreviewed_s: how long it is labelled neither.
        classes: of the attacks.
        labelled_by, sources, time_bases, time_checks: who and what the labels rest on.
    """

    attacked_s: float
    clean_s: float
    unreviewed_s: float
    classes: tuple[str, ...]
    labelled_by: tuple[str, ...]
    sources: tuple[str, ...]
    time_bases: tuple[str, ...]
    time_checks: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Summary:
    """One recording; ``metadata`` without the ledger, which is None where the file has none."""

    file: str
    start_ns: int | None
    duration_s: float | None
    clock: str | None
    topics: tuple[TopicSummary, ...]
    motion: MotionSummary | None
    attacks: int
    labels: LabelSummary | None
    metadata: Mapping[str, Mapping[str, str]]
    ledger: Ledger | None
    findings: tuple[Finding, ...]


def summarise(path: Path) -> Summary:
    """Summarise a recording.

    Raises:
        FormatError: the file is not a recording, or is damaged.
    """
    recording = read(path)
    has_rows = any(len(table) for topic, table in recording.items() if topic not in LABEL_TOPICS)
    span = recording.span if has_rows else None
    return Summary(
        file=path.name,
        start_ns=span.start_ns if span else None,
        duration_s=span.duration_s if span else None,
        clock=recording.metadata.get("recording", {}).get("clock"),
        topics=tuple(_topic(recording, topic) for topic in recording),
        motion=_motion(recording.primary("gnss/pvt")) if "gnss/pvt" in recording.kinds else None,
        attacks=len(recording[TRUTH_TOPIC]) if TRUTH_TOPIC in recording else 0,
        labels=summarise_labels(recording) if is_really_attacked(recording) else None,
        metadata={
            name: dict(record) for name, record in recording.metadata.items() if name != "ledger"
        },
        ledger=_ledger(recording.metadata.get("ledger")),
        findings=tuple(examine(recording)),
    )


def _topic(recording: Recording, topic: str) -> TopicSummary:
    times = recording[topic].time_ns
    source, kind = split_topic(topic)
    intervals_ns = np.diff(times)
    intervals_s = intervals_ns[intervals_ns > 0] / 1e9
    median_s = float(np.median(intervals_s)) if intervals_s.size else None
    gaps_s = intervals_s[intervals_s > GAP_FACTOR * median_s] if median_s else intervals_s
    return TopicSummary(
        topic=topic,
        primary=recording.metadata.get("primary", {}).get(kind) == source,
        rows=times.size,
        start_ns=int(times[0]) if times.size else None,
        end_ns=int(times[-1]) + 1 if times.size else None,
        rate_hz=1 / median_s if median_s else None,
        gaps=gaps_s.size,
        longest_gap_s=float(gaps_s.max()) if gaps_s.size else None,
    )


def _motion(pvt: Table) -> MotionSummary:
    speed_mps = speed(pvt)
    known = np.isfinite(speed_mps)
    moving = speed_mps >= STOPPED_MPS
    return MotionSummary(
        distance_m=_distance(pvt, moving | ~known),
        top_speed_mps=float(speed_mps[known].max()) if known.any() else None,
        stopped_share=float(np.mean(~moving[known])) if known.any() else None,
    )


def _distance(pvt: Table, moving: Bools) -> float | None:
    """Return the length of the track while the receiver moves, m; None where unknown."""
    import pymap3d

    has_position = np.isfinite(pvt["lat_deg"]) & np.isfinite(pvt["lon_deg"])
    if not has_position.any():
        return None
    rows = pvt.take(has_position)
    height_m = np.where(np.isfinite(rows["height_m"]), rows["height_m"], 0.0)
    ecef_m = np.stack(pymap3d.geodetic2ecef(rows["lat_deg"], rows["lon_deg"], height_m), axis=1)
    moving = moving[has_position]
    with np.errstate(over="ignore"):
        steps_m = np.linalg.norm(np.diff(ecef_m, axis=0), axis=1)
        distance_m = float(steps_m[moving[1:] | moving[:-1]].sum())
    return distance_m if np.isfinite(distance_m) else None


def summarise_labels(recording: Recording) -> LabelSummary:
    """Return what the labels of a really attacked recording say."""
    attacked_s, clean_s = (
        sum(interval.duration_s for interval in intervals)
        for intervals in (attacked_intervals(recording), clean_intervals(recording))
    )

    def words(name: str) -> tuple[str, ...]:
        tables = [recording[topic] for topic in sorted(LABEL_TOPICS) if topic in recording]
        texts = [text for table in tables if name in table for text in table.texts(name) if text]
        return tuple(dict.fromkeys(texts))

    return LabelSummary(
        attacked_s=attacked_s,
        clean_s=clean_s,
        unreviewed_s=max(0.0, recording.span.duration_s - attacked_s - clean_s),
        classes=words("class"),
        labelled_by=words("labelled_by"),
        sources=words("label_source"),
        time_bases=words("time_base"),
        time_checks=words("time_check"),
    )


def _ledger(record: Mapping[str, str] | None) -> Ledger | None:
    if record is None:
        return None
    try:
        return Ledger.of_metadata(record)
    except (KeyError, ValueError, TypeError):  # written by another program
        return None


def as_dict(summary: Summary) -> dict[str, Any]:
    """Return a summary for machines; unknown is None."""
    return {
        "file": summary.file,
        "start_ns": summary.start_ns,
        "duration_s": summary.duration_s,
        "clock": summary.clock,
        "topics": [asdict(topic) for topic in summary.topics],
        "motion": asdict(summary.motion) if summary.motion else None,
        "attacks": summary.attacks,
        "labels": asdict(summary.labels) if summary.labels else None,
        "metadata": {name: dict(record) for name, record in summary.metadata.items()},
        "ledger": summary.ledger.as_dict() if summary.ledger else None,
        "findings": [asdict(finding) for finding in summary.findings],
    }


def as_text(summary: Summary) -> str:
    """Return a summary for people, at a glance, in 80 columns."""
    when = "no rows"
    if summary.start_ns is not None and summary.duration_s is not None:
        duration = hours_minutes_seconds(summary.duration_s)
        when = f"{duration} from {date_time(summary.start_ns)} UTC"
    lines = [printable(summary.file), f"  {when}", *_topic_lines(summary.topics), ""]
    for name, value in _descriptions(summary):
        text = textwrap.fill(
            printable(value),
            _WIDTH,
            initial_indent=f"{printable(name) + '  ':<11}",
            subsequent_indent=" " * 11,
        )
        lines.append(text)
    return "\n".join(line.rstrip() for line in lines)


def _topic_lines(topics: tuple[TopicSummary, ...]) -> list[str]:
    names = [printable(topic.topic) for topic in topics]
    width = max(map(len, names), default=5) + 2
    lines = ["", f"  {'topic':<{width}}{'rows':>11}{'rate Hz':>10}{'gaps':>7}{'longest s':>11}"]
    for name, topic in zip(names, topics, strict=True):
        rate = f"{topic.rate_hz:.2f}" if topic.rate_hz else ""
        gap = f"{topic.longest_gap_s:.3f}" if topic.longest_gap_s else ""
        lines.append(
            f"  {name + (' *' if topic.primary else ''):<{width}}{topic.rows:>11,}{rate:>10}"
            f"{topic.gaps:>7}{gap:>11}"
        )
    if any(topic.primary for topic in topics):
        lines.append("  * primary source of its kind")
    return lines


def _descriptions(summary: Summary) -> Iterator[tuple[str, str]]:
    """Yield what there is to say besides the topics: what of, and the text."""
    origin = summary.metadata.get("origin", {})
    if "file" in origin:
        size = origin.get("size", "")
        with_size = f"{byte_size(float(size))}, " if size.isdecimal() and len(size) <= 20 else ""
        yield "log", f"{origin['file']}, {with_size}by the {origin.get('converter', '?')} converter"
    yield "clock", _clock_text(summary)
    sources = {split_topic(topic.topic)[0] or "reference" for topic in summary.topics}
    for name, record in summary.metadata.items():
        source = name.removeprefix("source/")
        if name.startswith("source/") and source in sources:
            yield source, _source_text(record)
    if summary.motion:
        yield "motion", _motion_text(summary.motion)
    if summary.labels:
        yield "labels", labels_text(summary.labels)
    elif summary.attacks:
        yield "attacks", f"{summary.attacks} in {TRUTH_TOPIC}"
    if summary.ledger:
        yield "ledger", _ledger_text(summary.ledger)
    yield "doctor", _doctor_text(summary.findings)


def _clock_text(summary: Summary) -> str:
    about = summary.metadata.get("recording", {})
    parts = [summary.clock or "unknown"]
    if "leap_seconds" in about:
        parts.append(f"leap seconds {about['leap_seconds']}")
    if "reference_date" in about:
        parts.append(f"date by the user {about['reference_date']}")
    if about.get("clock_step_count", "0") != "0":
        parts.append(f"{about['clock_step_count']} steps")
    return ", ".join(parts)


def _source_text(record: Mapping[str, str]) -> str:
    """What a source is: device and firmware, what its solution is of, its axes, and where the log
    had it.
    """
    solutions = {"gnss": "GNSS only", "fused": "fused with inertial sensors"}
    parts = (
        record.get("device"),
        record.get("firmware"),
        solutions.get(record.get("solution", "")),
        f"axes {record['axes']}" if "axes" in record else None,
        record.get("topic"),
    )
    return ", ".join(part for part in parts if part) or "unknown"


def _motion_text(motion: MotionSummary) -> str:
    parts = []
    if motion.distance_m is not None:
        parts.append(f"{motion.distance_m / 1000:.2f} km")
    if motion.top_speed_mps is not None and motion.stopped_share is not None:
        parts.append(
            f"top speed {motion.top_speed_mps:.1f} m/s, stopped {100 * motion.stopped_share:.0f} "
            "% of the time"
        )
    return ", ".join(parts) or "unknown"


def labels_text(labels: LabelSummary) -> str:
    """Return what labels of a real attack say, in one line."""
    classes, makers, sources, bases, checks = (
        ", ".join(texts)
        for texts in (
            labels.classes,
            labels.labelled_by,
            labels.sources,
            labels.time_bases,
            labels.time_checks,
        )
    )
    attacked, clean, unreviewed = map(
        hours_minutes_seconds, (labels.attacked_s, labels.clean_s, labels.unreviewed_s)
    )
    return (
        f"really attacked for {attacked} ({classes}), clean for {clean}, not reviewed for "
        f"{unreviewed}; by {makers}, from {sources}; time base {bases}, checked: {checks}"
    )


def _ledger_text(ledger: Ledger) -> str:
    text = f"{ledger.used:,} {ledger.unit} used, {ledger.skipped:,} skipped"
    if not ledger.skipped:
        return text
    reason, count = ledger.reasons.most_common(1)[0]
    return f"{text} ({share_percent(ledger.skipped_share)} %), {count:,} of them: {reason}"


def _doctor_text(findings: Sequence[Finding]) -> str:
    parts = []
    for severity in ("error", "warning"):
        codes = [finding.code for finding in findings if finding.severity == severity]
        if codes:
            parts.append(f"{counted(len(codes), severity)}: {', '.join(dict.fromkeys(codes))}")
    return "; ".join(parts) + "; see spoofbench doctor" if parts else "nothing to warn of"
