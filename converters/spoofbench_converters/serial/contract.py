"""Between the demultiplexer, the decoders of the protocols, and the time axis.

The demultiplexer cuts a log into frames, piece by piece, and gives each protocol's decoder its own.
A decoder groups them into epochs and says what time each epoch claims, as far as it knows; rows
belong to epochs. The axis merges the epochs of all protocols in file order, completes what they
claim, and gives their rows their times.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from spoofbench.conversion import Columns, Rejects

ABSENT_NS = np.iinfo(np.int64).min
DAY_NS = 86_400_000_000_000
WEEK_NS = 7 * DAY_NS


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

    octets: NDArray[np.uint8]
    starts: NDArray[np.int64]
    lengths: NDArray[np.int64]
    base: int
    used: NDArray[np.int64]
    receive_time_ns: NDArray[np.int64]
    leads: NDArray[np.int64] | None = field(default=None, kw_only=True)

    def offsets(self) -> NDArray[np.int64]:
        """Offset in the log of the bytes that belong to each frame, int64 ``(k,)``."""
        return (
            self.starts + self.base if self.leads is None else self.starts + self.base - self.leads
        )


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Rows of one kind of one source, in file order.

    Attributes:
        source: such as ``gnss0``, ``imu0``; counted within the protocol.
        kind: a kind of the schema.
        epoch: int64 ``(n,)``, the epoch of each row: its place in :class:`Epochs`.
        columns: fields of the kind, float64 NaN or ``Column.valid`` where absent, as
            :class:`spoofbench.recording.Table` takes them; without ``time_ns`` and
            ``receive_time_ns``.
        offset_ns: int64 ``(n,)``, the row's time minus that of its epoch; None: 0 for all.
        tick_ns: int64 ``(n,)``, time on the sensor's own counter, unwrapped, for rows that have one
            (ESF-MEAS, ESF-RAW); the axis then lays this counter against the epochs, and
            ``offset_ns`` is None.
        receive_time_ns: int64 ``(n,)``, ``ABSENT_NS`` where not known; None: that of the epoch.
    """

    source: str
    kind: str
    epoch: NDArray[np.int64]
    columns: Columns
    offset_ns: NDArray[np.int64] | None = None
    tick_ns: NDArray[np.int64] | None = None
    receive_time_ns: NDArray[np.int64] | None = None


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

    offset: NDArray[np.int64]
    claimed_ns: NDArray[np.int64]
    period_ns: NDArray[np.int64]
    receive_time_ns: NDArray[np.int64]
    used: NDArray[np.int64]
    rows: Sequence[Rows]


class Decoder(Protocol):
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
