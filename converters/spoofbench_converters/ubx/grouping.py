"""Which frames make one epoch.

The messages of a navigation epoch bear its time of week, iTOW. They mostly follow one another, but
may be repeated, missing, or come after those of the next epoch where a logger writes its buffers
out of order. So frames of one iTOW are one epoch as long as not more than eight others have begun
since.

A raw measurement bears the receiver's own time, off by its clock's error, and comes before the
solution made from it: it belongs to a solution that follows within 40 ms. Messages between
navigation epochs (HNR) belong to the last epoch within 2 s, or else to their second. What bears no
time belongs to the latest epoch begun.
"""

from dataclasses import dataclass

import numpy as np

from spoofbench.arrays import Bools, Ints, forward_fill
from spoofbench.gnss_time import wrap_difference
from spoofbench_converters.ubx.frames import ROLES, FrameBuffer
from spoofbench_converters.ubx.messages import Role

WEEK_MS = 604_800_000
LATE_RUNS = 8
RUN_BYTES = 1 << 20  # what one epoch may hold, so that memory is bounded where no time comes
_RAW_AFTER_MS, _RAW_BEFORE_MS, _HIGH_RATE_MS = 5, 40, 2_000


@dataclass(slots=True)
class _OpenEpoch:
    """An epoch that a later frame may still join."""

    time_ms: int
    raw: bool  # only raw measurements bore a time
    first_run: int
    epoch: int

    def takes(self, time_ms: int, raw: bool) -> bool:
        """Whether a run that begins with this time is of this epoch."""
        if raw and not self.raw:
            return self.time_ms >= 0 and -_RAW_AFTER_MS <= self.time_ms - time_ms <= _RAW_BEFORE_MS
        return self.time_ms == time_ms >= 0

    def learn(self, time_ms: int, raw: bool) -> None:
        """Take a run's last time as the epoch's, a solution's rather than a raw one."""
        if time_ms >= 0 and (self.raw or not raw):
            self.time_ms, self.raw = time_ms, raw


