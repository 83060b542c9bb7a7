"""From messages that say rows of kinds to blocks: ordering, and joining a receiver's position and
velocity.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench.conversion import Block, Columns, Rejects, TimeSorter
from spoofbench.conversion.rows import join, take
from spoofbench.schema import KINDS, topic_of
from spoofbench.table import Column, Table, encode_words

BACKWARDS = "time runs backwards"
JOIN_NS = 10_000_000_000


def block(source: str, kind: str, rows: Columns) -> Block:
    """Return rows as a block; it used as many messages as their ``units`` say, else one for
    each.
    """
    columns = {
        name: _column(KINDS[kind].fields[name].category, rows[name])
        for name in KINDS[kind].fields
        if name in rows
    }
    table = Table(kind, rows["time_ns"], columns)
    return Block(
        topic_of(source, kind), table, int(rows["units"].sum()) if "units" in rows else len(table)
    )


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
        self._order = TimeSorter()

    def push(self, side: str, rows: Columns) -> Iterator[Block | Rejects]:
        """Take the next rows in bag order; they bear ``time_ns``, ``receive_time_ns``, ``record``
        and ``units`` besides.
        """
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

    One without its counterpart becomes a row of its own once the other side is ahead, or 10 s
    behind.
    """

    def __init__(
        self,
        source: str,
        device: str | None = None,
        sides: Sequence[str] = ("position", "velocity"),
    ) -> None:
        """Take the source, what the receiver is called in rejects, and the sides that there are."""
        self.source = source
        self._where = device or f"/{source}/gnss/pvt"
        self._order = {side: TimeSorter() for side in sides}
        self._waiting: dict[str, Columns] = {side: {} for side in self._order}
        self._latest_ns: dict[str, int] = {}

    def push(self, side: str, rows: Columns) -> Iterator[Block | Rejects]:
        """Take the next rows of ``position`` or ``velocity``."""
        yield from self._take(side, *self._order[side].push(rows))

    def settle(self) -> Iterator[Block | Rejects]:
        """See :meth:`RowStream.settle`."""
        if self._latest_ns:
            both = (
                min(self._latest_ns.values())
                if len(self._latest_ns) == len(self._order)
                else np.iinfo(np.int64).min
            )
            yield from self._join(max(both, max(self._latest_ns.values()) - JOIN_NS))

    def finish(self) -> Iterator[Block | Rejects]:
        """See :meth:`RowStream.finish`."""
        for side, order in self._order.items():
            yield from self._take(side, *order.flush())
        yield from self._join(np.iinfo(np.int64).max)

    def _take(self, side: str, ready: Columns, refused: Columns) -> Iterator[Rejects]:
        yield from refused_rows(refused, f"the {side} of {self._where}")
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
            yield block(
                self.source,
                "gnss/pvt",
                {**rows, "units": np.concatenate([part["units"] for part in parts])},
            )


def refused_rows(rows: Columns, where: str) -> Iterator[Rejects]:
    """Yield the messages of refused rows as rejects."""
    if rows and rows["time_ns"].size:
        counted = rows["units"] > 0
        yield Rejects(rows["record"][counted], rows["units"][counted], f"{BACKWARDS} in {where}")


def outer_join(first: Columns, second: Columns) -> Columns:
    """Return one row per time of either, both in the order of time; the later receive time counts.

    Rows of equal time on one side are matched by their order.
    """
    keys = [
        np.stack([part["time_ns"], _occurrence(part["time_ns"])], 1) for part in (first, second)
    ]
    epochs, inverse = np.unique(np.concatenate(keys), axis=0, return_inverse=True)
    places = np.split(inverse.reshape(-1), [len(keys[0])])
    joined: Columns = {"time_ns": epochs[:, 0]}
    for part, place in zip((first, second), places, strict=True):
        for name in part.keys() - {"time_ns", "record", "receive_time_ns", "units"}:
            joined[name] = np.full(len(epochs), np.nan)
            joined[name][place] = part[name]
    received = np.full(len(epochs), np.iinfo(np.int64).min)
    for part, place in zip((first, second), places, strict=True):
        received[place] = np.maximum(received[place], part["receive_time_ns"])
    return joined | {"receive_time_ns": received}


def _occurrence(times: Any) -> Any:
    """How many rows of the same time stand before each row, times being sorted."""
    return np.arange(times.size) - np.searchsorted(times, times, "left")
