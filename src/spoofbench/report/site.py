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

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from spoofbench.report.leaderboard_table import COLUMNS, cell_text, evidence, markdown
from spoofbench.report.runs import labels, run_data
from spoofbench.results import FAILURES, Task, read_run, read_tasks, write_whole
from spoofbench.scoring.leaderboard import Leaderboard, LeaderboardCell

_STYLES = ("uplot/uPlot.min.css", "page.css")
_SCRIPTS = ("uplot/uPlot.iife.min.js", "tables.js", "data.js", "timeline.js", "map.js", "runs.js")


def write(folder: Path, board: Leaderboard, site: Path) -> Path:
    """Write the page, the Markdown and the JSON; return the page's path."""
    tasks, run = read_tasks(folder), read_run(folder)
    as_json = json.dumps(asdict(board), indent=1, allow_nan=False) + "\n"
    page = site / "index.html"
    _write(page, _page(board, run, tasks, run_data(folder, tasks, board.rows[0].detector)))
    _write(site / "leaderboard.md", [markdown(board)])
    _write(site / "leaderboard.json", [as_json])
    return page


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
        evidence=evidence(board),
        note=board.note,
        target=f"{board.target_far_per_hour:g}",
        columns=COLUMNS,
        rows=[(row, [column.figure(row) for column in COLUMNS]) for row in board.rows],
        attacks=board.attacks,
        heat=_heat(board, tasks),
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
class HeatCell:
    """One cell of the table by attack.

    Attributes:
        text: the detection percentage.
        share: how much of the full colour it has, in percent; None where it is unknown.
        link: address of its first run, of one that was tried if there is one.
        label: what it says in words.
        note: what became of the tasks that have no decisions.
    """

    text: str
    share: float | None
    link: str
    label: str
    note: str


def _heat(board: Leaderboard, tasks: Sequence[Task]) -> Iterator[tuple[str, list[HeatCell]]]:
    """Each detector and its cells against each attack."""
    linked: dict[tuple[str, str | None], Task] = {}
    for task in sorted(tasks, key=lambda task: task.status not in {"ok", *FAILURES}):
        linked.setdefault((task.detector, task.attack), task)
    for index, row in enumerate(board.rows):
        yield (
            row.detector,
            [
                _heat_cell(cell, linked.get((cell.detector, cell.attack)))
                for cell in board.cells_of(index)
            ],
        )


def _heat_cell(cell: LeaderboardCell, task: Task | None) -> HeatCell:
    pct, text = cell.detection_pct, cell_text(cell)
    counts = {"failed": cell.failed, "skipped": cell.skipped, "not modelled": cell.not_modelled}
    note = ", ".join(f"{n} {name}" for name, n in counts.items() if n)
    share = text if pct is None else f"{text} %"
    return HeatCell(
        text=text,
        share=None if pct is None else round(pct, 1),
        link="" if task is None else urlencode(labels(task)),
        label=f"{cell.detector} on {cell.attack}: {share}{f', {note}' if note else ''}",
        note=note,
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
