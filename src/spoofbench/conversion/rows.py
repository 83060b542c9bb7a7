"""Rows on their way from a log to the blocks of a recording.

A decoder makes batches: rows of one kind as the log has them. One :class:`RowBuffer` per topic puts
them in the order of time, however they come cut, and gives blocks and rejects. Absent is absent in
the one notation of :class:`~spoofbench.table.Table`: NaN in floats, a mask for other numbers, -1 in
the codes of text.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spoofbench.conversion.contract import Block, Rejects
from spoofbench.schema import KINDS, Field, Kind, split_topic
from spoofbench.table import Column, Rows, Table, as_column, concat_columns

Columns = dict[str, NDArray[Any]]
"""Arrays ``(n, ...)`` of equal length by name, among them ``time_ns``, int64."""

SECOND_NS = 1_000_000_000

_NO_FIELD = Field("", 0, "float", "float64")
_MAX_IDLE_CATEGORIES = 1000
"""So many texts are remembered that no held row uses any more."""


@dataclass(frozen=True, slots=True, eq=False)
class RowBatch:
    """Rows of one kind in any order, and where in the source they lie.

    Attributes:
        kind: of the schema.
        time_ns: int64 ``(n,)``.
        columns: by field; a field that is not there is absent in every row. Numbers under a name
            that is no field stay with the rows, but not in their block.
        offset: int64 ``(n,)``: where each row begins in the source, in its units.
        units: int64 ``(n,)``: how many units each row takes; 0 where others account for them.
    """

    kind: Kind
    time_ns: NDArray[np.int64]
    columns: Mapping[str, Column]
    offset: NDArray[np.int64]
    units: NDArray[np.int64]

    @classmethod
    def of(
        cls,
        kind: str,
        time_ns: NDArray[np.int64],
        columns: Mapping[str, ArrayLike | Column | Sequence[Any]],
        offset: NDArray[np.int64],
        units: NDArray[np.int64],
    ) -> Self:
        """Return rows whose columns are given as to :class:`~spoofbench.table.Table`."""
        fields = KINDS[kind].fields
        made = {
            name: as_column(fields.get(name, _NO_FIELD), given) for name, given in columns.items()
        }
        return cls(KINDS[kind], time_ns, made, offset, units)

    def __len__(self) -> int:
        """Number of rows."""
        return self.time_ns.size

    def take(self, rows: Rows) -> "RowBatch":
        """Return the rows that a slice, mask or index array selects."""
        columns = {
            name: Column(c.values[rows], None if c.valid is None else c.valid[rows], c.categories)
            for name, c in self.columns.items()
        }
        return RowBatch(self.kind, self.time_ns[rows], columns, self.offset[rows], self.units[rows])

    @staticmethod
    def concat(batches: Sequence["RowBatch"]) -> "RowBatch":
        """Return the rows of batches of one kind, at least one, one after the other."""
        if len(batches) == 1:
            return batches[0]
        kind, sizes = batches[0].kind, [len(batch) for batch in batches]
        names = {name for batch in batches for name in batch.columns}
        columns = {
            name: concat_columns(
                kind.fields.get(name, _NO_FIELD),
                [batch.columns.get(name) for batch in batches],
                sizes,
            )
            for name in names
        }
        time_ns, offset, units = (
            np.concatenate([getattr(batch, name) for batch in batches])
            for name in ("time_ns", "offset", "units")
        )
        return RowBatch(kind, time_ns, columns, offset, units)

    def block(self, topic: str) -> Block:
        """Return the rows, which must be in the order of time, as a block of a topic."""
        columns = {name: c for name, c in self.columns.items() if name in self.kind.fields}
        table = Table(self.kind.name, self.time_ns, columns)
        return Block(topic, table, int(self.units.sum()))

    def rejects(self, reason: str) -> Rejects:
        """Return the rows as rejects."""
        return Rejects(self.offset, self.units, reason)


class RowBuffer:
    """The rows of one topic, put in the order of time by a :class:`TimeSorter`.

    Only times are sorted; the columns wait in the order of the log and are picked when their turn
    has come.

    Args:
        topic: of a recording.
        window_ns: how far behind the latest row one may stand.
    """

    def __init__(self, topic: str, window_ns: int = SECOND_NS) -> None:
        self.topic = topic
        kind, nothing = KINDS[split_topic(topic)[1]], np.empty(0, np.int64)
        self._sorter = TimeSorter(window_ns)
        self._held = RowBatch(kind, nothing, {}, nothing, nothing)
        self._numbers = nothing  # running numbers of the held rows
        self._count = 0  # rows taken so far

    def push(self, rows: RowBatch) -> Iterator[Block | Rejects]:
        """Take the next rows of the log; yield what is ready and what came too late."""
        yield from self._given(*self.sort(rows))

    def flush(self) -> Iterator[Block | Rejects]:
        """Yield what is still held."""
        yield from self._given(*self.rest())

    def sort(self, rows: RowBatch) -> tuple[RowBatch, RowBatch]:
        """Take the next rows; return those that are ready, in the order of time, and those that
        are refused.
        """
        numbers = np.arange(self._count, self._count + len(rows))
        self._count += len(rows)
        self._held = RowBatch.concat([self._held, rows]) if len(self._held) else rows
        self._numbers = np.concatenate([self._numbers, numbers])
        return self._taken(*self._sorter.push({"time_ns": rows.time_ns, "number": numbers}))

    def rest(self) -> tuple[RowBatch, RowBatch]:
        """Return the rows still held, as ``(ready, refused)``."""
        return self._taken(*self._sorter.flush())

    def _given(self, ready: RowBatch, refused: RowBatch) -> Iterator[Block | Rejects]:
        if len(ready):
            yield ready.block(self.topic)
        if len(refused):
            yield refused.rejects(f"time runs backwards in {self.topic}")

    def _taken(self, ready: Columns, refused: Columns) -> tuple[RowBatch, RowBatch]:
        """Return the rows of these numbers, and hold the others alone: refused ones may be many."""
        taken, gone = [], np.zeros(len(self._held), bool)
        for numbered in (ready, refused):
            rows = _contiguous(self._index(numbered.get("number", np.empty(0, np.int64))))
            gone[rows] = True
            taken.append(self._held.take(rows))
        if gone.any():
            left = _contiguous(np.flatnonzero(~gone))
            self._held = _without_idle_categories(self._held.take(left))
            self._numbers = self._numbers[left]
        return taken[0], taken[1]

    def _index(self, numbers: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return where the rows of these running numbers are held."""
        held = self._numbers
        if held.size and held[-1] - held[0] == held.size - 1:
            return np.asarray(numbers - held[0])
        return np.searchsorted(held, numbers)


