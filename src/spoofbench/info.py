"""What a recording holds, at a glance."""

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench.codec import read
from spoofbench.conversion import Ledger
from spoofbench.doctor import Finding, examine
from spoofbench.formatting import (
    byte_size,
    counted,
    date_time,
    hours_minutes_seconds,
    printable,
    share_percent,
)
from spoofbench.recording import Recording
from spoofbench.schema import TRUTH_TOPIC, split_topic
from spoofbench.table import Table

STOPPED_MPS = 0.3
GAP_FACTOR = 1.75
WIDTH = 80


@dataclass(frozen=True, slots=True)
class TopicSummary:
    """One topic.

    Attributes:
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
class Motion:
    """How the primary receiver moved, by its own word.

    Attributes:
        distance_m: sum of the ways between epochs of which one at least is faster than 0.3 m/s.
        top_speed_mps: over ground; infinite speeds and places count as unknown.
        stopped_share: share of the epochs with a speed that are slower than 0.3 m/s.
    """

    distance_m: float | None
    top_speed_mps: float | None
    stopped_share: float | None


@dataclass(frozen=True, slots=True)
class Summary:
    """One recording; ``metadata`` without the ledger, which is None where the file has none."""

    file: str
    start_ns: int | None
    duration_s: float | None
    clock: str | None
    topics: tuple[TopicSummary, ...]
    motion: Motion | None
    attacks: int
    metadata: Mapping[str, Mapping[str, str]]
    ledger: Ledger | None
    findings: tuple[Finding, ...]


def summarise(path: Path) -> Summary:
    """Summarise a recording.

    Raises:
        FormatError: the file is not a recording, or is damaged.
    """
    recording = read(path)
    span = (
        recording.span
        if any(len(table) for topic, table in recording.items() if topic != TRUTH_TOPIC)
        else None
    )
    return Summary(
        file=path.name,
        start_ns=span.start_ns if span else None,
        duration_s=span.duration_s if span else None,
        clock=recording.metadata.get("recording", {}).get("clock"),
        topics=tuple(_topic(recording, topic) for topic in recording),
        motion=_motion(recording.primary("gnss/pvt")) if "gnss/pvt" in recording.kinds else None,
        attacks=len(recording[TRUTH_TOPIC]) if TRUTH_TOPIC in recording else 0,
        metadata={
            name: dict(record) for name, record in recording.metadata.items() if name != "ledger"
        },
        ledger=_ledger(recording.metadata.get("ledger")),
        findings=tuple(examine(recording)),
    )


def as_dict(summary: Summary) -> dict[str, Any]:
    """Return a summary for machines; unknown is None."""
    topics = [asdict(topic) for topic in summary.topics]
    return {
        "file": summary.file,
        "start_ns": summary.start_ns,
        "duration_s": summary.duration_s,
        "clock": summary.clock,
        "topics": topics,
        "motion": asdict(summary.motion) if summary.motion else None,
        "attacks": summary.attacks,
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
    origin = summary.metadata.get("origin", {})
    lines = [printable(summary.file), f"  {when}", *_topic_lines(summary.topics), ""]
    if "file" in origin:
        lines.append(
            _pair(
                "log",
                (
                    f"{origin['file']}, {_size(origin.get('size', ''))}by the "
                    f"{origin.get('converter', '?')} converter"
                ),
            )
        )
    lines.append(_pair("clock", _clock_text(summary)))
    here = {split_topic(topic.topic)[0] or "reference" for topic in summary.topics}
    for name, record in summary.metadata.items():
        source = name.removeprefix("source/")
        if name.startswith("source/") and source in here:
            lines.append(_pair(source, _source_text(record)))
    if summary.motion:
        lines.append(_pair("motion", _motion_text(summary.motion)))
    if summary.attacks:
        lines.append(_pair("attacks", f"{summary.attacks} in {TRUTH_TOPIC}"))
    if summary.ledger:
        lines.append(_pair("ledger", _ledger_text(summary.ledger)))
    lines.append(_pair("doctor", _doctor_text(summary.findings)))
    return "\n".join(line.rstrip() for line in lines)


def _clock_text(summary: Summary) -> str:
    about = summary.metadata.get("recording", {})
    steps = about.get("clock_step_count", "0")
    said = {"leap_seconds": "leap seconds ", "reference_date": "date by the user "}
    parts = [
        summary.clock or "unknown",
        *(f"{text}{about[key]}" for key, text in said.items() if key in about),
    ]
    return ", ".join([*parts, f"{steps} steps"] if steps != "0" else parts)


def _source_text(record: Mapping[str, str]) -> str:
    """What a source is: device and firmware, what its solution is of, its axes, and where the log
    had it.
    """
    solution = {"gnss": "GNSS only", "fused": "fused with inertial sensors"}.get(
        record.get("solution", "")
    )
    axes = f"axes {record['axes']}" if "axes" in record else None
    return (
        ", ".join(
            part
            for part in (
                record.get("device"),
                record.get("firmware"),
                solution,
                axes,
                record.get("topic"),
            )
            if part
        )
        or "unknown"
    )


def _ledger_text(ledger: Ledger) -> str:
    text = f"{ledger.used:,} {ledger.unit} used, {ledger.skipped:,} skipped"
    if not ledger.skipped:
        return text
    reason, count = ledger.reasons.most_common(1)[0]
    return f"{text} ({share_percent(ledger.skipped_share)} %), {count:,} of them: {reason}"


def _doctor_text(findings: Sequence[Finding]) -> str:
    codes = {
        severity: [finding.code for finding in findings if finding.severity == severity]
        for severity in ("error", "warning")
    }
    said = [
        f"{counted(len(found), severity)}: {', '.join(dict.fromkeys(found))}"
        for severity, found in codes.items()
        if found
    ]
    return "; ".join(said) + "; see spoofbench doctor" if said else "nothing to warn of"


def _size(text: str) -> str:
    return f"{byte_size(float(text))}, " if text.isdecimal() and len(text) <= 20 else ""


def _topic(recording: Recording, topic: str) -> TopicSummary:
    times = recording[topic].time_ns
    source, kind = split_topic(topic)
    steps = np.diff(times)
    steps = steps[steps > 0] / 1e9
    median = float(np.median(steps)) if steps.size else None
    gaps = steps[steps > GAP_FACTOR * median] if median else steps
    return TopicSummary(
        topic=topic,
        primary=recording.metadata.get("primary", {}).get(kind) == source,
        rows=times.size,
        start_ns=int(times[0]) if times.size else None,
        end_ns=int(times[-1]) + 1 if times.size else None,
        rate_hz=1 / median if median else None,
        gaps=gaps.size,
        longest_gap_s=float(gaps.max()) if gaps.size else None,
    )


def _motion(pvt: Table) -> Motion:
    speed = _speed(pvt)
    known = np.isfinite(speed)
    moving = speed >= STOPPED_MPS
    return Motion(
        distance_m=_distance(pvt, moving | ~known),
        top_speed_mps=float(speed[known].max()) if known.any() else None,
        stopped_share=float(np.mean(~moving[known])) if known.any() else None,
    )


def _speed(pvt: Table) -> NDArray[np.float64]:
    """Return the speed over ground, ``(n,)`` m/s, from the velocity or else as the receiver says
    it.
    """
    velocity = np.hypot(pvt["vel_n_mps"], pvt["vel_e_mps"])
    return np.where(np.isnan(velocity), pvt["speed_mps"], velocity)


def _distance(pvt: Table, moving: NDArray[np.bool_]) -> float | None:
    import pymap3d

    placed = np.isfinite(pvt["lat_deg"]) & np.isfinite(pvt["lon_deg"])
    if not placed.any():
        return None
    height = np.where(np.isfinite(pvt["height_m"]), pvt["height_m"], 0.0)[placed]
    places = np.stack(
        pymap3d.geodetic2ecef(pvt["lat_deg"][placed], pvt["lon_deg"][placed], height), axis=1
    )
    with np.errstate(over="ignore"):
        ways = np.linalg.norm(np.diff(places, axis=0), axis=1)
        distance_m = float(ways[moving[placed][1:] | moving[placed][:-1]].sum())
    return distance_m if np.isfinite(distance_m) else None


def _ledger(record: Mapping[str, str] | None) -> Ledger | None:
    if record is None:
        return None
    try:
        return Ledger.of_metadata(record)
    except (KeyError, ValueError, TypeError):  # written by another program
        return None


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
    return (
        [*lines, "  * primary source of its kind"]
        if any(topic.primary for topic in topics)
        else lines
    )


def _motion_text(motion: Motion) -> str:
    parts = []
    if motion.distance_m is not None:
        parts.append(f"{motion.distance_m / 1000:.2f} km")
    if motion.top_speed_mps is not None and motion.stopped_share is not None:
        parts.append(
            f"top speed {motion.top_speed_mps:.1f} m/s, stopped {100 * motion.stopped_share:.0f} "
            "% of the time"
        )
    return ", ".join(parts) or "unknown"


def _pair(name: str, value: str) -> str:
    return textwrap.fill(
        printable(value),
        WIDTH,
        initial_indent=f"{printable(name) + '  ':<11}",
        subsequent_indent=" " * 11,
    )
