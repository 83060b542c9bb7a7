"""A clock that jumps back, continued at its own interval."""

import numpy as np
from numpy.typing import NDArray

from spoofbench.converting import Columns
from spoofbench.converting.ordering import SECOND_NS, join, take

MAX_STEPS = 1000


class Appending:
    """Moves all that follows a jump back of more than ``window_ns`` so that it goes on at the interval before.

    A lone row that leaps ahead and back is left as it is. The same rows give the same result however they are cut.

    Attributes:
        steps: the first 1000 jumps: ``offset`` of the row in the source, ``from_ns`` and ``to_ns`` of the log's own clock.
        step_count: how many there were.
    """

    def __init__(self, window_ns: int = SECOND_NS) -> None:
        self.steps: list[dict[str, int]] = []
        self.step_count = 0
        self._window_ns = window_ns
        self._added_ns = 0
        self._interval_ns = 0
        self._before: list[int] = []  # the log's own time of the last row that was given
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
        times = np.concatenate([self._before, own]).astype(np.int64)
        after = np.append(own[1:], own[-1] if following is None else following)
        steps = np.diff(times, prepend=times[:1])[-own.size :]
        before = own - steps
        lone = (steps > self._window_ns) & (own - after > self._window_ns) & (after >= before - self._window_ns)
        back = np.flatnonzero((steps < -self._window_ns) & ~np.append(False, lone[:-1])[: own.size])
        added = np.zeros(own.size, np.int64)
        for place in back.tolist():
            self._remember(rows, place, int(before[place]), self._interval_before(steps, place))
            added[place] = self._interval_ns - int(steps[place])
        moved = own + self._added_ns + np.cumsum(added)
        self._interval_ns = self._interval_before(steps, own.size)
        self._added_ns += int(added.sum())
        self._before = [int(own[-1])]
        return {**rows, "time_ns": moved}

    def _interval_before(self, steps: NDArray[np.int64], place: int) -> int:
        """Return the last interval of the clock before a row, as long as a step back is no interval."""
        recent = steps[max(place - 16, 0) : place]
        forward = recent[(recent > 0) & (recent <= self._window_ns)]
        return int(forward[-1]) if forward.size else self._interval_ns

    def _remember(self, rows: Columns, place: int, before_ns: int, interval_ns: int) -> None:
        self._interval_ns = interval_ns
        self.step_count += 1
        if len(self.steps) < MAX_STEPS:
            self.steps.append({"offset": int(rows["offset"][place]), "from_ns": before_ns, "to_ns": int(rows["time_ns"][place])})
