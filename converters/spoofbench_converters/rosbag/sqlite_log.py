"""ROS 2 bags in SQLite: messages in bag order, by topic, read around damage.

The pages of a sound bag are read as arrays (see :mod:`spoofbench_converters.rosbag.pages`). What
follows the first page that is unusual or damaged is read by queries: rows are fetched some hundreds
at a time and their messages joined by topic.
"""

from collections.abc import Iterator
from itertools import compress, islice
from pathlib import Path
from typing import Any
from urllib.parse import quote

import apsw
import numpy as np
from numpy.typing import NDArray

from spoofbench.conversion import Reject, Rejects
from spoofbench.errors import ConversionError
from spoofbench_converters.rosbag.batches import (
    BATCH_MESSAGES,
    MAX_MESSAGE_BYTES,
    BagTopic,
    MessageBatch,
    RawMessages,
    TopicMessages,
    batch_of,
)
from spoofbench_converters.rosbag.definitions import normal_name
from spoofbench_converters.rosbag.pages import FIRST_KEY, LAST_KEY, Pages, UnsupportedPage

MAGIC = b"SQLite format 3\0"
FETCHED_MESSAGES = 512
BUSY_MS = 2000

_WAL = 2  # bytes 18 and 19 of the header: the file format's write and read version

# What is of another type than a bag's is not even read: text need not be text.
_TOPICS = (
    "SELECT id, name, type, serialization_format FROM topics WHERE typeof(id) = 'integer' ORDER BY "
    "id"
)
_DEFINITIONS = "SELECT topic_type, encoded_message_definition, encoding FROM message_definitions"
_MAX_TOPICS = 4096
_MESSAGES = """
SELECT id,
    CASE typeof(topic_id) WHEN 'integer' THEN topic_id END,
    CASE typeof(timestamp) WHEN 'integer' THEN timestamp END,
    CASE WHEN topic_id IN ({wanted}) AND typeof(data) = 'blob' THEN data END
FROM messages WHERE id > ? ORDER BY id
"""

_Row = tuple[Any, ...]


