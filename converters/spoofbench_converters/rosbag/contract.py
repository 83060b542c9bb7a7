"""Between the bag and the messages of a family: options, what messages say, and the session that
takes them.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from spoofbench.conversion import Block, Columns, Reject, Rejects, SourceMetadata
from spoofbench.conversion.rows import take
from spoofbench_converters.rosbag import batches
from spoofbench_converters.rosbag.batches import BagTopic, TopicMessages
from spoofbench_converters.rosbag.layouts import Group


@dataclass(frozen=True, slots=True)
class Options:
    """Options of the rosbag converter.

    Attributes:
        definitions: folder of ``.msg`` definitions, which go before those that the bag has or the
            converter knows.
        mapping: TOML file, or name of a ready mapping, that says what messages of other types hold.
        time: the rows' time: the messages' own time of validity (their header's stamp), or the
            recorder's stamps.
        source: topic of the one receiver (or IMU, ...) to convert, where there are several of a
            kind; other kinds are converted too.
        velocity: topic of a receiver's velocity in east, north and up (a twist); ``auto`` takes one
            that stands beside a receiver's position and is called so, ``none`` takes none.
        odometer: topic of wheel odometry; ``auto`` takes those that are called so, ``none`` takes
            none.
        reference: topic of the independent reference of a bag in ASPN-23; ``auto`` takes the first
            position-velocity-attitude topic of a device that gives neither the inertial nor the
            GNSS topics, ``none`` takes none.
        attitude: frames of a quaternion: ``ned-frd`` as ASPN-23 declares it, ``enu-rfu``, or
            ``auto``, which is ``enu-rfu`` for devices known to send that.
        imu_interval_s: over which integrated inertial rows are integrated; else found from their
            times.
        append_clock: where the recorder's clock jumps back, messages go on at the interval before,
            instead of being skipped.
        date: day (YYYY-MM-DD) of NMEA sentences that give none.
        session: name of the session that the log belongs to.
    """

    definitions: str | None = None
    mapping: str | None = None
    time: Literal["validity", "recorder"] = "validity"
    source: str | None = None
    velocity: str = "auto"
    odometer: str = "auto"
    reference: str = "auto"
    attitude: Literal["auto", "ned-frd", "enu-rfu"] = "auto"
    imu_interval_s: float | None = None
    append_clock: bool = False
    date: str | None = None
    session: str | None = None

    def __post_init__(self) -> None:
        if self.imu_interval_s is not None and not 0 < self.imu_interval_s < np.inf:
            raise ValueError(
                f"imu_interval_s must be above 0 and finite, not {self.imu_interval_s!r}"
            )


Refusal = tuple[NDArray[np.bool_], str]
"""Which messages cannot be used, and why."""


@dataclass(frozen=True, slots=True, eq=False)
class DecodedRows:
    """Rows of one kind that messages give.

    Attributes:
        kind: of the schema.
        columns: fields of the kind, ``(m,)`` each: numbers as float64, NaN where absent, texts
            empty where absent.
        message: place of each row's message, ascending, ``(m,)``; None: one row per message.
    """

    kind: str
    columns: Columns
    message: NDArray[np.intp] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class DecodedMessages:
    """What messages of one layout say.

    Attributes:
        parts: rows by kind.
        stamp_ns: the messages' own time, ``(n,)``; None where they have none.
        refusals: messages that cannot be used.
    """

    parts: Sequence[DecodedRows]
    stamp_ns: NDArray[np.int64] | None = None
    refusals: Sequence[Refusal] = field(default_factory=tuple)


class MessageReader(Protocol):
    """A family at work on one bag."""

    def take(
        self, topic: BagTopic, groups: Sequence[Group], messages: TopicMessages
    ) -> Iterator[Block | Reject | Rejects]:
        """Take a topic's next messages, by layout; ``Group.index`` counts within ``messages``."""
        ...

    def settle(self) -> Iterator[Block | Reject | Rejects]:
        """Give what is complete, now that all topics were read equally far."""
        ...

    def finish(self) -> Iterator[Block | Reject | Rejects | SourceMetadata]:
        """Give what is still held, and the metadata."""
        ...


def rejects(columns: Mapping[str, NDArray[Any]], reason: str) -> Iterator[Rejects]:
    """Yield one reject per row of columns ``(n,)``."""
    if columns and columns["record"].size:
        yield batches.rejects(columns["record"], reason)


def refused(
    refusals: Sequence[Refusal], records: NDArray[np.int64], topic: str
) -> tuple[NDArray[np.bool_], list[Rejects]]:
    """Return which messages are left, ``(n,)``, and the rejects: a message is refused for the first
    reason that applies.
    """
    kept, given = np.ones(records.size, bool), []
    for mask, reason in refusals:
        if (mask & kept).any():
            given.append(batches.rejects(records[mask & kept], f"{topic}: {reason}"))
        kept &= ~mask
    return kept, given


def in_bag_order(pieces: Sequence[Columns]) -> Columns:
    """Return the rows of pieces, whose columns are the same and ``(n,)`` each, by ``record``; rows
    of one record keep their order.
    """
    if len(pieces) == 1:
        return pieces[0]
    columns = {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}
    return take(columns, np.argsort(columns["record"], kind="stable"))
