"""When a clock without date counted 0."""

import struct
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from spoofbench.errors import ConversionError
from spoofbench.gnss_time import DAY_NS, GPS_EPOCH_NS, SECOND_NS, gps_to_utc
from spoofbench_converters.table.fields import TimeSpec
from spoofbench_converters.table.mapping import Anchor, TableSpec
from spoofbench_converters.table.reading import rows
from spoofbench_converters.table.session import TableSession
from spoofbench_converters.table.text import CellBatch
from spoofbench_converters.table.times import TableClock
from spoofbench_converters.text.numbers import moment_ns

TAGS = 1000
TAG = np.dtype([("tick", "<u4"), ("octets", "<u4")])
TAG_MAGIC = b"TIMETAG RTKLIB"
TAG_HEADER = 76
MS_NS = 1_000_000
UNDATED = "the clock has no date: it counts from 1970-01-01; give the first row's with --date"


def start_of(session: TableSession, date: str | None) -> tuple[int, dict[str, str]]:
    """Return the Unix time at which the session's clock without date counts 0, and what to say of
    it in the metadata.

    Raises:
        ConversionError: the date that the user gives is none; the anchor cannot be found.
    """
    moment = None if date is None else _moment(date)
    relative = [
        table for table in session.tables() if table.time is not None and table.time.is_relative
    ]
    if not relative:
        return 0, {}
    table, anchor = relative[0], session.mapping.anchor
    if date is not None and moment is not None:
        assert table.time is not None
        return moment // DAY_NS * DAY_NS if table.time.of_day else moment - _first(
            session, table
        ), {"reference_date": date}
    if anchor is not None and anchor.time is not None and session.files.get(anchor.table):
        return _by_row(session, anchor, anchor.time), {
            "reference_date_basis": f"the rows of table {anchor.table!r} with a time of their own"
        }
    if anchor is not None and session.tags is not None and session.files.get(anchor.table):
        return _by_tags(session, anchor), {
            "reference_date_basis": f"the time tags {session.tags.name!r}"
        }
    return 0, {"reference_date_basis": UNDATED}


def _moment(date: str) -> int:
    try:
        return moment_ns(date)
    except ValueError:
        raise ConversionError(
            f"the date {date!r} must be written like 2025-07-08 or 2025-07-08T19:34:18.5"
        ) from None


def _table(session: TableSession, name: str) -> TableSpec:
    return next(table for table in session.mapping.tables if table.name == name)


def _rows(session: TableSession, table: TableSpec) -> Iterator[CellBatch]:
    yield from (
        item
        for item in rows(table, session.files[table.name], 0)
        if isinstance(item, CellBatch) and item.offsets.size
    )


def _first(session: TableSession, table: TableSpec) -> int:
    """Return what the clock of a table counts at its first row."""
    assert table.time is not None
    for part in _rows(session, table):
        count_ns, bad = TableClock(table.time).read(part.columns)
        if not bad.all():
            return int(count_ns[np.argmin(bad)])
    raise ConversionError(f"the table {table.name!r} of the mapping has no row with a time")


def _by_row(session: TableSession, anchor: Anchor, time: TimeSpec) -> int:
    """Return the start by the first rows with both the clock's count and a time of their own: the
    median, since the first may be wrong.
    """
    table = _table(session, anchor.table)
    assert table.time is not None
    own = replace(table, time=replace(table.time, also=time.columns()))
    for part in _rows(session, own):
        count_ns, without_count = TableClock(table.time).read(part.columns)
        moment_ns, without_time = TableClock(time).read(part.columns)
        good = np.flatnonzero(~without_count & ~without_time & (moment_ns > 0))
        if good.size:
            return int(np.sort(moment_ns[good] - count_ns[good])[good.size // 2])
    raise ConversionError(
        f"no row of the table {table.name!r} tells when its clock was started; give the time of "
        "the first row with --date"
    )


def _by_tags(session: TableSession, anchor: Anchor) -> int:
    """Return the start by RTKLIB's time tags of the first rows (RTKLIB ver. 2.4.2 Manual, appendix;
    stream.c): the least delayed counts.

    A tag is the time in milliseconds since the first at which the file had so many bytes. Where the
    file's line ends were shortened since, the second byte of each is added.
    """
    table = _table(session, anchor.table)
    assert table.time is not None
    assert session.tags is not None
    origin_ns, ticks_ms, octets = _read_tags(session)
    for part in _rows(session, table):
        count_ns, bad = TableClock(table.time).read(part.columns)
        size = session.files[table.name][0].size() or 0
        shortened = int(octets[-1]) > size
        ends = part.offsets + part.lengths + (np.arange(1, bad.size + 1) if shortened else 0)
        row = np.searchsorted(ends, octets[:TAGS], "right") - 1
        good = (row >= 0) & (octets[:TAGS] <= ends[-1]) & ~bad[np.maximum(row, 0)]
        if good.any():
            return int((origin_ns + ticks_ms[:TAGS] * MS_NS - count_ns[row])[good].min())
    raise ConversionError(
        f"the time tags {session.tags.name!r} are not those of the table {table.name!r}"
    )


def _read_tags(session: TableSession) -> tuple[int, NDArray[np.int64], NDArray[np.int64]]:
    """Return the time of the first tag, UTC, the tags' ticks in milliseconds and the bytes that the
    file had then.
    """
    assert session.tags is not None
    content = session.tags.whole()
    octets = len(content) - TAG_HEADER
    if not content.startswith(TAG_MAGIC) or octets < TAG.itemsize:
        raise ConversionError(f"{session.tags.name!r} is no time tag file of RTKLIB")
    seconds, part = struct.unpack_from("<Id", content, 64)
    if not 0 <= part < 1:
        raise ConversionError(
            f"{session.tags.name!r} is no time tag file of RTKLIB: its first time is damaged"
        )
    tags = np.frombuffer(content, TAG, octets // TAG.itemsize, TAG_HEADER)
    moment_ns = int(gps_to_utc(seconds * SECOND_NS + round(part * SECOND_NS) - GPS_EPOCH_NS))
    return moment_ns, tags["tick"].astype(np.int64), tags["octets"].astype(np.int64)