def _contiguous(index: NDArray[np.int64]) -> slice | NDArray[np.int64]:
    """Return row numbers as a slice if they are neighbours: a view costs nothing."""
    if not index.size:
        return slice(0, 0)
    first = int(index[0])
    neighbours = int(index[-1]) - first == index.size - 1 and bool(np.all(np.diff(index) > 0))
    return slice(first, first + index.size) if neighbours else index


def _without_idle_categories(rows: RowBatch) -> RowBatch:
    """Drop the texts that no row uses, where there are many: a stream may never end."""
    limit = _MAX_IDLE_CATEGORIES + len(rows)
    large = {
        name: c for name, c in rows.columns.items() if c.categories and len(c.categories) > limit
    }
    if not large:
        return rows
    columns = dict(rows.columns)
    for name, column in large.items():
        codes, inverse = np.unique(column.values, return_inverse=True)
        known: Any = column.categories
        used = tuple(known[code] for code in codes[codes >= 0].tolist())
        renumbered = (inverse - np.count_nonzero(codes < 0)).astype(np.int32)
        columns[name] = Column(renumbered, None, used)
    return RowBatch(rows.kind, rows.time_ns, columns, rows.offset, rows.units)


class TimeSorter:
    """Puts the rows of one topic in the order of time.

    A row may stand up to ``window_ns`` behind the latest one before it and is then sorted in, after
    rows of equal time. One further behind is refused, and so is a lone row that leaps further ahead
    of both its neighbours: otherwise a single false time would refuse all that follows. The same
    rows give the same result however the stream is cut into pieces.
    """

    def __init__(self, window_ns: int = SECOND_NS) -> None:
        self._window_ns = window_ns
        # accepted, in the order of time, may still be preceded by a late row
        self._held: Columns = {}
        self._undecided: Columns = {}  # the newest row: whether it leaps ahead shows with the next
        self._before_ns: int | None = None  # time of the row before the undecided one
        self._latest_ns: int | None = None  # latest accepted time

    def push(self, columns: Columns) -> tuple[Columns, Columns]:
        """Take rows as they come; return ``(ready, refused)``, each possibly without rows."""
        rows = join(self._undecided, columns)
        if rows["time_ns"].size < 2:
            self._undecided = rows
            return take(rows, slice(0, 0)), take(rows, slice(0, 0))
        self._undecided = take(rows, slice(-1, None))
        leaps = self._leaps(rows["time_ns"])
        self._before_ns = int(rows["time_ns"][-2])
        return self._accept(take(rows, slice(0, -1)), leaps)

    def flush(self) -> tuple[Columns, Columns]:
        """Return the rows still held, as ``(ready, refused)``."""
        if not self._undecided or not self._undecided["time_ns"].size:
            return {}, {}
        ready, refused = self._accept(
            self._undecided, np.zeros(self._undecided["time_ns"].size, bool)
        )
        last = join(ready, self._held)
        self._held, self._undecided = {}, {}
        return last, refused

    def _leaps(self, times: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which rows but the last are further ahead of both neighbours than the window."""
        ahead_of_next = times[:-1] - times[1:] > self._window_ns
        before = np.concatenate(
            [[times[0] if self._before_ns is None else self._before_ns], times[:-2]]
        )
        ahead_of_last = times[:-1] - before > self._window_ns
        if self._before_ns is None:
            ahead_of_last[0] = True
        returns = times[1:] >= before - self._window_ns
        return np.asarray(
            ahead_of_next
            & ahead_of_last
            & (returns | (np.arange(times.size - 1) == 0) & (self._before_ns is None))
        )

    def _accept(self, rows: Columns, leaps: NDArray[np.bool_]) -> tuple[Columns, Columns]:
        times = rows["time_ns"]
        start = times[0] if self._latest_ns is None else self._latest_ns
        if (
            times.size
            and not leaps.any()
            and times[0] >= start
            and bool(np.all(times[1:] >= times[:-1]))
        ):
            refused, accepted = take(rows, slice(0, 0)), rows
        else:
            floor = np.iinfo(np.int64).min
            candidates = np.where(leaps, floor, times)
            latest = np.maximum.accumulate(
                np.concatenate(
                    [[floor if self._latest_ns is None else self._latest_ns], candidates]
                )
            )[:-1]
            late = leaps | ((latest > floor) & (times < latest - self._window_ns))
            refused, accepted = take(rows, late), take(rows, ~late)
        if not accepted["time_ns"].size:
            return accepted, refused
        newest = int(accepted["time_ns"].max())
        self._latest_ns = newest if self._latest_ns is None else max(newest, self._latest_ns)
        waiting = join(self._held, accepted)
        if np.any(waiting["time_ns"][1:] < waiting["time_ns"][:-1]):
            waiting = take(waiting, np.argsort(waiting["time_ns"], kind="stable"))
        ready = int(np.searchsorted(waiting["time_ns"], self._latest_ns - self._window_ns, "left"))
        self._held = take(waiting, slice(ready, None))
        return take(waiting, slice(0, ready)), refused


def take(columns: Mapping[str, NDArray[Any]], rows: Any) -> Columns:
    """Return the rows that a slice, mask ``(n,)`` or index array ``(m,)`` selects."""
    return {name: values[rows] for name, values in columns.items()}


def join(first: Columns, second: Columns) -> Columns:
    """Return the rows of both, ``(n,)`` and ``(m,)``, as ``(n + m,)``; either may be {}."""
    if not first or not second:
        return second or first
    return {name: np.concatenate([values, second[name]]) for name, values in first.items()}
