"""Findings for people and for machines."""

import textwrap
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from spoofbench.doctor.finding import SEVERITIES, Finding
from spoofbench.formatting import counted, date_time, printable

WIDTH = 80


def as_rows(findings: Sequence[Finding]) -> list[dict[str, Any]]:
    """Return the findings for machines; unknown is None."""
    return [asdict(finding) for finding in findings]


def as_text(name: str, findings: Sequence[Finding]) -> str:
    """Return the findings for people, in 80 columns."""
    lines = [f"{printable(name)}: {_total(findings)}"]
    for finding in findings:
        lines.append("")
        lines.append(f"{finding.severity:<8} {finding.code}  {printable(finding.topic)}".rstrip())
        for text in (f"{finding.text}{_when(finding)}", f"-> {finding.advice}"):
            lines += textwrap.wrap(
                printable(text),
                WIDTH,
                initial_indent=" " * 9,
                subsequent_indent=" " * 9,
                break_on_hyphens=False,
            )
    return "\n".join(lines)


def _total(findings: Sequence[Finding]) -> str:
    counts = [
        (severity, sum(finding.severity == severity for finding in findings))
        for severity in reversed(SEVERITIES)
    ]
    said = [
        f"{count} info" if severity == "info" else counted(count, severity)
        for severity, count in counts
        if count
    ]
    return ", ".join(said) or "nothing found"


def _when(finding: Finding) -> str:
    if finding.start_ns is None:
        return ""
    start = date_time(finding.start_ns)
    if finding.end_ns in (None, finding.start_ns):
        return f" (at {start})"
    return f" (from {start} to {date_time(finding.end_ns or 0)})"
