"""The page: one file with its styles, scripts and data, and the same leaderboard for machines
beside it.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from spoofbench.report.md import as_markdown
from spoofbench.report.runs import payload
from spoofbench.report.tables import Board, basis, exceeds_target, read_board
from spoofbench.report.views import COLUMNS, figures, shades, versions
from spoofbench.results import read_run, write_whole

_STYLES = ("uplot/uPlot.min.css", "page.css")
_SCRIPTS = ("uplot/uPlot.iife.min.js", "tables.js", "data.js", "timeline.js", "map.js", "runs.js")


def write(folder: Path, site: Path) -> Path:
    """Write the page, the Markdown and the JSON; return the page's path."""
    board, run = read_board(folder), read_run(folder)
    texts = {
        "leaderboard.md": as_markdown(board),
        "leaderboard.json": json.dumps(
            asdict(board.ranking) | {"clean_h": board.extent.clean_h}, indent=1, allow_nan=False
        )
        + "\n",
        "index.html": _page(board, run, payload(folder, board.ranking.rows[0].detector)),
    }
    for name, text in texts.items():
        write_whole(
            site / name, partial(Path.write_text, data=text, encoding="utf-8", newline="\n")
        )
    return site / "index.html"


def _page(board: Board, run: Mapping[str, Any], data: Mapping[str, Any]) -> str:
    assets = files("spoofbench.report")
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.policies["json.dumps_kwargs"] = {
        "sort_keys": True,
        "allow_nan": False,
        "separators": (",", ":"),
    }
    template = environment.from_string(
        (assets / "templates" / "index.html.j2").read_text(encoding="utf-8")
    )

    def inline(names: tuple[str, ...]) -> Markup:
        return Markup(
            "\n".join(
                (assets / "assets" / name).read_text(encoding="utf-8").strip() for name in names
            )
        )

    return template.render(
        title=_title(run),
        basis=basis(board),
        note=board.ranking.note,
        target=f"{board.ranking.target_far_per_hour:g}",
        columns=COLUMNS,
        rows=[(row, exceeds_target(row), figures(row, board)) for row in board.ranking.rows],
        attacks=board.ranking.attacks,
        heat=[(row.detector, shades(row.detector, board)) for row in board.ranking.rows],
        versions=versions(run),
        run=json.dumps(run, indent=1, sort_keys=True),
        data=data,
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
