"""The time axis: epochs of all protocols in file order, with what each claims, in; their times out.

The clock is what the log says: claimed times may leap, stand still or be missing.
"""

import json
from collections import defaultdict, deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from heapq import heappop, heappush
from itertools import pairwise
from statistics import median

import numpy as np
from numpy.typing import NDArray

from spoofbench.arrays import Ints, Times
from spoofbench.conversion import Columns
from spoofbench.conversion.rows import join, take
from spoofbench_converters.serial.contract import ABSENT_NS, Epochs, SerialOptions
from spoofbench_converters.serial.dates import ClaimedTimes, DateCompleter, InterleavingCheck

AHEAD = 2
"""How many epochs of its own protocol behind an epoch decide on its time."""

HORIZON = 2**20
"""How far apart in a log epochs may stand that decide on one another, in bytes."""

DEFAULT_INTERVAL_NS = 1_000_000_000
RECENT_INTERVALS = 64
MAX_STEPS = 1000

TIMED, NO_TIME_YET, BACKWARDS, NO_DATE = range(4)
"""Verdicts on epochs."""

REASONS: Mapping[int, str] = {
    NO_TIME_YET: "no valid time yet",
    BACKWARDS: "the recorder's clock runs backwards",
    NO_DATE: "time without a date",
}
"""Why epochs are rejected, by verdict."""

_FIRST_EPOCHS = 1000
"""Epochs from the start of the log that decide whether the recorder's clock is the recording's."""

_NEARLY_ALL = 0.9
_MAX_WAITING = 100_000
"""Epochs that wait for a date at most, where dates are carried backward."""

Verdicts = NDArray[np.uint8]

Decided = dict[int, tuple[Times, Verdicts]]
"""By protocol, times and verdicts of its next epochs."""


@dataclass(frozen=True, slots=True)
class FollowingRules:
    """How a clock is followed.

    Attributes:
        gap_ns: a step forward of this or more is not followed.
        by_recorder: the clock is the recorder's, whose pauses are followed however long they are,
            and whose steps backward make rejects, unless ``append``.
        append: steps backward of the recorder's clock go on at the nominal interval.
    """

    gap_ns: int
    by_recorder: bool
    append: bool


@dataclass(slots=True)
class ClockSteps:
    """Steps of the clock that were not followed: their number, and the first thousand."""

    count: int = 0
    listed: list[dict[str, int]] = field(default_factory=list)

    def note(self, offset: int, from_ns: int, to_ns: int) -> None:
        self.count += 1
        if len(self.listed) < MAX_STEPS:
            self.listed.append({"offset": offset, "from_ns": from_ns, "to_ns": to_ns})


@dataclass(slots=True)
class _Track:
    """How far one protocol's epochs have come.

    Attributes:
        clock_ns: last reading of the clock that was followed.
        time_ns: last time given.
        lead_ns: time minus clock.
        intervals: recent ones between epochs, in ns.
    """

    clock_ns: int = ABSENT_NS
    time_ns: int = ABSENT_NS
    lead_ns: int = 0
    intervals: deque[int] = field(default_factory=lambda: deque(maxlen=RECENT_INTERVALS))

    def interval_ns(self) -> int:
        """Median of the recent intervals."""
        return int(median(self.intervals)) if self.intervals else DEFAULT_INTERVAL_NS

    def advance_to(self, clock_ns: int, time_ns: int) -> None:
        if self.time_ns != ABSENT_NS and time_ns > self.time_ns:
            self.intervals.append(time_ns - self.time_ns)
        self.clock_ns, self.time_ns = clock_ns, time_ns


