"""``--append-clock``: rows after a jump back of the clock go on after those before it."""

import numpy as np
from numpy.typing import NDArray

from spoofbench.gnss_time import SECOND_NS

MAX_STEPS = 1000
RECENT_INTERVALS = 64


class ClockAppender:
    """Finds where a clock jumps back, and what is to be added to the times from there on.

    A row jumps back if it and the row after it are both more than the window behind both rows
    before it: a lone row that leaps ahead or falls behind moves no other. It then follows the row
    before it by the median of the recent intervals.

    Args:
        window_ns: how far behind a row may stand without a jump of the clock; longer steps forward
            are no intervals.

    Attributes:
        steps: the first 1000 jumps: ``offset`` of the row in the source, ``from_ns`` and ``to_ns``
            of the log's own clock.
        step_count: how many there were.
    """

    def __init__(self, window_ns: int = SECOND_NS) -> None:
        self.steps: list[dict[str, int]] = []
        self.step_count = 0
        self._window_ns = window_ns
        none = np.empty(0, np.int64)
        self._before_ns = none  # the log's own times of the last two rows
        self._intervals_ns = none  # the recent ones
        # Of the rows pushed last: what is added before the first jump, where the jumps lie, and
        # what is added behind each.
        self._base_ns, self._jumps, self._added_ns = 0, none, none

    def push(
        self,
        offset: NDArray[np.int64],
        time_ns: NDArray[np.int64],
        following_ns: int | None = None,
    ) -> NDArray[np.int64]:
        """Take the next rows in the order of the log; return what is added to their times.

        Args:
            offset: int64 ``(n,)``, where the rows lie in the source.
            time_ns: int64 ``(n,)``, by the log's own clock.
            following_ns: that of the row after them, where it is known.

        Returns:
            int64 ``(n,)``, nanoseconds.
        """
        base_ns = self._base_ns if not self._added_ns.size else int(self._added_ns[-1])
        if not time_ns.size:
            return np.empty(0, np.int64)
        known = self._before_ns.size
        times = np.concatenate([self._before_ns, time_ns])
        steps = np.diff(times, prepend=times[0])
        back = np.flatnonzero(self._jumps_back(times, following_ns)[known:])
        is_regular = (steps[known:] > 0) & (steps[known:] <= self._window_ns)
        regular = np.flatnonzero(is_regular)
        intervals = np.concatenate([self._intervals_ns, steps[known:][regular]])
        counts = self._intervals_ns.size + np.searchsorted(regular, back)
        added = np.zeros(time_ns.size, np.int64)
        for row, count in zip(back.tolist(), counts.tolist(), strict=True):
            step = int(steps[known + row])
            added[row] = _median(intervals[max(count - RECENT_INTERVALS, 0) : count]) - step
            if len(self.steps) < MAX_STEPS:
                to_ns = int(time_ns[row])
                self.steps.append(
                    {"offset": int(offset[row]), "from_ns": to_ns - step, "to_ns": to_ns}
                )
        self.step_count += back.size
        total = base_ns + np.cumsum(added)
        self._before_ns, self._intervals_ns = times[-2:], intervals[-RECENT_INTERVALS:]
        self._base_ns, self._jumps, self._added_ns = base_ns, offset[back], total[back]
        return total

    def added_at(self, offset: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return what is added to the times of other rows among those pushed last, or behind them,
        int64 ``(n,)``.
        """
        added = np.append(self._base_ns, self._added_ns)
        return added[np.searchsorted(self._jumps, offset, "right")]

    def _jumps_back(self, times: NDArray[np.int64], following_ns: int | None) -> NDArray[np.bool_]:
        """Return which rows jump back, bool ``(n,)``; the first never does."""
        after = np.append(times[1:], times[-1] if following_ns is None else following_ns)
        earlier = np.concatenate([times[:1], times[:-2]])[: times.size - 1]
        lowest = np.minimum(times[:-1], earlier)
        return np.append(False, np.maximum(times, after)[1:] < lowest - self._window_ns)


def _median(values: NDArray[np.int64]) -> int:
    """Return the median, the lower of two, so that it is one of the values; 0 of none."""
    return int(np.sort(values)[(values.size - 1) // 2]) if values.size else 0
