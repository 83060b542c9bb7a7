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

from spoofbench.arrays import Ints, Octets
from spoofbench.conversion import Columns
from spoofbench.conversion.rows import join, take
from spoofbench.errors import ConversionError
from spoofbench_converters.serial.contract import ABSENT_NS, Epochs, SerialOptions
from spoofbench_converters.serial.dates import ClaimedTimes, DateCompleter

AHEAD = 2
"""How many epochs of its own protocol behind an epoch decide on its time."""

HORIZON = 2**20
"""How far apart in a log epochs may stand that decide on one another, in bytes."""

DEFAULT_INTERVAL_NS = 1_000_000_000
RECENT_INTERVALS = 64
MAX_STEPS = 1000

TIMED, NO_TIME_YET, BACKWARDS = range(3)

_CHECKED, _TOO_MANY_BACK = 100, 20
_INTERLEAVED = (
    "two receivers seem to be interleaved in this log: of {judged} {protocol} epochs in a row, "
    "{back} go back in time; "
    "separate them first, or name one with --source"
)


@dataclass(frozen=True, slots=True)
class FollowingRules:
    """How an axis follows its clock.

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
    """Steps of the clock that the axis did not follow: their number, and the first thousand."""

    count: int = 0
    listed: list[dict[str, int]] = field(default_factory=list)

    def note(self, offset: int, from_ns: int, to_ns: int) -> None:
        self.count += 1
        if len(self.listed) < MAX_STEPS:
            self.listed.append({"offset": offset, "from_ns": from_ns, "to_ns": to_ns})


@dataclass(slots=True)
class _Track:
    """How far one protocol's epochs have come: last followed clock, last time given, axis minus
    clock, recent intervals.
    """

    clock_ns: int = ABSENT_NS
    time_ns: int = ABSENT_NS
    lead_ns: int = 0
    intervals: deque[int] = field(default_factory=lambda: deque(maxlen=RECENT_INTERVALS))

    def interval_ns(self) -> int:
        """Median of the recent intervals."""
        return int(median(self.intervals)) if self.intervals else DEFAULT_INTERVAL_NS

    def go(self, clock_ns: int, time_ns: int) -> None:
        if self.time_ns != ABSENT_NS and time_ns > self.time_ns:
            self.intervals.append(time_ns - self.time_ns)
        self.clock_ns, self.time_ns = clock_ns, time_ns


class ClockFollower:
    """Gives epochs their times, in the order of the log.

    The axis starts at the first time and follows the clock as long as that goes forward by less
    than a gap; equal times stay equal, for the log resolves no finer. A clock that steps backward
    or by a gap, and an epoch without a time, go on by the median of the recent intervals between
    epochs; so does an epoch whose clock leaps while the next one's is back on course, which changes
    nothing for those behind it. Protocols have courses of their own; one whose clock steps goes
    where the other went, if that went there before.
    """

    def __init__(self, rules: FollowingRules) -> None:
        self._rules = rules
        self._tracks: defaultdict[int, _Track] = defaultdict(_Track)
        self.steps = ClockSteps()

    def times(
        self, protocol: Ints, offset: Ints, clock_ns: Ints, count: int
    ) -> tuple[Ints, Octets]:
        """Return times and verdicts of the first ``count`` epochs given; those behind them are
        looked at alone.

        Args:
            protocol, offset, clock_ns: int64 ``(n,)``, of epochs in file order; ``ABSENT_NS`` for
                no time.
        """
        times, verdicts = np.full(count, ABSENT_NS), np.zeros(count, np.uint8)
        mine = {
            number: np.flatnonzero(protocol == number) for number in np.unique(protocol).tolist()
        }
        done = dict.fromkeys(mine, 0)
        events = self._irregular(mine, clock_ns, count)
        while events:
            here, number, place = heappop(events)
            if place < done[number]:
                continue
            own = mine[number]
            self._run(number, own[done[number] : place], clock_ns, times)
            ahead = own[place + 1 : place + 1 + AHEAD]
            ahead = ahead[offset[ahead] - offset[here] <= HORIZON]
            times[here], verdicts[here] = self._step(
                number, int(offset[here]), int(clock_ns[here]), clock_ns[ahead].tolist()
            )
            done[number] = place + 1
            if verdicts[here] == BACKWARDS and place + 1 < own.size and own[place + 1] < count:
                heappush(events, (int(own[place + 1]), number, place + 1))
        for number, own in mine.items():
            self._run(number, own[done[number] : int(np.searchsorted(own, count))], clock_ns, times)
        return times, verdicts

    def _irregular(
        self, mine: dict[int, Ints], clock_ns: Ints, count: int
    ) -> list[tuple[int, int, int]]:
        """Return place, protocol and place among its epochs of those that do not just follow the
        one before, as a heap.
        """
        found: list[tuple[int, int, int]] = []
        for number, own in mine.items():
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
                (int(own[place]), number, place) for place in np.flatnonzero(~regular).tolist()
            ]
        return sorted(found)

    def _run(self, number: int, places: Ints, clock_ns: Ints, times: Ints) -> None:
        """Let epochs follow their clock."""
        if not places.size:
            return
        track = self._tracks[number]
        given = np.maximum(clock_ns[places] + track.lead_ns, track.time_ns)
        times[places] = given
        steps = np.diff(
            given[-RECENT_INTERVALS - 1 :],
            prepend=[track.time_ns] if places.size <= RECENT_INTERVALS else [],
        )
        track.intervals.extend(steps[steps > 0].tolist())
        track.clock_ns, track.time_ns = int(clock_ns[places[-1]]), int(given[-1])

    def _step(self, number: int, offset: int, clock: int, ahead: list[int]) -> tuple[int, int]:
        """Give one epoch its time and verdict that does not just follow the one before."""
        track, rules = self._tracks[number], self._rules
        if track.time_ns == ABSENT_NS:
            return self._start(number, clock, ahead)
        nominal = track.time_ns + track.interval_ns()
        if clock == ABSENT_NS:
            track.go(track.clock_ns, nominal)
            return nominal, TIMED
        step = clock - track.clock_ns
        if 0 <= step < rules.gap_ns:
            track.go(clock, max(clock + track.lead_ns, track.time_ns))
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
        track.go(clock, clock + lead)
        return track.time_ns, TIMED

    def _start(self, number: int, clock: int, ahead: list[int]) -> tuple[int, int]:
        """Start a protocol's course, unless its first time is a lone one."""
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
        track.go(clock, clock + track.lead_ns)
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


