"""From the cells of a table to rows of topics."""

import difflib
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from spoofbench.arrays import Bools
from spoofbench.conversion import Item, Rejects, RowBatch, RowBuffer, Used
from spoofbench.errors import ConversionError
from spoofbench.table import Column
from spoofbench_converters.append_clock import ClockAppender
from spoofbench_converters.table.mapping import TableSpec
from spoofbench_converters.table.text import CellBatch
from spoofbench_converters.table.times import TableClock
from spoofbench_converters.table.topic import TopicReader, resolve

_NO_TIME = "a time that is none"
_BAD = "a cell of {!r} that is not what the column holds"
_REPEATED = "repeated row"
_NOTHING = "nothing in the columns that are mapped"
_OTHER = "of no topic of the mapping"
_BACKWARDS = "time runs backwards"
_IS_ROW = "is_row"


def used_columns(table: TableSpec, available: tuple[str, ...]) -> tuple[str, ...]:
    """Return the columns of a table that the mapping uses.

    Raises:
        ConversionError: one that it needs is not there.
    """
    found = []
    there = frozenset(available)
    for name, optional in table.wanted().items():
        column = resolve(name, there)
        if column is not None:
            found.append(column[0])
        elif not optional:
            near = difflib.get_close_matches(name.removeprefix("-"), available, 1, 0.5)
            hint = (
                f"did you mean {near[0]!r}?"
                if near
                else f"it has {', '.join(repr(name[:40]) for name in available[:15])}"
            )
            raise ConversionError(
                f"the table {table.name!r} of the mapping needs a column {name!r}; {hint}"
            )
    return tuple(dict.fromkeys(found))


class TableRows:
    """Makes rows of topics from the cells of one table, as they stream by.

    All rows of a table are put in order together, whichever topics they are of.

    Args:
        table: what the mapping says.
        start_ns: Unix time at which a clock without date counts 0.
        append_clock: a clock that jumps back goes on at its interval.

    Attributes:
        appender: of the clock, where it was to be appended.
    """

    def __init__(self, table: TableSpec, start_ns: int = 0, append_clock: bool = False) -> None:
        assert table.time is not None
        self._clock = TableClock(table.time, start_ns)
        self._topics = [TopicReader(topic) for topic in table.topics]
        self._buffers = [RowBuffer(topic.topic) for topic in table.topics]
        self.appender = ClockAppender() if append_clock else None
        self._last: list[RowBatch] = []  # where the clock is appended, the row whose next decides

    @property
    def repeated(self) -> dict[str, int]:
        """How many rows of a topic only repeated the row before, by topic."""
        return {topic.spec.topic: topic.repeated for topic in self._topics if topic.spec.changes}

    def push(self, cells: CellBatch) -> Iterator[Item]:
        """Yield what rows say, and which of them say nothing."""
        if cells.besides:
            yield Used(cells.besides)
        if not cells.offsets.size:
            return
        batches, rejects = self._read(cells)
        yield from rejects
        if self.appender:
            batches = self._appended(self.appender, batches)
        if len(batches[0]):
            yield from self._items(
                [buffer.sort(rows) for buffer, rows in zip(self._buffers, batches, strict=True)]
            )

    def finish(self) -> Iterator[Item]:
        """Yield what was still held back."""
        if self.appender and self._last:
            batches = _moved(self.appender, self._last, None)
            yield from self._items(
                [buffer.sort(rows) for buffer, rows in zip(self._buffers, batches, strict=True)]
            )
        yield from self._items([buffer.rest() for buffer in self._buffers])

    def _read(self, cells: CellBatch) -> tuple[list[RowBatch], list[Rejects]]:
        """Return all rows that say something as rows of each topic, and the others.

        Which rows a topic has is in a column ``_IS_ROW``. The bytes of a row go to the first topic
        that has it.
        """
        count = cells.offsets.size
        time_ns, no_time = self._clock.read(cells.columns)
        selected, some, repeated, is_bad = (np.zeros(count, bool) for _ in range(4))
        bad: dict[str, Bools] = {}
        batches = []
        for topic in self._topics:
            found = topic.read(cells.columns, count)
            units = np.where(found.some & ~some, cells.lengths, 0)
            columns = {**found.columns, _IS_ROW: Column(found.some)}
            batches.append(RowBatch.of(topic.spec.kind, time_ns, columns, cells.offsets, units))
            selected |= found.selected
            some |= found.some
            repeated |= found.repeated
            for name, wrong in found.bad.items():
                bad[name] = bad.get(name, False) | wrong
                is_bad |= wrong
        taken = some & ~is_bad & ~no_time
        rejects, left = [], ~taken
        for reason, wrong in (
            (_OTHER, ~selected),
            *((_BAD.format(name), wrong) for name, wrong in sorted(bad.items())),
            (_NO_TIME, no_time),
            (_REPEATED, repeated),
            (_NOTHING, ~some),
        ):
            now = left & wrong
            if now.any():
                rejects.append(Rejects(cells.offsets[now], cells.lengths[now], reason))
                left = left & ~wrong
        return (batches if taken.all() else [rows.take(taken) for rows in batches]), rejects

    def _appended(self, appender: ClockAppender, batches: Sequence[RowBatch]) -> list[RowBatch]:
        """Return the rows but the last, whose time shows with the next one, with appended times."""
        if self._last:
            pairs = zip(self._last, batches, strict=True)
            batches = [RowBatch.concat(pair) for pair in pairs]
        if not len(batches[0]):
            return list(batches)
        self._last = [rows.take(slice(-1, None)) for rows in batches]
        following_ns = int(batches[0].time_ns[-1])
        return _moved(appender, [rows.take(slice(0, -1)) for rows in batches], following_ns)

    def _items(self, parts: Sequence[tuple[RowBatch, RowBatch]]) -> Iterator[Item]:
        """Yield the rows of each topic that are ready, and those that are refused."""
        refused = [late for _, late in parts]
        if len(refused[0]):
            lengths = np.sum([rows.units for rows in refused], axis=0)
            yield Rejects(refused[0].offset, lengths, _BACKWARDS)
        for topic, (ready, _) in zip(self._topics, parts, strict=True):
            is_row = ready.columns[_IS_ROW].values if len(ready) else np.zeros(0, bool)
            if is_row.any():
                yield topic.derived(ready.take(is_row)).block(topic.spec.topic)


def _moved(
    appender: ClockAppender, batches: Sequence[RowBatch], following_ns: int | None
) -> list[RowBatch]:
    """Return rows with the times of the appended clock."""
    first = batches[0]
    time_ns = first.time_ns + appender.push(first.offset, first.time_ns, following_ns)
    return [replace(rows, time_ns=time_ns) for rows in batches]
