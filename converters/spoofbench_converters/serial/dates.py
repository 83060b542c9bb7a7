"""Claimed times: completed by dates, and refused where two receivers are interleaved."""

from dataclasses import dataclass, field

import numpy as np

from spoofbench.arrays import Ints, forward_fill
from spoofbench.errors import ConversionError
from spoofbench.gnss_time import DAY_NS, ROLLOVER_NS, wrap_difference
from spoofbench_converters.serial.contract import ABSENT_NS

_NO_PERIOD_NS = 2**62
_WINDOW_EPOCHS, _TOO_MANY_BACK = 100, 20
_INTERLEAVED = (
    "two receivers seem to be interleaved in this log: of {count} {protocol} epochs in a row, "
    "{back} go back in time; separate them first, or name one with --source"
)


@dataclass(frozen=True, slots=True, eq=False)
class ClaimedTimes:
    """What epochs claim, in file order.

    Attributes:
        protocol: int64 ``(n,)``, its number.
        claimed_ns, period_ns: int64 ``(n,)``, as in ``Epochs``.
    """

    protocol: Ints
    claimed_ns: Ints
    period_ns: Ints


@dataclass(frozen=True, slots=True)
class _LastTime:
    """A protocol's last time: complete, and as it was known, with its period."""

    time_ns: int
    known_ns: int
    period_ns: int


@dataclass(slots=True)
class DateCompleter:
    """Completes times of day and of week.

    A time is completed to the value nearest to the last one of its protocol; the first one to the
    value nearest to the last complete one of any protocol, else to that on the reference date. So
    dates are carried forward, across midnight and the end of the week, and follow a clock that
    jumps.

    Attributes:
        date_ns: start of the reference date, None without one.
        backward: dates are carried backward too, from the first complete time.
        rollovers: periods of 1024 weeks that complete times lack.
        dateless: how many times could not be completed.
        used_date: whether the reference date was used.
    """

    date_ns: int | None
    backward: bool
    rollovers: int
    dateless: int = 0
    used_date: bool = False
    _last: dict[int, _LastTime] = field(default_factory=dict)
    _complete: int | None = None

    def complete(self, claims: ClaimedTimes) -> Ints:
        """Return the complete times of the next epochs, int64 ``(n,)``, ``ABSENT_NS`` where there
        is none.
        """
        whole = np.where(
            (claims.period_ns == 0) & (claims.claimed_ns != ABSENT_NS),
            claims.claimed_ns + self.rollovers * ROLLOVER_NS,
            ABSENT_NS,
        )
        before = ABSENT_NS if self._complete is None else self._complete
        carried = forward_fill(whole, whole != ABSENT_NS, before)
        times = whole.copy()
        for protocol in np.unique(claims.protocol).tolist():
            rows = np.flatnonzero((claims.protocol == protocol) & (claims.claimed_ns != ABSENT_NS))
            if rows.size:
                times[rows] = self._of_protocol(
                    protocol,
                    claims.claimed_ns[rows],
                    claims.period_ns[rows],
                    (whole[rows], carried[rows]),
                )
        if carried.size and carried[-1] != ABSENT_NS:
            self._complete = int(carried[-1])
        return times

    def has_anchor(self, claims: ClaimedTimes) -> bool:
        """Whether any of these epochs, or one before them, has a date."""
        return (
            bool(self._last)
            or self.date_ns is not None
            or bool(np.any((claims.period_ns == 0) & (claims.claimed_ns != ABSENT_NS)))
        )

    def _of_protocol(
        self, protocol: int, claimed: Ints, period: Ints, dated: tuple[Ints, Ints]
    ) -> Ints:
        """Complete one protocol's times, of which none is absent."""
        whole, carried = dated
        last = self._last.get(protocol)
        known = np.where(period == 0, whole, claimed)
        before = np.append(known[0] if last is None else last.known_ns, known[:-1])
        period_before = np.append(0 if last is None else last.period_ns, period[:-1])
        steps = wrap_difference(known - before, _common_period(period, period_before))
        elapsed = np.cumsum(steps)
        anchors = np.where(period == 0, whole - elapsed, ABSENT_NS)
        if last is not None and period[0] != 0:
            anchors[0] = last.time_ns
        elif last is None:
            self._anchor(claimed, period, carried, (anchors, elapsed))
        anchors = forward_fill(anchors, anchors != ABSENT_NS, ABSENT_NS)
        if self.backward and (anchors != ABSENT_NS).any():
            anchors = np.where(
                anchors == ABSENT_NS, anchors[np.argmax(anchors != ABSENT_NS)], anchors
            )
        times = np.where(anchors == ABSENT_NS, ABSENT_NS, anchors + elapsed)
        self.dateless += int(np.count_nonzero(times == ABSENT_NS))
        if times[-1] != ABSENT_NS:
            self._last[protocol] = _LastTime(int(times[-1]), int(known[-1]), int(period[-1]))
        return np.asarray(times)

    def _anchor(self, claimed: Ints, period: Ints, carried: Ints, found: tuple[Ints, Ints]) -> None:
        """Date the first time that another protocol, or the reference date, dates, if none of its
        own is before.
        """
        anchors, elapsed = found
        can = (period == 0) | (carried != ABSENT_NS) | (self.date_ns is not None)
        first = int(np.argmax(can))
        if not can[first] or period[first] == 0:
            return
        if carried[first] != ABSENT_NS:
            near = carried[first] + wrap_difference(claimed[first] - carried[first], period[first])
        else:
            near = _on_date(int(claimed[first]), int(period[first]), self.date_ns or 0)
            self.used_date = True
        anchors[first] = near - elapsed[first]


