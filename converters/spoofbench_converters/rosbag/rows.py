"""Rows of a bag's sources on their way to blocks: joined, timed and in the order of time."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench.conversion import Block, Columns, Reject, Rejects, TimeSorter
from spoofbench.conversion.rows import join, take
from spoofbench.schema import KINDS, topic_of
from spoofbench.table import Column, Table, encode_words
from spoofbench_converters.rosbag.family import rejects

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


INTERVAL_ROWS = 1000
_WHOLE_HERTZ = 0.01  # share by which a median rate may differ from a whole number of hertz


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
        self._order = TimeSorter()

    def push(self, topic: str, columns: Columns) -> Iterator[Block | Reject | Rejects]:
        """Take the next rows in bag order; the first thousand wait until the interval is known from
        them.
        """
        del topic
        if self._interval_s is None:
            self._waiting = columns = join(self._waiting, columns)
            if columns["time_ns"].size < INTERVAL_ROWS:
                return
            self._interval_s, self._waiting = nominal_interval_s(columns), {}
        yield from self._blocks(*self._order.push(columns))

    def finish(self) -> Iterator[Block | Reject | Rejects]:
        """Give what is held."""
        if self._waiting:
            self._interval_s = nominal_interval_s(self._waiting)
            yield from self._blocks(*self._order.push(self._waiting))
        yield from self._blocks(*self._order.flush())

    def about(self) -> dict[str, str]:
        """Return the source's metadata."""
        basis = (
            "given"
            if self._given_s
            else "median interval of the first rows, taken as a whole number of hertz where within 1 % of one"
        )
        interval = (
            {}
            if self._interval_s is None
            else {"interval_s": repr(self._interval_s), "interval_basis": basis}
        )
        return {"topic": self.topics[0], "axes": "frd", **interval}

    def _blocks(self, ready: Columns, refused: Columns) -> Iterator[Block | Reject | Rejects]:
        yield from rejects(refused, f"{BACKWARDS} in {self.topics[0]}")
        if not ready or not ready["time_ns"].size:
            return
        integrated = ready["integrated"]
        if self._interval_s is None and integrated.any():
            yield from rejects(
                take(ready, integrated), f"{self.topics[0]}: a lone integrated row has no interval"
            )
            ready, integrated = take(ready, ~integrated), integrated[~integrated]
        interval = np.where(integrated, self._interval_s or 0.0, 0.0)
        divisor = np.where(integrated, interval, 1.0)
        rates = {
            name: values / divisor
            for name, values in ready.items()
            if name.startswith(("accel_", "gyro_"))
        }
        yield block(self.source, "imu", {**ready, **rates, "interval_s": interval})


def nominal_interval_s(columns: Columns) -> float | None:
    """Return the interval between successive rows, from the median of their time differences.

    A rate within 1 % of a whole number of hertz is taken as that number. None where there are fewer
    than two rows.
    """
    steps = np.diff(np.sort(columns["time_ns"]))
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
        self._order = TimeSorter()

    def push(self, topic: str, columns: Columns) -> Iterator[Block | Reject | Rejects]:
        """Take the next rows in bag order."""
        del topic
        yield from self._blocks(*self._order.push(columns))

    def finish(self) -> Iterator[Block | Reject | Rejects]:
        """Give what is held."""
        yield from self._blocks(*self._order.flush())

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

    def _blocks(self, ready: Columns, refused: Columns) -> Iterator[Block | Reject | Rejects]:
        yield from rejects(refused, f"{BACKWARDS} in {self.topics[0]}")
        if ready and ready["time_ns"].size:
            yield block(self.source, "ins/pva" if self.source else "reference/pva", ready)


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

    def push(self, topic: str, columns: Columns) -> Iterator[Block | Rejects]:
        """Take one topic's next rows in bag order."""
        yield from super().push(
            self._side[topic], {**columns, "units": np.ones(columns["time_ns"].size, np.int64)}
        )

    def about(self) -> dict[str, str]:
        """Return the source's metadata."""
        return {
            "topic": " ".join(self.topics),
            "device": self._device.rpartition("/")[2],
            "solution": "gnss",
            "solution_basis": "positions and velocities without attitude",
        }
