"""One clock for all sources of a bag, and where it jumps back.

The recorder stamps each message when it gets it. Most headers are stamped by the same host a little
earlier; others bear a clock of their own, the seconds of a day, or nothing. All rows of a recording
are on one clock, so every device's stamps are measured against the recorder's before any row is
given a time.

A host without network time starts with a wrong clock and sets it later; two recordings in one bag
may overlap. The messages that follow a jump back would all be refused as late until the clock is
where it was: the jump is noted, and appended if the user asks for it.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from spoofbench_converters.rosbag.batches import TopicMessages

AGREE_NS = 1_000_000_000
DAY_NS = 86_400_000_000_000
_EARLIEST_NS = (
    631_152_000_000_000_000  # 1990: before it, a stamp counts from something else than 1970
)
_BACKWARDS_SHARE = 0.01
_SAMPLES = 20_000
_DRIFT_LAPSE_S = 10  # between the middles of the halves that are compared

_Times = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class DeviceClock:
    """How a device's rows get their time.

    Attributes:
        by_header: from the header's stamp, else from the recorder's.
        shift_ns: what is added to it.
        basis: why.
    """

    by_header: bool
    shift_ns: int
    basis: str

    def time_ns(self, stamps_ns: _Times, received_ns: _Times) -> _Times:
        """Return the rows' times, ``(n,)``."""
        return (stamps_ns if self.by_header else received_ns) + self.shift_ns


def decide(seen: Mapping[str, tuple[_Times, _Times]]) -> tuple[Mapping[str, DeviceClock], int]:
    """Return each device's clock, and how far the recording's clock is ahead of the recorder's.

    It is the recorder's, unless two devices or more agree with each other within 1 s and none with
    the recorder: then the bag was recorded again later, and theirs is taken. A device whose stamps
    are off by up to a day is shifted onto it.

    Args:
        seen: by device, the headers' stamps (without rows where there are none) and the recorder's
            of its first messages.
    """
    troubles = {name: _trouble(*times) for name, times in seen.items()}
    offsets = {
        name: int(np.median(stamps - received))
        for name, (stamps, received) in seen.items()
        if troubles[name] is None
    }
    ahead_ns = 0
    agree = len(offsets) >= 2 and max(offsets.values()) - min(offsets.values()) <= AGREE_NS
    if agree and min(map(abs, offsets.values())) > AGREE_NS:
        ahead_ns = int(np.median(list(offsets.values())))
    clocks = {}
    for name, trouble in troubles.items():
        off_ns = offsets.get(name, 0) - ahead_ns
        if trouble is None and abs(off_ns) > DAY_NS:
            trouble = "the header's stamps are more than a day away from the recorder's"
        if trouble is not None:
            clocks[name] = DeviceClock(False, ahead_ns, f"recorder's stamps, for {trouble}")
        elif abs(off_ns) <= AGREE_NS:
            clocks[name] = DeviceClock(True, 0, "header's stamps")
        else:
            clocks[name] = DeviceClock(
                True,
                -off_ns,
                (
                    f"header's stamps less {off_ns / 1e9:.6f} s, their median lead over the "
                    "recording's clock"
                ),
            )
    return clocks, ahead_ns


def _trouble(stamps: _Times, received: _Times) -> str | None:
    """Return why stamps cannot be used, None where they can."""
    if not stamps.size:
        return "the messages have none of their own"
    if not stamps.any():
        return "the header's are zero"
    if stamps.size > 1 and (stamps == stamps[0]).all():
        return "the header's never change"
    if np.median(stamps) < _EARLIEST_NS:
        return "the header's do not count from 1970"
    if (np.diff(stamps) < -AGREE_NS).sum() > _BACKWARDS_SHARE * stamps.size:
        return "the header's run backwards"
    low, high = np.percentile(stamps - received, (25, 75))
    if high - low > AGREE_NS and received[0] != received[-1]:
        return "the header's wander against the recorder's by more than 1 s"
    return None


class OffsetMeter:
    """Measures a device's stamps against the recorder's, on a bounded number of messages spread
    over the bag.
    """

    def __init__(self) -> None:
        self._parts: list[NDArray[np.int64]] = []
        self._count, self._every, self._seen = 0, 1, 0

    def add(self, stamps_ns: _Times, received_ns: _Times) -> None:
        """Take a device's next messages."""
        first = -self._seen % self._every
        self._seen += stamps_ns.size
        self._parts.append(
            np.stack([received_ns, stamps_ns - received_ns])[:, first :: self._every]
        )
        self._count += self._parts[-1].shape[1]
        while self._count > _SAMPLES:
            thinned = np.concatenate(self._parts, axis=1)[:, ::2]
            self._parts, self._count, self._every = [thinned], thinned.shape[1], 2 * self._every

    def about(self) -> dict[str, str]:
        """Return median, spread (from the 5th to the 95th percentile) and drift of header minus
        recorder, as metadata.
        """
        if not self._count:
            return {}
        samples = np.concatenate(self._parts, axis=1)
        received, offsets = samples[:, np.lexsort(samples[::-1])]
        median, (low, high) = float(np.median(offsets)), np.percentile(offsets, (5, 95))
        about = {
            "header_offset_s": f"{median / 1e9:.6f}",
            "header_offset_spread_s": f"{(high - low) / 1e9:.6f}",
        }
        half = received.size // 2
        lapse_s = (
            float(np.median(received[half:]) - np.median(received[:half])) / 1e9 if half else 0.0
        )
        if lapse_s > _DRIFT_LAPSE_S:
            drift_s = float(np.median(offsets[half:]) - np.median(offsets[:half])) / 1e9
            about["header_drift_ppm"] = f"{drift_s / lapse_s * 1e6:.3f}"
        return about


MAX_STEPS = 1000
_WINDOW_NS = 1_000_000_000  # as of TimeSorter: less is sorted in


class RecorderJumps:
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

    def take(self, wanted: Mapping[int, TopicMessages]) -> dict[int, TopicMessages]:
        """Return a batch's messages by number of the topic, put forward where that is asked for."""
        if not wanted:
            return {}
        records = np.concatenate([messages.records for messages in wanted.values()])
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
            number: appended[known:][np.searchsorted(records, messages.records)]
            for number, messages in wanted.items()
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
