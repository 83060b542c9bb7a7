"""Between the demultiplexer, the decoders of the protocols, and the time axis.

The demultiplexer cuts a log into frames, piece by piece, and gives each protocol's decoder its own.
A decoder groups them into epochs and says what time each epoch claims, as far as it knows; rows
belong to epochs. The axis merges the epochs of all protocols in file order, completes what they
claim, and gives their rows their times.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date
from typing import Any, Literal, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike

from spoofbench.arrays import Bools, Ints, Octets
from spoofbench.conversion import Rejects
from spoofbench.schema import KINDS
from spoofbench.table import Column, as_column, concat_columns
from spoofbench_converters.serial.framing import Checksum

ABSENT_NS = np.iinfo(np.int64).min


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """One protocol's frames in one piece of a log, in file order; each is valid by its checksum, or
    by the declared policy.

    Attributes:
        octets: uint8 ``(n,)``, the piece, read-only.
        starts, lengths: int64 ``(k,)``, each frame within ``octets``; a UBX frame from its sync
            bytes to its checksum, a sentence from ``$`` or ``!`` to its checksum (to the end of the
            line where it has none), line end excluded.
        base: offset of the piece in the log.
        used: int64 ``(k,)``, bytes of the log that belong to each frame: itself, its line end, and
            its time stamp.
        receive_time_ns: int64 ``(k,)``, when the recorder got it, ``ABSENT_NS`` where the log does
            not say.
        leads: int64 ``(k,)``, how many of the bytes in ``used`` stand before the frame; None: none.
    """

    octets: Octets
    starts: Ints
    lengths: Ints
    base: int
    used: Ints
    receive_time_ns: Ints
    leads: Ints | None = field(default=None, kw_only=True)

    def offsets(self) -> Ints:
        """Offset in the log of the bytes that belong to each frame, int64 ``(k,)``."""
        return (
            self.starts + self.base if self.leads is None else self.starts + self.base - self.leads
        )


@dataclass(frozen=True, slots=True, eq=False)
class EpochRows:
    """Rows of one kind of one source, each of an epoch.

    Attributes:
        source: such as ``gnss0``, ``imu0``; counted within the protocol.
        kind: name of a kind of the schema.
        epoch: int64 ``(n,)``, index in :class:`Epochs` of each row's epoch; not decreasing.
        columns: by field, without ``time_ns`` and ``receive_time_ns``.
        offset_ns: int64 ``(n,)``, the row's time minus that of its epoch; None: 0 for all.
        tick_ns: int64 ``(n,)``, time on the sensor's own counter, unwrapped, for rows that have one
            (ESF-MEAS, ESF-RAW); the counter is then laid against the epochs, and ``offset_ns`` is
            None.
        receive_time_ns: int64 ``(n,)``, ``ABSENT_NS`` where not known; None: that of the epoch.
    """

    source: str
    kind: str
    epoch: Ints
    columns: Mapping[str, Column]
    offset_ns: Ints | None = None
    tick_ns: Ints | None = None
    receive_time_ns: Ints | None = None

    @classmethod
    def of(
        cls,
        source: str,
        kind: str,
        epoch: Ints,
        columns: Mapping[str, ArrayLike | Column | Sequence[Any]],
        **times: Ints | None,
    ) -> Self:
        """Return rows whose columns ``(n,)`` are given as to :class:`~spoofbench.table.Table`."""
        fields = KINDS[kind].fields
        made = {name: as_column(fields[name], given) for name, given in columns.items()}
        return cls(source, kind, epoch, made, **times)

    def take(self, rows: Bools | Ints) -> "EpochRows":
        """Return the rows that a mask ``(n,)`` or index array selects."""
        columns = {
            name: Column(c.values[rows], None if c.valid is None else c.valid[rows], c.categories)
            for name, c in self.columns.items()
        }
        times = [
            None if time is None else time[rows]
            for time in (self.offset_ns, self.tick_ns, self.receive_time_ns)
        ]
        return EpochRows(self.source, self.kind, self.epoch[rows], columns, *times)

    @staticmethod
    def by_topic(parts: Iterable["EpochRows"]) -> list["EpochRows"]:
        """Return the rows of each source and kind that has any as one, in the order of epochs.

        Rows of one epoch stay in the order given.
        """
        topics: dict[tuple[str, str], list[EpochRows]] = {}
        for part in parts:
            if part.epoch.size:
                topics.setdefault((part.source, part.kind), []).append(part)
        return [_in_epoch_order(_concat(same)) for same in topics.values()]


def _concat(parts: Sequence[EpochRows]) -> EpochRows:
    """Return rows of one source and kind, one part after the other."""
    if len(parts) == 1:
        return parts[0]
    source, kind, sizes = parts[0].source, parts[0].kind, [part.epoch.size for part in parts]
    columns = {
        name: concat_columns(field, [part.columns.get(name) for part in parts], sizes)
        for name, field in KINDS[kind].fields.items()
        if any(name in part.columns for part in parts)
    }
    times: list[Ints | None] = []
    for name, absent in (("offset_ns", 0), ("tick_ns", 0), ("receive_time_ns", ABSENT_NS)):
        given = [getattr(part, name) for part in parts]
        times.append(
            None
            if all(time is None for time in given)
            else np.concatenate(
                [
                    np.full(size, absent) if time is None else time
                    for time, size in zip(given, sizes, strict=True)
                ]
            )
        )
    return EpochRows(source, kind, np.concatenate([part.epoch for part in parts]), columns, *times)


def _in_epoch_order(rows: EpochRows) -> EpochRows:
    in_order = bool(np.all(rows.epoch[1:] >= rows.epoch[:-1]))
    return rows if in_order else rows.take(np.argsort(rows.epoch, kind="stable"))


@dataclass(frozen=True, slots=True, eq=False)
class Epochs:
    """A decoder's next complete epochs in file order, and the rows that belong to them.

    Attributes:
        offset: int64 ``(m,)``, offset in the log of the epoch's first frame, increasing.
        claimed_ns: int64 ``(m,)``, UTC that the receiver claims, to be completed by whole periods;
            ``ABSENT_NS`` where it claims none, or says that its time is not valid.
        period_ns: int64 ``(m,)``, 0: complete; ``DAY_NS``: time of day without a date; ``WEEK_NS``:
            time of week without a week.
        receive_time_ns: int64 ``(m,)``, when the recorder got the epoch's first frame;
            ``ABSENT_NS`` where not known.
        used: int64 ``(m,)``, bytes of the log that each epoch's rows came from.
        rows: by source and kind; several of one source and kind follow one another.
    """

    offset: Ints
    claimed_ns: Ints
    period_ns: Ints
    receive_time_ns: Ints
    used: Ints
    rows: Sequence[EpochRows]


class FrameDecoder(Protocol):
    """One protocol's decoder at work on one log. Results do not depend on how the log is cut into
    pieces.
    """

    @property
    def protocol(self) -> Literal["ubx", "nmea"]:
        """Whose frames it takes."""
        ...

    def push(self, frames: Frames) -> Iterator[Epochs | Rejects]:
        """Take the next piece's frames; yield what is complete, and frames that give no rows, with
        the reason.
        """
        ...

    def finish(self) -> Iterator[Epochs | Rejects]:
        """Give what is still held."""
        ...

    def about(self) -> Mapping[str, Mapping[str, str]]:
        """Return, by source, what the protocol tells of it: ``device``, ``firmware``, ``solution``,
        ``axes``, ...; after :meth:`finish`.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class SerialOptions:
    """How a byte stream is converted.

    Attributes:
        date: reference date, YYYY-MM-DD: that of the first time of day or week which nothing else
            in the log dates.
        date_backward: carry dates backward too, from the first complete time to those before it.
        week_rollover: periods of 1024 weeks to add to complete times, for receivers that lost some.
        gap_s: a claimed time that goes forward by this or more is a step of the clock, which the
            time axis does not follow.
        append_clock: where a recorder's clock jumps back, go on at the nominal interval instead of
            rejecting rows.
        checksum: whether sentences need theirs.
        zone_is_utc: times of the recorder without a zone are UTC; else they are not used.
        session: what recordings of one session share.
    """

    date: str | None = None
    date_backward: bool = False
    week_rollover: int = 0
    gap_s: float = 3600.0
    append_clock: bool = False
    checksum: Checksum = "required"
    zone_is_utc: bool = False
    session: str | None = None

    def __post_init__(self) -> None:
        if self.date is not None:
            _ = date.fromisoformat(self.date)
        if not 0 < self.gap_s <= 86_400:
            raise ValueError(f"gap_s must be above 0 and at most 86400, not {self.gap_s!r}")
        if not -8 <= self.week_rollover <= 8:
            raise ValueError(
                "week_rollover must be a number of 1024-week periods from -8 to 8, not "
                f"{self.week_rollover!r}"
            )

    def date_ns(self) -> int | None:
        """Start of the reference date, Unix UTC in ns."""
        return (
            None
            if self.date is None
            else (date.fromisoformat(self.date) - date(1970, 1, 1)).days * 86_400_000_000_000
        )
