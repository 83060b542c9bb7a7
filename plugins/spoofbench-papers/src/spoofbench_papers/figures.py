"""Figures and tables in a folder: equal bytes for equal content."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pyarrow as pa
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from pyarrow import parquet

from spoofbench.errors import ResultsError
from spoofbench.results import write_whole


def make_folder(path: Path) -> None:
    """Make a folder and those above it.

    Raises:
        ResultsError: it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ResultsError(
            f"the folder {str(path)!r} cannot be made: {error.strerror or error}"
        ) from error


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as PNG and SVG, equal bytes for equal figures; ``path`` is without suffix."""
    with mpl.rc_context({"svg.hashsalt": path.name, "svg.fonttype": "path"}):
        figure.savefig(path.with_suffix(".png"), dpi=110, metadata={"Software": None})
        figure.savefig(path.with_suffix(".svg"), metadata={"Date": None, "Creator": None})


def new_figure(
    width_in: float = 7.0, height_in: float = 4.2, columns: int = 1, rows: int = 1
) -> tuple[Figure, Any]:
    """Return a figure that needs no screen, and its axes as matplotlib's ``subplots`` gives
    them.
    """
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns)


def save_table(columns: Mapping[str, Sequence[Any]], path: Path) -> None:
    """Write columns of equal length as a Parquet file."""
    write_whole(path, partial(parquet.write_table, pa.table(dict(columns))))
