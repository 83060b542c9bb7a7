"""The time axis of an Android log: the phone's elapsed time, laid on Unix time once."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from spoofbench_converters.append_clock import ClockAppender

STEP_NS = 100_000_000
JUMP_NS = (
    10_000_000_000  # sensors that are handed over in batches stand up to this behind each other
)
MAX_STEPS = 1000
PAIRS = 100

Pairs = tuple[NDArray[np.int64], NDArray[np.int64]]
"""Elapsed time and a Unix time of the same rows, int64 ``(n,)`` in nanoseconds."""


Stamps = tuple[NDArray[np.int64], NDArray[np.bool_]]
"""Times of n rows in nanoseconds, int64 ``(n,)``, and which rows have one."""


@dataclass(slots=True)
class ElapsedTimeAxis:
    """Times of rows on the recording's clock.

    Attributes:
        offset_ns: Unix time minus elapsed time since boot; None where the log has no elapsed time.
        basis: which rows said so.
        shift_ns: what is added to a time that the GNSS receiver claims, where a row has no other.
    """

    offset_ns: int | None = None
    basis: str = "no row has elapsed time: times are those that each row claims"
    shift_ns: int = 0
    _appender: ClockAppender = field(default_factory=lambda: ClockAppender(JUMP_NS))

    @classmethod
    def of(cls, sensors: Pairs, fixes: Pairs, raw: Pairs) -> "ElapsedTimeAxis":
        """Lay the axis by the first rows that have both clocks: the sensors', else the fixes', else
        the raw measurements'.
        """
        named = {
            "median of the first sensor rows' utcTimeMillis minus elapsedRealtimeNanos": sensors,
            "median of the first GPS fixes' UnixTimeMillis minus elapsedRealtimeNanos": fixes,
            "median of the first raw measurements' GNSS time minus elapsed time": raw,
        }
        for basis, pairs in named.items():
            offset = _median(pairs[1] - pairs[0])
            if offset is not None:
                claimed = next((p for p in (fixes, raw) if p[0].size), None)
                shift = None if claimed is None else _median(claimed[0] + offset - claimed[1])
                return cls(offset, basis, shift or 0)
        return cls()

    def times(
        self, offsets: NDArray[np.int64], elapsed: Stamps, claimed: Stamps, shift: bool = False
    ) -> Stamps:
        """Return the times of rows, and which have one.

        Args:
            offsets: where the rows lie in the log, int64 ``(n,)``.
            elapsed: time since boot.
            claimed: Unix time, which counts where there is no time since boot.
            shift: whether that is the GNSS receiver's.
        """
        has = elapsed[1] & (elapsed[0] > 0) & (self.offset_ns is not None)
        own = claimed[1] & (claimed[0] > 0)
        times = np.where(
            has, elapsed[0] + (self.offset_ns or 0), claimed[0] + (self.shift_ns if shift else 0)
        )
        return times + self._appender.added_at(offsets), has | own

    def append(self, offsets: NDArray[np.int64], times_ns: NDArray[np.int64]) -> None:
        """Let rows after a jump back of the clock follow those before it.

        Args:
            offsets: where the rows of the next piece that tell the time lie, in the order of the
                log, int64 ``(n,)``.
            times_ns: their times, as :meth:`times` gives them without jumps, int64 ``(n,)``.
        """
        self._appender.push(offsets, times_ns)


def _median(values: NDArray[np.int64]) -> int | None:
    """The median, the lower of two, so that it is one of the values; None of none."""
    return int(np.sort(values)[(values.size - 1) // 2]) if values.size else None


@dataclass(slots=True)
class ClockDeviation:
    """How far the logged clock strays from the axis, and where it steps."""

    low_ns: int | None = None
    high_ns: int | None = None
    count: int = 0
    steps: list[dict[str, int]] = field(default_factory=list)
    _last_ns: int | None = None

    def watch(
        self, offsets: NDArray[np.int64], logged_ns: NDArray[np.int64], axis_ns: NDArray[np.int64]
    ) -> None:
        """Take rows in the order of the file: where they lie, the time they log, and their time on
        the axis; ``(n,)`` each.
        """
        if not offsets.size:
            return
        stray = logged_ns - axis_ns
        self.low_ns = min(int(stray.min()), stray[0] if self.low_ns is None else self.low_ns)
        self.high_ns = max(int(stray.max()), stray[0] if self.high_ns is None else self.high_ns)
        before = np.concatenate(
            [[stray[0] if self._last_ns is None else self._last_ns], stray[:-1]]
        )
        self._last_ns = int(stray[-1])
        rows = np.flatnonzero(np.abs(stray - before) > STEP_NS)
        self.count += rows.size
        for row in rows[: MAX_STEPS - len(self.steps)].tolist():
            logged, step = int(logged_ns[row]), int(stray[row] - before[row])
            self.steps.append(
                {"offset": int(offsets[row]), "from_ns": logged - step, "to_ns": logged}
            )

    def about(self) -> Mapping[str, str]:
        """Return the recording's metadata on it."""
        spread = (
            {}
            if self.low_ns is None or self.high_ns is None
            else {"clock_spread_ns": str(int(self.high_ns - self.low_ns))}
        )
        steps = (
            {"clock_steps": json.dumps(self.steps), "clock_step_count": str(self.count)}
            if self.count
            else {}
        )
        return {**spread, **steps}
