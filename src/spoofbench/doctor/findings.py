"""What a check reports, and how it is written for people and for machines."""

import textwrap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

from spoofbench.arrays import Times
from spoofbench.formatting import counted, date_time, printable
from spoofbench.recording import Recording

Severity = Literal["info", "warning", "error"]
SEVERITIES: tuple[Severity, ...] = ("info", "warning", "error")

_WIDTH = 80


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is not as it should be, or that whoever uses the recording has to know.

    Attributes:
        code: stable name of the check's outcome.
        severity: ``error``: what the rows say is wrong; ``warning``: some rows are, or it has to be
            looked at; ``info``: to be known.
        topic: where; empty for the whole recording.
        text: one sentence: what was measured.
        advice: what to do.
        count: how many rows, intervals or units; None where there is nothing to count.
        start_ns, end_ns: the first time and the last one; None for all of the topic.
    """

    code: str
    severity: Severity
    topic: str
    text: str
    advice: str
    count: int | None = None
    start_ns: int | None = None
    end_ns: int | None = None


Check = Callable[[Recording], Iterator[Finding]]
"""A check yields what it finds, and nothing where it cannot judge."""


def extent(times_ns: Times) -> dict[str, int | None]:
    """Return the fields ``count``, ``start_ns`` and ``end_ns`` of a finding in rows of these times,
    ``(n,)``.
    """
    if not times_ns.size:
        return {"count": 0, "start_ns": None, "end_ns": None}
    return {
        "count": int(times_ns.size),
        "start_ns": int(times_ns.min()),
        "end_ns": int(times_ns.max()),
    }


def metadata_record(recording: Recording, name: str) -> dict[str, str]:
    """Return a metadata record, empty where there is none."""
    return dict(recording.metadata.get(name, {}))


def as_rows(findings: Sequence[Finding]) -> list[dict[str, Any]]:
    """Return the findings for machines; unknown is None."""
    return [asdict(finding) for finding in findings]


def as_text(name: str, findings: Sequence[Finding]) -> str:
    """Return the findings for people, in 80 columns."""
    lines = [f"{printable(name)}: {_total(findings)}"]
    indent = " " * 9
    for finding in findings:
        heading = f"{finding.severity:<8} {finding.code}  {printable(finding.topic)}"
        lines += ["", heading.rstrip()]
        for text in (f"{finding.text}{_when(finding)}", f"-> {finding.advice}"):
            lines += textwrap.wrap(
                printable(text),
                _WIDTH,
                initial_indent=indent,
                subsequent_indent=indent,
                break_on_hyphens=False,
            )
    return "\n".join(lines)


def _total(findings: Sequence[Finding]) -> str:
    """Return how many findings of each severity there are, the worst first."""
    counts = {
        severity: sum(finding.severity == severity for finding in findings)
        for severity in reversed(SEVERITIES)
    }
    parts = [
        f"{count} info" if severity == "info" else counted(count, severity)
        for severity, count in counts.items()
        if count
    ]
    return ", ".join(parts) or "nothing found"


def _when(finding: Finding) -> str:
    if finding.start_ns is None:
        return ""
    start = date_time(finding.start_ns)
    if finding.end_ns in (None, finding.start_ns):
        return f" (at {start})"
    return f" (from {start} to {date_time(finding.end_ns or 0)})"
