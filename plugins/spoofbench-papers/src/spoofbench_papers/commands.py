"""The commands ``reproduce`` and ``integrity``. Heavy imports wait until a command runs."""

import os
from pathlib import Path
from typing import Annotated

import typer

from spoofbench.terminal import complain, print_json, print_lines, progress_bars


def reproduce(
    papers: Annotated[
        list[str], typer.Argument(metavar="PAPER...", help="lo2017, borio, tanil2018, kujur.")
    ],
    out: Annotated[Path, typer.Option("-o", help="Folder; each paper gets one in it.")],
    data: Annotated[
        Path | None,
        typer.Option(
            exists=True,
            file_okay=False,
            help="Folder of further logs; what needs a log that is not there is left out.",
        ),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="A short form with fewer seeds.")] = False,
) -> None:
    """Put a paper's tables and figures beside ours."""
    _limit_threads()
    from spoofbench_papers.reproduction import as_rows, find_paper, reproduce_paper

    for paper in papers:
        find_paper(paper)
    if data is None:
        complain("no folder of further logs (--data): what needs them is left out")
    with progress_bars() as progress:
        pages = [
            reproduce_paper(paper, out / paper, data, quick, progress(paper)) for paper in papers
        ]
    for page, reproduced in pages:
        print_lines([*as_rows(reproduced), f"report: {page}"])


def integrity(
    scenario: Annotated[Path, typer.Argument(metavar="SCENARIO.toml")],
    out: Annotated[Path, typer.Option("-o", help="Folder for tables and pictures.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print for machines.")] = False,
) -> None:
    """Assess an innovation monitor of your own vehicle."""
    _limit_threads()
    from spoofbench_papers.assessment import assess

    with progress_bars() as progress:
        summary = assess(scenario, out, progress(scenario.stem))
    if as_json:
        print_json(summary)
    else:
        print_lines(
            [
                *(f"{name:<22}{value:.6g}" for name, value in summary.items()),
                f"tables and pictures: {out}",
            ]
        )


def _limit_threads() -> None:
    """Keep linear algebra on one thread: threads only slow small matrices down."""
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(name, "1")
