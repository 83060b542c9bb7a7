"""Successive messages of a bag, by topic: what every kind of bag is read to."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from spoofbench.conversion import Reject, Rejects
from spoofbench.errors import LimitError

BATCH_MESSAGES = 16_384
BATCH_BYTES = 16_777_216
MAX_TOPICS = 4096
MAX_MESSAGE_BYTES = 16_384
_SAME_CLOCK_NS = 1_000_000_000

_Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class BagTopic:
    """One topic of a bag.

    Attributes:
        number: its key in the bag.
        name: such as ``/gps/fix``.
        type: ``<package>/msg/<Type>``.
        encoding: of its messages: ``cdr`` or ``ros1``, others are not understood.
        definition: of the type and those within it, as the bag has it; empty where it has none.
        definition_format: ``ros2msg``, ``ros1msg`` or ``ros2idl``.
    """

    number: int
    name: str
    type: str
    encoding: str
    definition: str = ""
    definition_format: str = ""


@dataclass(frozen=True, slots=True)
class TopicMessages:
    """Successive messages of one topic.

    Attributes:
        octets: bytes among which theirs lie.
        starts: where each starts, ``(n,)``.
        lengths: bytes of each, ``(n,)``.
        records: ordinal of each in the bag, ``(n,)``.
        stamps_ns: when the recorder got each, ``(n,)``.
        appended_ns: by how much that was put forward, for the recorder's clock jumped back before,
            ``(n,)``; None: by nothing.
    """

    octets: NDArray[np.uint8]
    starts: _Integers
    lengths: _Integers
    records: _Integers
    stamps_ns: _Integers
    appended_ns: _Integers | None = None

    def appended(self, own_ns: _Integers, places: NDArray[np.intp]) -> _Integers:
        """Return the own stamps of messages, put forward alike where they are the recorder's
        clock's: within 1 s of its stamps.
        """
        if self.appended_ns is None:
            return own_ns
        by_host = (
            np.abs(self.stamps_ns[places] - self.appended_ns[places] - own_ns) <= _SAME_CLOCK_NS
        )
        return np.asarray(own_ns + np.where(by_host, self.appended_ns[places], 0))


@dataclass(slots=True)
class MessageBatch:
    """Successive messages of a bag.

    Attributes:
        wanted: messages by number of the wanted topics.
        others: how many messages each other topic has, and the ordinal of its first.
        rejects: messages that cannot be handed on.
    """

    wanted: dict[int, TopicMessages] = field(default_factory=dict)
    others: dict[int, tuple[int, int]] = field(default_factory=dict)
    rejects: list[Reject | Rejects] = field(default_factory=list)


class MessageLog(Protocol):
    """An open bag, or one file of it.

    Attributes:
        topics: all topics.
        records: how many messages were met so far, lost ones included.
        expected: how many messages it says that it has, 0 where it does not say.
        unverified: how many chunks have a wrong checksum and were read all the same.
    """

    @property
    def topics(self) -> tuple[BagTopic, ...]: ...

    @property
    def unverified(self) -> int: ...

    @property
    def records(self) -> int: ...

    @property
    def expected(self) -> int: ...

    def batches(self, wanted: frozenset[int]) -> Iterator[MessageBatch | Reject]:
        """Yield all messages in bag order; of the topics that are not wanted, only how many there
        are.
        """
        ...

    def close(self) -> None:
        """Let go of the file."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class RawMessages:
    """Successive messages, where they lie in ``octets``; ``numbers`` are those of their topics;
    ``(n,)`` each.
    """

    octets: NDArray[np.uint8]
    numbers: _Integers
    stamps_ns: _Integers
    starts: _Integers
    lengths: _Integers


