"""What time each epoch claims."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spoofbench.arrays import Bools, Floats, Ints, forward_fill
from spoofbench.gnss_time import (
    DAY_NS,
    LEAP_SECONDS,
    WEEK_NS,
    calendar_to_utc,
    gps_of_week,
    gps_to_utc,
    leap_seconds_at_gps,
    nearest_week,
    utc_to_gps,
)
from spoofbench_converters.serial.contract import ABSENT_NS
from spoofbench_converters.ubx.batch import EpochBatch, MessageFrames
from spoofbench_converters.ubx.frames import ROLES
from spoofbench_converters.ubx.messages import Role

MS_NS = 1_000_000
_ALL = 7  # date and time valid, and fully resolved
_WEEK_MS = WEEK_NS // MS_NS


@dataclass(frozen=True, slots=True, eq=False)
class EpochTimes:
    """What ``m`` epochs claim.

    Attributes:
        claimed_ns, period_ns: int64 ``(m,)``, as in ``Epochs``.
        week, tow_s: float64 ``(m,)``, GPS week and time of week, NaN where not reported; the week
            that UTC and time of week imply, where no message has it.
        time_valid: float64 ``(m,)``, whether the receiver says that its time is valid; NaN where it
            does not say.
        time_ms: int64 ``(m,)``, time of week of the navigation epoch, -1 where none.
    """

    claimed_ns: Ints
    period_ns: Ints
    week: Floats
    tow_s: Floats
    time_valid: Floats
    time_ms: Ints


class EpochTimeReader:
    """Reads epochs' times; remembers the last leap seconds reported."""

    def __init__(self) -> None:
        self.leap_s: int | None = None

    def read(self, batch: EpochBatch) -> EpochTimes:
        """Return the claims of a batch.

        UTC where it is valid and fully resolved; else week and time of week, less the leap seconds
        last reported by the receiver or else announced by then; else time of week, or time of day.
        None where messages say that it is not valid.
        """
        return _TimeReading(batch, self).claims()


