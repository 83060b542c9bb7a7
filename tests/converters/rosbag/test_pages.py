"""What is read from a database's pages is what queries give, message by message, also where the
database is odd or damaged.
"""

import random
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from spoofbench_converters.rosbag import batches, pages, sqlite_log
from spoofbench_converters.rosbag.pages import Pages, UnsupportedPage

from spoofbench.conversion import Reject
from spoofbench.errors import ConversionError

MESSAGES = (
    "CREATE TABLE messages(id INTEGER PRIMARY KEY,topic_id INTEGER NOT NULL,timestamp INTEGER NOT "
    "NULL, data BLOB NOT NULL)"
)
TOPICS = (
    "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)"
)
WANTED = frozenset({0, 1, 2, 300})
DECLARED = WANTED | {3, 1000}
STAMPS = (
    0,
    1,
    -1,
    127,
    -128,
    40_000,
    -9_000_000,
    2**31,
    -(2**40),
    2**47,
    2**62,
    -(2**63),
    1_700_000_000_000_000_000,
)
LEAF = 13
SIZES = (0, 1, 57, 58, 100, 164, 796)

Row = tuple[Any, Any, Any, Any]


class Blob(NamedTuple):
    """So many bytes."""

    size: int


@dataclass(frozen=True)
class Shape:
    """How a bag's database is made."""

    page_bytes: int
    auto_vacuum: int = 0
    indexed: bool = True
    count: int = 400
    shuffled: bool = False
    deleted: float = 0.0
    odd: tuple[Row, ...] = ()
    seed: int = 0


def make(path: Path, shape: Shape) -> None:
    """Write a bag; rows that the table's constraints forbid are written before it says them."""
    chance = random.Random(shape.seed)
    keys = list(range(1, shape.count + 1))
    rows: list[Row] = [
        (
            key,
            chance.choice((*sorted(DECLARED), 99)),
            chance.choice(STAMPS),
            chance.randbytes(chance.choice(SIZES)),
        )
        for key in keys
    ]
    if shape.shuffled:
        chance.shuffle(rows)
    with closing(sqlite3.connect(path)) as database:
        database.execute(f"PRAGMA page_size={shape.page_bytes}")
        database.execute(f"PRAGMA auto_vacuum={shape.auto_vacuum}")
        database.execute(TOPICS)
        database.execute(MESSAGES.replace(" NOT NULL", ""))
        if shape.indexed:
            database.execute("CREATE INDEX timestamp_idx ON messages (timestamp ASC)")
        database.executemany(
            "INSERT INTO topics VALUES (?, '/a', 'b/msg/C', 'cdr')",
            [(number,) for number in sorted(DECLARED)],
        )
        database.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", rows)
        gone = [row for row in rows if chance.random() < shape.deleted]
        database.executemany("DELETE FROM messages WHERE id = ?", [row[:1] for row in gone])
        database.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", gone[::2])
        database.executemany(
            "INSERT OR REPLACE INTO messages VALUES (?, ?, ?, ?)",
            [
                (*row, bytes(data.size) if isinstance(data, Blob) else data)
                for *row, data in shape.odd
            ],
        )
        database.execute("PRAGMA writable_schema=ON")
        database.execute("UPDATE sqlite_master SET sql = ? WHERE name = 'messages'", (MESSAGES,))
        database.commit()


@dataclass
class Content:
    """What reading gave: messages and rejects by ordinal, other topics, how many records; or a
    refusal.
    """

    messages: dict[int, tuple[int, int, bytes]] = field(default_factory=dict)
    others: dict[int, tuple[int, int]] = field(default_factory=dict)
    rejects: list[Reject] = field(default_factory=list)
    records: int = 0
    refusal: str = ""


def content(path: Path) -> Content:
    result = Content()
    try:
        log = sqlite_log.SqliteLog(path)
        with closing(log):
            for batch in log.batches(WANTED):
                _add(result, batch)
            result.records = log.records
    except ConversionError as error:
        result.refusal = str(error)
    return result


