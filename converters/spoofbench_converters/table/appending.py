"""A clock that jumps back, continued at its own interval."""

import numpy as np
from numpy.typing import NDArray

from spoofbench.conversion import Columns
from spoofbench.conversion.rows import SECOND_NS, join, take

MAX_STEPS = 1000


class Appending:
    """Moves all that follows a jump back of more than ``window_ns`` so that it goes on at the
    interval before.

    A lone row that leaps ahead and back is left as it is. The same rows give the same result
    however they are cut.

    Attributes:
        steps: the first 1000 jumps: ``offset`` of the row in the source, ``from_ns`` and ``to_ns``
            of the log's own clock.
        step_count: how many there were.
    """

    def __init__(self, window_ns: int = SECOND_NS) -> None:
        self.steps: list[dict[str, int]] = []
        self.step_count = 0
        self._window_ns = window_ns
        self._added_ns = 0
        self._interval_ns = 0  # the last one of the clock that is no jump
        self._before_ns: int | None = (
            None  # the log's own time of the last row that was given, and whether that leapt
        )
        self._leapt = False
        self._last: Columns = {}  # the newest row: whether it leaps shows with the next

    def push(self, columns: Columns) -> Columns:
        """Take rows as they come; return those that are settled."""
        rows = join(self._last, columns)
        self._last = take(rows, slice(-1, None))
        return self._moved(take(rows, slice(0, -1)), int(rows["time_ns"][-1]))

    def flush(self) -> Columns:
        """Return the row that is left."""
        rows, self._last = self._last, {}
        return self._moved(rows, None) if rows else rows

    def _moved(self, rows: Columns, following: int | None) -> Columns:
        own = rows["time_ns"]
        if not own.size:
            return rows
        steps = np.diff(own, prepend=own[0] if self._before_ns is None else self._before_ns)
        before = own - steps
        after = np.append(own[1:], own[-1] if following is None else following)
        leaps = (
            (steps > self._window_ns)
            & (own - after > self._window_ns)
            & (after >= before - self._window_ns)
        )
        returns = np.append(self._leapt, leaps[:-1])
        back = np.flatnonzero((steps < -self._window_ns) & ~returns)
        intervals = self._intervals(steps)
        added = np.zeros(own.size, np.int64)
        added[back] = intervals[back] - steps[back]
        for place in back[: max(MAX_STEPS - len(self.steps), 0)].tolist():
            self.steps.append(
                {
                    "offset": int(rows["offset"][place]),
                    "from_ns": int(before[place]),
                    "to_ns": int(own[place]),
                }
            )
        self.step_count += back.size
        moved = own + self._added_ns + np.cumsum(added)
        self._added_ns += int(added.sum())
        self._interval_ns = int(intervals[-1])
        self._before_ns, self._leapt = int(own[-1]), bool(leaps[-1])
        return {**rows, "time_ns": moved}

    def _intervals(self, steps: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return at each row the last interval up to it that is forward and no jump."""
        regular = (steps > 0) & (steps <= self._window_ns)
        latest = np.maximum.accumulate(np.where(regular, np.arange(steps.size), -1))
        return np.where(latest < 0, self._interval_ns, steps[np.maximum(latest, 0)])
