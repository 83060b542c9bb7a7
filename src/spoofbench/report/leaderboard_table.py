"""The leaderboard as a table: its columns, declared once, and the terminal and Markdown.

:data:`COLUMNS` says of each column what stands over it, what it means and what a row shows in it.
Terminal, Markdown and page (:mod:`.site`) render that; they decide about layout alone.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from string import ascii_lowercase
from textwrap import fill, wrap
from typing import Literal

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from spoofbench.formatting import (
    NONE,
    between,
    counted,
    percent,
    printable,
    rate,
    seconds,
    share_percent,
)
from spoofbench.scoring.leaderboard import Leaderboard, LeaderboardCell, LeaderboardRow


@dataclass(frozen=True, slots=True)
class Figure:
    """What a row shows in a column.

    Attributes:
        text: the figure.
        sort: what it sorts by, a number as text; "" is unknown, and last.
        interval: its 95 % interval, a dash where there is none.
        mark: ``*`` where the figure exceeds the target.
    """

    text: str
    sort: str
    interval: str = NONE
    mark: str = ""


@dataclass(frozen=True, slots=True)
class LeaderboardColumn:
    """One column of the leaderboard.

    Attributes:
        title, unit: over the column on the page.
        figure: what a row shows.
        heading: over the column in the terminal and in Markdown, a line break where the terminal
            breaks it; "" leaves the column out there.
        heading_unit: what Markdown adds to the heading.
        legend: name and short definition, under the table in the terminal and in Markdown.
        term, definition: name and definition on the page.
        interval: where the terminal puts the interval; Markdown gives it a column of its own.
        first: the order that the first click on the page asks for.
        is_name: whether it holds the detector's name.
    """

    title: str
    unit: str
    figure: Callable[[LeaderboardRow], Figure]
    heading: str = ""
    heading_unit: str = ""
    legend: tuple[str, str] | None = None
    term: str = ""
    definition: str = ""
    interval: Literal["none", "beside", "beneath"] = "none"
    first: Literal["ascending", "descending"] = "descending"
    is_name: bool = False


def _figure(text: str, value: float | None, interval: str = NONE, mark: str = "") -> Figure:
    return Figure(text, "" if value is None else repr(float(value)), interval, mark)


def _false_alerts(row: LeaderboardRow) -> Figure:
    interval = between(rate(row.far_per_hour_lo), rate(row.far_per_hour_hi))
    mark = "*" if row.exceeds_target else ""
    return _figure(rate(row.far_per_hour), row.far_per_hour, interval, mark)


def _detection(row: LeaderboardRow) -> Figure:
    interval = between(percent(row.detection_pct_lo), percent(row.detection_pct_hi))
    return _figure(percent(row.detection_pct), row.detection_pct, interval)


def _missed(row: LeaderboardRow) -> Figure:
    interval = between(share_percent(row.p_md_lo), share_percent(row.p_md_hi))
    return _figure(share_percent(row.p_md), row.p_md, interval)


def _detection_time(value_s: float | None, row: LeaderboardRow) -> Figure:
    """A quantile that is never reached exceeds the longest attack: it sorts behind all known ones,
    before unknown ones.
    """
    if value_s is None and row.longest_attack_s is not None:
        return Figure(f"> {seconds(row.longest_attack_s)}", "inf")
    return _figure(seconds(value_s), value_s)


COLUMNS = (
    LeaderboardColumn(
        "Rank",
        "",
        lambda row: _figure(NONE if row.rank is None else str(row.rank), row.rank),
        heading="#",
        term="Rank",
        definition=(
            "By detection, then by mean time to first detection, restricted to the longest attack. "
            "Detectors whose false-alert rate exceeds the target even at the lower end of its "
            "interval rank below those that keep it, and those whose rate is unknown below both."
        ),
        first="ascending",
    ),
    LeaderboardColumn(
        "Detector",
        "",
        lambda row: Figure(row.detector, row.detector),
        heading="Detector",
        first="ascending",
        is_name=True,
    ),
    LeaderboardColumn(
        "False alerts",
        "per hour",
        _false_alerts,
        heading="FA/h",
        legend=("FA/h", "alarm episodes per available clean hour, exact (Garwood) 95 % interval."),
        term="False alerts per hour",
        definition=(
            "Alarm episodes per available hour of the unattacked recordings, with the exact "
            "(Garwood) 95 % Poisson interval. Alerts less than 10 s apart are one episode, and an "
            "episode counts again for every 60 s that it lasts. Clean stretches of attacked "
            "variants do not count: they are the same data again."
        ),
        interval="beside",
        first="ascending",
    ),
    LeaderboardColumn(
        "Detection",
        "% of spoofed epochs",
        _detection,
        heading="Det %",
        legend=(
            "Det %",
            (
                "alerted share of all spoofed epochs; unavailable ones count as missed. Its "
                "interval is a bootstrap over sessions, from 5 sessions on."
            ),
        ),
        term="Detection",
        definition=(
            "Alerted share of all spoofed epochs; unavailable epochs count as missed. The mean "
            "over attacked tasks, with a 95 % bootstrap interval over sessions where there are at "
            "least five."
        ),
        interval="beneath",
    ),
    LeaderboardColumn(
        "Missed",
        "% of attacks",
        _missed,
        term="Missed",
        definition=(
            "Share of attack intervals without a first alert (P_MD). Its interval resamples "
            "sessions and is left out below five: windows on one recording may overlap."
        ),
        first="ascending",
    ),
    LeaderboardColumn(
        "Median",
        "s to first detection",
        lambda row: _detection_time(row.ttfd_median_s, row),
        heading="TTFD\nmedian",
        heading_unit=", s",
        legend=("TTFD", "time to first detection, s, Kaplan-Meier; > beyond the longest attack."),
        term="Time to first detection (TTFD)",
        definition=(
            "First alert minus start of the attack; an alert that was on already must begin anew. "
            "Median and 90 % quantile are Kaplan-Meier estimates, attacks without detection "
            "censored at their length; > stands where a quantile exceeds the longest attack."
        ),
        first="ascending",
    ),
    LeaderboardColumn(
        "90 %",
        "s to first detection",
        lambda row: _detection_time(row.ttfd_p90_s, row),
        heading="TTFD\n90 %",
        heading_unit=", s",
        first="ascending",
    ),
    LeaderboardColumn(
        "Available",
        "% of clean epochs",
        lambda row: _figure(share_percent(row.availability), row.availability),
        heading="Avail\n%",
        legend=("Avail %", "available share of clean epochs."),
        term="Available",
        definition="Share of the clean epochs at which the detector could tell.",
    ),
    LeaderboardColumn(
        "Failed",
        "tasks",
        lambda row: _figure(str(row.failed), row.failed),
        heading="Fail",
        legend=("Fail", "tasks that crashed or ran over a limit; they count as misses."),
        term="Failed",
        definition=(
            "Tasks that crashed or ran over their time or memory. They count as misses: no "
            "detection, no first alert."
        ),
        first="ascending",
    ),
)
"""In the order of the page; those without a heading are on the page alone."""

_TEXT_COLUMNS = tuple(column for column in COLUMNS if column.heading)


def evidence(board: Leaderboard) -> str:
    """Return what the figures rest on, one sentence."""
    return (
        f"{counted(len(board.rows), 'detector')}; {counted(len(board.attacks), 'attack')}, "
        f"{counted(board.attacked_variants, 'attacked variant')}; "
        f"{counted(board.recordings, 'recording')}, {counted(board.sessions, 'session')}, "
        f"{rate(board.clean_h)} h."
    )


def legend(board: Leaderboard) -> list[str]:
    """Return what stands under the table in the terminal and in Markdown, one entry each."""
    lines = [
        evidence(board),
        board.note,
        (
            f"Target FA/h: {board.target_far_per_hour:g}; * is above it even at the lower end and "
            "ranks below the rest."
        ),
        *(": ".join(column.legend) for column in COLUMNS if column.legend),
        "A dash is unknown, never 0.",
    ]
    return [line for line in lines if line]


def cell_text(cell: LeaderboardCell) -> str:
    """Return the detection percentage of a cell, a dash where there is nothing to measure."""
    return percent(cell.detection_pct)


_WIDTH = 80
_NAME_WIDTH = 28
"""Widest column of names; longer ones fold."""

_CELL_WIDTH = 6
"""Of a detection percentage, with air."""


def print_board(board: Leaderboard, console: Console) -> None:
    """Print the leaderboard, its legend and the detection percentages by attack.

    Two tables that fit 80 columns and cut nothing off.
    """
    width = min(console.width, _WIDTH)
    letters = list(_letters(len(board.attacks)))
    console.print(_terminal_table(board), width=width)
    console.print(_paragraphs(legend(board), width), style="dim", width=width)
    for table in _terminal_cells(board, letters, width):
        console.print(table, width=width)
    key = "  ".join(
        f"{letter}\N{NO-BREAK SPACE}{name}"
        for letter, name in zip(letters, board.attacks, strict=True)
    )
    console.print(_paragraphs([key], width), style="dim", width=width)


def _terminal_table(board: Leaderboard) -> Table:
    table = _empty_table("Leaderboard")
    for column in _TEXT_COLUMNS:
        if column.is_name:
            table.add_column(column.heading.lower(), overflow="fold", max_width=_NAME_WIDTH)
            continue
        # a blank where other rows have a mark keeps the figures aligned
        heading = column.heading + (" " if column.interval == "beside" else "")
        for each in [heading, *(["95 %"] if column.interval == "beside" else [])]:
            table.add_column(Text(each), justify="right", no_wrap=True, vertical="top")
    for row in board.rows:
        cells: list[str | Text] = []
        for column in _TEXT_COLUMNS:
            figure = column.figure(row)
            if column.is_name:
                cells.append(_folded(figure.text))
            elif column.interval == "beside":
                cells += [figure.text + (figure.mark or " "), figure.interval]
            else:
                beneath = column.interval == "beneath" and figure.interval != NONE
                cells.append(figure.text + (f"\n{figure.interval}" if beneath else ""))
        table.add_row(*cells, style="dim" if row.exceeds_target else None)
    return table


def _terminal_cells(board: Leaderboard, letters: Sequence[str], width: int) -> Iterator[Table]:
    """Detector x attack, attacks by letter, as many tables as the width asks for."""
    names = [row.detector for row in board.rows]
    name_width = min(max(map(len, names), default=8), _NAME_WIDTH)
    each = max((width - name_width) // (_CELL_WIDTH + 1), 1)
    for first in range(0, len(letters), each):
        part = slice(first, first + each)
        table = _empty_table("Detection by attack, %")
        table.add_column("detector", overflow="fold", max_width=_NAME_WIDTH)
        for letter in letters[part]:
            table.add_column(letter, justify="right", no_wrap=True, min_width=_CELL_WIDTH)
        for index, name in enumerate(names):
            table.add_row(_folded(name), *map(cell_text, board.cells_of(index)[part]))
        yield table


def _empty_table(title: str) -> Table:
    return Table(
        title=title,
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE_HEAD,
        padding=0,
        pad_edge=False,
        show_edge=False,
    )


def _folded(name: str) -> Text:
    """A name, folded at its hyphens where it is long."""
    return Text("\n".join(wrap(printable(name), _NAME_WIDTH)))


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


_MARKDOWN_SPECIAL = re.compile(r"([\\`*_{}\[\]<>()#+!|~$&@:-])")


def markdown(board: Leaderboard) -> str:
    """Return the leaderboard, its legend and the detection percentages by attack, in GitHub
    Markdown.
    """
    head: list[str] = []
    for column in _TEXT_COLUMNS:
        head.append(column.heading.replace("\n", " ") + column.heading_unit)
        head += ["95 %"] if column.interval != "none" else []
    parts = [
        "## Leaderboard",
        _markdown_table(head, [list(_markdown_cells(row)) for row in board.rows]),
        "\n".join(f"- {escape(line, keep='-()%:;')}" for line in legend(board)),
        "## Detection by attack, %",
        _markdown_table(
            ["Detector", *map(escape, board.attacks)],
            [
                [escape(row.detector), *map(cell_text, board.cells_of(index))]
                for index, row in enumerate(board.rows)
            ],
        ),
    ]
    return "\n\n".join(parts) + "\n"


def escape(text: str, keep: str = "-") -> str:
    """Return text that Markdown shows as it is; a line break becomes a blank."""
    return _MARKDOWN_SPECIAL.sub(
        lambda found: found[0] if found[0] in keep else f"\\{found[0]}",
        printable(" ".join(text.split())),
    )


def _markdown_cells(row: LeaderboardRow) -> Iterator[str]:
    for column in _TEXT_COLUMNS:
        figure = column.figure(row)
        yield escape(figure.text) if column.is_name else figure.text + escape(figure.mark)
        if column.interval != "none":
            yield figure.interval


def _markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """The column of names, headed ``Detector``, is set left; figures right."""
    rule = [":--" if name == "Detector" else "--:" for name in head]
    # < and > of a bound are text, not markup
    literal = ([re.sub(r"(?<!\\)([<>])", r"\\\1", cell) for cell in row] for row in rows)
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, rule, *literal))
