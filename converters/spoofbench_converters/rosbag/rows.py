"""Rows of a bag's sources on their way to blocks: joined, divided and in the order of time."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench.arrays import Ints, Times
from spoofbench.conversion import Block, Columns, Reject, Rejects, RowBatch, RowBuffer
from spoofbench.conversion.rows import join, take
from spoofbench.schema import KINDS, Field, topic_of
from spoofbench.table import Column, as_column
from spoofbench_converters.rosbag.contract import rejects

BACKWARDS = "time runs backwards"
JOIN_NS = 10_000_000_000
INTERVAL_ROWS = 1000
_WHOLE_HERTZ = 0.01  # share by which a median rate may differ from a whole number of hertz


def row_batch(kind: str, rows: Columns) -> RowBatch:
    """Return rows of a kind.

    Args:
        kind: of the schema.
        rows: ``time_ns``, ``record`` (the ordinal of the message) and fields of the kind, ``(n,)``
            each: numbers NaN and texts empty where absent; others are left out. ``units`` says how
            many messages each row stands for in the ledger, one where it is missing.
    """
    columns = {
        name: _column(field, rows[name])
        for name, field in KINDS[kind].fields.items()
        if name in rows
    }
    units = rows.get("units", np.ones(rows["time_ns"].size, np.int64))
    return RowBatch.of(kind, rows["time_ns"], columns, rows["record"], units)


def _column(field: Field, values: NDArray[Any]) -> Column:
    if field.category in ("text", "bytes"):
        return as_column(field, [word or None for word in values.tolist()])
    if field.category == "float" or values.dtype.kind != "f":
        return Column(values)
    valid = ~np.isnan(values)
    return Column(np.where(valid, values, 0), valid)


class RowStream:
    """Rows of one kind of one source."""

    def __init__(self, source: str, kind: str) -> None:
        self.kind = kind
        self._buffer = RowBuffer(topic_of(source, kind))

    def push(self, side: str, rows: RowBatch) -> Iterator[Block | Rejects]:
        """Take the next rows in bag order."""
        del side
        yield from _sorted(self._buffer, self._buffer.topic, *self._buffer.sort(rows))

    def settle(self) -> Iterator[Block | Rejects]:
        """Give what is complete, now that all topics were read equally far."""
        yield from ()

    def finish(self) -> Iterator[Block | Rejects]:
        """Give what is held."""
        yield from _sorted(self._buffer, self._buffer.topic, *self._buffer.rest())


class PairStream:
    """Positions and velocities of one receiver, joined where their times are equal.

    One without its counterpart becomes a row of its own once the other side is ahead, or 10 s
    behind.

    Args:
        source: of the rows.
        device: what the receiver is called in rejects.
        sides: those that there are.
    """

    kind = "gnss/pvt"

    def __init__(
        self,
        source: str,
        device: str | None = None,
        sides: Sequence[str] = ("position", "velocity"),
    ) -> None:
        self.source = source
        self._topic = topic_of(source, self.kind)
        self._called = device or self._topic
        self._buffers = {side: RowBuffer(self._topic) for side in sides}
        self._waiting: dict[str, RowBatch] = {}
        self._latest_ns: dict[str, int] = {}

    def push(self, side: str, rows: RowBatch) -> Iterator[Block | Rejects]:
        """Take the next rows of ``position`` or ``velocity``."""
        yield from self._take(side, *self._buffers[side].sort(rows))

    def settle(self) -> Iterator[Block | Rejects]:
        """See :meth:`RowStream.settle`."""
        if self._latest_ns:
            both = (
                min(self._latest_ns.values())
                if len(self._latest_ns) == len(self._buffers)
                else np.iinfo(np.int64).min
            )
            yield from self._join(max(both, max(self._latest_ns.values()) - JOIN_NS))

    def finish(self) -> Iterator[Block | Rejects]:
        """See :meth:`RowStream.finish`."""
        for side, buffer in self._buffers.items():
            yield from self._take(side, *buffer.rest())
        yield from self._join(np.iinfo(np.int64).max)

    def _take(self, side: str, ready: RowBatch, refused: RowBatch) -> Iterator[Rejects]:
        yield from _refused(refused, f"the {side} of {self._called}")
        if len(ready):
            waiting = self._waiting.get(side)
            self._waiting[side] = ready if waiting is None else RowBatch.concat([waiting, ready])
            self._latest_ns[side] = int(ready.time_ns[-1])

    def _join(self, before_ns: int) -> Iterator[Block]:
        parts = []
        for side in self._buffers:
            if side in self._waiting:
                rows = self._waiting[side]
                ready = int(np.searchsorted(rows.time_ns, before_ns, "left"))
                self._waiting[side] = rows.take(slice(ready, None))
                if ready:
                    parts.append(rows.take(slice(0, ready)))
        if parts:
            rows = outer_join(parts[0], parts[1]) if len(parts) == 2 else parts[0]
            yield rows.block(self._topic)


def _sorted(
    buffer: RowBuffer, called: str, ready: RowBatch, refused: RowBatch
) -> Iterator[Block | Rejects]:
    """Yield what a buffer gave: the rows that came too late, under a name, and those ready."""
    yield from _refused(refused, called)
    if len(ready):
        yield ready.block(buffer.topic)


def _refused(rows: RowBatch, called: str) -> Iterator[Rejects]:
    """Yield the messages of rows that came too late."""
    if len(rows):
        yield rows.take(rows.units > 0).rejects(f"{BACKWARDS} in {called}")


def outer_join(first: RowBatch, second: RowBatch) -> RowBatch:
    """Return one row per time of either, both in the order of time; the later receive time counts.

    Rows of equal time on one side are matched by their order.
    """
    parts = (first, second)
    keys = [np.stack([part.time_ns, _occurrence(part.time_ns)], 1) for part in parts]
    epochs, inverse = np.unique(np.concatenate(keys), axis=0, return_inverse=True)
    indices = np.split(inverse.reshape(-1), [len(keys[0])])
    fields, count = first.kind.fields, len(epochs)
    columns: dict[str, Column] = {}
    received = np.full(count, np.iinfo(np.int64).min)
    units, record = np.zeros(count, np.int64), np.zeros(count, np.int64)
    for part, index in zip(parts, indices, strict=True):
        for name, column in part.columns.items():
            if name == "receive_time_ns":
                received[index] = np.maximum(received[index], column.values)
            else:
                columns[name] = _spread(fields[name], column, index, count)
        units[index] += part.units
        record[index] = part.offset
    columns["receive_time_ns"] = Column(received)
    return RowBatch(first.kind, epochs[:, 0], columns, record, units)


def _spread(field: Field, column: Column, index: Ints, count: int) -> Column:
    """Return a column of so many rows, absent but at these."""
    if column.categories is not None:
        codes = np.full(count, -1, np.int32)
        codes[index] = column.values
        return Column(codes, None, column.categories)
    values = np.full(count, np.nan if field.category == "float" else 0, column.values.dtype)
    values[index] = column.values
    if field.category == "float":
        return Column(values)
    valid = np.zeros(count, bool)
    valid[index] = True if column.valid is None else column.valid
    return Column(values, valid)


def _occurrence(time_ns: Times) -> Ints:
    """How many rows of the same time stand before each row, times being sorted, ``(n,)``."""
    return np.arange(time_ns.size) - np.searchsorted(time_ns, time_ns, "left")


class ImuStream:
    """Inertial rows of one topic.

    Integrated rows are divided by the nominal interval, not by the difference of their own times,
    whose jitter (3 % on some recorders) would become noise of the same share of gravity.
    """

    def __init__(self, source: str, topic: str, interval_s: float | None) -> None:
        self.source, self.topics = source, (topic,)
        self._given_s = interval_s
        self._interval_s = interval_s
        self._waiting: Columns = {}
        self._buffer = RowBuffer(topic_of(source, "imu"))

    def push(self, topic: str, columns: Columns) -> Iterator[Block | Reject | Rejects]:
        """Take the next rows, columns ``(n,)``, in bag order; the first thousand wait until the
        interval is known from them.
        """
        del topic
        if self._interval_s is None:
            self._waiting = columns = join(self._waiting, columns)
            if columns["time_ns"].size < INTERVAL_ROWS:
                return
            self._interval_s, self._waiting = nominal_interval_s(columns["time_ns"]), {}
        yield from self._divided(columns)

    def finish(self) -> Iterator[Block | Reject | Rejects]:
        """Give what is held."""
        if self._waiting:
            self._interval_s = nominal_interval_s(self._waiting["time_ns"])
            yield from self._divided(self._waiting)
        yield from _sorted(self._buffer, self.topics[0], *self._buffer.rest())

    def about(self) -> dict[str, str]:
        """Return the source's metadata."""
        basis = (
            "given"
            if self._given_s
            else "median interval of the first rows, taken as a whole number of hertz where within "
            "1 % of one"
        )
        interval = (
            {}
            if self._interval_s is None
            else {"interval_s": repr(self._interval_s), "interval_basis": basis}
        )
        return {"topic": self.topics[0], "axes": "frd", **interval}

    def _divided(self, columns: Columns) -> Iterator[Block | Reject | Rejects]:
        """Divide what is integrated by the interval, and put the rows in order."""
        integrated = columns["integrated"]
        if self._interval_s is None and integrated.any():
            lone = take(columns, integrated)
            yield from rejects(lone, f"{self.topics[0]}: a lone integrated row has no interval")
            columns, integrated = take(columns, ~integrated), integrated[~integrated]
        interval = np.where(integrated, self._interval_s or 0.0, 0.0)
        divisor = np.where(integrated, interval, 1.0)
        rates = {
            name: values / divisor
            for name, values in columns.items()
            if name.startswith(("accel_", "gyro_"))
        }
        rows = row_batch("imu", {**columns, **rates, "interval_s": interval})
        yield from _sorted(self._buffer, self.topics[0], *self._buffer.sort(rows))


