"""The page: one file with its styles, scripts and data, and the same leaderboard for machines
beside it.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import numpy as np
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from spoofbench.formatting import NONE
from spoofbench.report import wording
from spoofbench.report.columns import (
    FURTHER,
    MARKS,
    VERDICT,
    Entry,
    LeaderboardColumn,
    columns_of,
    explained,
)
from spoofbench.report.markdown_text import markdown
from spoofbench.report.runs import labels, run_data
from spoofbench.results import FAILURES, Task, read_run, read_tasks, write_whole
from spoofbench.scoring.leaderboard import (
    BoardTable,
    Leaderboard,
    LeaderboardCell,
    LeaderboardRow,
)

_STYLES = ("uplot/uPlot.min.css", "page.css")
_SCRIPTS = ("uplot/uPlot.iife.min.js", "tables.js", "data.js", "timeline.js", "map.js", "runs.js")


def write(folder: Path, board: Leaderboard, site: Path) -> Path:
    """Write the page, the Markdown and the JSON; return the page's path."""
    tasks, run = read_tasks(folder), read_run(folder)
    as_json = json.dumps(asdict(board), indent=1, allow_nan=False, default=np.ndarray.tolist)
    page = site / "index.html"
    _write(page, _page(board, run, tasks, run_data(folder, tasks, _opened(board))))
    _write(site / "leaderboard.md", [markdown(board)])
    _write(site / "leaderboard.json", [as_json + "\n"])
    return page


def _opened(board: Leaderboard) -> str:
    """The detector with which the page opens: one that is ranked first, else any."""
    rows = [row for table in board.tables for row in table.rows]
    rows.sort(key=lambda row: row.rank != 1)
    return rows[0].detector if rows else ""


def _write(path: Path, texts: Iterable[str]) -> None:
    def write_texts(temporary: Path) -> None:
        with temporary.open("w", encoding="utf-8", newline="\n") as stream:
            stream.writelines(texts)

    write_whole(path, write_texts)


def _page(
    board: Leaderboard, run: Mapping[str, Any], tasks: Sequence[Task], data: Iterator[str]
) -> Iterator[str]:
    """The page in pieces: the data on the runs may be large, and are never held as one text."""
    assets = files("spoofbench.report")
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    template = environment.from_string(
        (assets / "templates" / "index.html.j2").read_text(encoding="utf-8")
    )

    def inline(names: tuple[str, ...]) -> Markup:
        texts = [(assets / "assets" / name).read_text(encoding="utf-8").strip() for name in names]
        return Markup("\n".join(texts))  # noqa: S704, our own files

    return template.generate(
        title=_title(run),
        wording=wording,
        board=board,
        sections=[_section(board, table, tasks) for table in board.tables],
        explained=explained(board.tables),
        transfer=list(map(wording.transfer_cells, board.transfer)),
        versions=_versions(run),
        run=json.dumps(run, indent=1, sort_keys=True),
        data=map(Markup, data),
        styles=inline(_STYLES),
        scripts=inline(_SCRIPTS),
    )


def _title(run: Mapping[str, Any]) -> str:
    suite = run.get("suite")
    name = suite.get("name") if isinstance(suite, Mapping) else suite
    return (
        f"GNSS spoofing detectors on suite {name}"
        if isinstance(name, str)
        else "GNSS spoofing detectors"
    )


@dataclass(frozen=True, slots=True)
class PageGrid:
    """Columns of a table, and what each row shows in them: beneath its name its marks in words."""

    columns: Sequence[LeaderboardColumn]
    rows: Sequence[tuple[LeaderboardRow, str, Sequence[Entry]]]


@dataclass(frozen=True, slots=True)
class HeatCell:
    """One cell of the table by attack.

    Attributes:
        text: attacks detected of all, and the placebo.
        share: how much of the full colour it has, in percent; None where it is unknown.
        link: address of its first run, of one that was tried if there is one.
        label: what it says in words.
    """

    text: str
    share: float | None
    link: str
    label: str


@dataclass(frozen=True, slots=True)
class PageSection:
    """One table of the leaderboard as the page shows it.

    Attributes:
        heading, evidence, notes: what is said of it.
        grids: its figures: what decides, and what else is known.
        attacks: over the table by attack.
        heat: each detector, and its cells against each attack.
        severity: of attacks made at several strengths, see :func:`.wording.severity_of`.
    """

    heading: str
    evidence: str
    notes: Sequence[str]
    grids: Sequence[PageGrid]
    attacks: Sequence[str]
    heat: Sequence[tuple[str, Sequence[HeatCell]]]
    severity: Sequence[Sequence[str]]


def _section(board: Leaderboard, table: BoardTable, tasks: Sequence[Task]) -> PageSection:
    grids = []
    for columns in (VERDICT, FURTHER):
        shown = columns_of(table, columns)
        is_marked = MARKS in shown
        shown = [column for column in shown if column is not MARKS]
        rows = [
            (
                row,
                MARKS.entry(table, row).text if is_marked else "",
                [column.entry(table, row) for column in shown],
            )
            for row in table.rows
        ]
        grids.append(PageGrid(shown, rows))
    return PageSection(
        heading=wording.heading(table),
        evidence=wording.evidence(board, table),
        notes=wording.notes(table),
        grids=grids,
        attacks=table.attacks,
        heat=list(_heat(table, tasks)),
        severity=wording.severity_of(board, table),
    )


def _heat(table: BoardTable, tasks: Sequence[Task]) -> Iterator[tuple[str, list[HeatCell]]]:
    """Each detector and its cells against each attack."""
    linked: dict[tuple[str, str | None], Task] = {}
    own = [task for task in tasks if task.role == "judged" and task.provenance == table.provenance]
    for task in sorted(own, key=lambda task: task.status not in {"ok", *FAILURES}):
        linked.setdefault((task.detector, task.attack), task)
    for index, row in enumerate(table.rows):
        yield (
            row.detector,
            [
                _heat_cell(table, cell, linked.get((cell.detector, cell.attack)))
                for cell in table.cells_of(index)
            ],
        )


def _heat_cell(table: BoardTable, cell: LeaderboardCell, task: Task | None) -> HeatCell:
    figures, text = cell.figures, wording.cell_text(table, cell)
    return HeatCell(
        text=text,
        share=None if text == NONE else round(100 * figures.detected / figures.attacks, 1),
        link="" if task is None else urlencode(labels(task)),
        label=f"{cell.detector} on {cell.attack}: {text}",
    )


def _versions(run: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Versions, machine and digests of the inputs that a run rests on, as name and text."""
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
