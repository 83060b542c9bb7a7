"""The leaderboard in GitHub Markdown, all columns of it."""

import re
from collections.abc import Iterable, Iterator, Sequence

from spoofbench.formatting import NONE, printable
from spoofbench.report import wording
from spoofbench.report.columns import (
    FURTHER,
    VERDICT,
    Entry,
    LeaderboardColumn,
    columns_of,
    explained,
)
from spoofbench.scoring.leaderboard import BoardTable, Leaderboard, LeaderboardRow

_SPECIAL = re.compile(r"([\\`*_{}\[\]<>()#+!|~$&@:-])")
_PLAIN = "-()%:;="
"""Of these, what means nothing within a line."""


def markdown(board: Leaderboard) -> str:
    """Return each table with its notes, and what its columns mean, in GitHub Markdown."""
    parts = ["# Leaderboard"]
    if not board.tables:
        parts.append(wording.NO_TABLES)
    for table in board.tables:
        parts += _table(board, table)
    if board.transfer:
        rows = (tuple(map(_escape, wording.transfer_cells(row))) for row in board.transfer)
        parts += [
            f"## {wording.TRANSFER}",
            _grid(wording.TRANSFER_HEAD, [True] * 3 + [False] * 3, rows),
            _escape(wording.TRANSFER_NOTE, _PLAIN),
        ]
    if board.absent:
        parts.append("\n".join(f"- {_escape(text, _PLAIN)}" for text in wording.absent(board)))
    if board.tables:
        meanings = [
            f"- {_escape(column.heading, _PLAIN)}: {_escape(column.definition, _PLAIN)}"
            for column in explained(board.tables)
        ]
        parts += [
            "## What the columns mean",
            "\n".join([*meanings, "- A dash is unknown, never 0."]),
        ]
    return "\n\n".join(parts) + "\n"


def _table(board: Leaderboard, table: BoardTable) -> Iterator[str]:
    yield f"## {_escape(wording.heading(table), _PLAIN)}"
    yield _escape(wording.evidence(board, table), _PLAIN)
    yield "\n".join(f"- {_escape(note, _PLAIN)}" for note in wording.notes(table))
    for columns in (VERDICT, FURTHER):
        yield _figures(table, columns_of(table, columns))
    if table.windows > 1:
        yield "Detected by attack, and in brackets the placebo:"
        yield _grid(
            ["Detector", *(_escape(name) for name in table.attacks)],
            [True] + [False] * len(table.attacks),
            (
                [
                    _escape(row.detector),
                    *(_escape(wording.cell_text(table, cell), _PLAIN) for cell in cells),
                ]
                for row, cells in zip(
                    table.rows, map(table.cells_of, range(len(table.rows))), strict=True
                )
            ),
        )
    severity = wording.severity_of(board, table)
    if severity:
        yield f"### {wording.SEVERITY}"
        yield _grid(
            wording.SEVERITY_HEAD,
            [True] * 2 + [False] * 4,
            (tuple(map(_escape, cells)) for cells in severity),
        )
        yield _escape(wording.SEVERITY_NOTE, _PLAIN)


def _figures(table: BoardTable, columns: Sequence[LeaderboardColumn]) -> str:
    head: list[str] = []
    is_text: list[bool] = []
    for column in columns:
        head += [column.heading, *(["95 %"] if column.has_interval else [])]
        is_text += [column.is_text, *([False] if column.has_interval else [])]
    return _grid(head, is_text, (list(_cells(table, row, columns)) for row in table.rows))


def _cells(
    table: BoardTable, row: LeaderboardRow, columns: Iterable[LeaderboardColumn]
) -> Iterator[str]:
    for column in columns:
        entry = column.entry(table, row)
        yield _escape(entry.text, "-" if column.is_name else _PLAIN)
        if column.has_interval:
            yield _escape(_interval(entry), _PLAIN)


def _interval(entry: Entry) -> str:
    return entry.interval + (f", {entry.remark}" if entry.remark and entry.interval != NONE else "")


def _grid(head: Sequence[str], is_text: Sequence[bool], rows: Iterable[Sequence[str]]) -> str:
    """Words are set left, figures right."""
    rule = [":--" if left else "--:" for left in is_text]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, rule, *rows))


def _escape(text: str, keep: str = "-") -> str:
    """Return text that Markdown shows as it is; a line break becomes a blank."""
    return _SPECIAL.sub(
        lambda found: found[0] if found[0] in keep else f"\\{found[0]}",
        printable(" ".join(text.split())),
    )
