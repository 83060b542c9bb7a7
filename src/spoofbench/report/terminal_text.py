"""The leaderboard in the terminal: in at most 80 columns what a verdict rests on.

Nothing is cut off: names fold, and attacks take several tables. What does not fit is in Markdown
and on the page.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from string import ascii_lowercase
from textwrap import fill, wrap

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from spoofbench.formatting import printable
from spoofbench.report import wording
from spoofbench.report.columns import (
    FALSE_ALERTS,
    LARGEST_ERROR,
    MEAN_TIME,
    MEDIAN_ERROR,
    RANK,
)
from spoofbench.report.marks import MEANINGS, marks
from spoofbench.scoring.leaderboard import BoardTable, Leaderboard, LeaderboardRow

_WIDTH = 80
_NAME_WIDTH = 28
"""Widest column of names; longer ones fold."""

_LEAST_NAME_WIDTH = 13
"""What figures leave to names before they go into a table of their own."""

_LEGEND = {
    "#": (
        "rank, by attacks detected, then by time. Baselines (B) and rows that stand apart (a) have "
        "none."
    ),
    "FA/h": "alarm episodes per available clean hour, with their 95 % interval.",
    "detected": (
        "attack windows in which an alert begins, of all; in brackets those of them in which one "
        "begins without any attack (placebo)."
    ),
    "TTFD": (
        "time to first detection, s: mean up to the longest attack, in which a miss counts in "
        "full; > where nothing is detected."
    ),
    "error": (
        "largest position error before the first alert, or in all of an attack that is missed: "
        "median and largest over the attacks, m."
    ),
    "-": "unknown, never 0.",
    "more": (
        "95 % intervals and quantiles, alarm time, availability, re-trust, hazard, thresholds and "
        "what they give as published are in the Markdown and on the page."
    ),
}

Cells = Callable[[LeaderboardRow], str]


def print_board(board: Leaderboard, console: Console) -> None:
    """Print each table with its notes, its verdict and its detections by attack, then the key."""
    width = min(console.width, _WIDTH)

    def say(lines: Iterable[str]) -> None:
        console.print(_paragraphs(lines, width), style="dim", width=width)

    if not board.tables:
        say([wording.NO_TABLES, *wording.absent(board)])
        return
    for table in board.tables:
        console.print(Text(fill(wording.heading(table), width)), style="bold", width=width)
        say([wording.evidence(board, table), *wording.notes(table)])
        for part in _verdict(table, width):
            console.print(part, width=width)
        say(wording.details(table))
        if table.windows > 1:
            letters = list(_letters(len(table.attacks)))
            for part in _by_attack(table, letters, width):
                console.print(part, width=width)
            say(
                [
                    "  ".join(
                        f"{letter}\N{NO-BREAK SPACE}{name}"
                        for letter, name in zip(letters, table.attacks, strict=True)
                    )
                ]
            )
        severity = wording.severity_of(board, table)
        if severity:
            head = wording.SEVERITY_HEAD
            console.print(_plain(wording.SEVERITY, head, 2, severity, width), width=width)
            say([wording.SEVERITY_NOTE])
    if board.transfer:
        rows = list(map(wording.transfer_cells, board.transfer))
        head = wording.TRANSFER_HEAD
        console.print(_plain(wording.TRANSFER, head, 3, rows, width), width=width)
        say([wording.TRANSFER_NOTE])
    say(
        [
            *wording.absent(board),
            *(f"{term}: {meaning}" for term, meaning in _LEGEND.items()),
            *_meanings(board),
        ]
    )


def _meanings(board: Leaderboard) -> Iterator[str]:
    """The meanings of the marks that the board shows."""
    shown = {
        mark.letter for table in board.tables for row in table.rows for mark in marks(table, row)
    }
    for letter, meaning in MEANINGS.items():
        if letter in shown:
            yield f"{letter}: {meaning}"


def _verdict(table: BoardTable, width: int) -> Iterator[Table]:
    """What decides, as one table where it fits, else as several of the same rows."""
    columns: list[tuple[str, Cells]] = [
        ("FA/h", lambda row: FALSE_ALERTS.entry(table, row).text),
        ("95 %", lambda row: FALSE_ALERTS.entry(table, row).interval),
        ("detected\n(placebo)", lambda row: _detected(table, row)),
        ("TTFD\nmean s", lambda row: MEAN_TIME.entry(table, row).text),
        ("error\nmed. m", lambda row: MEDIAN_ERROR.entry(table, row).text),
        ("error\nmax. m", lambda row: LARGEST_ERROR.entry(table, row).text),
    ]
    if table.windows == 1:
        del columns[3:5]
    ranks = [RANK.entry(table, row).text for row in table.rows]
    letters = ["".join(mark.letter for mark in marks(table, row)) for row in table.rows]
    figures = [(title, [form(row) for row in table.rows]) for title, form in columns]
    around = _widest(["#", *ranks]) + 2 + _widest(["marks", *letters])
    for part in _packed(figures, width - around - _LEAST_NAME_WIDTH):
        taken = around + sum(1 + _widest([title, *texts]) for title, texts in part)
        name_width = min(width - taken, _NAME_WIDTH)
        shown = _empty_table()
        shown.add_column("#", justify="right", no_wrap=True)
        shown.add_column("detector", overflow="fold", max_width=name_width)
        for title, _ in part:
            shown.add_column(Text(title), justify="right", no_wrap=True)
        shown.add_column("marks", no_wrap=True)
        for number, row in enumerate(table.rows):
            shown.add_row(
                ranks[number],
                _folded(row.detector, name_width),
                *(texts[number] for _, texts in part),
                Text(letters[number]),
                style="dim" if row.exceeds_target or row.baseline else None,
            )
        yield shown


def _packed(
    columns: Iterable[tuple[str, list[str]]], width: int
) -> Iterator[list[tuple[str, list[str]]]]:
    """Split columns, title and texts each, into runs that fit a width with a blank before each."""
    part: list[tuple[str, list[str]]] = []
    left = width
    for title, texts in columns:
        needed = 1 + _widest([title, *texts])
        if part and needed > left:
            yield part
            part, left = [], width
        part.append((title, texts))
        left -= needed
    yield part


def _widest(texts: Iterable[str]) -> int:
    return max(len(line) for text in texts for line in text.split("\n"))


def _detected(table: BoardTable, row: LeaderboardRow) -> str:
    """As in the cells by attack, and beneath the interval, where there is one."""
    figures = row.shown
    text = wording.detected_and_placebo(table, figures)
    low, high = figures.detected_share_lo, figures.detected_share_hi
    return text if low is None or high is None else f"{text}\n{100 * low:.0f}-{100 * high:.0f} %"


def _by_attack(table: BoardTable, letters: Sequence[str], width: int) -> Iterator[Table]:
    """Detector x attack, attacks by letter, as many tables as the width asks for."""
    names = [row.detector for row in table.rows]
    name_width = min(max(map(len, names), default=8), _NAME_WIDTH)
    texts = [
        [wording.cell_text(table, cell) for cell in table.cells_of(n)] for n in range(len(names))
    ]
    widest = max((len(text) for row in texts for text in row), default=1)
    each = max((width - name_width) // (widest + 1), 1)
    for first in range(0, len(letters), each):
        part = slice(first, first + each)
        shown = _empty_table()
        shown.add_column("detected\n(placebo)", overflow="fold", max_width=_NAME_WIDTH)
        for letter in letters[part]:
            shown.add_column(f"\n{letter}", justify="right", no_wrap=True, min_width=widest)
        for name, row in zip(names, texts, strict=True):
            shown.add_row(_folded(name, _NAME_WIDTH), *row[part])
        yield shown


def _plain(
    title: str, head: Sequence[str], names: int, rows: Sequence[Sequence[str]], width: int
) -> Table:
    """A table whose first columns hold names, which fold to what the figures leave them."""
    figures = [_widest([text, *(row[n] for row in rows)]) for n, text in enumerate(head)][names:]
    name_width = min((width - sum(figures) - len(figures)) // names - 1, 20)
    shown = _empty_table(title)
    for number, text in enumerate(head):
        if number < names:
            shown.add_column(text.lower(), overflow="fold", max_width=name_width)
        else:
            shown.add_column(text.lower(), justify="right", no_wrap=True)
    for row in rows:
        folded = (_folded(text, name_width) for text in row[:names])
        shown.add_row(*folded, *map(Text, row[names:]))
    return shown


def _empty_table(title: str | None = None) -> Table:
    return Table(
        title=title,
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE_HEAD,
        padding=0,
        pad_edge=False,
        show_edge=False,
    )


def _folded(name: str, width: int) -> Text:
    """A name, folded at its hyphens where it is long."""
    return Text("\n".join(wrap(printable(name), width)))


def _paragraphs(texts: Iterable[str], width: int) -> Text:
    """Paragraphs with a hanging indent, and a blank line; no-break blanks hold."""
    lines = [
        fill(printable(text), width, subsequent_indent="  ", break_on_hyphens=False)
        for text in texts
    ]
    return Text("\n".join([*lines, ""]))


def _letters(n: int) -> Iterator[str]:
    """``a`` to ``z``, then ``aa`` and on."""
    for index in range(n):
        yield (ascii_lowercase[index // 26 - 1] if index >= 26 else "") + ascii_lowercase[
            index % 26
        ]
