"""From messages that say rows of kinds to blocks: ordering, and joining a receiver's position and velocity."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench.converting import Block, Columns, InOrder, Rejects
from spoofbench.converting.ordering import join, take
from spoofbench.recording import Column, Table, encode_words
from spoofbench.schema import KINDS, topic_of
from spoofbench_converters.rosbag.streams import BACKWARDS, JOIN_NS, outer_join

Sides = Mapping[str, str]


def block(source: str, kind: str, rows: Columns) -> Block:
    """Return rows as a block; it used as many messages as their ``units`` say."""
    columns = {name: _column(KINDS[kind].fields[name].category, rows[name]) for name in KINDS[kind].fields if name in rows}
    return Block(topic_of(source, kind), Table(kind, rows["time_ns"], columns), int(rows["units"].sum()))


def _column(category: str, values: NDArray[Any]) -> Any:
    if category in ("text", "bytes"):
        return encode_words([word or None for word in values.tolist()])
    if category == "float" or values.dtype.kind != "f":
        return values
    valid = ~np.isnan(values)
    return Column(np.where(valid, values, 0), valid)


class RowStream:
    """Rows of one kind of one source."""

    def __init__(self, source: str, kind: str) -> None:
        self.source, self.kind = source, kind
        self._order = InOrder()

    def push(self, side: str, rows: Columns) -> Iterator[Block | Rejects]:
        """Take the next rows in bag order; they bear ``time_ns``, ``receive_time_ns``, ``record`` and ``units`` besides."""
        del side
        yield from self._blocks(*self._order.push(rows))

    def settle(self) -> Iterator[Block | Rejects]:
        """Give what is complete, now that all topics were read equally far."""
        yield from ()

    def finish(self) -> Iterator[Block | Rejects]:
        """Give what is held."""
        yield from self._blocks(*self._order.flush())

    def _blocks(self, ready: Columns, refused: Columns) -> Iterator[Block | Rejects]:
        yield from refused_rows(refused, f"/{self.source}/{self.kind}")
        if ready and ready["time_ns"].size:
            yield block(self.source, self.kind, ready)


class PairStream:
    """Positions and velocities of one receiver, joined where their times are equal.

    One without its counterpart becomes a row of its own once the other side is ahead, or 10 s behind.
    """

    def __init__(self, source: str) -> None:
        self.source, self.kind = source, "gnss/pvt"
        self._order = {"position": InOrder(), "velocity": InOrder()}
        self._waiting: dict[str, Columns] = {side: {} for side in self._order}
        self._latest_ns: dict[str, int] = {}

    def push(self, side: str, rows: Columns) -> Iterator[Block | Rejects]:
        """Take the next rows of ``position`` or ``velocity``."""
        yield from self._take(side, *self._order[side].push(rows))

    def settle(self) -> Iterator[Block | Rejects]:
        """See :meth:`RowStream.settle`."""
        if self._latest_ns:
            both = min(self._latest_ns.values()) if len(self._latest_ns) == len(self._order) else np.iinfo(np.int64).min
            yield from self._join(max(both, max(self._latest_ns.values()) - JOIN_NS))

    def finish(self) -> Iterator[Block | Rejects]:
        """See :meth:`RowStream.finish`."""
        for side, order in self._order.items():
            yield from self._take(side, *order.flush())
        yield from self._join(np.iinfo(np.int64).max)

    def _take(self, side: str, ready: Columns, refused: Columns) -> Iterator[Rejects]:
        yield from refused_rows(refused, f"the {side} of /{self.source}/{self.kind}")
        if ready and ready["time_ns"].size:
            self._waiting[side] = join(self._waiting[side], ready)
            self._latest_ns[side] = int(ready["time_ns"][-1])

    def _join(self, before_ns: int) -> Iterator[Block]:
        parts = []
        for side, rows in self._waiting.items():
            if rows:
                ready = int(np.searchsorted(rows["time_ns"], before_ns, "left"))
                parts.append(take(rows, slice(0, ready)))
                self._waiting[side] = take(rows, slice(ready, None))
        parts = [part for part in parts if part["time_ns"].size]
        if parts:
            rows = outer_join(parts[0], parts[1]) if len(parts) == 2 else parts[0]
            yield block(self.source, self.kind, {**rows, "units": np.concatenate([part["units"] for part in parts])})


def refused_rows(rows: Columns, where: str) -> Iterator[Rejects]:
    """Yield the messages of refused rows as rejects."""
    if rows and rows["time_ns"].size:
        counted = rows["units"] > 0
        yield Rejects(rows["record"][counted], rows["units"][counted], f"{BACKWARDS} in {where}")
