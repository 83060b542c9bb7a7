"""The page's tables as text, sort keys and shades."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal
from urllib.parse import urlencode

from spoofbench.formatting import NONE, between, percent, rate, share_percent
from spoofbench.report.runs import labels
from spoofbench.report.tables import (
    Board,
    cell_text,
    detection_interval,
    exceeds_target,
    far_interval,
    time_to_detection,
)
from spoofbench.results import FAILURES
from spoofbench.scoring.leaderboard import Cell, Row


@dataclass(frozen=True, slots=True)
class Column:
    """A sortable column: ``first`` is the order that the first click asks for."""

    title: str
    unit: str
    first: Literal["ascending", "descending"] = "descending"
    kind: Literal["number", "text"] = "number"


COLUMNS = (
    Column("Rank", "", "ascending"),
    Column("Detector", "", "ascending", "text"),
    Column("False alerts", "per hour", "ascending"),
    Column("Detection", "% of spoofed epochs"),
    Column("Missed", "% of attacks", "ascending"),
    Column("Median", "s to first detection", "ascending"),
    Column("90 %", "s to first detection", "ascending"),
    Column("Available", "% of clean epochs"),
    Column("Failed", "tasks", "ascending"),
)


@dataclass(frozen=True, slots=True)
class Figure:
    """One table cell: text, what stands beside it, and what it sorts by ("" is unknown, and
    last).
    """

    text: str
    beside: str = ""
    sort: str = ""


def figures(row: Row, board: Board) -> list[Figure]:
    """Return a row of the leaderboard, in the order of :data:`COLUMNS`."""
    missed = between(share_percent(row.p_md_lo), share_percent(row.p_md_hi))
    return [
        _figure(NONE if row.rank is None else str(row.rank), row.rank),
        Figure(row.detector, "baseline" if row.baseline else "", row.detector),
        _figure(
            rate(row.far_per_hour),
            row.far_per_hour,
            far_interval(row) + ("*" if exceeds_target(row) else ""),
        ),
        _figure(percent(row.detection_pct), row.detection_pct, detection_interval(row)),
        _figure(share_percent(row.p_md), row.p_md, missed),
        _detection_time(row.ttfd_median_s, row, board),
        _detection_time(row.ttfd_p90_s, row, board),
        _figure(share_percent(row.availability), row.availability),
        _figure(str(row.failed), row.failed),
    ]


def _figure(text: str, value: float | None, interval: str = NONE) -> Figure:
    return Figure(
        text, "" if interval == NONE else interval, "" if value is None else repr(float(value))
    )


def _detection_time(value_s: float | None, row: Row, board: Board) -> Figure:
    """A time beyond the longest attack sorts behind all known ones, before unknown ones."""
    beyond = "inf" if row.events else ""
    return Figure(
        time_to_detection(value_s, row, board.extent),
        "",
        beyond if value_s is None else repr(float(value_s)),
    )


@dataclass(frozen=True, slots=True)
class Shade:
    """One cell of the table by attack: text, its share of full colour in percent, where it leads,
    what it says in words.
    """

    text: str
    share: float | None
    link: str
    label: str
    note: str


def shades(detector: str, board: Board) -> list[Shade]:
    """Return a detector's cells against each attack, each with the address of its first run."""
    return [
        _shade(detector, attack, cell, board)
        for attack, cell in zip(board.ranking.attacks, board.cells(detector), strict=True)
    ]


def _shade(detector: str, attack: str, cell: Cell | None, board: Board) -> Shade:
    pct = None if cell is None else cell.detection_pct
    text, note = cell_text(cell), "" if cell is None else _note(cell)
    runs = [task for task in board.tasks if task.detector == detector and task.attack == attack]
    best = next(
        (task for task in runs if task.status == "ok" or task.status in FAILURES),
        runs[0] if runs else None,
    )
    return Shade(
        text=text,
        share=None if pct is None else round(pct, 1),
        link="" if best is None else urlencode(labels(best)),
        label=f"{detector} on {attack}: {text if pct is None else f'{text} %'}{f', {note}' if note else ''}",
        note=note,
    )


def _note(cell: Cell) -> str:
    """What became of the tasks that have no decisions."""
    counts = {"failed": cell.failed, "skipped": cell.skipped, "not modelled": cell.not_modelled}
    return ", ".join(f"{n} {name}" for name, n in counts.items() if n)


def versions(run: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return what a run's results rest on: versions, machine and digests of the inputs, as name and
    text.
    """
    groups = [
        (group, run[group])
        for group in ("versions", "machine", "inputs")
        if isinstance(run.get(group), Mapping)
    ]
    return [
        (name if group == "versions" else f"{group}: {name}", str(value))
        for group, facts in groups
        for name, value in sorted(facts.items())
    ]