def batch_of(messages: RawMessages, first: int, wanted: frozenset[int]) -> MessageBatch:
    """Return messages by topic, the first of which has this ordinal in the bag."""
    batch = MessageBatch()
    order = np.argsort(messages.numbers, kind="stable")
    for mine in np.split(order, np.flatnonzero(np.diff(messages.numbers[order])) + 1):
        if not mine.size:
            continue
        number = int(messages.numbers[mine[0]])
        if number not in wanted:
            batch.others[number] = (mine.size, first + int(mine[0]))
            continue
        long = messages.lengths[mine] > MAX_MESSAGE_BYTES
        if long.any():
            batch.rejects.append(
                rejects(first + mine[long], f"a message has more than {MAX_MESSAGE_BYTES:,} bytes")
            )
            mine = mine[~long]
        if mine.size:
            batch.wanted[number] = TopicMessages(
                messages.octets,
                messages.starts[mine],
                messages.lengths[mine],
                first + mine,
                messages.stamps_ns[mine],
            )
    return batch


def rejects(records: _Integers, reason: str) -> Rejects:
    """Return rejects of one message each."""
    return Rejects(records, np.ones(records.size, np.int64), reason)


@dataclass(frozen=True, slots=True)
class LostMessages:
    """So many messages that cannot be read, and why."""

    count: int
    reason: str


class ChunkedLog:
    """A file whose messages lie in chunks.

    Attributes:
        records: how many messages were met so far, lost ones included.
        expected: how many messages the file says that it has, 0 where it does not say.
        unverified: how many chunks have a wrong checksum and were read all the same.
    """

    def __init__(self) -> None:
        self.records = self.expected = self.unverified = 0
        self._numbers: dict[tuple[str, str, str], int] = {}
        self._topics: list[BagTopic] = []

    @property
    def topics(self) -> tuple[BagTopic, ...]:
        """All topics."""
        return tuple(self._topics)

    def topic_number(self, name: str, kind: str, encoding: str, definition: str, form: str) -> int:
        """Return the number of a topic; connections that tell the same of it are one.

        Raises:
            LimitError: there are too many.
        """
        number = self._numbers.setdefault((name, kind, definition), len(self._topics))
        if number == len(self._topics):
            if number >= MAX_TOPICS:
                raise LimitError(f"the bag declares more than {MAX_TOPICS:,} topics")
            self._topics.append(BagTopic(number, name, kind, encoding, definition, form))
        return number

    def parts(self) -> Iterator[RawMessages | LostMessages]:
        """Yield what is in the chunks, in file order."""
        raise NotImplementedError

    def batches(self, wanted: frozenset[int]) -> Iterator[MessageBatch | Reject]:
        """See :class:`MessageLog`."""
        filling = _BatchBuilder()
        for part in self.parts():
            if isinstance(part, RawMessages) and not filling.add(part):
                continue
            yield from self._poured(filling, wanted)
            if isinstance(part, LostMessages):
                yield Reject(self.records, part.count, part.reason)
                self.records += part.count
        yield from self._poured(filling, wanted)

    def _poured(self, filling: "_BatchBuilder", wanted: frozenset[int]) -> Iterator[MessageBatch]:
        if filling.parts:
            messages = filling.pour()
            yield batch_of(messages, self.records, wanted)
            self.records += messages.numbers.size


class _BatchBuilder:
    """Messages of successive chunks, put together until they are worth handing on."""

    def __init__(self) -> None:
        self.parts: list[RawMessages] = []

    def add(self, messages: RawMessages) -> bool:
        """Take a chunk's messages; return whether it is enough."""
        if messages.numbers.size:
            self.parts.append(messages)
        count = sum(part.numbers.size for part in self.parts)
        return (
            count >= BATCH_MESSAGES or sum(part.octets.size for part in self.parts) >= BATCH_BYTES
        )

    def pour(self) -> RawMessages:
        """Return what was taken, and start anew."""
        parts, self.parts = self.parts, []
        if len(parts) == 1:
            return parts[0]
        bases = np.cumsum([0, *(part.octets.size for part in parts[:-1])]).tolist()
        return RawMessages(
            np.concatenate([part.octets for part in parts]),
            np.concatenate([part.numbers for part in parts]),
            np.concatenate([part.stamps_ns for part in parts]),
            np.concatenate([part.starts + base for part, base in zip(parts, bases, strict=True)]),
            np.concatenate([part.lengths for part in parts]),
        )
