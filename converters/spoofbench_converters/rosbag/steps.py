"""Where the recorder's clock jumps back: noted, and appended if the user asks for it.

A host without network time starts with a wrong clock and sets it later; two recordings in one bag
may overlap. The messages that follow would all be refused as late until the clock is where it was.
"""

import json
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from spoofbench_converters.rosbag.slabs import Payloads

MAX_STEPS = 1000
_WINDOW_NS = 1_000_000_000  # as of TimeSorter: less is sorted in


class Steps:
    """Finds the jumps back of the recorder's stamps over all topics, in the bag's order; a lone
    stamp that leaps ahead makes none.
    """

    def __init__(self, append: bool) -> None:
        """Take whether messages after a jump back are put forward, so that the clock goes on at the
        interval before it.
        """
        self._append = append
        self._last: list[int] = []  # the last two stamps
        self._interval_ns = self._appended_ns = self._count = 0
        self._steps: list[dict[str, int]] = []

    def take(self, wanted: Mapping[int, Payloads]) -> dict[int, Payloads]:
        """Return a slab's messages by number of the topic, put forward where that is asked for."""
        if not wanted:
            return {}
        records = np.concatenate([payloads.records for payloads in wanted.values()])
        order = np.argsort(records, kind="stable")
        records, known = records[order], len(self._last)
        stamps = np.concatenate(
            [
                np.array(self._last, np.int64),
                np.concatenate([each.stamps_ns for each in wanted.values()])[order],
            ]
        )
        intervals = np.diff(stamps)
        back = np.flatnonzero(intervals < -_WINDOW_NS) + 1
        back = back[(back >= known) & ((back < 2) | (stamps[back] < stamps[back - 2] - _WINDOW_NS))]
        appended = np.full(stamps.size, self._appended_ns)
        for place in back.tolist():
            self._note(int(records[place - known]), int(stamps[place - 1]), int(stamps[place]))
            regular = intervals[: place - 1][
                (intervals[: place - 1] > 0) & (intervals[: place - 1] <= _WINDOW_NS)
            ]
            gap_ns = int(regular[-1]) if regular.size else self._interval_ns
            appended[place:] += int(stamps[place - 1] - stamps[place]) + gap_ns
        regular = intervals[(intervals > 0) & (intervals <= _WINDOW_NS)]
        self._interval_ns = int(regular[-1]) if regular.size else self._interval_ns
        self._appended_ns, self._last = int(appended[-1]), stamps[-2:].tolist()
        if not self._append or not appended.any():
            return dict(wanted)
        added = {
            number: appended[known:][np.searchsorted(records, payloads.records)]
            for number, payloads in wanted.items()
        }
        return {
            number: replace(
                each, stamps_ns=each.stamps_ns + added[number], appended_ns=added[number]
            )
            for number, each in wanted.items()
        }

    def about(self) -> dict[str, str]:
        """Return the recording's metadata: how many jumps, and the first thousand."""
        return (
            {"clock_step_count": str(self._count), "clock_steps": json.dumps(self._steps)}
            if self._count
            else {}
        )

    def _note(self, record: int, from_ns: int, to_ns: int) -> None:
        self._count += 1
        if len(self._steps) < MAX_STEPS:
            self._steps.append({"record": record, "from_ns": from_ns, "to_ns": to_ns})