class InterleavingCheck:
    """Refuses logs whose claimed times go back again and again, as those of two receivers do that
    are merged without order.
    """

    def __init__(self, names: tuple[str, ...]) -> None:
        self._names = names
        self._last: dict[int, int] = {}
        self._seen: dict[int, tuple[int, int]] = {}

    def look(self, protocol: Ints, claimed_ns: Ints) -> None:
        """Look at the next epochs' complete times.

        Raises:
            ConversionError: of a hundred epochs in a row, twenty or more go back.
        """
        for number in np.unique(protocol).tolist():
            claimed = claimed_ns[(protocol == number) & (claimed_ns != ABSENT_NS)]
            if not claimed.size:
                continue
            back = np.diff(claimed, prepend=self._last.get(number, claimed[0])) < 0
            self._last[number] = int(claimed[-1])
            judged, behind = self._seen.get(number, (0, 0))
            window = (np.arange(back.size) + judged) // _CHECKED
            counts = np.bincount(window, back)
            counts[0] += behind
            for count in counts[counts >= _TOO_MANY_BACK][:1].tolist():
                raise ConversionError(
                    _INTERLEAVED.format(
                        judged=_CHECKED, protocol=self._names[number], back=int(count)
                    )
                )
            self._seen[number] = (
                (judged + back.size) % _CHECKED,
                int(counts[-1]) if (judged + back.size) % _CHECKED else 0,
            )

    def finish(self) -> None:
        """Judge what is left, by the same share.

        Raises:
            ConversionError: a fifth of the last epochs, and five or more, go back.
        """
        for number, (judged, back) in self._seen.items():
            if back >= 5 and back * _CHECKED >= judged * _TOO_MANY_BACK:
                raise ConversionError(
                    _INTERLEAVED.format(judged=judged, protocol=self._names[number], back=back)
                )


