"""What a family of messages gives the rosbag converter: definitions, columns, and topics of a recording."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from spoofbench.converting import Block, Columns, Facts, Reject
from spoofbench_converters.rosbag.cdr import Definitions
from spoofbench_converters.rosbag.reading import Topic


@dataclass(frozen=True, slots=True)
class Options:
    """Options of the rosbag converter.

    Attributes:
        definitions: folder of ``.msg`` definitions, which go before those that the converter knows.
        time: the rows' time: the messages' own time of validity, or the recorder's stamps.
        reference: topic of the independent reference; ``auto`` takes the first position-velocity-attitude
            topic of a device that gives neither the inertial nor the GNSS topics, ``none`` takes none.
        attitude: frames of a quaternion: ``ned-frd`` as ASPN-23 declares it, ``enu-rfu``, or ``auto``,
            which is ``enu-rfu`` for devices known to send that.
        imu_interval_s: over which integrated inertial rows are integrated; else found from their times.
        session: name of the session that the log belongs to.
    """

    definitions: str | None = None
    time: Literal["validity", "recorder"] = "validity"
    reference: str = "auto"
    attitude: Literal["auto", "ned-frd", "enu-rfu"] = "auto"
    imu_interval_s: float | None = None
    session: str | None = None

    def __post_init__(self) -> None:
        if self.imu_interval_s is not None and not 0 < self.imu_interval_s < np.inf:
            raise ValueError(f"imu_interval_s must be above 0 and finite, not {self.imu_interval_s!r}")


Refusal = tuple[NDArray[np.bool_], str]
"""Which messages cannot be used, and why."""


class Session(Protocol):
    """A family at work on one bag."""

    def columns(self, topic: Topic, rows: NDArray[Any]) -> tuple[Columns, Sequence[Refusal]]:
        """Return what messages of one layout say, ``time_ns`` (their own time) among it, and which are refused.

        The columns of a topic are the same for all layouts.
        """
        ...

    def push(self, topic: Topic, columns: Columns) -> Iterator[Block | Reject]:
        """Take a topic's next rows, in bag order; they bear ``time_ns``, ``receive_time_ns`` and ``record`` besides."""
        ...

    def settle(self) -> Iterator[Block | Reject]:
        """Give what is complete, now that all topics were read equally far."""
        ...

    def finish(self) -> Iterator[Block | Reject | Facts]:
        """Give what is still held, and the metadata."""
        ...


class Family(Protocol):
    """One module per family of messages."""

    TYPES: frozenset[str]

    def definitions(self) -> Definitions:
        """Return the definitions of all types of the family."""
        ...

    def open(self, topics: Sequence[Topic], options: Options) -> Session:
        """Return a session for those of the bag's topics that are of the family's types."""
        ...


def rejects(columns: Mapping[str, NDArray[Any]], reason: str) -> Iterator[Reject]:
    """Yield one reject per row."""
    for record in columns["record"].tolist() if columns else ():
        yield Reject(record, 1, reason)
