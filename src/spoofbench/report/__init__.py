"""The report of a results folder: in the terminal, as Markdown, and as one page that works
offline.

Each takes the folder's leaderboard, see :func:`spoofbench.scoring.leaderboard.leaderboard`, so that
a folder is ranked once.
"""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

    from spoofbench.scoring.leaderboard import Leaderboard

__all__ = ["markdown", "print_leaderboard", "write_site"]


def print_leaderboard(board: "Leaderboard", console: "Console | None" = None) -> None:
    """Print a leaderboard in at most 80 columns, by default to standard output."""
    from rich.console import Console

    from spoofbench.report.terminal_text import print_board

    print_board(board, console or Console())


def markdown(board: "Leaderboard") -> str:
    """Return a leaderboard in GitHub Markdown."""
    from spoofbench.report import markdown_text

    return markdown_text.markdown(board)


def write_site(folder: Path, board: "Leaderboard", site: Path) -> Path:
    """Write ``index.html``, ``leaderboard.md`` and ``leaderboard.json`` and return the page's path.

    Equal folders give equal bytes; the page makes no request.

    Args:
        folder: the results folder.
        board: its leaderboard.
        site: the folder to write into.

    Raises:
        ResultsError: the results folder lacks a file or a file is damaged.
    """
    from spoofbench.report.site import write

    return write(folder, board, site)
