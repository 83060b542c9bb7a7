"""The agreement as a table for the terminal, as Markdown, and as JSON."""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.agreement import gpsd
from benchmarks.agreement.compare import Disagreement

Entry = Mapping[str, Any]
"""What is to be shown of one log: ``file``, ``ours``, ``disagreements``, ``gpsd``."""


def entry(
    file: str, ours: Mapping[str, Any], said: Sequence[Disagreement], agreed: gpsd.Agreement | None
) -> dict[str, Any]:
    """Return one log's entry."""
    listed = [
        {"kind": d.kind, "ours": d.ours, "theirs": d.theirs, "explanation": d.explanation}
        for d in said
    ]
    return {
        "file": file,
        "ours": ours,
        "disagreements": listed,
        "gpsd": gpsd.as_dict(agreed) if agreed else None,
    }


def table(entries: Sequence[Entry]) -> Iterator[str]:
    """Yield the lines of a table that fits 80 columns."""
    yield f"{'log':<34}{'format':<8}{'rows':>9}{'skipped':>9}{'s':>6}{'differ':>8}{'open':>5}"
    for one in entries:
        ours, said = one["ours"], one["disagreements"]
        rows = sum(ours.get("rows", {}).values())
        total = ours.get("used", 0) + ours.get("skipped", 0)
        skipped = f"{100 * ours['skipped'] / total:.1f} %" if total else "-"
        unexplained = sum(not d["explanation"] for d in said)
        name = one["file"].rpartition("/")[2]
        name = name if len(name) <= 33 else name[:30] + "..."
        counts = f"{rows:>9,}{skipped:>9}{ours['seconds']:>6.2f}{len(said):>8}{unexplained:>5}"
        yield f"{name:<34}{ours['format']:<8}{counts}"


def summary(entries: Sequence[Entry], agreements: Sequence[gpsd.Agreement]) -> Iterator[str]:
    """Yield what all logs come to."""
    said = [d for one in entries for d in one["disagreements"]]
    unexplained = sum(not d["explanation"] for d in said)
    converted = [one for one in entries if one["ours"].get("rows")]
    rows = sum(sum(one["ours"]["rows"].values()) for one in converted)
    yield (
        f"{len(entries)} logs, {len(converted)} converted, {rows:,} rows, "
        f"{sum(one['ours']['seconds'] for one in entries):.1f} s;"
    )
    yield (
        f"{len(said)} disagreements with other parsers and the manifests, {unexplained} of them "
        "not explained."
    )
    if agreements:
        epochs, matched = sum(a.epochs for a in agreements), sum(a.matched for a in agreements)
        yield (
            f"gpsd: {len(agreements)} logs, {epochs} epochs with a time, {matched} of them with a "
            "row of ours at that time;"
        )
        for name in agreements[0].differences:
            found = gpsd.statistics([a.differences[name] for a in agreements])
            if found["n"]:
                yield (
                    f"  {name:<14}{found['n']:>6} compared   median {found['median']:<10g} max "
                    f"{found['max']:g}"
                )


def markdown(entries: Sequence[Entry], closing: Sequence[str]) -> Iterator[str]:
    """Yield the lines of the Markdown report."""
    yield "# Agreement of the converters with other parsers"
    yield ""
    yield from (f"{line.strip()}  " for line in closing)
    yield ""
    yield "| log | format | rows by topic | rejects by reason (units) | s | clock |"
    yield "|---|---|---|---|---|---|"
    for one in entries:
        ours = one["ours"]
        rows = "<br>".join(f"{topic} {count:,}" for topic, count in ours.get("rows", {}).items())
        rejects = "<br>".join(
            f"{_cell(reason)}: {count:,}" for reason, count in ours.get("rejects", {}).items()
        )
        refused = f"refused: {_cell(ours['refused'])}" if ours["refused"] else ""
        given = f"; with date {ours['date_given']}:<br>" if ours["date_given"] and refused else ""
        cells = (
            one["file"],
            ours["format"],
            refused + given + rows,
            rejects,
            f"{ours['seconds']:.2f}",
            ours.get("clock") or "",
        )
        yield f"| {' | '.join(cells)} |"
    yield ""
    yield "## Where others disagree"
    yield ""
    yield "| log | what | ours | theirs | who is right |"
    yield "|---|---|---|---|---|"
    for one in entries:
        for d in one["disagreements"]:
            why = _cell(d["explanation"]) or "**not explained**"
            yield (
                f"| {one['file']} | {d['kind']} | {_cell(d['ours'])} | {_cell(d['theirs'])} | "
                f"{why} |"
            )
    yield ""
    yield "## gpsd, log by log"
    yield ""
    names = ("position_m", "height_m", "height_msl_m", "speed_mps", "course_deg")
    yield (
        "| log | epochs | same time | "
        + " | ".join(f"{name} median / max (n)" for name in names)
        + " | satellites both / gpsd alone / ours alone |"
    )
    yield "|---|---|---|" + "---|" * (len(names) + 1)
    for one in entries:
        if found := one["gpsd"]:
            figures = [
                f"{s['median']:g} / {s['max']:g} ({s['n']})" if (s := found[name])["n"] else ""
                for name in names
            ]
            satellites = " / ".join(str(number) for number in found["satellites"].values())
            yield (
                f"| {one['file']} | {found['epochs']} | {found['matched']} | {' | '.join(figures)} "
                f"| {satellites} |"
            )


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


def save(entries: Sequence[Entry], closing: Sequence[str], folder: Path) -> None:
    """Write ``agreement.md`` and ``agreement.json``."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "agreement.md").write_text(
        "\n".join(markdown(entries, closing)) + "\n", encoding="utf-8"
    )
    (folder / "agreement.json").write_text(
        json.dumps(entries, indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
    )
