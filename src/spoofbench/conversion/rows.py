"""Rows into the order of time, as they stream by."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Columns = dict[str, NDArray[Any]]
"""Arrays ``(n, ...)`` of equal length by name, among them ``time_ns``, int64."""

SECOND_NS = 1_000_000_000


class TimeSorter:
    """Puts the rows of one topic in the order of time.

    A row may stand up to ``window_ns`` behind the latest one before it and is then sorted in, after
    rows of equal time. One further behind is refused, and so is a lone row that leaps further ahead
    of both its neighbours: otherwise a single false time would refuse all that follows. The same
    rows give the same result however the stream is cut into pieces.
    """

    def __init__(self, window_ns: int = SECOND_NS) -> None:
        self._window_ns = window_ns
        # accepted, in the order of time, may still be preceded by a late row
        self._held: Columns = {}
        self._undecided: Columns = {}  # the newest row: whether it leaps ahead shows with the next
        self._before_ns: int | None = None  # time of the row before the undecided one
        self._latest_ns: int | None = None  # latest accepted time

    def push(self, columns: Columns) -> tuple[Columns, Columns]:
        """Take rows as they come; return ``(ready, refused)``, each possibly without rows."""
        rows = join(self._undecided, columns)
        if rows["time_ns"].size < 2:
            self._undecided = rows
            return take(rows, slice(0, 0)), take(rows, slice(0, 0))
        self._undecided = take(rows, slice(-1, None))
        leaps = self._leaps(rows["time_ns"])
        self._before_ns = int(rows["time_ns"][-2])
        return self._accept(take(rows, slice(0, -1)), leaps)

    def flush(self) -> tuple[Columns, Columns]:
        """Return the rows still held, as ``(ready, refused)``."""
        if not self._undecided:
            return {}, {}
        ready, refused = self._accept(
            self._undecided, np.zeros(self._undecided["time_ns"].size, bool)
        )
        last = join(ready, self._held)
        self._held, self._undecided = {}, {}
        return last, refused

    def _leaps(self, times: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which rows but the last are further ahead of both neighbours than the window."""
        ahead_of_next = times[:-1] - times[1:] > self._window_ns
        before = np.concatenate(
            [[times[0] if self._before_ns is None else self._before_ns], times[:-2]]
        )
        ahead_of_last = times[:-1] - before > self._window_ns
        if self._before_ns is None:
            ahead_of_last[0] = True
        returns = times[1:] >= before - self._window_ns
        return np.asarray(
            ahead_of_next
            & ahead_of_last
            & (returns | (np.arange(times.size - 1) == 0) & (self._before_ns is None))
        )

    def _accept(self, rows: Columns, leaps: NDArray[np.bool_]) -> tuple[Columns, Columns]:
        times = rows["time_ns"]
        start = times[0] if self._latest_ns is None else self._latest_ns
        if (
            times.size
            and not leaps.any()
            and times[0] >= start
            and bool(np.all(times[1:] >= times[:-1]))
        ):
            refused, accepted = take(rows, slice(0, 0)), rows
        else:
            floor = np.iinfo(np.int64).min
            candidates = np.where(leaps, floor, times)
            latest = np.maximum.accumulate(
                np.concatenate(
                    [[floor if self._latest_ns is None else self._latest_ns], candidates]
                )
            )[:-1]
            late = leaps | ((latest > floor) & (times < latest - self._window_ns))
            refused, accepted = take(rows, late), take(rows, ~late)
        if not accepted["time_ns"].size:
            return accepted, refused
        newest = int(accepted["time_ns"].max())
        self._latest_ns = newest if self._latest_ns is None else max(newest, self._latest_ns)
        waiting = join(self._held, accepted)
        if np.any(waiting["time_ns"][1:] < waiting["time_ns"][:-1]):
            waiting = take(waiting, np.argsort(waiting["time_ns"], kind="stable"))
        ready = int(np.searchsorted(waiting["time_ns"], self._latest_ns - self._window_ns, "left"))
        self._held = take(waiting, slice(ready, None))
        return take(waiting, slice(0, ready)), refused


def take(columns: Mapping[str, NDArray[Any]], rows: Any) -> Columns:
    """Return the rows that a slice, mask or index array selects."""
    return {name: values[rows] for name, values in columns.items()}


def join(first: Columns, second: Columns) -> Columns:
    """Return the rows of both, the first one's first; either may be empty of columns."""
    if not first or not second:
        return second or first
    return {name: np.concatenate([values, second[name]]) for name, values in first.items()}
