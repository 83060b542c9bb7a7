"""What the command line reads and prints: ``KEY=VALUE`` words, lines, JSON and progress bars.

Heavy imports wait until they are needed.
"""

import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from spoofbench.config import Text

Progress = Callable[[str], Callable[[float], None]]
"""Opens a bar by name and returns what moves it, from 0 to 1."""


def read_parameters(pairs: Iterable[str] | None) -> "dict[str, Text]":
    """Return the values of ``KEY=VALUE`` words by key, as texts that whoever takes them reads as it
    needs.

    Raises:
        typer.BadParameter: a word is something else, or a key is duplicated.
    """
    from spoofbench.config import Text

    texts = {}
    for pair in pairs or []:
        key, equals, value = pair.partition("=")
        if not key or not equals:
            raise typer.BadParameter(f"{pair!r} is not KEY=VALUE")
        if key in texts:
            raise typer.BadParameter(f"parameter {key!r} is duplicated; give it once")
        texts[key] = Text(value)
    return texts


def print_json(value: Any) -> None:
    """Print a value as JSON; unknown is null."""
    typer.echo(json.dumps(value, indent=1, allow_nan=False))


def print_lines(lines: Iterable[str]) -> None:
    """Print lines without control characters."""
    from spoofbench.formatting import printable

    for line in lines:
        typer.echo(printable(line))


def complain(reason: str) -> None:
    """Print a reason on stderr, in one line."""
    from spoofbench.formatting import printable

    typer.echo(f"spoofbench: {printable(' '.join(reason.split()))}", err=True)


@contextmanager
def progress_bars() -> Iterator[Progress]:
    """Yield a function that opens progress bars; they show on a terminal only."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from spoofbench.formatting import printable

    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal) as bars:

        def start(name: str) -> Callable[[float], None]:
            bar = bars.add_task(printable(name), total=1.0)
            return lambda share: bars.update(bar, completed=share)

        yield start