def nominal_interval_s(time_ns: Times) -> float | None:
    """Return the interval between successive rows, from the median of their time differences.

    A rate within 1 % of a whole number of hertz is taken as that number. None where there are fewer
    than two different times.

    Args:
        time_ns: ``(n,)``, in any order.
    """
    steps = np.diff(np.sort(time_ns))
    steps = steps[steps > 0]
    if not steps.size:
        return None
    median_s = float(np.median(steps)) / 1e9
    whole = round(1 / median_s)
    return 1 / whole if whole and abs(whole * median_s - 1) <= _WHOLE_HERTZ else median_s


class PvaStream:
    """Position, velocity and attitude of one topic; without a source it is the reference."""

    def __init__(self, source: str, topic: str) -> None:
        self.source, self.topics = source, (topic,)
        self._kind = "ins/pva" if source else "reference/pva"
        self._buffer = RowBuffer(topic_of(source, self._kind))

    def push(self, topic: str, columns: Columns) -> Iterator[Block | Reject | Rejects]:
        """Take the next rows, columns ``(n,)``, in bag order."""
        del topic
        ready, refused = self._buffer.sort(row_batch(self._kind, columns))
        yield from _sorted(self._buffer, self.topics[0], ready, refused)

    def finish(self) -> Iterator[Block | Reject | Rejects]:
        """Give what is held."""
        yield from _sorted(self._buffer, self.topics[0], *self._buffer.rest())

    def about(self) -> dict[str, str]:
        """Return the source's metadata."""
        if self.source:
            return {"topic": self.topics[0], "solution": "fused"}
        return {
            "topic": self.topics[0],
            "basis": (
                "a device that gives neither the inertial nor the GNSS topics, or as the options "
                "say"
            ),
        }


class PvtStream(PairStream):
    """Positions and velocities of one receiver, a topic each."""

    def __init__(self, source: str, device: str, sides: Mapping[str, str]) -> None:
        """Take the name of the source and of the device, and the side, ``position`` or
        ``velocity``, of each topic.
        """
        super().__init__(source, device, sorted(sides.values()))
        self.topics = tuple(sides)
        self._device = device
        self._side = dict(sides)

    def push(  # type: ignore[override]
        self, topic: str, columns: Columns
    ) -> Iterator[Block | Rejects]:
        """Take one topic's next rows, columns ``(n,)``, in bag order."""
        yield from super().push(self._side[topic], row_batch(self.kind, columns))

    def about(self) -> dict[str, str]:
        """Return the source's metadata."""
        return {
            "topic": " ".join(self.topics),
            "device": self._device.rpartition("/")[2],
            "solution": "gnss",
            "solution_basis": "positions and velocities without attitude",
        }
