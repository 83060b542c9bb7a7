"""ROS 2 bags in SQLite: opened read-only, streamed in bag order, read around damage."""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any
from urllib.parse import quote

import apsw

from spoofbench.converting import Reject
from spoofbench.errors import ConversionError

SQLITE_MAGIC = b"SQLite format 3\0"
MAX_MESSAGE_BYTES = 16_384
MAX_METADATA_BYTES = 4_194_304
SLAB_MESSAGES = 16_384
FETCHED_MESSAGES = 512
BUSY_MS = 2000

_WAL = 2  # bytes 18 and 19 of the header: the file format's write and read version


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic of a bag; ``number`` is its key in the bag."""

    number: int
    name: str
    type: str
    encoding: str


@dataclass(frozen=True, slots=True)
class Slab:
    """Successive messages of a bag, sequences of one length.

    Attributes:
        first: ordinal of the first message in the bag.
        topics: number of the topic of each.
        stamps_ns: the recorder's stamps.
        payloads: bytes of the wanted topics, None for the rest.
    """

    first: int
    topics: list[Any]
    stamps_ns: list[Any]
    payloads: list[Any]


@dataclass(frozen=True, slots=True)
class Location:
    """Where a bag's database is, and how many messages its metadata declare (None: not said)."""

    database: Path
    declared: int | None


def locate(path: Path) -> Location:
    """Return the database of a bag folder, or of a bare ``.db3``.

    Raises:
        ConversionError: a kind of bag that cannot be read yet, or no bag at all.
    """
    if path.is_file():
        with path.open("rb") as file:
            head = file.read(16)
        if head != SQLITE_MAGIC:
            raise ConversionError(f"{path.name!r} is {_what(head)}, which cannot be converted yet; give a ROS 2 bag in SQLite")
        return Location(path, None)
    about = _metadata(path / "metadata.yaml")
    storage, files = about.get("storage_identifier"), about.get("relative_file_paths")
    if about.get("compression_mode") not in (None, "", "none", "NONE"):
        raise ConversionError(f"the bag {path.name!r} is compressed ({about['compression_mode']!r}); decompress it with `ros2 bag convert`")
    if storage != "sqlite3":
        raise ConversionError(f"the bag {path.name!r} is stored as {storage!r}, which cannot be converted yet; store it as 'sqlite3'")
    if not isinstance(files, list) or len(files) != 1:
        count = len(files) if isinstance(files, list) else 0
        raise ConversionError(f"the bag {path.name!r} is split into {count} files; merge it with `ros2 bag convert`")
    database = path / Path(str(files[0])).name
    if not database.is_file():
        raise ConversionError(f"the bag {path.name!r} lacks its database {database.name!r}")
    declared = about.get("message_count")
    return Location(database, declared if isinstance(declared, int) else None)


def is_bag(path: Path) -> bool:
    """Whether a database has the tables of a bag, or a folder the metadata of one."""
    if path.is_dir():
        try:
            with (path / "metadata.yaml").open("rb") as file:
                return b"rosbag2_bagfile_information" in file.read(4096)
        except OSError:
            return False
    try:
        with closing(_connect(path)) as database:
            return _tables(database) >= {"topics", "messages"}
    except apsw.Error:
        return False


