"""A bag of any kind: the messages of its files, one after the other."""

import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

from spoofbench.conversion import Reject
from spoofbench.errors import ConversionError, SpoofbenchError
from spoofbench_converters.rosbag import mcap_log, ros1_log, sqlite_log
from spoofbench_converters.rosbag.batches import BagTopic, MessageBatch, MessageLog
from spoofbench_converters.rosbag.locating import Location, Named, is_plain
from spoofbench_converters.rosbag.unpacking import unpacked_messages

_HEAD_BYTES = 4096
_COPIED_BYTES = 1 << 20


class Bag:
    """An open bag.

    Attributes:
        topics: all topics of all files.
        records: how many messages were met so far, lost ones included.
        expected: how many messages it says that it has, 0 where it does not say.
        unverified: how many chunks have a wrong checksum and were read all the same.
    """

    def __init__(self, location: Location) -> None:
        """Look into the files.

        Raises:
            ConversionError: none can be read.
        """
        self.records, self.expected, self.unverified = 0, location.declared, 0
        self._location = location
        self._numbers: dict[tuple[str, str, str, str], int] = {}
        self._failures: dict[int, str] = {}
        self._open: _File | None = None
        topics: list[BagTopic] = []
        for place, named in enumerate(location.files):
            try:
                file = _File(named)
            except SpoofbenchError as error:
                if len(location.files) == 1:
                    raise
                self._failures[place] = str(error)
                continue
            topics += [self._number(topic) for topic in file.log.topics]
            if len(location.files) == 1:
                self._open, self.expected = file, location.declared or file.log.expected
            else:
                file.close()
        if len(self._failures) == len(location.files):
            raise ConversionError(next(iter(self._failures.values())))
        self.topics: Sequence[BagTopic] = tuple({topic.number: topic for topic in topics}.values())

    def _number(self, topic: BagTopic) -> BagTopic:
        key = (topic.name, topic.type, topic.encoding, topic.definition)
        return replace(topic, number=self._numbers.setdefault(key, len(self._numbers)))

    def close(self) -> None:
        """Let go of the files."""
        if self._open is not None:
            self._open.close()

    def batches(self, wanted: frozenset[int]) -> Iterator[MessageBatch | Reject]:
        """Yield all messages in bag order; of the topics that are not wanted, only how many there
        are.
        """
        for place, named in enumerate(self._location.files):
            if place in self._failures:
                count = self._location.counts[place] or 1
                yield Reject(
                    self.records,
                    count,
                    f"a file of the bag cannot be read: {self._failures[place]}",
                )
                self.records += count
                continue
            file = self._open = self._open or _File(named)
            yield from self._batches_of(file.log, wanted)
            self.unverified += file.log.unverified
            file.close()
            self._open = None

    def _batches_of(
        self, log: MessageLog, wanted: frozenset[int]
    ) -> Iterator[MessageBatch | Reject]:
        base = self.records
        numbers = {topic.number: self._number(topic).number for topic in log.topics}
        for item in log.batches(
            frozenset(number for number, mine in numbers.items() if mine in wanted)
        ):
            if isinstance(item, Reject):
                yield replace(item, offset=item.offset + base)
            else:
                yield _renumbered(unpacked_messages(item), numbers, base)
            self.records = base + log.records
        self.records = base + log.records


def _renumbered(batch: MessageBatch, numbers: Mapping[int, int], base: int) -> MessageBatch:
    """Return a file's batch as one of the bag: its topics by their numbers there, its records after
    those of the files before.
    """
    if not base and all(number == mine for number, mine in numbers.items()):
        return batch
    wanted = {
        numbers[number]: replace(messages, records=messages.records + base)
        for number, messages in batch.wanted.items()
    }
    others = {
        numbers.get(number, -1 - number): (count, first + base)
        for number, (count, first) in batch.others.items()
    }
    rejects = [
        replace(reject, offset=reject.offset + base)
        if isinstance(reject, Reject)
        else replace(reject, offsets=reject.offsets + base)
        for reject in batch.rejects
    ]
    return MessageBatch(wanted, others, rejects)


class _File:
    """One file of a bag, unpacked to a temporary place where it is packed."""

    def __init__(self, file: Named | None) -> None:
        """Open a file.

        Raises:
            ConversionError: it is missing, or no bag.
        """
        if file is None:
            raise ConversionError("it is missing")
        self._temporary: Path | None = None
        with file.open() as stream:
            head = stream.read(_HEAD_BYTES)
            kind = next(
                (opener for magic, opener in _KINDS.items() if head.startswith(magic)), None
            )
            if kind is None:
                raise ConversionError(
                    f"{file.path.name!r} is no bag: neither a ROS 1 bag, nor an SQLite database, "
                    "nor an MCAP file"
                )
            path = file.path if is_plain(file, head[:16]) else self._unpacked(head, stream)
        try:
            self.log: MessageLog = kind(path)
        except BaseException:
            self._remove()
            raise

    def close(self) -> None:
        """Let go of the file."""
        self.log.close()
        self._remove()

    def _unpacked(self, head: bytes, stream: IO[bytes]) -> Path:
        handle, name = tempfile.mkstemp(prefix="spoofbench-", suffix=".bag")
        self._temporary = Path(name)
        try:
            with os.fdopen(handle, "wb") as copy:
                piece = head
                while piece:
                    copy.write(piece)
                    piece = stream.read(_COPIED_BYTES)
        except OSError as error:
            self._remove()
            raise ConversionError(
                f"there is no room to unpack the bag in {tempfile.gettempdir()!r}: {error.strerror}"
            ) from error
        except SpoofbenchError:
            # What was unpacked before the damage is a bag that was cut off.
            return self._temporary
        return self._temporary

    def _remove(self) -> None:
        if self._temporary is not None:
            self._temporary.unlink(missing_ok=True)


_KINDS: dict[bytes, Any] = {
    b"#ROSBAG": ros1_log.Ros1Log,
    mcap_log.MAGIC: mcap_log.McapLog,
    sqlite_log.MAGIC: sqlite_log.SqliteLog,
}
