"""Recordings that are the same up to a time and another thing after it."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from spoofbench.recording import Recording
from spoofbench.table import Column, Table

_SEED = 20_170_503


def futures(recording: Recording, time_ns: int) -> Iterator[tuple[str, Recording]]:
    """Yield recordings whose rows at or before a time are those given, and what became of the rows
    after it.
    """
    yield "cut off", recording.until(time_ns)
    for name, change in (("scrambled", _scrambled), ("altered", _altered)):
        rng = np.random.default_rng(_SEED)
        tables = {}
        for topic, table in recording.items():
            first = int(np.searchsorted(table.time_ns, time_ns, "right"))
            tables[topic] = change(table, first, rng) if first < len(table) else table
        yield name, Recording(tables, recording.metadata)


def cuts(time_ns: NDArray[np.int64], thorough: bool) -> list[int]:
    """Choose times for :func:`futures` from the epochs: before all, at rows, 1 ns before and after,
    between, at the end.
    """
    if not time_ns.size:
        return [0]
    rows = [round(share * (time_ns.size - 1)) for share in (0.3, 0.45, 0.65, 1.0)]
    at = [int(time_ns[row]) for row in rows]
    if not thorough:
        return at[:-1]
    half = int(time_ns[rows[2] + 1] - time_ns[rows[2]]) // 2 if rows[2] + 1 < time_ns.size else 1
    return [int(time_ns[0]) - 1, *at, at[1] - 1, at[1] + 1, at[2] + half]


def _scrambled(table: Table, first: int, rng: np.random.Generator) -> Table:
    order = np.concatenate([np.arange(first), first + rng.permutation(len(table) - first)])
    columns = {}
    for name in table:
        column = table.column(name)
        columns[name] = Column(
            column.values[order],
            None if column.valid is None else column.valid[order],
            column.words,
        )
    return Table(table.kind.name, table.time_ns, columns)


def _altered(table: Table, first: int, rng: np.random.Generator) -> Table:
    """Scale and shift floats and lose some, change some counts and flags, lose every third row, let
    time run ahead.
    """
    after = np.arange(len(table)) >= first
    changed = {name: table.column(name) for name in table}
    for name, column in changed.items():
        values, some = column.values, after & (rng.random(len(table)) < 0.2)
        if values.dtype.kind == "f":
            moved = values * 1.7 + rng.normal(0, 3, values.size)
            changed[name] = Column(np.where(some, np.nan, np.where(after, moved, values)))
        elif column.words is None:
            changed[name] = Column(
                np.where(some, values ^ np.ones((), values.dtype), values), column.valid
            )
    altered = Table(table.kind.name, table.time_ns + np.where(after, 37_000_000, 0), changed)
    return altered.take(~after | (np.arange(len(table)) % 3 != 0))
