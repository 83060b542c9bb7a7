"""The time axis: epochs of all protocols in file order, each with what it claims, in; their times
out.
"""

import json
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from spoofbench.conversion import Columns
from spoofbench.conversion.rows import join, take
from spoofbench_converters.serial.contract import ABSENT_NS, Epochs
from spoofbench_converters.serial.course import (
    AHEAD,
    BACKWARDS,
    HORIZON,
    NO_TIME_YET,
    Course,
    Interleaving,
    Rules,
)
from spoofbench_converters.serial.dates import Calendar, Claims
from spoofbench_converters.serial.frames import Places
from spoofbench_converters.serial.options import StreamOptions

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

Given = dict[int, tuple[Places, NDArray[np.uint8]]]
"""By protocol, times and verdicts of its next epochs."""


class Axis:
    """Completes and follows what epochs claim; see :class:`Calendar` and :class:`Course`.

    Where at least nine of ten of the first thousand epochs have a receive time, the recorder's
    clock is the recording's; else what the receiver claims is.
    """

    def __init__(self, options: StreamOptions, protocols: tuple[str, ...]) -> None:
        self._options = options
        self._calendar = Calendar(options.date_ns(), options.date_backward, options.week_rollover)
        self._interleaving = Interleaving(protocols)
        self._course: Course | None = None
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
        claims = Claims(*(new[name][:ready] for name in ("protocol", "claimed_ns", "period_ns")))
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

    def _begin(self, first: Columns) -> Course:
        self._by_recorder = bool(np.mean(first["receive_time_ns"] != ABSENT_NS) >= _NEARLY_ALL)
        gap_ns = round(self._options.gap_s * 1e9)
        return Course(Rules(gap_ns, self._by_recorder, self._options.append_clock))

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