class SqliteLog:
    """An open database; see :class:`spoofbench_converters.rosbag.batches.MessageLog`."""

    def __init__(self, path: Path) -> None:
        """Open a database read-only.

        Raises:
            ConversionError: it is locked, or damaged beyond reading its topics, or no bag.
        """
        self.records = self.unverified = 0
        self._name = path.name
        try:
            self._database = connect(path)
            self._database.execute("BEGIN")  # one state of the bag is read, whoever writes to it
            if not tables(self._database) >= {"topics", "messages"}:
                raise ConversionError(
                    f"{path.name!r} is an SQLite database, but no ROS 2 bag: it lacks the tables "
                    "'topics' and 'messages'"
                )
            rows: list[Any] = list(islice(self._database.execute(_TOPICS), _MAX_TOPICS))
        except (apsw.Error, UnicodeDecodeError) as error:
            raise ConversionError(f"the bag {path.name!r} cannot be read: {error}") from error
        texts = self._definitions()
        self.topics = tuple(
            BagTopic(
                number, str(name), normal_name(str(kind)), str(encoding), *texts.get(kind, ("", ""))
            )
            for number, name, kind, encoding in rows
        )

    def close(self) -> None:
        """Close the database."""
        self._database.close()

    @property
    def expected(self) -> int:
        """The highest message key: in an undamaged bag, the number of messages; 0 where it cannot
        be read.
        """
        try:
            rows: list[Any] = self._database.execute("SELECT max(id) FROM messages").fetchall()
        except apsw.Error:
            return 0
        return int(rows[0][0] or 0)

    def _definitions(self) -> dict[Any, tuple[str, str]]:
        """Return the definitions that bags have since ROS 2 Iron, and their format, by type."""
        if "message_definitions" not in tables(self._database):
            return {}
        try:
            rows: list[Any] = list(islice(self._database.execute(_DEFINITIONS), _MAX_TOPICS))
        except (apsw.Error, UnicodeDecodeError):
            return {}
        return {kind: (str(text), str(form)) for kind, text, form in rows}

    def batches(self, wanted: frozenset[int]) -> Iterator[MessageBatch | Reject]:
        """Yield all messages in bag order; of the topics that are not wanted, only how many there
        are.
        """
        last = FIRST_KEY
        try:
            for cells in Pages(self._database).cells(wanted):
                messages = RawMessages(
                    cells.octets, cells.topics, cells.stamps_ns, cells.starts, cells.lengths
                )
                yield batch_of(messages, self.records, wanted)
                self.records += cells.keys.size
                last = int(cells.keys[-1])
        except (UnsupportedPage, apsw.Error):
            pass
        else:
            return
        yield from self._by_queries(wanted, last)

    def _by_queries(
        self, wanted: frozenset[int], last: int | None
    ) -> Iterator[MessageBatch | Reject]:
        """Yield the messages after a key."""
        query = _MESSAGES.format(wanted=", ".join(map(str, sorted(wanted))) or "NULL")
        while last is not None:
            rows = _Rows(self._database, query, last)
            filling = _BatchBuilder(wanted)
            while fetched := rows.fetch(FETCHED_MESSAGES):
                filling.add(fetched, self.records)
                self.records += len(fetched)
                if filling.messages >= BATCH_MESSAGES:
                    yield filling.batch()
                    filling = _BatchBuilder(wanted)
            if filling.messages:
                yield filling.batch()
            if rows.failure is None:
                return
            reject, last = self._around(rows.failure, query, max(rows.last, 0))
            self.records += reject.length
            yield reject

    def _around(self, failure: apsw.Error, query: str, last: int) -> tuple[Reject, int | None]:
        """Return what was lost after a message, and the key after which to go on, None where
        nothing follows.
        """
        if isinstance(failure, apsw.BusyError | apsw.LockedError):
            raise ConversionError(
                f"the bag {self._name!r} is locked by another program; close it there first"
            ) from failure
        reason = f"the database is damaged here ({failure})"
        if isinstance(failure, apsw.TooBigError):
            reason = f"a message has more than {MAX_MESSAGE_BYTES:,} bytes"
        highest = self.expected
        following = self._next_readable(query, last + 1, highest)
        if following is None:
            reason += "; nothing after it can be read"
        lost = (max(highest + 1, last + 2) if following is None else following) - last - 1
        return Reject(self.records, lost, reason), None if following is None else following - 1

    def _next_readable(self, query: str, bad: int, highest: int) -> int | None:
        """Return the first key after a bad one from which a message can be read."""
        furthest = min(max(highest, 1 << 40), LAST_KEY)
        step, good = 1, None
        while good is None:
            if bad + step > furthest:
                return None
            good = self._first_from(query, bad + step)
            if good is None:
                bad, step = bad + step, step * 2
        while bad + 1 < good:
            middle = (bad + good) // 2
            found = self._first_from(query, middle)
            if found is None or found > good:
                bad = middle
            elif found == good:
                return good
            else:
                good = found
        return good

    def _first_from(self, query: str, key: int) -> int | None:
        """Return the key of the first message from a key on, None where it cannot be read or there
        is none.
        """
        rows = _Rows(self._database, query, key - 1)
        return rows.last if rows.fetch(1) else None


class _Rows:
    """Rows of a query up to its end or to the first that cannot be read, or whose key is not above
    the last.

    Attributes:
        last: key of the last row, at first the one after which the query starts.
        failure: why reading ended, None at the end.
    """

    def __init__(self, database: apsw.Connection, query: str, after: int) -> None:
        self.last = after
        self.failure: apsw.Error | None = None
        self._cursor: Iterator[_Row] = iter(())
        try:
            self._cursor = database.execute(query, (after,))
        except apsw.Error as error:
            self.failure = error

    def fetch(self, most: int) -> list[_Row]:
        """Return the next rows, none at the end."""
        rows: list[_Row] = []
        if self.failure is None:
            try:
                rows.extend(
                    islice(self._cursor, most)
                )  # what came before an error stays in the list
            except apsw.Error as error:
                self.failure = error
        for place, row in enumerate(rows):
            if not isinstance(row[0], int) or row[0] <= self.last:
                self.failure = apsw.CorruptError("keys are out of order")
                return rows[:place]
            self.last = row[0]
        return rows