class ClockFollower:
    """Gives epochs their times, in the order of the log.

    The axis starts at the first time and follows the clock as long as that goes forward by less
    than a gap; equal times stay equal, for the log resolves no finer. A clock that steps backward
    or by a gap, and an epoch without a time, go on by the median of the recent intervals between
    epochs; so does an epoch whose clock leaps while the next one's is back where it was, which
    changes nothing for those behind it. Each protocol is followed on its own; one whose clock steps
    goes where the other went, if that went there before.

    This is more than :class:`~spoofbench_converters.append_clock.ClockAppender` does for rows of
    one recorder's clock: here clocks also leap ahead, or tell nothing, any step backward counts,
    and two protocols share an axis.
    """

    def __init__(self, rules: FollowingRules) -> None:
        self._rules = rules
        self._tracks: defaultdict[int, _Track] = defaultdict(_Track)
        self.steps = ClockSteps()

    def times(
        self, protocol: Ints, offset: Ints, clock_ns: Ints, count: int
    ) -> tuple[Ints, Verdicts]:
        """Return times and verdicts of the first ``count`` epochs given, int64 and uint8
        ``(count,)``; those behind them are only looked at.

        Args:
            protocol, offset, clock_ns: int64 ``(n,)``, of epochs in file order; ``ABSENT_NS`` for
                no time.
        """
        times, verdicts = np.full(count, ABSENT_NS), np.zeros(count, np.uint8)
        by_protocol = {
            number: np.flatnonzero(protocol == number) for number in np.unique(protocol).tolist()
        }
        done = dict.fromkeys(by_protocol, 0)
        events = self._irregular(by_protocol, clock_ns, count)
        while events:
            here, number, index = heappop(events)
            if index < done[number]:
                continue
            own = by_protocol[number]
            self._run(number, own[done[number] : index], clock_ns, times)
            ahead = own[index + 1 : index + 1 + AHEAD]
            ahead = ahead[offset[ahead] - offset[here] <= HORIZON]
            times[here], verdicts[here] = self._step(
                number, int(offset[here]), int(clock_ns[here]), clock_ns[ahead].tolist()
            )
            done[number] = index + 1
            if verdicts[here] == BACKWARDS and index + 1 < own.size and own[index + 1] < count:
                heappush(events, (int(own[index + 1]), number, index + 1))
        for number, own in by_protocol.items():
            self._run(number, own[done[number] : int(np.searchsorted(own, count))], clock_ns, times)
        return times, verdicts

    def _irregular(
        self, by_protocol: dict[int, Ints], clock_ns: Ints, count: int
    ) -> list[tuple[int, int, int]]:
        """Return, as a heap, the epochs that do not just follow the one before: index among all,
        protocol, index among its own.
        """
        found: list[tuple[int, int, int]] = []
        for number, own in by_protocol.items():
            clock = clock_ns[own[: np.searchsorted(own, count)]]
            before = np.append(self._tracks[number].clock_ns, clock[:-1])
            steps = clock - before
            regular = (
                (clock != ABSENT_NS)
                & (before != ABSENT_NS)
                & (steps >= 0)
                & (steps < self._rules.gap_ns)
            )
            found += [
                (int(own[index]), number, index) for index in np.flatnonzero(~regular).tolist()
            ]
        return sorted(found)

    def _run(self, number: int, rows: Ints, clock_ns: Ints, times: Ints) -> None:
        """Let epochs follow their clock."""
        if not rows.size:
            return
        track = self._tracks[number]
        given = np.maximum(clock_ns[rows] + track.lead_ns, track.time_ns)
        times[rows] = given
        steps = np.diff(
            given[-RECENT_INTERVALS - 1 :],
            prepend=[track.time_ns] if rows.size <= RECENT_INTERVALS else [],
        )
        track.intervals.extend(steps[steps > 0].tolist())
        track.clock_ns, track.time_ns = int(clock_ns[rows[-1]]), int(given[-1])

    def _step(self, number: int, offset: int, clock: int, ahead: list[int]) -> tuple[int, int]:
        """Return time and verdict of one epoch that does not just follow the one before."""
        track, rules = self._tracks[number], self._rules
        if track.time_ns == ABSENT_NS:
            return self._start(number, clock, ahead)
        nominal = track.time_ns + track.interval_ns()
        if clock == ABSENT_NS:
            track.advance_to(track.clock_ns, nominal)
            return nominal, TIMED
        step = clock - track.clock_ns
        if 0 <= step < rules.gap_ns:
            track.advance_to(clock, max(clock + track.lead_ns, track.time_ns))
            return track.time_ns, TIMED
        if rules.by_recorder and step < 0 and not rules.append:
            return ABSENT_NS, BACKWARDS
        if ahead and ahead[0] != ABSENT_NS and 0 <= ahead[0] - track.clock_ns < rules.gap_ns:
            self.steps.note(offset, track.clock_ns, clock)
            track.time_ns = max(min(nominal, ahead[0] + track.lead_ns), track.time_ns)
            return track.time_ns, TIMED
        if rules.by_recorder and step > 0:
            track.clock_ns, track.time_ns = clock, clock + track.lead_ns
            return track.time_ns, TIMED
        lead = self._lead_of_another(number, clock)
        if lead is None:
            self.steps.note(offset, track.clock_ns, clock)
            lead = nominal - clock
        track.lead_ns = lead
        track.advance_to(clock, clock + lead)
        return track.time_ns, TIMED

    def _start(self, number: int, clock: int, ahead: list[int]) -> tuple[int, int]:
        """Start to follow a protocol, unless its first time is a lone one."""
        if clock == ABSENT_NS:
            return ABSENT_NS, NO_TIME_YET
        known = [time for time in ahead if time != ABSENT_NS]
        follows = [
            0 <= later - earlier < self._rules.gap_ns
            for earlier, later in pairwise([clock, *known])
        ]
        if len(follows) == AHEAD and not follows[0] and follows[1] and not self._rules.by_recorder:
            return ABSENT_NS, NO_TIME_YET
        track = self._tracks[number]
        track.lead_ns = self._lead_of_another(number, clock) or 0
        track.advance_to(clock, clock + track.lead_ns)
        return track.time_ns, TIMED

    def _lead_of_another(self, number: int, clock: int) -> int | None:
        """Return by how much the axis leads the clock of another protocol, if that fits a clock
        that starts or steps.
        """
        own = self._tracks[number]
        for other, track in self._tracks.items():
            if other != number and track.time_ns != ABSENT_NS:
                earliest = (
                    own.time_ns if own.time_ns != ABSENT_NS else track.time_ns - self._rules.gap_ns
                )
                if (
                    earliest
                    <= clock + track.lead_ns
                    < max(earliest, track.time_ns) + self._rules.gap_ns
                ):
                    return track.lead_ns
        return None