class Bag:
    """An open bag."""

    def __init__(self, path: Path) -> None:
        """Open a database read-only.

        Raises:
            ConversionError: it is locked, or damaged beyond reading its topics.
        """
        self._name = path.name
        try:
            self._database = _connect(path)
            if not _tables(self._database) >= {"topics", "messages"}:
                raise ConversionError(f"{path.name!r} is an SQLite database, but no ROS 2 bag: it lacks the tables 'topics' and 'messages'")
            rows = self._database.execute("SELECT id, name, type, serialization_format FROM topics ORDER BY id").fetchall()
        except apsw.Error as error:
            raise ConversionError(f"the bag {path.name!r} cannot be read: {error}") from error
        self.topics = tuple(Topic(int(row[0]), *map(str, row[1:])) for row in rows)

    def close(self) -> None:
        """Close the database."""
        self._database.close()

    def highest_id(self) -> int:
        """Return the highest message key: in an undamaged bag, the number of messages; 0 where it cannot be read."""
        try:
            highest: Any = self._database.execute("SELECT max(id) FROM messages").fetchall()[0][0]
        except apsw.Error:
            return 0
        return int(highest) if highest else 0

    def slabs(self, wanted: frozenset[int]) -> Iterator[Slab | Reject]:
        """Yield all messages in bag order, those of other topics without their payload."""
        payload = "data"
        if wanted < {topic.number for topic in self.topics}:
            payload = f"CASE WHEN topic_id IN ({', '.join(map(str, sorted(wanted))) or 'NULL'}) THEN data END"
        query = f"SELECT id, topic_id, timestamp, {payload} FROM messages WHERE id > ? ORDER BY id"  # noqa: S608 - numbers of our own
        ordinal, last = 0, -(2**63)
        while True:
            try:
                for ids, *columns in self._pieces(query, last):
                    yield Slab(ordinal, *columns)
                    ordinal, last = ordinal + len(ids), ids[-1]
            except (apsw.BusyError, apsw.LockedError) as error:
                raise ConversionError(f"the bag {self._name!r} is locked by another program; close it there first") from error
            except apsw.Error as error:
                following = self._next_readable(query, last)
                lost = (following if following is not None else max(self.highest_id() + 1, last + 2)) - max(last, 0) - 1
                if lost > 0:
                    yield Reject(ordinal, lost, _damage(error))
                if following is None:
                    return
                ordinal, last = ordinal + lost, following - 1
            else:
                return

    def _pieces(self, query: str, after: int) -> Iterator[tuple[list[Any], ...]]:
        """Yield columns in slabs; what stands before damage comes before its error."""
        cursor = self._database.execute(query, (after,))
        columns: tuple[list[Any], ...] = ([], [], [], [])
        rows, failure = _fetch(cursor)
        while rows:
            # Few rows at a time: tuples that live long cost the garbage collector more than the reading.
            for column, values in zip(columns, zip(*rows, strict=True), strict=True):
                column += values
            if len(columns[0]) >= SLAB_MESSAGES:
                yield columns
                columns = ([], [], [], [])
            if failure:
                break
            rows, failure = _fetch(cursor)
        if columns[0]:
            yield columns
        if failure:
            raise failure

    def _next_readable(self, query: str, last: int) -> int | None:
        """Return the first key after the damage from which a message can be read; None where there is none."""
        bad, step = max(last, 0) + 1, 1
        while (good := self._first_from(query, bad + step)) is None:
            if bad + step > max(self.highest_id(), 1 << 40):
                return None
            bad, step = bad + step, step * 2
        low = bad
        while low + 1 < good:
            middle = (low + good) // 2
            found = self._first_from(query, middle)
            if found is None:
                low = middle
            elif found >= good:
                good = min(good, found)
                break
            else:
                good = found
        return good

    def _first_from(self, query: str, key: int) -> int | None:
        try:
            row = next(self._database.execute(query, (key - 1,)), None)
        except apsw.Error:
            return None
        return None if row is None else int(row[0])


def _fetch(cursor: apsw.Cursor) -> tuple[list[tuple[Any, ...]], apsw.Error | None]:
    """Return the next rows, and the error that ends them."""
    rows: list[tuple[Any, ...]] = []
    try:
        rows.extend(islice(cursor, FETCHED_MESSAGES))  # what came before an error stays in the list
    except apsw.Error as error:
        return rows, error
    return rows, None


def _connect(path: Path) -> apsw.Connection:
    with path.open("rb") as file:
        head = file.read(20)
    write_ahead = Path(f"{path}-wal")
    settled = head[18:19] == bytes([_WAL]) and not (write_ahead.exists() and write_ahead.stat().st_size)
    # A settled write-ahead database is opened as immutable: else SQLite creates files beside it.
    uri = f"file:{quote(str(path.resolve()))}?mode=ro{'&immutable=1' if settled else ''}"
    database = apsw.Connection(uri, flags=apsw.SQLITE_OPEN_READONLY | apsw.SQLITE_OPEN_URI)
    database.set_busy_timeout(BUSY_MS)
    database.limit(apsw.SQLITE_LIMIT_LENGTH, MAX_MESSAGE_BYTES)
    # Tables alone are read, no code in the schema runs, and a file shorter than its header says opens nevertheless.
    for pragma in ("trusted_schema=OFF", "cell_size_check=ON", "writable_schema=ON"):
        database.execute(f"PRAGMA {pragma}")
    return database


def _damage(error: apsw.Error) -> str:
    if isinstance(error, apsw.TooBigError):
        return f"a message has more than {MAX_MESSAGE_BYTES:,} bytes"
    return f"the database is damaged here ({error})"


def _tables(database: apsw.Connection) -> set[str]:
    return {row[0] for row in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}


def _metadata(path: Path) -> dict[str, Any]:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        if path.stat().st_size > MAX_METADATA_BYTES:
            raise ConversionError(f"{path.name!r} of the bag {path.parent.name!r} is larger than {MAX_METADATA_BYTES:,} bytes")
        content = YAML(typ="safe").load(path.read_text("utf-8"))
        about = content["rosbag2_bagfile_information"]
    except (OSError, UnicodeDecodeError, YAMLError, KeyError, TypeError) as error:
        raise ConversionError(f"{path.name!r} of the bag {path.parent.name!r} cannot be read: {type(error).__name__}") from error
    if not isinstance(about, dict):
        raise ConversionError(f"{path.name!r} of the bag {path.parent.name!r} does not describe a bag")
    return about


def _what(head: bytes) -> str:
    known = {b"#ROSBAG": "a ROS 1 bag", b"\x89MCAP0": "an MCAP file", b"\x28\xb5\x2f\xfd": "a compressed file"}
    return next((name for magic, name in known.items() if head.startswith(magic)), "no SQLite database")