NO_DATE = BACKWARDS + 1
REASONS: Mapping[int, str] = {
    NO_TIME_YET: "no valid time yet",
    BACKWARDS: "the recorder's clock runs backwards",
    NO_DATE: "time without a date",
}

_JUDGED = 1000
"""Epochs from the start of the log that decide whether the recorder's clock is the recording's."""

_NEARLY_ALL = 0.9
_HELD = 100_000
"""Epochs that wait for a date at most, where dates are carried backward."""

Given = dict[int, tuple[Ints, Octets]]
"""By protocol, times and verdicts of its next epochs."""


class TimeAxis:
    """Completes and follows what epochs claim; see :class:`DateCompleter` and :class:`ClockFollower`.

    Where at least nine of ten of the first thousand epochs have a receive time, the recorder's
    clock is the recording's; else what the receiver claims is.
    """

    def __init__(self, options: SerialOptions, protocols: tuple[str, ...]) -> None:
        self._options = options
        self._calendar = DateCompleter(
            options.date_ns(), options.date_backward, options.week_rollover
        )
        self._interleaving = InterleavingCheck(protocols)
        self._course: ClockFollower | None = None
        self._new: Columns = {}
        self._dated: Columns = {}
        self._by_recorder = False

    @property
    def dateless(self) -> int:
        """How many times could not be completed."""
        return self._calendar.dateless

    def push(self, protocol: int, epochs: Epochs) -> None:
        """Take a protocol's next epochs."""
        columns = {
            name: getattr(epochs, name)
            for name in ("offset", "claimed_ns", "period_ns", "receive_time_ns")
        }
        self._new = join(self._new, {"protocol": np.full(epochs.offset.size, protocol), **columns})

    def advance(self, limit: int, last: bool) -> Given:
        """Return what is decided, now that all epochs are known that start before an offset in the
        log.

        Raises:
            ConversionError: two receivers are interleaved.
        """
        self._date(limit, last)
        if not self._dated or (
            self._course is None and self._dated["offset"].size < _JUDGED and not last
        ):
            return {}
        dated = self._dated
        if self._course is None:
            self._course = self._begin(take(dated, slice(0, _JUDGED)))
        count = dated["offset"].size if last else self._decidable(limit)
        clock_ns = dated["receive_time_ns"] if self._by_recorder else dated["time_ns"]
        times, verdicts = self._course.times(dated["protocol"], dated["offset"], clock_ns, count)
        decided = take(dated, slice(0, count))
        verdicts[
            (verdicts == NO_TIME_YET)
            & (decided["claimed_ns"] != ABSENT_NS)
            & (decided["time_ns"] == ABSENT_NS)
        ] = NO_DATE
        self._dated = take(dated, slice(count, None))
        if last:
            self._interleaving.finish()
        mine = {
            number: decided["protocol"] == number
            for number in np.unique(decided["protocol"]).tolist()
        }
        return {number: (times[rows], verdicts[rows]) for number, rows in mine.items()}

    def about(self) -> dict[str, str]:
        """Return what the recording's metadata say of its clock."""
        steps = self._course.steps if self._course else None
        options, told = self._options, {"clock": "recorder" if self._by_recorder else "gnss"}
        if steps and steps.count:
            told |= {"clock_step_count": str(steps.count), "clock_steps": json.dumps(steps.listed)}
        if self._calendar.used_date and options.date:
            told["reference_date"] = options.date
        if options.week_rollover:
            told["week_rollover"] = str(options.week_rollover)
        return told

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
            and ready < _HELD
            and not self._calendar.has_anchor(claims)
        ):
            self._new = new
            return
        times = self._calendar.complete(claims)
        self._interleaving.look(claims.protocol, times)
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
        return int(min((int(places[0]) for places in waiting if places.size), default=offset.size))
