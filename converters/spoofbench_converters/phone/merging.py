"""Rows of one topic from several tables of a log: in the order of time, rows that repeat the one
before them apart, and rows of equal time as one.

A row whose bytes another topic accounts for takes 0 units of the source.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from spoofbench.conversion import Block, Item, Rejects
from spoofbench.conversion.rows import RowBatch, RowBuffer
from spoofbench.schema import topic_of
from spoofbench.table import Column

REPEATED = "repeated row"
_END_NS = np.iinfo(np.int64).max


def in_file_order(batches: Sequence[RowBatch]) -> RowBatch:
    """Return the rows of batches of one kind, at least one, in the order in which they stand in the
    log.
    """
    rows = RowBatch.concat(batches)
    return rows if len(batches) == 1 else rows.take(np.argsort(rows.offset, kind="stable"))


def merge(topic: "MergedTopic", inputs: Mapping[str, Iterator[RowBatch | Item]]) -> Iterator[Item]:
    """Push the rows of a topic's inputs, always those of the one that is behind, so that none is
    held for long.
    """
    while (name := topic.behind()) is not None:
        item = next(inputs[name], None)
        if item is None:
            yield from topic.finish(name)
        elif isinstance(item, RowBatch):
            yield from topic.push(item, name)
        else:
            yield item


class MergedTopic:
    """Rows of one topic, from one or more inputs that are each in their own order.

    Args:
        source: name of the source.
        kind: kind of the schema.
        inputs: names of the inputs.
        joins: whether rows of equal time are one, unless two of them say different things of one
            field; all fields must then be floats.
        derive: makes the fields of joined rows; it may use columns that are no fields.
        window_s: how far behind the latest row of its input one may stand.

    Attributes:
        rows: how many have been given so far.
    """

    def __init__(
        self,
        source: str,
        kind: str,
        *,
        inputs: Sequence[str] = ("",),
        joins: bool = False,
        derive: Callable[[RowBatch], RowBatch] | None = None,
        window_s: float = 1.0,
    ) -> None:
        self.topic = topic_of(source, kind)
        self.rows = 0
        self._joins, self._derive = joins, derive
        self._buffers = {name: RowBuffer(self.topic, round(window_s * 1e9)) for name in inputs}
        self._waiting: dict[str, RowBatch | None] = dict.fromkeys(inputs)
        self._until_ns = dict.fromkeys(inputs, np.iinfo(np.int64).min)
        self._last: RowBatch | None = None

    def push(self, rows: RowBatch, source: str = "") -> Iterator[Block | Rejects]:
        """Take the next rows of one input; yield what is ready of all."""
        if len(rows):
            yield from self._take(source, *self._buffers[source].sort(rows))
            yield from self._ready()

    def finish(self, source: str | None = None) -> Iterator[Block | Rejects]:
        """End one input, or all; yield what is ready."""
        for name in self._buffers if source is None else (source,):
            yield from self._take(name, *self._buffers[name].rest())
            self._until_ns[name] = _END_NS
        yield from self._ready()

    def behind(self) -> str | None:
        """Return the input that the others wait for; None where all have ended."""
        name = min(self._until_ns, key=lambda name: self._until_ns[name])
        return None if self._until_ns[name] == _END_NS else name

    def _take(self, source: str, ready: RowBatch, refused: RowBatch) -> Iterator[Rejects]:
        yield from _rejects(refused, f"time runs backwards in {self.topic}")
        if len(ready):
            waiting = self._waiting[source]
            self._waiting[source] = RowBatch.concat([waiting, ready]) if waiting else ready
            self._until_ns[source] = int(ready.time_ns[-1])

    def _ready(self) -> Iterator[Block | Rejects]:
        """Yield the rows before which none of any input can come any more."""
        before_ns = min(self._until_ns.values())
        parts = []
        for source, rows in self._waiting.items():
            if rows is not None:
                count = len(rows)
                if before_ns != _END_NS:
                    count = int(np.searchsorted(rows.time_ns, before_ns, "left"))
                parts.append(rows.take(slice(0, count)))
                self._waiting[source] = rows.take(slice(count, None))
        parts = [part for part in parts if len(part)]
        if not parts:
            return
        rows = RowBatch.concat(parts)
        if len(parts) > 1:
            rows = rows.take(np.argsort(rows.time_ns, kind="stable"))
        repeated = self._repeats(rows)
        if repeated.any():
            yield from _rejects(rows.take(repeated), REPEATED)
            rows = rows.take(~repeated)
        if len(rows):
            rows = self._joined(rows) if self._joins else rows
            rows = self._derive(rows) if self._derive else rows
            self.rows += len(rows)
            yield rows.block(self.topic)

    def _repeats(self, rows: RowBatch) -> NDArray[np.bool_]:
        """Return which rows say the same as the row before them, at the same time."""
        known = [self._last] if self._last is not None else []
        self._last = rows.take(slice(-1, None))
        times = np.concatenate([*(last.time_ns for last in known), rows.time_ns])
        same = np.append(False, times[1:] == times[:-1])
        if same.any():
            for column in RowBatch.concat([*known, rows]).columns.values():
                same[1:] &= _equals_next(column)
        return same[len(known) :]

    def _joined(self, rows: RowBatch) -> RowBatch:
        """Make one row of those of equal time, unless two of them say different things of one
        field.
        """
        times = rows.time_ns
        begins = np.append(True, times[1:] != times[:-1])
        first = np.flatnonzero(begins)
        if first.size == times.size:
            return rows
        agree, highest = np.ones(first.size, bool), {}
        for name, column in rows.columns.items():
            highest[name] = np.fmax.reduceat(column.values, first)
            agree &= ~(highest[name] > np.fmin.reduceat(column.values, first))
        group = np.cumsum(begins) - 1
        joined = agree[group]
        columns = {
            name: Column(np.where(joined, highest[name][group], column.values))
            for name, column in rows.columns.items()
        }
        units = np.where(joined, np.add.reduceat(rows.units, first)[group], rows.units)
        whole = RowBatch(rows.kind, times, columns, rows.offset, units)
        return whole.take(begins | ~joined)


def _equals_next(column: Column) -> NDArray[np.bool_]:
    """Return which rows but the last say the same as the next one, bool ``(n - 1,)``."""
    values, valid = column.values, column.valid
    equal = values[1:] == values[:-1]
    if values.dtype.kind == "f":
        equal |= np.isnan(values[1:]) & np.isnan(values[:-1])
    return np.asarray(equal if valid is None else equal & (valid[1:] == valid[:-1]))


def _rejects(rows: RowBatch, reason: str) -> Iterator[Rejects]:
    """Yield rows as rejects, but for those whose bytes others account for."""
    if (rows.units > 0).any():
        yield rows.take(rows.units > 0).rejects(reason)
