"""Rows of epochs that know their times, on their way to the tables of a recording."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from spoofbench.arrays import Ints, Times
from spoofbench.conversion import Block, Rejects, RowBatch, RowBuffer
from spoofbench.schema import KINDS, topic_of
from spoofbench.table import Column, Table
from spoofbench_converters.serial.contract import ABSENT_NS, EpochRows, Epochs
from spoofbench_converters.serial.time_axis import TIMED, Verdicts

BLOCK_EPOCHS = 60
RESTART_NS = 60_000_000_000
"""A lead that changes by more than this from one epoch to the next is that of a counter which has
started anew.
"""


@dataclass(frozen=True, slots=True, eq=False)
class TimedEpochs:
    """A decoder's epochs with their times and verdicts.

    Attributes:
        epochs: as the decoder gave them, ``m`` of them.
        time_ns: int64 ``(m,)``, on the recording's clock.
        verdicts: uint8 ``(m,)``, whether they have a time, as in ``time_axis``.
        first: number of the first of them among all of the decoder's.
    """

    epochs: Epochs
    time_ns: Times
    verdicts: Verdicts
    first: int

    def batch(self, rows: EpochRows) -> RowBatch:
        """Return rows, whose epochs all have a time, with their times.

        They account for no bytes, because those of an epoch are shared by all its topics.
        """
        epochs, epoch, columns = self.epochs, rows.epoch, dict(rows.columns)
        received = (
            epochs.receive_time_ns[epoch] if rows.receive_time_ns is None else rows.receive_time_ns
        )
        known = received != ABSENT_NS
        if known.any():
            columns["receive_time_ns"] = Column(np.where(known, received, 0), known)
        time_ns = self.time_ns[epoch]
        if rows.offset_ns is not None:
            time_ns = time_ns + rows.offset_ns
        nothing = np.zeros(epoch.size, np.int64)
        return RowBatch(KINDS[rows.kind], time_ns, columns, epochs.offset[epoch], nothing)


class TopicRows:
    """The rows of one topic, put in the order of time.

    Attributes:
        positions, moving: how many rows have a position, and how many of these a velocity or speed.
    """

    def __init__(self, source: str, kind: str) -> None:
        self.source = source
        self.positions, self.moving = 0, 0
        self._kind = kind
        self._buffer = RowBuffer(topic_of(source, kind))
        self._clock: SensorClock | None = None

    @property
    def is_pvt(self) -> bool:
        return self._kind == "gnss/pvt"

    @property
    def preference(self) -> tuple[bool, bool, int]:
        """Sorts receivers: those first of which half the positions have a velocity or speed, then
        those with positions, then by number.
        """
        return (
            2 * self.moving < max(self.positions, 1),
            not self.positions,
            int(self.source.removeprefix("gnss")),
        )

    def push(self, rows: EpochRows, timed: TimedEpochs) -> Iterator[Block | Rejects]:
        """Take the next rows; those of epochs without a time are left out."""
        has_time = timed.verdicts[rows.epoch] == TIMED
        if not has_time.any():
            return
        rows = rows if has_time.all() else rows.take(has_time)
        batch = timed.batch(rows)
        if rows.tick_ns is None:
            yield from self._counted(self._buffer.push(batch))
            return
        self._clock = self._clock or SensorClock()
        for ready in self._clock.push(batch, rows.tick_ns, rows.epoch + timed.first):
            yield from self._buffer.push(ready)

    def finish(self) -> Iterator[Block | Rejects]:
        """Yield what is held."""
        for ready in self._clock.finish() if self._clock else ():
            yield from self._buffer.push(ready)
        yield from self._counted(self._buffer.flush())

    def about(self) -> dict[str, str]:
        """Return what metadata say of the source's counter."""
        return self._clock.about() if self._clock else {}

    def _counted(self, items: Iterator[Block | Rejects]) -> Iterator[Block | Rejects]:
        """Yield items, and count positions in those of ``gnss/pvt``."""
        for item in items:
            if self.is_pvt and isinstance(item, Block):
                self._count(item.table)
            yield item

    def _count(self, table: Table) -> None:
        position = ~np.isnan(table["lat_deg"])
        still = np.isnan(table["vel_n_mps"]) & np.isnan(table["speed_mps"])
        self.positions += int(np.count_nonzero(position))
        self.moving += int(np.count_nonzero(position & ~still))


