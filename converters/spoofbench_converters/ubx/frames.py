"""Frames on their way to rows: taken in, held until their epoch is complete, read as structured
arrays.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from spoofbench.arrays import Bools, Ints, Octets, ragged_arange, ragged_ranges
from spoofbench.conversion import Rejects
from spoofbench_converters.serial.contract import Frames
from spoofbench_converters.ubx.messages import (
    FRAME_OVERHEAD,
    MESSAGES,
    NUMBER,
    NUMBER_OF_KEY,
    PAYLOAD,
    Message,
    Role,
    offset_in,
)
from spoofbench_converters.ubx.names import name_of

_LONGEST_FIXED = 128
_BASE = np.array([message.head.itemsize for message in MESSAGES])
_BLOCK = np.array(
    [message.block.itemsize if message.block is not None else 0 for message in MESSAGES]
)
_COUNT_AT = np.array(
    [offset_in(message.head, message.count) if message.count else -1 for message in MESSAGES]
)
_FITS = np.zeros((len(MESSAGES), _LONGEST_FIXED), bool)
for _number, _message in enumerate(MESSAGES):
    _FITS[_number, list(_message.lengths)] = True
ROLES = np.array([message.role for message in MESSAGES])


@dataclass(frozen=True, slots=True, eq=False)
class FrameBuffer:
    """Frames of known messages, in file order; all arrays but ``octets`` are ``(k,)``.

    Attributes:
        octets: uint8 ``(n,)``, which holds at least these frames.
        number: index of the message in ``MESSAGES``.
        start, size: of the payload in ``octets``.
        offset, used, receive_time_ns: as in :class:`Frames`.
        time_ms: time of week that the frame bears, -1 where none.
        epoch: running number of its epoch.
    """

    octets: Octets
    number: Ints
    start: Ints
    size: Ints
    offset: Ints
    used: Ints
    receive_time_ns: Ints
    time_ms: Ints
    epoch: Ints

    @classmethod
    def none(cls) -> Self:
        """Return no frames."""
        nothing = np.zeros(0, np.int64)
        return cls(np.zeros(0, np.uint8), *[nothing] * 8)

    def take(self, rows: NDArray[Any]) -> Self:
        """Return the frames that a mask ``(k,)`` or index array selects."""
        arrays = {
            field.name: getattr(self, field.name)[rows]
            for field in fields(self)
            if field.name != "octets"
        }
        return replace(self, **arrays)

    def compact(self) -> Self:
        """Return the same frames over octets of their own."""
        octets = self.octets[ragged_ranges(self.start, self.size)]
        return replace(self, octets=octets, start=np.cumsum(self.size) - self.size)

    def join(self, later: Self) -> Self:
        """Return these frames and later ones."""
        arrays: dict[str, Any] = {
            field.name: np.concatenate([getattr(self, field.name), getattr(later, field.name)])
            for field in fields(self)
        }
        arrays["start"][self.start.size :] += self.octets.size
        return replace(self, **arrays)

    def heads(self, rows: Ints, layout: np.dtype[np.void]) -> NDArray[np.void]:
        """Read the beginning of payloads by a layout; what a payload lacks reads 0.

        Args:
            rows: int64 ``(n,)``, indices of the frames.
            layout: of the fields.

        Returns:
            Structured ``(n,)``.
        """
        heads = np.zeros(rows.size, layout)
        sizes = np.minimum(self.size[rows], layout.itemsize)
        for size in np.unique(sizes).tolist():
            chosen = sizes == size
            raw = heads.view(np.uint8).reshape(rows.size, layout.itemsize)
            raw[chosen, :size] = pieces(self.octets, self.start[rows[chosen]], size)
        return heads

    def blocks(
        self, rows: Ints, head: int, layout: np.dtype[np.void]
    ) -> tuple[NDArray[np.void], Ints]:
        """Read all blocks that follow ``head`` bytes of payloads.

        Args:
            rows: int64 ``(n,)``, indices of the frames.
            head: bytes before the first block.
            layout: of one block.

        Returns:
            Blocks, structured ``(b,)``, and which of ``rows`` each is of, int64 ``(b,)``.
        """
        counts = (self.size[rows] - head) // layout.itemsize
        starts = (
            np.repeat(self.start[rows] + head, counts) + ragged_arange(counts) * layout.itemsize
        )
        return pieces(self.octets, starts, layout.itemsize).view(layout)[:, 0], np.repeat(
            np.arange(rows.size), counts
        )


def pieces(octets: Octets, starts: Ints, size: int) -> Octets:
    """Return ``octets[start : start + size]`` of each start, uint8 ``(k, size)``."""
    if not starts.size or not size:
        return np.zeros((starts.size, size), np.uint8)
    windows: NDArray[np.void] = np.ndarray((octets.size - size + 1,), f"V{size}", octets, 0, (1,))
    return windows[starts].view(np.uint8).reshape(starts.size, size)


def accept(frames: Frames) -> tuple[FrameBuffer, list[Rejects]]:
    """Return the frames that a decoder can read, without epochs, and the others with the reason."""
    octets, starts = np.ascontiguousarray(frames.octets), frames.starts + PAYLOAD
    size = frames.lengths - FRAME_OVERHEAD
    key = octets[frames.starts + 2].astype(np.int64) << 8 | octets[frames.starts + 3]
    number = NUMBER_OF_KEY[key].astype(np.int64)
    polls, known = size == 0, number >= 0
    fits = known & ~polls
    fits[fits] = _length_is_known(octets, starts[fits], size[fits], number[fits])
    rejects = [
        *_reject(frames, key, ~known & ~polls, "nothing in the schema"),
        *_reject(frames, key, polls, "a poll"),
        *_reject(frames, key, known & ~polls & ~fits, "length not known"),
    ]
    nothing = np.full(starts.size, -1)
    buffer = FrameBuffer(
        octets,
        number,
        starts,
        size,
        frames.offsets(),
        frames.used,
        frames.receive_time_ns,
        nothing,
        nothing,
    ).take(fits)
    return replace(buffer, time_ms=_times(buffer)), rejects


def _length_is_known(octets: Octets, start: Ints, size: Ints, number: Ints) -> Bools:
    """Whether each payload's length is one of its message's, and agrees with the number of blocks
    that it gives.
    """
    base, block = _BASE[number], _BLOCK[number]
    fixed = block == 0
    known = _FITS[number, np.minimum(size, _LONGEST_FIXED - 1)] & (size < _LONGEST_FIXED)
    rest = size - base
    known[~fixed] = ((rest >= 0) & (rest % np.maximum(block, 1) == 0))[~fixed]
    counted = known & (_COUNT_AT[number] >= 0)
    reported = octets[start[counted] + _COUNT_AT[number[counted]]]
    known[counted] = reported == rest[counted] // block[counted]
    for name, check in (("ESF-MEAS", _measurements), ("SEC-SIG", _security)):
        rows = np.flatnonzero(known & (number == NUMBER[name]))
        known[rows] = check(pieces(octets, start[rows], _BASE[NUMBER[name]]), size[rows])
    return known


def _measurements(head: Octets, size: Ints) -> Bools:
    """ESF-MEAS gives the number of data and whether a time tag follows them; before u-blox M8 it
    gave no number.
    """
    flags = head[:, 4].astype(np.int64) | head[:, 5].astype(np.int64) << 8
    reported, tagged = flags >> 11, flags >> 3 & 1
    return np.asarray((reported + tagged == (size - 8) // 4) | (reported == 0))


def _security(head: Octets, size: Ints) -> Bools:
    """SEC-SIG is 12 bytes in version 1; version 2 gives its number of blocks."""
    return np.asarray(
        ((head[:, 0] == 1) & (size == 12)) | ((head[:, 0] == 2) & (head[:, 3] == (size - 4) // 4))
    )


def _times(buffer: FrameBuffer) -> Ints:
    times = np.full(buffer.number.size, -1)
    for number, message in enumerate(MESSAGES):
        if not message.time:
            continue
        rows = np.flatnonzero(buffer.number == number)
        if rows.size:
            times[rows] = _time_of(buffer, rows, message)
    return times


def _time_of(buffer: FrameBuffer, rows: Ints, message: Message) -> Ints:
    kind, at = message.head[message.time], offset_in(message.head, message.time)
    reported = pieces(buffer.octets, buffer.start[rows] + at, kind.itemsize).view(kind)[:, 0]
    if message.name == "RXM-RAWX":
        within = (reported >= 0) & (reported < 604_801)
        return np.where(within, np.rint(np.where(within, reported, 0) * 1e3), -1).astype(np.int64)
    times = reported.astype(np.int64)
    if message.name == "RXM-MEASX":
        unset = buffer.octets[buffer.start[rows] + offset_in(message.head, "flags")] & 3 == 0
        times[unset] = -1
    return np.maximum(times, -1) if message.role == Role.RAW else times


def _reject(frames: Frames, key: Ints, refused: Bools, reason: str) -> Iterator[Rejects]:
    for one in np.unique(key[refused]).tolist():
        rows = refused & (key == one)
        yield Rejects(frames.offsets()[rows], frames.used[rows], f"UBX {name_of(one)}: {reason}")
