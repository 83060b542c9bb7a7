"""Papers' tables and figures beside ours: what a reproduction gives, and how it is written down.

A reproduction is a module of :data:`PAPERS`. It writes its numbers as Parquet and its pictures into
a folder, and returns cells: one printed value each, ours beside it, and a verdict.
"""

import base64
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, Protocol

from spoofbench.config import did_you_mean
from spoofbench.errors import SpoofbenchError
from spoofbench.results import write_whole
from spoofbench_papers.figures import make_folder

Verdict = Literal["matches", "matches after calibration", "trend only", "not reproduced"]
Progress = Callable[[float], None]

PAPERS: Mapping[str, str] = {
    "borio": "spoofbench_papers.borio",
    "kujur": "spoofbench_papers.kujur",
    "lo2017": "spoofbench_papers.lo2017",
    "tanil2018": "spoofbench_papers.tanil2018",
}
"""The module of each paper; it is imported when the paper is asked for."""


class ReproductionError(SpoofbenchError):
    """A paper is asked for that is not here."""


@dataclass(frozen=True, slots=True)
class Cell:
    """One thing that a paper prints.

    Attributes:
        item: where the paper prints it, and what it is.
        printed: its value, None where the paper shows a trend alone.
        ours: our value; ``lo`` and ``hi`` its interval over seeds, None where nothing is random.
        verdict: ``matches`` with nothing tuned; ``matches after calibration`` where something that
            the paper does not say was chosen so that it does; ``trend only``; ``not reproduced``.
        reason: what the verdict rests on, in a sentence.
    """

    item: str
    printed: float | str | None
    ours: float | str | None
    lo: float | None
    hi: float | None
    verdict: Verdict
    reason: str


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture in the folder, ``<name>.png`` and ``<name>.svg``, and what it shows."""

    name: str
    caption: str


@dataclass(frozen=True, slots=True)
class Reproduced:
    """What a reproduction found."""

    cells: Sequence[Cell]
    pictures: Sequence[Picture]
    notes: Sequence[str]


class Reproduction(Protocol):
    """Reproduces one paper.

    Attributes:
        TITLE: what is reproduced, for a heading.
        PAPER: authors, title, where and when.
    """

    TITLE: str
    PAPER: str

    def reproduce(
        self, out: Path, data: Path | None, quick: bool, progress: Progress
    ) -> Reproduced:
        """Write Parquet files and pictures into ``out``.

        Args:
            out: folder, which exists.
            data: folder of further logs, where there is one; what needs an absent log is left out
                and noted.
            quick: a short form with fewer seeds, for tests.
            progress: is told the share that is done, 0 to 1.
        """
        ...


def find_paper(name: str) -> Reproduction:
    """Return the reproduction of a paper.

    Raises:
        ReproductionError: there is no such paper; names those there are.
    """
    if name not in PAPERS:
        raise ReproductionError(f"no paper is called {name!r}{did_you_mean(name, PAPERS)}")
    module: Any = import_module(PAPERS[name])
    reproduction: Reproduction = module
    return reproduction


def reproduce_paper(
    name: str, out: Path, data: Path | None, quick: bool, progress: Progress
) -> tuple[Path, Reproduced]:
    """Run a reproduction and write its pages; return the page's path and what was found.

    Raises:
        ReproductionError: there is no such paper.
        ResultsError: the folder cannot be made, or a file not written.
    """
    reproduction = find_paper(name)
    make_folder(out)
    found = reproduction.reproduce(out, data, quick, progress)
    progress(1.0)
    return write_pages(out, reproduction, found), found


def as_rows(found: Reproduced) -> list[str]:
    """Return the cells and the tally as lines for a terminal."""
    lines = [
        f"{cell.verdict:<25}{shown(cell.printed):>12} {shown(cell.ours):>14}  {cell.item}"
        for cell in found.cells
    ]
    return [
        f"{'verdict':<25}{'printed':>12} {'ours':>14}  item",
        *lines,
        ", ".join(f"{k}: {n}" for k, n in tally(found.cells).items()),
    ]


def write_pages(out: Path, reproduction: Reproduction, found: Reproduced) -> Path:
    """Write ``verdicts.json``, ``README.md`` and ``index.html`` beside the pictures; return the
    page's path.
    """
    verdicts = json.dumps([asdict(cell) for cell in found.cells], indent=1, allow_nan=False) + "\n"
    texts = {
        "verdicts.json": verdicts,
        "README.md": as_markdown(reproduction, found),
        "index.html": _page(out, reproduction, found),
    }
    for name, text in texts.items():
        write_whole(out / name, partial(Path.write_text, data=text, encoding="utf-8", newline="\n"))
    return out / "index.html"


def as_markdown(reproduction: Reproduction, found: Reproduced) -> str:
    """Return the cells, notes and pictures as Markdown."""
    lines = [
        f"# {reproduction.TITLE}",
        "",
        reproduction.PAPER,
        "",
        "| printed | ours | interval | verdict | item, and why |",
        "|---|---|---|---|---|",
    ]
    for cell in found.cells:
        text = f"**{cell.item}**: {cell.reason}".replace("|", "\\|")
        lines.append(
            f"| {shown(cell.printed)} | {shown(cell.ours)} | {_interval(cell)} | {cell.verdict} | "
            f"{text} |"
        )
    lines += ["", *(f"- {note}" for note in found.notes)]
    for picture in found.pictures:
        lines += ["", f"![{picture.caption}]({picture.name}.png)", "", picture.caption]
    return "\n".join(lines) + "\n"


def tally(cells: Sequence[Cell]) -> dict[str, int]:
    """How many cells have each verdict, the best first."""
    order: tuple[Verdict, ...] = (
        "matches",
        "matches after calibration",
        "trend only",
        "not reproduced",
    )
    return {verdict: sum(cell.verdict == verdict for cell in cells) for verdict in order}


def shown(value: float | str | None) -> str:
    """Return a value as text: four figures, a dash for null."""
    if value is None:
        return "-"
    return value if isinstance(value, str) else f"{value:.4g}"


def _interval(cell: Cell) -> str:
    return "-" if cell.lo is None or cell.hi is None else f"{shown(cell.lo)} to {shown(cell.hi)}"


def _page(out: Path, reproduction: Reproduction, found: Reproduced) -> str:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        autoescape=True,
        undefined=StrictUndefined,
        loader=PackageLoader("spoofbench_papers"),
    )
    pictures = [
        (p.caption, base64.b64encode((out / f"{p.name}.png").read_bytes()).decode())
        for p in found.pictures
    ]
    rows = [(cell, shown(cell.printed), shown(cell.ours), _interval(cell)) for cell in found.cells]
    return environment.get_template("reproduction.html.j2").render(
        title=reproduction.TITLE,
        paper=reproduction.PAPER,
        rows=rows,
        notes=found.notes,
        pictures=pictures,
        tally=tally(found.cells),
    )
