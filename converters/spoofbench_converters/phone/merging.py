"""From parsed rows to the blocks of a recording's topics: the order of time, rows of equal time,
accounting.

Columns carry ``time_ns``, and ``offset`` and ``length``, the bytes of the log that a row came from;
a row whose bytes another topic accounts for has length 0. A column ``<field>?`` says which rows of
an integer, flag or enum have a value; text is codes into ``words``.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from spoofbench.conversion import Block, Columns, Item, Rejects, TimeSorter
from spoofbench.conversion.rows import join, take
from spoofbench.schema import KINDS, topic_of
from spoofbench.table import Column, Table

Words = Mapping[str, tuple[str, ...]]
REPEATED = "repeated row"
_FAR_FUTURE = np.iinfo(np.int64).max


def rejects(columns: Columns, rows: NDArray[np.bool_], reason: str) -> Iterator[Rejects]:
    """Yield the rows that a mask selects as rejects, if there are any of which the bytes are not
    accounted for elsewhere.
    """
    rows = rows & (columns["length"] > 0)
    if rows.any():
        yield Rejects(columns["offset"][rows], columns["length"][rows], reason)


def used(length: int) -> Block:
    """Return the account of bytes that told something about the log, but are no rows: headers."""
    return Block("/gnss0/gnss/pvt", Table("gnss/pvt", np.empty(0, np.int64), {}), length)


def in_file_order(parts: Sequence[Columns]) -> Columns:
    """Return the rows of all parts in the order in which they stand in the log."""
    joined: Columns = {}
    for part in parts:
        joined = join(joined, part)
    return joined if len(parts) == 1 else take(joined, np.argsort(joined["offset"], kind="stable"))


def together(
    stream: "MergedTopic", inputs: Mapping[str, Iterator[Columns | Item]]
) -> Iterator[Item]:
    """Push the rows of several inputs, always those of the one that is behind, so that none is held
    for long.
    """
    while (name := stream.behind()) is not None:
        item = next(inputs[name], None)
        if item is None:
            yield from stream.finish(name)
        elif isinstance(item, dict):
            yield from stream.push(item, name)
        else:
            yield item


class MergedTopic:
    """Rows of one topic, from one or more inputs that are each in their own order.

    Args:
        source: name of the source.
        kind: kind of the schema.
        fields: the fields that rows may have; those that a push lacks are absent.
        words: the words of text fields.
        inputs: names of the inputs.
        derive: makes the fields of rows of which those of equal time are one; it may use columns
            that are no fields.
        window_s: how far behind the latest row of its input one may stand.
    """

    def __init__(
        self,
        source: str,
        kind: str,
        fields: Sequence[str],
        *,
        words: Words = MappingProxyType({}),
        inputs: Sequence[str] = ("",),
        derive: Callable[[Columns], Columns] | None = None,
        window_s: float = 1.0,
    ) -> None:
        self.topic = topic_of(source, kind)
        self._kind, self._words, self._derive = kind, words, derive
        self._dtypes = {
            name: KINDS[kind].fields[name].dtype if name in KINDS[kind].fields else "float64"
            for name in fields
        }
        self._orders = {name: TimeSorter(round(window_s * 1e9)) for name in inputs}
        self._waiting: dict[str, Columns] = {name: {} for name in inputs}
        self._until_ns = dict.fromkeys(inputs, np.iinfo(np.int64).min)
        self._last: Columns = {}
        self.rows = 0

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs."""
        return tuple(self._orders)

    def push(self, columns: Columns, source: str = "") -> Iterator[Block | Rejects]:
        """Take the next rows of one input; yield what is ready of all."""
        if columns["time_ns"].size:
            yield from self._take(source, *self._orders[source].push(self.complete(columns)))
            yield from self._ready()

    def finish(self, source: str | None = None) -> Iterator[Block | Rejects]:
        """End one input, or all; yield what is ready."""
        for name in self.inputs if source is None else (source,):
            yield from self._take(name, *self._orders[name].flush())
            self._until_ns[name] = _FAR_FUTURE
        yield from self._ready()

    def behind(self) -> str | None:
        """The input that the others wait for; None where all have ended."""
        name = min(self._until_ns, key=lambda name: self._until_ns[name])
        return None if self._until_ns[name] == _FAR_FUTURE else name

    def complete(self, columns: Columns) -> Columns:
        """Return the columns with those that they lack, and no others."""
        rows = columns["time_ns"].size
        complete: Columns = {name: columns[name] for name in ("time_ns", "offset", "length")}
        for name, dtype in self._dtypes.items():
            if name in self._words:
                complete[name] = columns.get(name, np.full(rows, -1, np.int32))
            elif np.dtype(dtype).kind == "f":
                complete[name] = columns.get(name, np.full(rows, np.nan))
            else:
                given = name in columns
                complete[name] = columns[name] if given else np.zeros(rows, dtype)
                complete[f"{name}?"] = columns.get(f"{name}?", np.full(rows, given))
        return complete

    def _take(self, source: str, ready: Columns, refused: Columns) -> Iterator[Rejects]:
        if refused:
            yield from rejects(
                refused,
                np.ones(refused["time_ns"].size, bool),
                f"time runs backwards in {self.topic}",
            )
        if ready and ready["time_ns"].size:
            self._waiting[source] = join(self._waiting[source], ready)
            self._until_ns[source] = int(ready["time_ns"][-1])

    def _ready(self) -> Iterator[Block | Rejects]:
        """Yield the rows before which none of any input can come any more."""
        before_ns = min(self._until_ns.values())
        parts = []
        for source, columns in self._waiting.items():
            if columns:
                count = columns["time_ns"].size
                ready = (
                    count
                    if before_ns == _FAR_FUTURE
                    else int(np.searchsorted(columns["time_ns"], before_ns, "left"))
                )
                parts.append(take(columns, slice(0, ready)))
                self._waiting[source] = take(columns, slice(ready, count))
        rows: Columns = {}
        for part in parts:
            rows = join(rows, part)
        if not rows or not rows["time_ns"].size:
            return
        if len(parts) > 1:
            rows = take(rows, np.argsort(rows["time_ns"], kind="stable"))
        rows, repeated = self._without_repeated(rows)
        if repeated:
            yield from rejects(repeated, np.ones(repeated["time_ns"].size, bool), REPEATED)
        if rows["time_ns"].size:
            rows = self._merged(rows)
            yield self._block(self._derive(rows) if self._derive else rows)

    def _without_repeated(self, rows: Columns) -> tuple[Columns, Columns]:
        """LogFile rows from those that say the same as the row before them, at the same time."""
        with_last = join(self._last, rows)
        held = with_last["time_ns"].size - rows["time_ns"].size
        same = np.zeros(with_last["time_ns"].size, bool)
        same[1:] = with_last["time_ns"][1:] == with_last["time_ns"][:-1]
        if self._last or rows["time_ns"].size:
            self._last = take(rows, slice(-1, None))
        if not same.any():
            return rows, {}
        for name in set(with_last) - {"time_ns", "offset", "length"}:
            values = with_last[name]
            equal = values[1:] == values[:-1]
            if values.dtype.kind == "f":
                equal |= np.isnan(values[1:]) & np.isnan(values[:-1])
            same[1:] &= equal
        repeated = same[held:]
        return take(rows, ~repeated), take(rows, repeated) if repeated.any() else {}

    def _merged(self, rows: Columns) -> Columns:
        """Make one row of those of equal time, unless two of them say different things of one
        field.
        """
        times = rows["time_ns"]
        first = np.flatnonzero(np.concatenate([[True], times[1:] != times[:-1]]))
        names = [name for name in rows if rows[name].dtype.kind == "f"]
        if first.size == times.size or len(names) + 3 < len(rows):
            return rows
        highest = {name: np.fmax.reduceat(rows[name], first) for name in names}
        agree = np.ones(first.size, bool)
        for name in names:
            agree &= ~(highest[name] > np.fmin.reduceat(rows[name], first))
        group = np.cumsum(np.isin(np.arange(times.size), first)) - 1
        joined = agree[group]
        lengths = np.where(joined, np.add.reduceat(rows["length"], first)[group], rows["length"])
        merged = {name: np.where(joined, highest[name][group], rows[name]) for name in names} | {
            "length": lengths
        }
        keep = ~joined
        keep[first] = True
        return take(rows | merged, keep)

    def _block(self, rows: Columns) -> Block:
        columns: dict[str, NDArray[np.generic] | Column] = {}
        for name in self._dtypes.keys() & KINDS[self._kind].fields.keys():
            values = rows[name]
            if name in self._words:
                columns[name] = Column(values, None, self._words[name])
            elif values.dtype.kind in "fO":
                columns[name] = values
            else:
                columns[name] = Column(values, rows[f"{name}?"])
        table = Table(self._kind, rows["time_ns"], columns)
        self.rows += len(table)
        return Block(self.topic, table, int(rows["length"].sum()))
