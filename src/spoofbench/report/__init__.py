"""The report of a results folder: in the terminal, as Markdown, and as one page that works
offline.
"""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import rich.console

__all__ = ["markdown", "print_leaderboard", "write_site"]


def print_leaderboard(folder: Path, console: "rich.console.Console") -> None:
    """Print the leaderboard of a results folder in at most 80 columns.

    Raises:
        ResultsError: the folder lacks a file or a file is damaged.
    """
    from spoofbench.report.tables import read_board
    from spoofbench.report.terminal import print_board

    print_board(read_board(folder), console)


def markdown(folder: Path) -> str:
    """Return the leaderboard of a results folder in GitHub Markdown.

    Raises:
        ResultsError: the folder lacks a file or a file is damaged.
    """
    from spoofbench.report.md import as_markdown
    from spoofbench.report.tables import read_board

    return as_markdown(read_board(folder))


def write_site(folder: Path, site: Path) -> Path:
    """Write ``index.html``, ``leaderboard.md`` and ``leaderboard.json`` and return the page's path.

    Equal folders give equal bytes; the page makes no request.

    Raises:
        ResultsError: the folder lacks a file or a file is damaged.
    """
    from spoofbench.report.site import write

    return write(folder, site)
