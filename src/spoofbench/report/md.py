"""The leaderboard in GitHub Markdown."""

import re
from collections.abc import Sequence

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

_SPECIAL = re.compile(r"([\\`*_{}\[\]<>()#+!|~$&@:-])")


def as_markdown(board: Board) -> str:
    """Return the leaderboard, its legend and the detection percentages by attack."""
    head = [
        "#",
        "Detector",
        "FA/h",
        "95 %",
        "Det %",
        "95 %",
        "TTFD median, s",
        "TTFD 90 %, s",
        "Avail %",
        "Fail",
    ]
    rows = [
        [
            NONE if row.rank is None else str(row.rank),
            escape(row.detector),
            rate(row.far_per_hour) + ("\\*" if exceeds_target(row) else ""),
            far_interval(row),
            percent(row.detection_pct),
            detection_interval(row),
            time_to_detection(row.ttfd_median_s, row, board.extent),
            time_to_detection(row.ttfd_p90_s, row, board.extent),
            share_percent(row.availability),
            str(row.failed),
        ]
        for row in board.ranking.rows
    ]
    attacks = [
        [escape(row.detector), *map(cell_text, board.cells(row.detector))]
        for row in board.ranking.rows
    ]
    return (
        "\n\n".join(
            [
                "## Leaderboard",
                _table(head, rows),
                "\n".join(f"- {escape(line, keep='-()%:;')}" for line in legend(board)),
                "## Detection by attack, %",
                _table(["Detector", *map(escape, board.ranking.attacks)], attacks),
            ]
        )
        + "\n"
    )


def escape(text: str, keep: str = "-") -> str:
    """Return text that Markdown shows as it is; a line break becomes a blank."""
    return _SPECIAL.sub(
        lambda found: found[0] if found[0] in keep else f"\\{found[0]}",
        printable(" ".join(text.split())),
    )


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """The column of names, headed ``Detector``, is set left; figures right."""
    rule = [":--" if name == "Detector" else "--:" for name in head]
    return "\n".join(
        f"| {' | '.join(cells)} |" for cells in (head, rule, *(_literal(row) for row in rows))
    )


def _literal(cells: Sequence[str]) -> list[str]:
    """``>`` and ``<`` of a bound are text, not markup."""
    return [re.sub(r"(?<!\\)([<>])", r"\\\1", cell) for cell in cells]