class Grouper:
    """Numbers the epochs of frames as they come; the same frames get the same numbers however they
    are cut into pieces.

    A run is a stretch of frames of one time; an epoch is one run, or several.
    """

    def __init__(self) -> None:
        self._run = 0
        self._filled = 0  # bytes of the run under way
        self._navigation_ms = -1  # time of the last navigation message
        self._anchor: tuple[int, bool] | None = (
            None  # time of the last frame that bore one, and whether it was raw
        )
        self._leading = True  # no frame has borne a time yet
        self._open = [_OpenEpoch(-1, True, 0, 0)]
        self._current = self._open[0]  # the epoch of the run under way
        self._latest = 0  # the latest epoch begun

    @property
    def first_open(self) -> int:
        """The first epoch that a later frame may still join."""
        return min(group.epoch for group in self._open)

    @property
    def end(self) -> int:
        """The number after the latest epoch's."""
        return self._latest + 1

    def assign(self, buffer: FrameBuffer) -> Ints:
        """Return the epoch of each frame, int64 ``(k,)``."""
        if not buffer.number.size:
            return buffer.epoch
        decides, raw, times = self._anchors(ROLES[buffer.number], buffer.time_ms)
        begins = self._begins(decides, raw, times)
        self._cut(begins, decides, buffer.used)
        runs = self._run + np.cumsum(begins)
        epochs = self._epochs(runs, decides, raw, times)
        epoch = epochs[runs - self._run]
        latest = np.maximum(np.maximum.accumulate(epoch), self._latest)
        self._run, self._latest = int(runs[-1]), int(latest[-1])
        self._open = [group for group in self._open if group.first_run >= self._run - LATE_RUNS]
        return np.where(decides | (ROLES[buffer.number] == Role.RAW), epoch, latest)

    def _anchors(self, roles: Ints, time_ms: Ints) -> tuple[Bools, Bools, Ints]:
        """Which frames decide on their epoch, which of them are raw, and the time that they bear,
        in ms.
        """
        navigation = roles == Role.NAV
        last = forward_fill(time_ms, navigation, self._navigation_ms)
        self._navigation_ms = int(last[-1])
        apart = np.where(last >= 0, _apart(time_ms, last), WEEK_MS)
        raw = (roles == Role.RAW) & (time_ms >= 0) & (apart > _RAW_AFTER_MS)
        high_rate = (roles == Role.HIGH_RATE) & (apart > _HIGH_RATE_MS)
        return (
            navigation | raw | high_rate,
            raw,
            np.where(high_rate, time_ms // 1000 * 1000, time_ms),
        )

    def _begins(self, decides: Bools, raw: Bools, times: Ints) -> Bools:
        """Which frames begin a run, because they bear another time than the one before that bore
        one.
        """
        begins = np.zeros(decides.size, bool)
        if not decides.any():
            return begins
        now, now_raw = times[decides], raw[decides]
        before_ms, before_raw = self._anchor or (-1, False)
        before = np.concatenate([[before_ms], now[:-1]])
        before_is_raw = np.concatenate([[before_raw], now_raw[:-1]])
        apart = _apart(now, before)
        same = np.where(
            before_is_raw,
            np.where(now_raw, apart <= 1, apart <= _RAW_BEFORE_MS),
            np.where(now_raw, False, now == before),
        )
        if self._anchor is None:
            same[0] = self._leading
        begins[decides] = ~same
        self._anchor, self._leading = (int(now[-1]), bool(now_raw[-1])), False
        return begins

    def _cut(self, begins: Bools, decides: Bools, size: Ints) -> None:
        """Begin further runs within those that are too large; mark them in ``begins``."""
        before = np.cumsum(size) - size
        edges = np.concatenate([[0], np.flatnonzero(begins), [size.size]])
        start = np.concatenate([[-self._filled], before[edges[1:-1]], [before[-1] + size[-1]]])
        for segment in np.flatnonzero(np.diff(start) > RUN_BYTES).tolist():
            origin, end = int(start[segment]), int(edges[segment + 1])
            while (cut := int(np.searchsorted(before[:end], origin + RUN_BYTES))) < end:
                begins[cut] = True
                origin = int(before[cut])
                later = cut + np.flatnonzero(decides[cut:end])
                if later.size:
                    begins[later[0]] = True
                    origin = int(before[later[0]])
                elif end == size.size:
                    self._anchor, self._leading = None, False
        last = np.flatnonzero(begins)
        total = int(before[-1] + size[-1])
        self._filled = total - int(before[last[-1]]) if last.size else total + self._filled

    def _epochs(self, runs: Ints, decides: Bools, raw: Bools, times: Ints) -> Ints:
        """Return the epoch of each run from the one under way on."""
        count = int(runs[-1]) - self._run + 1
        deciding = np.flatnonzero(decides)
        first, last = np.full(count, -1), np.full(count, -1)
        last[runs[deciding] - self._run] = deciding
        first[runs[deciding[::-1]] - self._run] = deciding[::-1]
        begin_ms, end_ms = (
            np.where(first >= 0, times[first], -1),
            np.where(last >= 0, times[last], -1),
        )
        begin_raw, end_raw = raw[first], raw[last]
        self._current.learn(int(end_ms[0]), bool(end_raw[0]))
        latest, epochs = self._latest, np.full(count, self._current.epoch)
        fresh = (
            begin_ms
            > _recent(np.append(max(group.time_ms for group in self._open), end_ms[1:]))
            + _RAW_AFTER_MS
        )
        for stretch in np.split(np.arange(1, count), np.flatnonzero(fresh[2:] != fresh[1:-1]) + 1):
            if stretch.size and fresh[stretch[0]]:
                epochs[stretch] = latest + 1 + np.arange(stretch.size)
                latest = int(epochs[stretch[-1]])
                self._open += [
                    _OpenEpoch(
                        int(end_ms[index]),
                        bool(end_raw[index]),
                        self._run + index,
                        int(epochs[index]),
                    )
                    for index in stretch[-LATE_RUNS - 1 :].tolist()
                ]
                self._current = self._open[-1]
                continue
            for index in stretch.tolist():
                latest = self._join(
                    self._run + index, int(begin_ms[index]), bool(begin_raw[index]), latest
                )
                self._current.learn(int(end_ms[index]), bool(end_raw[index]))
                epochs[index] = self._current.epoch
        return epochs

    def _join(self, run: int, time_ms: int, raw: bool, latest: int) -> int:
        """Give a run the open epoch of its time, or a new one; return the latest epoch."""
        self._open = [group for group in self._open if group.first_run >= run - LATE_RUNS]
        match = next((group for group in self._open if group.takes(time_ms, raw)), None)
        if match is None:
            latest += 1
            match = _OpenEpoch(time_ms, raw, run, latest)
            self._open.append(match)
        self._current = match
        return latest


def _recent(times: Ints) -> Ints:
    """Return the largest time before each index, of as many as can still matter."""
    largest = np.full(times.size, -1)
    for back in range(1, 2 * LATE_RUNS + 1):
        largest[back:] = np.maximum(largest[back:], times[:-back])
    return largest


def _apart(times: Ints, others: Ints) -> Ints:
    """How far times of week are apart, in ms."""
    return np.asarray(np.abs(wrap_difference(times - others, WEEK_MS)))
