"""The messages of a bag straight from the pages of its SQLite database, many at a time, without an
object for each.

After the SQLite file format (sqlite.org/fileformat2.html, sections 1.3 and 1.5 to 2.2). SQLite
itself opens the file, recovers or refuses it, holds its lock and says where the table is. Here only
what a sound bag consists of is understood; at anything else reading ends, and whoever reads goes on
with queries from the last message that was given.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import apsw
import numpy as np
from numpy.typing import NDArray

from spoofbench_converters.rosbag.batches import BATCH_BYTES, MAX_MESSAGE_BYTES
from spoofbench_converters.rosbag.layouts import windows

FIRST_KEY, LAST_KEY = -(2**63), 2**63 - 1

_TABLE = (
    b"CREATE TABLE messages ( id INTEGER PRIMARY KEY , topic_id INTEGER NOT NULL , timestamp "
    b"INTEGER NOT NULL , data BLOB NOT NULL )"
)
_INTERIOR, _LEAF = 5, 13  # types of a table's pages
_MAX_DEPTH = 20  # as in SQLite
_LOCK_BYTE = 2**30  # its page holds no data
_HEADER_BYTES = 100
_INTEGER_BYTES = np.array(
    [-1, 1, 2, 3, 4, 6, 8, -1, 0, 0] + [-1] * 246
)  # by serial type; 8 and 9 are the numbers 0 and 1
_PADDING = 64  # more than the head of a cell

_Integers = NDArray[np.int64]


class UnsupportedPage(Exception):
    """A database, a page or a cell that is not as a sound bag has it."""


@dataclass(frozen=True, slots=True)
class PageCells:
    """Successive messages, where they lie.

    Attributes:
        octets: pages of the database.
        keys: key of each message, increasing, ``(n,)``.
        topics: number of each message's topic, ``(n,)``.
        stamps_ns: when the recorder got each, ``(n,)``.
        starts: where each message's bytes start in ``octets``, ``(n,)``.
        lengths: bytes of each, ``(n,)``; of topics that are not wanted, they need not all be in
            ``octets``.
    """

    octets: NDArray[np.uint8]
    keys: _Integers
    topics: _Integers
    stamps_ns: _Integers
    starts: _Integers
    lengths: _Integers


@dataclass(frozen=True, slots=True)
class _Children:
    """Children of an interior page: the keys in each are above the key before, up to its own."""

    pages: _Integers
    keys: _Integers

    def split(self, size: int) -> "Iterator[_Children]":
        """Yield them so many at a time, at last the rest."""
        for start in range(0, self.pages.size, size):
            yield _Children(self.pages[start : start + size], self.keys[start : start + size])


def _joined(parts: Sequence[_Children]) -> _Children:
    return _Children(
        np.concatenate([part.pages for part in parts]),
        np.concatenate([part.keys for part in parts]),
    )


class Pages:
    """The table of messages of an open database, within a read transaction."""

    def __init__(self, database: apsw.Connection) -> None:
        """Find the table.

        Raises:
            UnsupportedPage: it is not the table that bags have, or there is a write-ahead log.
            apsw.Error: the database cannot be read.
        """
        self._database = database
        definitions: list[Any] = database.execute(
            "SELECT rootpage, CAST(sql AS BLOB) FROM sqlite_master WHERE sql LIKE '%messages%' "
            "AND sql NOT LIKE 'CREATE INDEX %'"
        ).fetchall()
        if (
            len(definitions) != 1
            or _words(definitions[0][1]) != _words(_TABLE)
            or not isinstance(definitions[0][0], int)
        ):
            raise UnsupportedPage
        self._root = definitions[0][0]
        _, header = database.read("main", 0, 0, _HEADER_BYTES)
        size = int.from_bytes(header[16:18], "big")
        self._page_bytes = 65_536 if size == 1 else size
        self._usable = self._page_bytes - header[20]
        self._pages = int.from_bytes(header[28:32], "big")
        if header[18:20] != b"\x01\x01" or self._page_bytes < 512 or self._usable < 480:
            raise UnsupportedPage

    def cells(self, wanted: frozenset[int]) -> Iterator[PageCells]:
        """Yield all messages by key.

        Raises:
            UnsupportedPage: the next are not as a sound bag has them.
            apsw.Error: the next cannot be read.
        """
        numbers = np.array(sorted(wanted), np.int64)
        before = FIRST_KEY
        for leaves in self._batches():
            cells = self._read_leaves(leaves, before, numbers)
            before = int(cells.keys[-1])
            yield cells

    def _batches(self) -> Iterator[_Children]:
        """Yield the leaves by key, as many at a time as are read at once."""
        most = max(BATCH_BYTES // self._page_bytes, 1)
        waiting: list[_Children] = []
        count = 0
        for leaves in self._leaves(
            _Children(np.array([self._root]), np.array([LAST_KEY])), FIRST_KEY, 0
        ):
            waiting.append(leaves)
            count += leaves.pages.size
            if count >= most:
                *whole, rest = _joined(waiting).split(most)
                yield from whole
                waiting, count = [rest], rest.pages.size
        yield _joined(waiting)

    def _leaves(self, children: _Children, before: int, depth: int) -> Iterator[_Children]:
        if depth >= _MAX_DEPTH:
            raise UnsupportedPage
        if self._read(children.pages[:1])[0] == _LEAF:
            yield children
            return
        for page, last in zip(children.pages.tolist(), children.keys.tolist(), strict=True):
            yield from self._leaves(self._read_interior(page, before, last), before, depth + 1)
            before = last

    def _read(self, pages: _Integers) -> NDArray[np.uint8]:
        """Return pages, one after the other, and padding."""
        size = self._page_bytes
        if pages.min() < 2 or pages.max() > self._pages or (pages == _LOCK_BYTE // size + 1).any():
            raise UnsupportedPage
        octets = np.empty(pages.size * size + _PADDING, np.uint8)
        octets[-_PADDING:] = 0
        runs = np.concatenate([[0], np.flatnonzero(np.diff(pages) != 1) + 1, [pages.size]]).tolist()
        for start, end in pairwise(runs):
            whole, read = self._database.read(
                "main", 0, (int(pages[start]) - 1) * size, (end - start) * size
            )
            if not whole:
                raise UnsupportedPage
            octets[start * size : end * size] = np.frombuffer(read, np.uint8)
        return octets

    def _read_interior(self, page: int, before: int, last: int) -> _Children:
        octets = self._read(np.array([page]))
        starts, _ = self._pointers(octets, 1, _INTERIOR)
        keys, ends = _varints(octets, starts + 4)
        if (
            (np.diff(keys) <= 0).any()
            or keys[0] <= before
            or keys[-1] > last
            or (ends > self._usable).any()
        ):
            raise UnsupportedPage
        pages = (
            octets[np.concatenate([starts, [8]])[:, None] + np.arange(4)]
            .view(">u4")[:, 0]
            .astype(np.int64)
        )
        return _Children(pages, np.concatenate([keys, [last]]))

    def _pointers(
        self, octets: NDArray[np.uint8], pages: int, kind: int
    ) -> tuple[_Integers, _Integers]:
        """Return where the cells of pages of one type start, and how many each page has."""
        size, first = self._page_bytes, 8 if kind == _LEAF else 12
        matrix = octets[: pages * size].reshape(pages, size)
        counts = matrix[:, 3] * np.int64(256) + matrix[:, 4]
        if (matrix[:, 0] != kind).any() or counts.min() < 1 or counts.max() > (size - 8) // 6:
            raise UnsupportedPage
        mine = np.arange(counts.max()) < counts[:, None]
        places = matrix.view(">u2")[:, first // 2 : first // 2 + int(counts.max())][mine].astype(
            np.int64
        )
        pages_of = np.repeat(np.arange(pages), counts)
        if (places < first + 2 * counts[pages_of]).any() or places.max() > self._usable - 4:
            raise UnsupportedPage
        return places + pages_of * size, counts

    def _read_leaves(self, leaves: _Children, before: int, wanted: _Integers) -> PageCells:
        octets = self._read(leaves.pages)
        starts, counts = self._pointers(octets, leaves.pages.size, _LEAF)
        messages, ends = _varints(octets, starts)
        keys, heads = _varints(octets, ends)
        last = np.cumsum(counts) - 1
        bounds = np.concatenate([[before], leaves.keys])
        if (
            (np.diff(keys) <= 0).any()
            or (keys[last - counts + 1] <= bounds[:-1]).any()
            or (keys[last] > leaves.keys).any()
        ):
            raise UnsupportedPage
        cells = _cells(octets, keys, heads, messages)
        local = self._local(messages)
        whole = (local == messages) & (cells.lengths < MAX_MESSAGE_BYTES - _PADDING)
        ends = (
            heads + local + 4 * (local < messages)
        )  # the number of the page where the rest lies takes four bytes
        page_ends = np.repeat(np.arange(counts.size) * self._page_bytes + self._usable, counts)
        if (ends > page_ends).any() or np.isin(cells.topics[~whole], wanted).any():
            raise UnsupportedPage
        return cells

    def _local(self, messages: _Integers) -> _Integers:
        """Return how many bytes of messages are within their cells."""
        most, least = self._usable - 35, (self._usable - 12) * 32 // 255 - 23
        if messages.max() <= most:
            return messages
        rest = least + (messages - least) % (self._usable - 4)
        return np.where(messages <= most, messages, np.where(rest <= most, rest, least))


def _words(sql: bytes) -> list[bytes]:
    return re.findall(rb"\w+|[^\s\w]", sql.upper())


def _cells(
    octets: NDArray[np.uint8], keys: _Integers, heads: _Integers, messages: _Integers
) -> PageCells:
    """Return messages whose records start at these places and have so many bytes: no key, two whole
    numbers, bytes.
    """
    topic_types, stamp_types = octets[heads + 2], octets[heads + 3]
    data_types, ends = _varints(octets, heads + 4)
    if (octets[heads] != ends - heads).any() or octets[heads + 1].any() or (data_types & 1).any():
        raise UnsupportedPage
    topics, ends = _integers(octets, ends, topic_types)
    stamps_ns, starts = _integers(octets, ends, stamp_types)
    lengths = (data_types - 12) // 2  # below 0 for what is neither text nor bytes
    if (starts + lengths != heads + messages).any():
        raise UnsupportedPage
    return PageCells(octets, keys, topics, stamps_ns, starts, lengths)


def _varints(octets: NDArray[np.uint8], starts: _Integers) -> tuple[_Integers, _Integers]:
    """Return the numbers of variable length that start at these places, and where they end."""
    octet = octets[starts]
    values, ends = (octet & 0x7F).astype(np.int64), starts + 1
    more = octet >= 0x80
    for _ in range(7):
        if not more.any():
            return values, ends
        octet = octets[ends]
        values = np.where(more, (values << 7) | (octet & 0x7F), values)
        ends = ends + more
        more &= octet >= 0x80
    raise UnsupportedPage


def _integers(
    octets: NDArray[np.uint8], starts: _Integers, types: NDArray[np.uint8]
) -> tuple[_Integers, _Integers]:
    """Return the signed numbers of these serial types that start at these places, and where they
    end.
    """
    sizes = _INTEGER_BYTES[types]
    if sizes.min() < 0:
        raise UnsupportedPage
    ends = starts + sizes
    unused = 64 - 8 * sizes
    values = (windows(octets, 8)[ends - 8].view(">i8").astype(np.int64) << unused) >> unused
    return np.where(sizes == 0, types - np.int64(8), values), ends