class _BatchBuilder:
    """A batch being filled."""

    def __init__(self, wanted: frozenset[int]) -> None:
        self.messages = 0
        self._joined: dict[int, bytearray] = {number: bytearray() for number in wanted}
        self._parts: dict[int, list[tuple[Any, ...]]] = {number: [] for number in wanted}
        self._others: dict[int, tuple[int, int]] = {}
        self._rejects: list[Reject | Rejects] = []

    def add(self, rows: list[_Row], first: int) -> None:
        """Take rows, the first of which has this ordinal in the bag."""
        self.messages += len(rows)
        records = np.arange(first, first + len(rows))
        try:
            self._sort(rows, records)
        except (
            TypeError
        ):  # a column holds something else than it must: rare, so looked for only now
            good = [self._is_good(row) for row in rows]
            kept = np.array(good)
            self._rejects += [
                Reject(record, 1, "a message's row is not of the types that a bag has")
                for record in records[~kept].tolist()
            ]
            if kept.any():
                self._sort(list(compress(rows, good)), records[kept])

    def _sort(self, rows: list[_Row], records: NDArray[np.int64]) -> None:
        _, numbers, stamps, messages = zip(*rows, strict=True)
        topics, stamps_ns = np.array(numbers), np.array(stamps)
        if topics.dtype != np.int64 or stamps_ns.dtype != np.int64:
            raise TypeError
        parts, others = {}, {}
        for number in set(numbers):
            mine = topics == number
            if number in self._joined:
                chosen = list(compress(messages, mine.tolist()))
                parts[number] = (
                    b"".join(chosen),
                    np.fromiter(map(len, chosen), np.int64, len(chosen)),
                    records[mine],
                    stamps_ns[mine],
                )
            else:
                count, start = self._others.get(number, (0, int(records[mine][0])))
                others[number] = (count + int(mine.sum()), start)
        self._others |= others
        for number, (joined, *arrays) in parts.items():
            self._joined[number] += joined
            self._parts[number].append(tuple(arrays))

    def _is_good(self, row: _Row) -> bool:
        return (
            isinstance(row[1], int)
            and isinstance(row[2], int)
            and (isinstance(row[3], bytes) or row[1] not in self._joined)
        )

    def batch(self) -> MessageBatch:
        """Return what was taken."""
        wanted = {
            number: _payloads(
                self._joined[number],
                *(np.concatenate(column) for column in zip(*parts, strict=True)),
            )
            for number, parts in self._parts.items()
            if parts
        }
        return MessageBatch(wanted, self._others, self._rejects)


def _payloads(
    joined: bytearray, lengths: NDArray[np.int64], *about: NDArray[np.int64]
) -> TopicMessages:
    return TopicMessages(
        np.frombuffer(joined, np.uint8), np.cumsum(lengths) - lengths, lengths, *about
    )


def connect(path: Path) -> apsw.Connection:
    """Open a database read-only, leaving no trace beside it.

    Raises:
        apsw.Error: it cannot be opened.
    """
    with path.open("rb") as file:
        head = file.read(20)
    write_ahead = Path(f"{path}-wal")
    settled = head[18:19] == bytes([_WAL]) and not (
        write_ahead.exists() and write_ahead.stat().st_size
    )
    # A settled write-ahead database is opened as immutable: else SQLite creates files beside it.
    uri = f"file:{quote(str(path.resolve()))}?mode=ro{'&immutable=1' if settled else ''}"
    database = apsw.Connection(uri, flags=apsw.SQLITE_OPEN_READONLY | apsw.SQLITE_OPEN_URI)
    database.set_busy_timeout(BUSY_MS)
    database.limit(apsw.SQLITE_LIMIT_LENGTH, MAX_MESSAGE_BYTES)
    # Tables alone are read, no code in the schema runs, and a file shorter than its header says
    # opens nevertheless.
    for pragma in ("trusted_schema=OFF", "cell_size_check=ON", "writable_schema=ON"):
        database.execute(f"PRAGMA {pragma}")
    return database


def tables(database: apsw.Connection) -> set[str]:
    """Return the names of the tables, views left out."""
    return {
        row[0] for row in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
    }
