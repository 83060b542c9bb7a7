"""Cells of lines, against the csv module."""

import csv
import io

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from spoofbench_converters.text import lines
from spoofbench_converters.text.columns import ColumnReader
from spoofbench_converters.text.lines import Lines


@settings(max_examples=100, deadline=None)
@given(
    rows=st.integers(2, 4).flatmap(
        lambda width: st.lists(
            st.lists(st.text("ab,1. -", max_size=5), min_size=width, max_size=width),
            min_size=1,
            max_size=5,
        )
    ),
    delimiter=st.sampled_from(",;\t"),
)
def test_cells_are_those_of_the_csv_module(rows: list[list[str]], delimiter: str) -> None:
    text = io.StringIO()
    csv.writer(text, delimiter=delimiter, quoting=csv.QUOTE_ALL, lineterminator="\n").writerows(
        rows
    )
    piece = next(
        item
        for item in lines.read_lines(io.BytesIO(text.getvalue().encode()), 0, delimiter)
        if isinstance(item, Lines)
    )
    assert piece.cells.tolist() == [len(row) for row in rows]
    reader = ColumnReader(piece, {}, delimiter)
    for place, cells in enumerate(zip(*rows, strict=True)):
        masked = [cell.replace(delimiter, "?") or None for cell in cells]
        assert reader.cells(place).to_pylist() == masked


@settings(max_examples=100, deadline=None)
@given(st.lists(st.binary(max_size=12).filter(lambda line: b"\n" not in line), min_size=1))
def test_any_lines_have_the_cells_that_are_counted(texts: list[bytes]) -> None:
    log = b"".join(b"x" + text + b"\n" for text in texts)
    piece = next(item for item in lines.read_lines(io.BytesIO(log)) if isinstance(item, Lines))
    for width in np.unique(piece.cells).tolist():
        same = piece.take(piece.cells == width)
        reader = ColumnReader(same, {})
        cells = [reader.cells(place).to_pylist() for place in range(width)]
        assert all(len(column) == len(same) for column in cells)
