"""Complete epochs on their way to rows, and what became of each of their frames."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench.arrays import Bools, Floats, Ints
from spoofbench.conversion import Rejects
from spoofbench.table import Column
from spoofbench_converters.serial.contract import ABSENT_NS, EpochRows
from spoofbench_converters.ubx.frames import FrameBuffer
from spoofbench_converters.ubx.messages import MESSAGES, NUMBER

_SOLUTIONS = frozenset(
    {"NAV-PVT", "NAV-PVAT", "NAV-POSLLH", "NAV-HPPOSLLH", "NAV-POSECEF", "NAV-HPPOSECEF", "NAV-SOL"}
)
_UNDECIDED, _USED, _REFUSED = 0, 1, 2


FieldColumns = dict[str, Any]
"""Columns by field: arrays, or ``Column`` where a number, a flag or a text may be absent."""


@dataclass(frozen=True, slots=True, eq=False)
class MessageFrames:
    """Frames of one message.

    Attributes:
        index: int64 ``(k,)``, of each frame in the batch.
        epoch: int64 ``(k,)``, of each frame.
        head: structured ``(k,)``, the fields before its blocks.
    """

    index: Ints
    epoch: Ints
    head: NDArray[np.void]

    def take(self, rows: Bools) -> "MessageFrames":
        """Return the frames that a mask ``(k,)`` selects."""
        return MessageFrames(self.index[rows], self.epoch[rows], self.head[rows])


class EpochBatch:
    """The frames of complete epochs, and what becomes of each.

    Attributes:
        buffer: the frames, ``k`` of them.
        epoch: int64 ``(k,)``, of each frame, from 0.
        count: number of epochs.
        conflicts: solutions that differ from another of the same message in their epoch, as those
            of a second receiver do.
    """

    def __init__(self, buffer: FrameBuffer, first: int, count: int) -> None:
        self.buffer = buffer
        self.epoch = buffer.epoch - first
        self.count = count
        self.conflicts = 0
        self._fate = np.zeros(buffer.number.size, np.int8)
        self._rejects: list[Rejects] = []
        self._once: dict[str, MessageFrames] = {}

    def all_of(self, name: str, layout: np.dtype[np.void] | None = None) -> MessageFrames:
        """Return all frames of a message, in file order."""
        number = NUMBER[name]
        return self._read(
            np.flatnonzero(self.buffer.number == number), layout or MESSAGES[number].head
        )

    def one_of(self, name: str) -> MessageFrames:
        """Return the first frame of a message in each epoch that has one, by epoch; further ones
        are refused.
        """
        if name not in self._once:
            self._once[name] = self._first_of(name)
        return self._once[name]

    def _first_of(self, name: str) -> MessageFrames:
        number = NUMBER[name]
        rows = np.flatnonzero(self.buffer.number == number)
        epochs, first, owner = np.unique(self.epoch[rows], return_index=True, return_inverse=True)
        if first.size < rows.size:
            repeated = np.ones(rows.size, bool)
            repeated[first] = False
            heads = self.buffer.heads(rows, MESSAGES[number].head)
            if name in _SOLUTIONS:
                self.conflicts += int(
                    np.count_nonzero(heads[repeated] != heads[first[owner[repeated]]])
                )
            self.refuse(rows[repeated], "repeated in its epoch")
            rows = rows[first]
            return MessageFrames(rows, epochs, heads[first])
        return self._read(rows, MESSAGES[number].head)

    def _read(self, rows: Ints, layout: np.dtype[np.void]) -> MessageFrames:
        return MessageFrames(rows, self.epoch[rows], self.buffer.heads(rows, layout))

    def blocks(self, name: str, frames: MessageFrames) -> tuple[NDArray[np.void], Ints]:
        """Return all blocks of these frames, structured ``(b,)``, and which of the frames each is
        of, int64 ``(b,)``.
        """
        message = MESSAGES[NUMBER[name]]
        assert message.block is not None
        return self.buffer.blocks(frames.index, message.head.itemsize, message.block)

    def use(self, index: Ints) -> None:
        """Count frames, int64 ``(n,)``, as having given rows."""
        self._fate[index] = _USED

    def refuse(self, index: Ints, reason: str) -> None:
        """Reject frames of one message, int64 ``(n,)``."""
        if index.size:
            self._fate[index] = _REFUSED
            name = MESSAGES[int(self.buffer.number[index[0]])].name
            self._rejects.append(
                Rejects(self.buffer.offset[index], self.buffer.used[index], f"UBX {name}: {reason}")
            )

    def settle(self) -> tuple[Ints, list[Rejects]]:
        """Return the bytes that gave rows, by epoch, int64 ``(count,)``, and all rejects; what
        completes an epoch's rows shares their fate.
        """
        gave = np.bincount(self.epoch[self._fate == _USED], minlength=self.count) > 0
        undecided = np.flatnonzero(self._fate == _UNDECIDED)
        completing = gave[self.epoch[undecided]]
        self._fate[undecided[completing]] = _USED
        lone = undecided[~completing]
        for number in np.unique(self.buffer.number[lone]).tolist():
            self.refuse(
                lone[self.buffer.number[lone] == number], "nothing in its epoch to complete"
            )
        used = np.bincount(
            self.epoch, np.where(self._fate == _USED, self.buffer.used, 0), self.count
        )
        return used.astype(np.int64), self._rejects

    def rows(
        self, source: str, kind: str, index: Ints, columns: FieldColumns, **times: Ints
    ) -> EpochRows:
        """Return rows of which each came from one frame, int64 ``(n,)``."""
        received = self.buffer.receive_time_ns[index]
        return EpochRows.of(
            source,
            kind,
            self.epoch[index],
            columns,
            receive_time_ns=received if np.any(received != ABSENT_NS) else None,
            **times,
        )


class EpochColumns:
    """Columns ``(count,)`` by epoch that several messages fill; the first that has a value keeps
    it.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._columns: dict[str, Floats] = {}

    def __getitem__(self, name: str) -> Floats:
        return self._columns.setdefault(name, np.full(self._count, np.nan))

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def fill(self, epoch: Ints, **values: NDArray[Any]) -> None:
        """Give epochs ``(k,)``, each once, values ``(k,)`` where they have none; NaN is none."""
        for name, given in values.items():
            column = self[name]
            column[epoch] = np.where(np.isnan(column[epoch]), given, column[epoch])

    def fill_together(self, epoch: Ints, **values: NDArray[Any]) -> None:
        """Fill fields that belong together, ``(k,)`` each, from one message: only where the first
        named has none, and then all of them.
        """
        first = next(iter(values))
        lacking = np.isnan(self[first][epoch]) & ~np.isnan(values[first])
        for name, given in values.items():
            self[name][epoch[lacking]] = given[lacking]


def whole(values: Floats, dtype: str = "int64") -> Column:
    """Return floats ``(n,)`` as whole numbers, absent where NaN."""
    valid = ~np.isnan(values)
    return Column(np.where(valid, values, 0).astype(dtype), valid)


def absent_where(mask: Bools, values: NDArray[Any]) -> Floats:
    """Return values ``(n,)`` as float64, NaN where masked, and where they are no finite number."""
    with np.errstate(invalid="ignore"):  # a signalling NaN
        result = values.astype(np.float64)
    return np.where(mask | ~np.isfinite(result), np.nan, result)


def scaled(values: NDArray[Any], scale: float, unknown: int | None = None) -> Floats:
    """Return whole numbers ``(n,)`` times a scale, NaN where they are ``unknown``."""
    result = values.astype(np.float64) * scale
    return result if unknown is None else np.where(values == unknown, np.nan, result)


NO_ACCURACY = 0xFFFFFFFF
"""What accuracies read when the receiver has no estimate."""
NO_DOP = 9999
"""What dilutions of precision read when the receiver has no estimate."""
