"""Counters of sensors laid against the epochs of the receiver that they are logged with."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from spoofbench.conversion import Columns
from spoofbench.conversion.rows import join, take

BLOCK_EPOCHS = 60
RESTART_NS = 60_000_000_000
"""A lead that changes by more than this from one epoch to the next is that of a counter which has
started anew.
"""


@dataclass(slots=True)
class _Block:
    """Epochs in a row: their counter where their rows begin, how far their time leads it, and the
    rows.
    """

    ticks: list[int] = field(default_factory=list)
    leads: list[int] = field(default_factory=list)
    rows: Columns = field(default_factory=dict)

    def middle(self) -> tuple[float, float]:
        """Return the median of the counter, and of the lead."""
        return float(np.median(self.ticks)), float(np.median(self.leads))


class Counter:
    """Gives one sensor's rows times by its counter.

    An epoch's messages and the row behind them were given out together, so the row's time is about
    that of the epoch. The lead of time over counter is the median over sixty epochs in a row, which
    neither jitter nor a delayed row disturbs, and is linear between the middles of such blocks.
    What all epochs have in common of the delay between their time and their output remains: times
    are too early by as much.
    """

    def __init__(self) -> None:
        self._open = _Block()
        self._closed: _Block | None = None  # its rows wait for the middle of the next block
        self._before: tuple[float, float] | None = None
        self._lead_ns: float | None = None
        self._spreads: list[float] = []

    def push(self, rows: Columns) -> Iterator[Columns]:
        """Take the next rows in file order.

        Args:
            rows: ``tick_ns`` and whatever else, and ``epoch`` and ``epoch_ns``, number and time of
                each row's epoch.

        Yields:
            Rows with ``time_ns``.
        """
        epochs, first = np.unique(rows["epoch"], return_index=True)
        ticks, leads = rows["tick_ns"][first], (rows["epoch_ns"] - rows["tick_ns"])[first]
        begin = 0
        for epoch, tick, lead in zip(epochs.tolist(), ticks.tolist(), leads.tolist(), strict=True):
            restarts = bool(self._open.leads) and abs(lead - self._open.leads[-1]) > RESTART_NS
            if restarts or len(self._open.leads) == BLOCK_EPOCHS:
                end = int(np.searchsorted(rows["epoch"], epoch))
                self._open.rows = join(self._open.rows, take(rows, slice(begin, end)))
                begin = end
                yield from self._close(restarts)
            self._open.ticks.append(tick)
            self._open.leads.append(lead)
        self._open.rows = join(self._open.rows, take(rows, slice(begin, None)))

    def finish(self) -> Iterator[Columns]:
        """Give what is held."""
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

    def _close(self, last: bool) -> Iterator[Columns]:
        """Close the open block; give the rows of the one before, and its own if it is the last
        before a restart or the end.
        """
        block, self._open = self._open, _Block()
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

    def _timed(self, block: _Block, after: tuple[float, float] | None) -> Columns:
        knots = sorted(knot for knot in (self._before, block.middle(), after) if knot)
        ticks = block.rows["tick_ns"]
        lead = np.interp(ticks.astype(np.float64), *np.array(knots).T)
        return {**block.rows, "time_ns": ticks + np.rint(lead).astype(np.int64)}