def _common_period(period: Ints, before: Ints) -> Ints:
    """Return the period in which two times can be compared: the shorter one, or one beyond all
    times where both are complete.
    """
    shorter = np.minimum(
        np.where(period == 0, _NO_PERIOD_NS, period), np.where(before == 0, _NO_PERIOD_NS, before)
    )
    return np.asarray(shorter, np.int64)


def _on_date(claimed_ns: int, period_ns: int, date_ns: int) -> int:
    """Return the time on a date; one of week that is on none of its hours, that nearest to its
    noon.
    """
    first = date_ns + DAY_NS // 2 - period_ns // 2
    return first + (claimed_ns - first) % period_ns


class InterleavingCheck:
    """Refuses logs whose claimed times go back again and again, as those of two receivers do that
    are merged without order.
    """

    def __init__(self, names: tuple[str, ...]) -> None:
        self._names = names
        self._last: dict[int, int] = {}
        self._open_windows: dict[int, tuple[int, int]] = {}

    def check(self, protocol: Ints, claimed_ns: Ints) -> None:
        """Take the next epochs' complete times, int64 ``(n,)``.

        Raises:
            ConversionError: of a hundred epochs in a row, twenty or more go back.
        """
        for number in np.unique(protocol).tolist():
            claimed = claimed_ns[(protocol == number) & (claimed_ns != ABSENT_NS)]
            if not claimed.size:
                continue
            back = np.diff(claimed, prepend=self._last.get(number, claimed[0])) < 0
            self._last[number] = int(claimed[-1])
            seen, behind = self._open_windows.get(number, (0, 0))
            window = (np.arange(back.size) + seen) // _WINDOW_EPOCHS
            counts = np.bincount(window, back)
            counts[0] += behind
            for count in counts[counts >= _TOO_MANY_BACK][:1].tolist():
                raise ConversionError(
                    _INTERLEAVED.format(
                        count=_WINDOW_EPOCHS, protocol=self._names[number], back=int(count)
                    )
                )
            self._open_windows[number] = (
                (seen + back.size) % _WINDOW_EPOCHS,
                int(counts[-1]) if (seen + back.size) % _WINDOW_EPOCHS else 0,
            )

    def finish(self) -> None:
        """Check what is left, by the same share.

        Raises:
            ConversionError: a fifth of the last epochs, and five or more, go back.
        """
        for number, (seen, back) in self._open_windows.items():
            if back >= 5 and back * _WINDOW_EPOCHS >= seen * _TOO_MANY_BACK:
                raise ConversionError(
                    _INTERLEAVED.format(count=seen, protocol=self._names[number], back=back)
                )
