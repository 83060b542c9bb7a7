"""Words of the command line to values, and values to what a terminal can show. Heavy imports wait
until they are needed.
"""

import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from spoofbench.config import Text

Progress = Callable[[str], Callable[[float], None]]


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
    """Print for machines."""
    typer.echo(json.dumps(value, indent=1, allow_nan=False))


def print_lines(lines: Iterable[str]) -> None:
    """Print lines without what a terminal would obey."""
    from spoofbench.formatting import printable

    for line in lines:
        typer.echo(printable(line))


def complain(reason: str) -> None:
    """Print one line on stderr."""
    from spoofbench.formatting import printable

    typer.echo(f"spoofbench: {printable(' '.join(reason.split()))}", err=True)


@contextmanager
def progress_bars() -> Iterator[Progress]:
    """Yield a function that opens a progress bar by name and returns what moves it (0 to 1); bars
    show on a terminal only.
    """
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