class TimeAxis:
    """Completes and follows what epochs claim: see :class:`DateCompleter`, :class:`ClockFollower`.

    Where at least nine of ten of the first thousand epochs have a receive time, the recorder's
    clock is the recording's; else what the receiver claims is.
    """

    def __init__(self, options: SerialOptions, protocols: tuple[str, ...]) -> None:
        self._options = options
        self._dates = DateCompleter(options.date_ns(), options.date_backward, options.week_rollover)
        self._interleaving = InterleavingCheck(protocols)
        self._follower: ClockFollower | None = None
        self._new: Columns = {}
        self._dated: Columns = {}
        self._by_recorder = False

    @property
    def dateless(self) -> int:
        """How many times could not be completed."""
        return self._dates.dateless

    def push(self, protocol: int, epochs: Epochs) -> None:
        """Take a protocol's next epochs."""
        columns = {
            name: getattr(epochs, name)
            for name in ("offset", "claimed_ns", "period_ns", "receive_time_ns")
        }
        self._new = join(self._new, {"protocol": np.full(epochs.offset.size, protocol), **columns})

    def advance(self, limit: int, last: bool) -> Decided:
        """Return what is decided, now that all epochs are known that start before an offset in the
        log.

        Raises:
            ConversionError: two receivers are interleaved.
        """
        self._date(limit, last)
        if not self._dated or (
            self._follower is None and self._dated["offset"].size < _FIRST_EPOCHS and not last
        ):
            return {}
        dated = self._dated
        if self._follower is None:
            self._follower = self._begin(take(dated, slice(0, _FIRST_EPOCHS)))
        count = dated["offset"].size if last else self._decidable(limit)
        clock_ns = dated["receive_time_ns"] if self._by_recorder else dated["time_ns"]
        times, verdicts = self._follower.times(dated["protocol"], dated["offset"], clock_ns, count)
        decided = take(dated, slice(0, count))
        verdicts[
            (verdicts == NO_TIME_YET)
            & (decided["claimed_ns"] != ABSENT_NS)
            & (decided["time_ns"] == ABSENT_NS)
        ] = NO_DATE
        self._dated = take(dated, slice(count, None))
        if last:
            self._interleaving.finish()
        by_protocol = {
            number: decided["protocol"] == number
            for number in np.unique(decided["protocol"]).tolist()
        }
        return {number: (times[rows], verdicts[rows]) for number, rows in by_protocol.items()}

    def about(self) -> dict[str, str]:
        """Return what the recording's metadata say of its clock."""
        steps = self._follower.steps if self._follower else None
        options, about = self._options, {"clock": "recorder" if self._by_recorder else "gnss"}
        if steps and steps.count:
            about |= {"clock_step_count": str(steps.count), "clock_steps": json.dumps(steps.listed)}
        if self._dates.used_date and options.date:
            about["reference_date"] = options.date
        if options.week_rollover:
            about["week_rollover"] = str(options.week_rollover)
        return about

    def _date(self, limit: int, last: bool) -> None:
        """Complete the times of the epochs that start before an offset, in file order."""
        if not self._new:
            return
        new = take(self._new, np.argsort(self._new["offset"], kind="stable"))
        ready = new["offset"].size if last else int(np.searchsorted(new["offset"], limit))
        claims = ClaimedTimes(
            *(new[name][:ready] for name in ("protocol", "claimed_ns", "period_ns"))
        )
        if (
            self._options.date_backward
            and not last
            and ready < _MAX_WAITING
            and not self._dates.has_anchor(claims)
        ):
            self._new = new
            return
        times = self._dates.complete(claims)
        self._interleaving.check(claims.protocol, times)
        self._dated = join(self._dated, {**take(new, slice(0, ready)), "time_ns": times})
        self._new = take(new, slice(ready, None))

    def _begin(self, first: Columns) -> ClockFollower:
        self._by_recorder = bool(np.mean(first["receive_time_ns"] != ABSENT_NS) >= _NEARLY_ALL)
        gap_ns = round(self._options.gap_s * 1e9)
        return ClockFollower(FollowingRules(gap_ns, self._by_recorder, self._options.append_clock))

    def _decidable(self, limit: int) -> int:
        """Return how many epochs have those behind them that decide on their times, or stand far
        enough back.
        """
        protocol, offset = self._dated["protocol"], self._dated["offset"]
        near = np.flatnonzero(offset >= limit - HORIZON)
        waiting = [
            near[protocol[near] == number][-AHEAD:][:1] for number in np.unique(protocol).tolist()
        ]
        return int(min((int(rows[0]) for rows in waiting if rows.size), default=offset.size))
