"""The differences of two results folders in the terminal, in at most 80 columns."""

from collections.abc import Iterator
from textwrap import fill, wrap

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from spoofbench.formatting import NONE, counted, percent, printable, rate, seconds
from spoofbench.scoring.changes import Change
from spoofbench.scoring.comparison import fewest_sessions
from spoofbench.scoring.differences import (
    Differences,
    FigureDifference,
    Shared,
    TableDifferences,
)
from spoofbench.scoring.statistics import MIN_SESSIONS

_WIDTH = 80
_NAME_WIDTH = 22
"""Widest column of names; longer ones fold."""

_UNMARKED = "\N{NO-BREAK SPACE}"
"""Where other rows have a mark, so that figures stay aligned."""

_LEGEND = """\
FA/h: false alerts per hour. Detected: share of attacks. TTFD: mean time to first detection up to \
the longest attack. Each is A's, then B - A and beneath it its 95 % interval, paired by session; \
false alerts have no upper bound, and their differences no interval.
* is told apart: a sign-flip test over sessions, Holm over the detectors of the table.
A dash is unknown, never 0."""


def print_differences(found: Differences, console: Console) -> None:
    """Print what differs between two results folders, and what changed."""
    width = min(console.width, _WIDTH)

    def say(text: str) -> None:
        console.print(
            fill(printable(text), width, subsequent_indent="  ", break_on_hyphens=False),
            markup=False,
            highlight=False,
        )

    say(f"A: {found.a}")
    say(f"B: {found.b}")
    for table in found.tables:
        console.print()
        console.print(_table(table), width=width)
        for text in _evidence(table):
            say(text)
    console.print()
    for text in (*_LEGEND.splitlines(), *_left_out(found)):
        say(text)
    console.print()
    if not found.changes:
        say("Nothing changed: versions, plugins, recordings, suite, parameters and thresholds.")
    for change in found.changes:
        say(_change(change))


def _table(found: TableDifferences) -> Table:
    table = Table(
        title=f"{found.provenance}, {found.input_class}: {found.point} thresholds",
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE_HEAD,
        padding=0,
        pad_edge=False,
        show_edge=False,
    )
    table.add_column("detector", overflow="fold", max_width=_NAME_WIDTH)
    for heading in ("FA/h", "B - A", "Detected\n%", "B - A\n95 %", "TTFD\ns", "B - A\n95 %"):
        table.add_column(Text(heading), justify="right", no_wrap=True, vertical="top")
    for row in found.rows:
        name = Text("\n".join(wrap(printable(row.detector), _NAME_WIDTH)))
        cells: list[str | Text] = [name]
        for figure, scale, text in (
            (row.far_per_hour, 1.0, rate),
            (row.detected_share, 100.0, percent),
            (row.restricted_mean_ttfd_s, 1.0, seconds),
        ):
            cells.append(text(None if figure.a is None else scale * figure.a))
            cells.append(_signed(figure, scale, 2 if text is rate else 1))
        table.add_row(*cells)
    return table


def _signed(figure: FigureDifference, scale: float, places: int) -> str:
    """A difference and its mark, and its interval on a line of its own."""
    if figure.difference is None:
        return f"{NONE}{_UNMARKED}"

    def number(value: float) -> str:
        text = f"{scale * value:+,.{places}f}"
        return "0" if not text.strip("+-0.,") and not value else text

    shown = number(figure.difference) + ("*" if figure.told_apart else _UNMARKED)
    if figure.lo is None or figure.hi is None:
        return shown
    return f"{shown}\n{number(figure.lo)} to {number(figure.hi)}{_UNMARKED}"


def _evidence(found: TableDifferences) -> Iterator[str]:
    yield (
        f"In both: {counted(found.windows.both, 'attack interval')} of "
        f"{counted(found.sessions, 'session')}, {counted(found.recordings.both, 'clean recording')}"
        f", {counted(found.detectors.both, 'detector')}."
    )
    parts = {
        "attack interval": found.windows,
        "clean recording": found.recordings,
        "detector": found.detectors,
    }
    for side in ("A", "B"):
        alone = [
            counted(number, noun) for noun, each in parts.items() if (number := _only(each, side))
        ]
        if alone:
            yield f"Only in {side}, and not compared: {', '.join(alone)}."
    if found.moved:
        yield f"{counted(found.moved, 'attack interval')} that both have lie elsewhere in B."
    if found.sessions < MIN_SESSIONS:
        yield (
            f"No intervals: they take {MIN_SESSIONS} sessions or more, and telling detectors apart "
            f"at least {fewest_sessions(len(found.rows))}."
        )


def _only(shared: Shared, side: str) -> int:
    return shared.only_a if side == "A" else shared.only_b


def _left_out(found: Differences) -> Iterator[str]:
    for side, tables in (("A", found.only_a), ("B", found.only_b)):
        if tables:
            names = "; ".join(f"{provenance}, {inputs}" for provenance, inputs in tables)
            yield f"Tables only in {side}: {names}."


def _change(change: Change) -> str:
    a, b = (NONE if value is None else value for value in (change.a, change.b))
    return f"{change.subject} {change.name}: {a} -> {b}"