@dataclass(slots=True)
class _ClockBlock:
    """Epochs in a row: their counter where their rows begin, how far their time leads it, and the
    rows, whose times are those of the counter.
    """

    ticks: list[int] = field(default_factory=list)
    leads: list[int] = field(default_factory=list)
    rows: list[RowBatch] = field(default_factory=list)

    def middle(self) -> tuple[float, float]:
        """Return the median of the counter, and of the lead."""
        return float(np.median(self.ticks)), float(np.median(self.leads))


class SensorClock:
    """Gives one sensor's rows times by its counter.

    An epoch's messages and the row behind them were given out together, so the row's time is about
    that of the epoch. The lead of time over counter is the median over sixty epochs in a row, which
    neither jitter nor a delayed row disturbs, and is linear between the middles of such blocks.
    What all epochs have in common of the delay between their time and their output remains: times
    are too early by as much.
    """

    def __init__(self) -> None:
        self._open = _ClockBlock()
        self._closed: _ClockBlock | None = None  # its rows wait for the middle of the next block
        self._before: tuple[float, float] | None = None
        self._lead_ns: float | None = None
        self._spreads: list[float] = []

    def push(self, rows: RowBatch, tick_ns: Ints, epoch: Ints) -> Iterator[RowBatch]:
        """Take the next rows in file order; yield those whose times are known.

        Args:
            rows: of a sensor, each with the time of its epoch.
            tick_ns: int64 ``(n,)``, time on the sensor's counter.
            epoch: int64 ``(n,)``, running number of each row's epoch.
        """
        ticking = replace(rows, time_ns=tick_ns)
        epochs, first = np.unique(epoch, return_index=True)
        ticks, leads = tick_ns[first], (rows.time_ns - tick_ns)[first]
        begin = 0
        for number, tick, lead in zip(epochs.tolist(), ticks.tolist(), leads.tolist(), strict=True):
            restarts = bool(self._open.leads) and abs(lead - self._open.leads[-1]) > RESTART_NS
            if restarts or len(self._open.leads) == BLOCK_EPOCHS:
                end = int(np.searchsorted(epoch, number))
                self._open.rows.append(ticking.take(slice(begin, end)))
                begin = end
                yield from self._close(restarts)
            self._open.ticks.append(tick)
            self._open.leads.append(lead)
        self._open.rows.append(ticking.take(slice(begin, None)))

    def finish(self) -> Iterator[RowBatch]:
        """Yield what is held."""
        if self._open.leads:
            yield from self._close(last=True)

    def about(self) -> dict[str, str]:
        """Return what metadata say of the counter."""
        if self._lead_ns is None:
            return {}
        return {
            "time_basis": "its counter, laid against the receiver's epochs",
            "counter_offset_s": repr(round(self._lead_ns / 1e9, 6)),
            "counter_spread_s": repr(round(float(np.median(self._spreads)) / 1e9, 6)),
        }

    def _close(self, last: bool) -> Iterator[RowBatch]:
        """Close the open block; yield the rows of the one before, and its own if it is the last
        before a restart or the end.
        """
        block, self._open = self._open, _ClockBlock()
        middle = block.middle()
        if self._lead_ns is None:
            self._lead_ns = middle[1]
        self._spreads.append(float(np.subtract(*np.percentile(block.leads, [90, 10]))))
        if self._closed:
            yield self._timed(self._closed, middle)
            self._before = self._closed.middle()
        self._closed = block
        if last:
            yield self._timed(block, None)
            self._closed, self._before = None, None

    def _timed(self, block: _ClockBlock, after: tuple[float, float] | None) -> RowBatch:
        knots = sorted(knot for knot in (self._before, block.middle(), after) if knot)
        rows = RowBatch.concat(block.rows)
        lead = np.interp(rows.time_ns.astype(np.float64), *np.array(knots).T)
        return replace(rows, time_ns=rows.time_ns + np.rint(lead).astype(np.int64))
