"""From a device's messages to the rows of a recording's topics: ordering, intervals, joining."""

from collections.abc import Iterator, Mapping

import numpy as np

from spoofbench.conversion import Block, Columns, Reject, Rejects, TimeSorter
from spoofbench.conversion.rows import join, take
from spoofbench_converters.rosbag.family import rejects
from spoofbench_converters.rosbag.rows import BACKWARDS, PairStream, block

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
