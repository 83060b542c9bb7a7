"""From the columns of a table to rows of topics."""

import difflib
from collections.abc import Iterator

import numpy as np

from spoofbench.conversion import Block, Columns, Item, Rejects, TimeSorter
from spoofbench.conversion.rows import take
from spoofbench.errors import ConversionError
from spoofbench.table import Table
from spoofbench_converters.table.appending import Appending
from spoofbench_converters.table.cells import Bools
from spoofbench_converters.table.mapping import TableSpec
from spoofbench_converters.table.text import Rows
from spoofbench_converters.table.times import Clock
from spoofbench_converters.table.topic import Topic, resolve

_NO_TIME = "a time that is none"
_BAD = "a cell of {!r} that is not what the column holds"
_HELD = "repeated row"
_NOTHING = "nothing in the columns that are mapped"
_OTHER = "of no topic of the mapping"
_BACKWARDS = "time runs backwards"


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


class Topics:
    """Makes rows of topics from the rows of one table, as they stream by.

    Args:
        table: what the mapping says.
        start_ns: Unix time at which a clock without date counts 0.
        append_clock: a clock that jumps back goes on at its interval.

    Attributes:
        held: by topic, how many rows only repeated the row before.
        steps: where the clock jumped back and was appended.
    """

    def __init__(self, table: TableSpec, start_ns: int = 0, append_clock: bool = False) -> None:
        assert table.time is not None
        self._clock = Clock(table.time, start_ns)
        self._topics = [Topic(topic, f"{place}|") for place, topic in enumerate(table.topics)]
        self._order = TimeSorter()
        self._appending = Appending() if append_clock else None

    @property
    def held(self) -> dict[str, int]:
        return {topic.spec.topic: topic.held for topic in self._topics if topic.spec.changes}

    @property
    def step_count(self) -> int:
        return self._appending.step_count if self._appending else 0

    @property
    def steps(self) -> list[dict[str, int]]:
        return self._appending.steps if self._appending else []

    def push(self, rows: Rows) -> Iterator[Item]:
        """Yield what rows say, and which of them say nothing."""
        columns, rejects = self._columns(rows)
        yield from rejects
        yield from self._ordered(columns, rows.besides)

    def finish(self) -> Iterator[Item]:
        """Yield what was still held back."""
        if self._appending:
            yield from self._in_order(self._appending.flush(), 0)
        ready, refused = self._order.flush()
        if ready:
            yield from self._refuse(refused)
            yield from self._blocks(ready, 0)

    def _columns(self, rows: Rows) -> tuple[Columns, list[Rejects]]:
        """Return the columns of all topics in the rows that say something, and the others."""
        count = rows.offsets.size
        if not count:
            return {}, []
        time_ns, no_time = self._clock.read(rows.columns)
        columns: Columns = {"time_ns": time_ns, "offset": rows.offsets, "length": rows.lengths}
        mine, some, held, is_bad = (np.zeros(count, bool) for _ in range(4))
        bad: dict[str, Bools] = {}
        for topic in self._topics:
            found = topic.read(rows.columns, count)
            columns |= found.columns
            mine |= found.mine
            for name, wrong in found.bad.items():
                bad[name] = bad.get(name, False) | wrong
                is_bad |= wrong
            some |= found.some
            held |= found.held
        taken = some & ~is_bad & ~no_time
        rejects, left = [], ~taken
        wrongs = [(_BAD.format(name), wrong) for name, wrong in sorted(bad.items())]
        for reason, wrong in (
            (_OTHER, ~mine),
            *wrongs,
            (_NO_TIME, no_time),
            (_HELD, held),
            (_NOTHING, ~some),
        ):
            now = left & wrong
            if now.any():
                rejects.append(Rejects(rows.offsets[now], rows.lengths[now], reason))
                left = left & ~wrong
        return (columns if taken.all() else take(columns, taken)), rejects

    def _ordered(self, columns: Columns, besides: int) -> Iterator[Item]:
        if columns and self._appending:
            columns = self._appending.push(columns)
        yield from self._in_order(columns, besides)

    def _in_order(self, columns: Columns, besides: int) -> Iterator[Item]:
        if columns and columns["time_ns"].size:
            ready, refused = self._order.push(columns)
            yield from self._refuse(refused)
            yield from self._blocks(ready, besides)
        elif besides:
            spec = self._topics[0].spec
            yield Block(spec.topic, Table(spec.kind, np.zeros(0, np.int64), {}), besides)

    def _refuse(self, refused: Columns) -> Iterator[Item]:
        if refused and refused["time_ns"].size:
            yield Rejects(refused["offset"], refused["length"], _BACKWARDS)

    def _blocks(self, ready: Columns, besides: int) -> Iterator[Item]:
        """Yield each topic's rows; what a row takes of the source goes to the first topic that has
        it.
        """
        free = np.ones(ready["time_ns"].size, bool)
        for topic in self._topics:
            rows = ready[f"{topic.key}row"]
            used = int(ready["length"][rows & free].sum()) + besides
            free &= ~rows
            if rows.any() or used:
                yield Block(topic.spec.topic, topic.table(take(ready, rows)), used)
            besides = 0
