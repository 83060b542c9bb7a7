"""The leaderboard in the terminal: two tables that fit 80 columns and truncate nothing."""

from collections.abc import Iterable, Iterator
from string import ascii_lowercase
from textwrap import fill, wrap

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from spoofbench.formatting import NONE, percent, printable, rate, share_percent
from spoofbench.report.tables import (
    Board,
    cell_text,
    detection_interval,
    exceeds_target,
    far_interval,
    legend,
    time_to_detection,
)

_WIDTH = 80
_NAME = 28
"""Widest column of names; longer ones fold."""

_CELL = 6
"""Width of a detection percentage, with air."""


def print_board(board: Board, console: Console) -> None:
    """Print the leaderboard, its legend and the detection percentages by attack."""
    width = min(console.width, _WIDTH)
    console.print(_leaderboard(board), width=width)
    console.print(_lines(legend(board), width), style="dim", width=width)
    for table in _by_attack(board, width):
        console.print(table, width=width)
    console.print(_lines([_key(board)], width), style="dim", width=width)


def _lines(texts: Iterable[str], width: int) -> Text:
    """Paragraphs with a hanging indent, and a blank line; no-break blanks hold."""
    return Text(
        "\n".join(
            [
                fill(printable(text), width, subsequent_indent="  ", break_on_hyphens=False)
                for text in texts
            ]
            + [""]
        )
    )


def _name(name: str) -> Text:
    """A name, folded at its hyphens where it is long."""
    return Text("\n".join(wrap(printable(name), _NAME)))


def _table(title: str) -> Table:
    return Table(
        title=title,
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE_HEAD,
        padding=0,
        pad_edge=False,
        show_edge=False,
    )


def _leaderboard(board: Board) -> Table:
    table = _table("Leaderboard")
    table.add_column("#", justify="right", no_wrap=True)
    table.add_column("detector", overflow="fold", max_width=_NAME)
    for heading in ("FA/h ", "95 %", "Det %", "TTFD\nmedian", "TTFD\n90 %", "Avail\n%", "Fail"):
        table.add_column(Text(heading), justify="right", no_wrap=True, vertical="top")
    for row in board.ranking.rows:
        interval = detection_interval(row)
        table.add_row(
            NONE if row.rank is None else str(row.rank),
            _name(row.detector),
            rate(row.far_per_hour) + ("*" if exceeds_target(row) else " "),
            far_interval(row),
            percent(row.detection_pct) + ("" if interval == NONE else f"\n{interval}"),
            time_to_detection(row.ttfd_median_s, row, board.extent),
            time_to_detection(row.ttfd_p90_s, row, board.extent),
            share_percent(row.availability),
            str(row.failed),
            style="dim" if exceeds_target(row) else None,
        )
    return table


def _by_attack(board: Board, width: int) -> Iterator[Table]:
    """Detector x attack, attacks by letter, as many tables as the width asks for."""
    names = [row.detector for row in board.ranking.rows]
    letters = _letters(len(board.ranking.attacks))
    each = max((width - min(max(map(len, names), default=8), _NAME)) // (_CELL + 1), 1)
    for first in range(0, len(letters), each):
        part = slice(first, first + each)
        table = _table("Detection by attack, %")
        table.add_column("detector", overflow="fold", max_width=_NAME)
        for letter in letters[part]:
            table.add_column(letter, justify="right", no_wrap=True, min_width=_CELL)
        for name in names:
            table.add_row(_name(name), *(cell_text(cell) for cell in board.cells(name)[part]))
        yield table


def _letters(n: int) -> list[str]:
    """``a`` to ``z``, then ``aa`` and on."""
    return [
        ascii_lowercase[i] if i < 26 else ascii_lowercase[i // 26 - 1] + ascii_lowercase[i % 26]
        for i in range(n)
    ]


def _key(board: Board) -> str:
    attacks = board.ranking.attacks
    return "  ".join(
        f"{letter}\N{NO-BREAK SPACE}{name}"
        for letter, name in zip(_letters(len(attacks)), attacks, strict=True)
    )