def _add(result: Content, batch: batches.MessageBatch | Reject) -> None:
    if isinstance(batch, Reject):
        result.rejects.append(batch)
        return
    result.rejects += batch.rejects
    for number, (count, first) in batch.others.items():
        before, first = result.others.get(number, (0, first))
        result.others[number] = (before + count, first)
    for number, mine in batch.wanted.items():
        for record, stamp, start, length in zip(
            *map(list, (mine.records, mine.stamps_ns, mine.starts, mine.lengths)), strict=True
        ):
            assert record not in result.messages
            result.messages[int(record)] = (
                number,
                int(stamp),
                mine.octets[start : start + length].tobytes(),
            )


def by_queries(path: Path) -> Content:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Pages, "cells", _unusual)
        return content(path)


def _unusual(*_: Any) -> Iterator[Any]:
    raise UnsupportedPage


def by_pages_alone(path: Path) -> Content:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sqlite_log.SqliteLog, "_by_queries", _refuse)
        return content(path)


def _refuse(*_: Any) -> Iterator[Any]:
    raise AssertionError("pages of a sound bag must be understood")


shapes = st.builds(
    Shape,
    page_bytes=st.sampled_from([2**power for power in range(9, 17)]),
    auto_vacuum=st.integers(0, 2),
    indexed=st.booleans(),
    count=st.integers(0, 400),
    shuffled=st.booleans(),
    deleted=st.sampled_from([0.0, 0.1, 0.9]),
    seed=st.integers(0, 2**32),
)
odd_rows = st.lists(
    st.tuples(
        st.integers(-5, 450)
        | st.sampled_from([2**20, 2**40, 2**56 - 1, 2**56, 2**63 - 1, -(2**63)]),
        st.sampled_from([*DECLARED, 99, -5, 2**40]) | st.sampled_from([None, "text", 1.5, b"blob"]),
        st.sampled_from(STAMPS) | st.sampled_from([None, "noon", 0.25, b""]),
        st.sampled_from([None, "text", 7, 0.5])
        | st.sampled_from([0, 400, 4057, 4058, 16_383, 16_384, 16_385, 70_000, 200_000]).map(Blob),
    ),
    max_size=8,
).map(tuple)


@given(shape=shapes, batch_bytes=st.sampled_from([1, 20_000, 4_000_000]))
@settings(max_examples=60, deadline=None)
def test_sound_bags_are_read_from_their_pages_alone(shape: Shape, batch_bytes: int) -> None:
    shape = Shape(
        **{**shape.__dict__, "page_bytes": max(shape.page_bytes, 1024)}
    )  # so that no message overflows its page
    with TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setattr(pages, "BATCH_BYTES", batch_bytes)
        path = Path(folder) / "bag.db3"
        make(path, shape)
        queried = by_queries(path)
        assert not queried.rejects
        assert not queried.refusal
        assert queried.records or not shape.count
        same = (by_pages_alone(path) if queried.records else content(path)) == queried
        assert same


@given(shape=shapes, odd=odd_rows, batch_bytes=st.sampled_from([1, 20_000, 4_000_000]))
@example(shape=Shape(65_536), odd=((9, 1, 1, Blob(16_385)),), batch_bytes=1)
@example(
    shape=Shape(65_536), odd=((9, 3, 1, Blob(16_385)), (10, 99, 1, Blob(200_000))), batch_bytes=1
)
@settings(max_examples=150, deadline=None)
def test_odd_rows_are_read_as_queries_read_them(
    shape: Shape, odd: tuple[Row, ...], batch_bytes: int
) -> None:
    with TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setattr(pages, "BATCH_BYTES", batch_bytes)
        path = Path(folder) / "bag.db3"
        make(path, Shape(**{**shape.__dict__, "odd": odd}))
        same = content(path) == by_queries(path)
        assert same


def structure(octets: bytes, page_bytes: int, page: int, where: int, cell: int) -> int:
    """Return a place that says something of a database's structure: in its header, or in a page's
    head, pointers or cells.
    """
    start = page * page_bytes
    if page == 0:
        return 16 + where
    if where < 12:
        return start + where
    pointers = start + (8 if octets[start] == LEAF else 12)
    pointer = pointers + 2 * (cell % max(int.from_bytes(octets[start + 3 : start + 5]), 1))
    if where < 14:
        return pointer + where - 12
    return start + int.from_bytes(octets[pointer : pointer + 2]) + where - 14