class _TimeReading:
    def __init__(self, batch: EpochBatch, reader: EpochTimeReader) -> None:
        count = batch.count
        self.batch, self.reader = batch, reader
        self.time_ms = _times(batch)
        self.tow_ns = np.where(
            (self.time_ms >= 0) & (self.time_ms < _WEEK_MS), self.time_ms * MS_NS, ABSENT_NS
        )
        self.utc = np.full(count, ABSENT_NS)
        self.unresolved = np.full(count, ABSENT_NS)
        self.day = np.full(count, ABSENT_NS)
        self.week = np.full(count, -1)
        self.leap = np.full(count, -1)
        self.valid = np.full(count, np.nan)
        self.tow_trust = np.full(count, np.nan)

    def claims(self) -> EpochTimes:
        for system in ("NAV", "NAV2"):
            for name in ("PVT", "PVAT"):
                self._calendar(self.batch.one_of(f"{system}-{name}"))
            self._week(self.batch.one_of(f"{system}-TIMEGPS"), 1, 2)
            self._leaps(self.batch.one_of(f"{system}-TIMELS"), "currLs", "valid", 1)
            self._timeutc(self.batch.one_of(f"{system}-TIMEUTC"))
            status = self.batch.one_of(f"{system}-STATUS")
            self._note(status.epoch, status.head["flags"] & 8 > 0, None)
        self._week(self.batch.one_of("NAV-SOL"), 8, 4)
        self._raw()
        self._high_rate()
        return self._decided()

    def _calendar(self, frames: MessageFrames) -> None:
        flags, time = frames.head["valid"], utc_ns(frames.head)
        time[flags & 2 == 0] = ABSENT_NS
        self._fill(self.utc, frames.epoch, np.where(flags & _ALL == _ALL, time, ABSENT_NS))
        self._fill(self.unresolved, frames.epoch, np.where(flags & 3 == 3, time, ABSENT_NS))
        self._fill(self.day, frames.epoch, np.where(time == ABSENT_NS, ABSENT_NS, time % DAY_NS))
        self._note(frames.epoch, flags & 2 > 0, flags & _ALL == _ALL)

    def _timeutc(self, frames: MessageFrames) -> None:
        flags, time = frames.head["valid"], utc_ns(frames.head)
        self._fill(self.utc, frames.epoch, np.where(flags & 4 > 0, time, ABSENT_NS))
        self._note(frames.epoch, flags & 1 > 0, flags & 4 > 0)

    def _week(self, frames: MessageFrames, tow_flag: int, week_flag: int) -> None:
        """Take week and fraction of NAV-TIMEGPS or NAV-SOL."""
        head = frames.head
        flags = head["valid"] if "valid" in (head.dtype.names or ()) else head["flags"]
        tow_valid, week_valid = flags & tow_flag > 0, flags & week_flag > 0
        self._fill(
            self.week, frames.epoch, np.where(week_valid & (head["week"] > 0), head["week"], -1), -1
        )
        exact = self.tow_ns[frames.epoch] + head["fTOW"]
        self.tow_ns[frames.epoch] = np.where(
            tow_valid & (self.tow_ns[frames.epoch] == self.time_ms[frames.epoch] * MS_NS),
            exact,
            self.tow_ns[frames.epoch],
        )
        self._note(frames.epoch, tow_valid, tow_valid & week_valid)
        if "leapS" in (head.dtype.names or ()):
            self._leaps(frames, "leapS", "valid", 4)

    def _leaps(self, frames: MessageFrames, field: str, flags: str, flag: int) -> None:
        reported = frames.head[flags] & flag > 0
        self._fill(self.leap, frames.epoch, np.where(reported, frames.head[field], -1), -1)

    def _raw(self) -> None:
        """Take week and time of week of raw measurements, for epochs without a solution."""
        for name in ("RXM-RAWX", "RXM-RAW"):
            frames = self.batch.one_of(name)
            head, epoch = frames.head, frames.epoch
            turns = np.rint(
                (self.batch.buffer.time_ms[frames.index] - self.time_ms[epoch]) / _WEEK_MS
            ).astype(np.int64)
            self._fill(self.week, epoch, np.where(head["week"] > 0, head["week"] + turns, -1), -1)
            if name == "RXM-RAWX":
                self._leaps(frames, "leapS", "recStat", 1)
                alone = self.time_ms[epoch] == self.batch.buffer.time_ms[frames.index]
                within = alone & (self.time_ms[epoch] >= 0)
                exact = np.rint(np.where(within, head["rcvTow"], 0) * 1e9).astype(np.int64)
                self.tow_ns[epoch] = np.where(
                    within & np.isnan(self.tow_trust[epoch]), exact, self.tow_ns[epoch]
                )

    def _high_rate(self) -> None:
        frames = self.batch.all_of("HNR-PVT")
        epoch, first = np.unique(frames.epoch, return_index=True)
        head, time = frames.head[first], utc_ns(frames.head[first])
        after = (head["iTOW"].astype(np.int64) - self.time_ms[epoch]) * MS_NS
        known = (
            (head["valid"] & 3 == 3)
            & (time != ABSENT_NS)
            & (self.time_ms[epoch] >= 0)
            & (np.abs(after) < DAY_NS)
        )
        self._fill(self.utc, epoch, np.where(known, time - np.where(known, after, 0), ABSENT_NS))

    def _fill(self, what: Ints, epoch: Ints, values: Ints, absent: int = ABSENT_NS) -> None:
        what[epoch] = np.where(what[epoch] == absent, values, what[epoch])

    def _note(self, epoch: Ints, tow: Bools, complete: Bools | None) -> None:
        """Note whether any message says that the time of week is valid, and whether the first says
        that all of the time is.
        """
        self.tow_trust[epoch] = np.fmax(self.tow_trust[epoch], tow)
        if complete is not None:
            self.valid[epoch] = np.where(np.isnan(self.valid[epoch]), complete, self.valid[epoch])

    def _decided(self) -> EpochTimes:
        leap = self._carried_leaps()
        tow = self.tow_ns != ABSENT_NS
        rough = np.where(self.utc != ABSENT_NS, self.utc, self.unresolved)
        implied = nearest_week(
            np.where(tow, utc_to_gps(rough, LEAP_SECONDS), 0), np.where(tow, self.tow_ns, 0)
        )
        week = np.where((self.week < 0) & (rough != ABSENT_NS) & tow, implied, self.week)
        trusted = tow & (np.nan_to_num(self.tow_trust, nan=1.0) > 0)
        gps_ns = np.where(tow, gps_of_week(np.maximum(week, 0), self.tow_ns), 0)
        announced = np.where(week >= 0, leap_seconds_at_gps(gps_ns), LEAP_SECONDS)
        by_week = gps_to_utc(gps_ns, np.where(leap >= 0, leap, announced))
        claimed, period = self.utc.copy(), np.zeros(self.utc.size, np.int64)
        for given, values, length in (
            (trusted & (week >= 0), by_week, 0),
            (self.day != ABSENT_NS, self.day, DAY_NS),
            (trusted, by_week, WEEK_NS),
        ):
            chosen = (claimed == ABSENT_NS) & given
            claimed[chosen], period[chosen] = values[chosen], length
        tow_s = np.where(tow, self.tow_ns / 1e9, np.nan)
        return EpochTimes(
            claimed, period, np.where(week >= 0, week, np.nan), tow_s, self.valid, self.time_ms
        )

    def _carried_leaps(self) -> Ints:
        """Return the leap seconds last reported up to each epoch, -1 where none, and remember the
        last.
        """
        before = -1 if self.reader.leap_s is None else self.reader.leap_s
        carried = forward_fill(self.leap, self.leap >= 0, before)
        if carried.size and carried[-1] >= 0:
            self.reader.leap_s = int(carried[-1])
        return carried


def _times(batch: EpochBatch) -> Ints:
    """Return the time of week of each epoch in ms: of its solution, else of its raw measurement,
    else the second of its high rate.
    """
    times = np.full(batch.count, -1)
    buffer = batch.buffer
    for role in (Role.HIGH_RATE, Role.RAW, Role.NAV):
        rows = np.flatnonzero((ROLES[buffer.number] == role) & (buffer.time_ms >= 0))[::-1]
        reported = buffer.time_ms[rows]
        times[batch.epoch[rows]] = reported // 1000 * 1000 if role == Role.HIGH_RATE else reported
    return times


def utc_ns(fields: NDArray[np.void]) -> Ints:
    """Return Unix nanoseconds, int64 ``(n,)``, of the fields year, month, day, hour, min, sec and
    nano; ``ABSENT_NS`` where they are no date.

    Nanoseconds are signed: seconds are rounded to the nearest one.
    """
    time, exists = calendar_to_utc(
        *(fields[name] for name in ("year", "month", "day", "hour", "min", "sec", "nano"))
    )
    return np.where(exists, time, ABSENT_NS)