damages = st.tuples(
    st.integers(0, 2**16),
    st.integers(0, 32),
    st.integers(0, 2**16),
    st.sampled_from([1, 2, 3, 4, 8, 64, 128, 255]) | st.integers(1, 255),
)


@pytest.mark.slow
@given(
    shape=shapes,
    odd=st.just(()) | odd_rows,
    batch_bytes=st.sampled_from([1, 20_000, 4_000_000]),
    damage=st.lists(damages, min_size=1, max_size=3),
    kept=st.just(1.0) | st.floats(0.1, 1.0),
)
@settings(max_examples=500, deadline=None)
def test_damaged_bags_are_read_as_queries_read_them(
    shape: Shape,
    odd: tuple[Row, ...],
    batch_bytes: int,
    damage: list[tuple[int, int, int, int]],
    kept: float,
) -> None:
    with TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setattr(pages, "BATCH_BYTES", batch_bytes)
        path = Path(folder) / "bag.db3"
        shape = Shape(**{**shape.__dict__, "odd": odd, "page_bytes": min(shape.page_bytes, 2048)})
        make(path, shape)
        octets = bytearray(path.read_bytes())
        count = len(octets) // shape.page_bytes
        for page, where, cell, change in damage:
            place = structure(octets, shape.page_bytes, page % count, where, cell)
            octets[min(place, len(octets) - 1)] ^= change
        path.write_bytes(octets[: int(kept * len(octets))])
        same = content(path) == by_queries(path)
        assert same


@pytest.mark.parametrize(
    "columns",
    [
        "id INTEGER, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, data BLOB NOT NULL",
        (
            "id INTEGER PRIMARY KEY DESC, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, "
            "data BLOB NOT NULL"
        ),
        (
            "id INTEGER PRIMARY KEY, timestamp INTEGER NOT NULL, topic_id INTEGER NOT NULL, data "
            "BLOB NOT NULL"
        ),
        (
            "id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, data "
            "BLOB NOT NULL, more TEXT"
        ),
    ],
)
def test_other_tables_are_read_by_queries(tmp_path: Path, columns: str) -> None:
    path = tmp_path / "bag.db3"
    with closing(sqlite3.connect(path)) as database:
        database.execute(TOPICS)
        database.execute(f"CREATE TABLE messages({columns})")
        database.executemany(
            "INSERT INTO messages(id, topic_id, timestamp, data) VALUES (?, 1, ?, ?)",
            [(i, 10 - i, bytes(i)) for i in range(1, 9)],
        )
        database.commit()
    read = content(path)
    assert read == by_queries(path)
    assert [message[1:] for message in read.messages.values()] == [
        (10 - i, bytes(i)) for i in range(1, 9)
    ]


def test_a_write_ahead_log_is_read(tmp_path: Path) -> None:
    path = tmp_path / "bag.db3"
    make(path, Shape(4096, count=10))
    with closing(sqlite3.connect(path)) as writer:
        writer.execute("PRAGMA journal_mode=WAL")
        writer.execute("UPDATE messages SET topic_id = 2")
        writer.commit()
        assert [message[0] for message in content(path).messages.values()] == [2] * 10


def test_pages_past_the_end_that_the_header_says_are_damage(tmp_path: Path) -> None:
    path = tmp_path / "bag.db3"
    make(path, Shape(2048))
    octets = bytearray(path.read_bytes())
    octets[28:32] = (int.from_bytes(octets[28:32]) // 2).to_bytes(4)
    path.write_bytes(octets)
    read = content(path)
    assert read == by_queries(path)
    assert read.rejects


def test_a_cell_past_the_end_of_its_page_is_damage(tmp_path: Path) -> None:
    path = tmp_path / "bag.db3"
    make(path, Shape(512, count=0, odd=((1, 1, 5, Blob(40)),)))
    with closing(sqlite3.connect(path)) as database:
        ((root,),) = database.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'")
    octets = bytearray(path.read_bytes())
    cell = structure(octets, 512, root - 1, 14, 0)
    octets[cell] += 1  # bytes of the record
    octets[cell + 6] += 2  # type of its last column: one byte longer
    path.write_bytes(octets)
    read = content(path)
    assert read == by_queries(path)
    assert not read.messages
