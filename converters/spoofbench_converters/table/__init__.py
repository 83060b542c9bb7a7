"""Converter of tables: delimited text, JSON, Parquet, MAT files and NumPy arrays, by a mapping of
columns to topics.

A mapping is a small TOML file (see :mod:`spoofbench_converters.table.mapping`); those that come
with the converter are recognised by the exact columns of their tables. A folder or archive is one
session; so is a mapping beside its files. Rows of formats other than text have no bytes of their
own: those of the file are shared out evenly.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import chain
from typing import Literal

from spoofbench.conversion import Item, Reject, Rejects, SizeHint, Source, SourceMetadata, Used
from spoofbench.errors import ConversionError
from spoofbench.schema import split_topic
from spoofbench_converters.table.anchoring import start_of
from spoofbench_converters.table.export import export
from spoofbench_converters.table.flights import FlightChoice
from spoofbench_converters.table.mapping import Mapping, load_mapping
from spoofbench_converters.table.reading import rows
from spoofbench_converters.table.rows import TableRows
from spoofbench_converters.table.session import open_session, sniff

__all__ = ["UNIT", "VERSION", "Options", "convert", "export", "load_mapping", "sniff"]

VERSION = "1"
UNIT: Literal["bytes"] = "bytes"


@dataclass(frozen=True, slots=True)
class Options:
    """Options of the converter.

    Attributes:
        mapping: the path of a mapping, or the name of one that comes with the converter; None: the
            one that knows the log.
        date: UTC date or time of the first row, for clocks without date (``2025-07-08`` or
            ``2025-07-08T19:34:18.5``).
        append_clock: a clock that jumps back goes on at its interval, instead of its rows being
            skipped.
        source: the one source to convert, such as ``gnss1``, where the mapping has several of a
            kind.
        session: name of the session, shared by its recordings.
        flight: the one flight to convert out of a table of many: words of the columns that tell
            flights apart, such as ``4baac6`` or ``4baac6 THY9BP``.
    """

    mapping: str | None = None
    date: str | None = None
    append_clock: bool = False
    source: str | None = None
    session: str | None = None
    flight: str | None = None


def convert(source: Source, options: Options) -> Iterator[Item]:
    """Yield what the tables hold; see :class:`spoofbench.conversion.Converter`."""
    session = open_session(source, options.mapping)
    if options.source is not None:
        session = replace(session, mapping=_only(session.mapping, options.source))
    sizes = [
        file.size()
        for file in [
            *chain(*session.files.values()),
            *session.unused,
            *([session.tags] if session.tags else []),
        ]
    ]
    if None not in sizes:
        yield SizeHint(sum(size or 0 for size in sizes))
    start_ns, facts = start_of(session, options.date)
    yield SourceMetadata(
        {
            "recording": {"clock": session.mapping.clock, "mapping": session.mapping.name, **facts},
            **session.mapping.sources,
        }
    )
    base = 0
    for table in session.tables():
        made = TableRows(table, start_ns, options.append_clock)
        choice = FlightChoice(table.flight, options.flight)
        for item in rows(table, session.files[table.name], base):
            base += int(item.lengths.sum())
            if isinstance(item, Rejects):
                yield item
                continue
            base += item.besides
            for part in choice.keep(item):
                yield from [part] if isinstance(part, Rejects) else made.push(part)
        yield from made.finish()
        yield from _learned(made, choice)
    if session.tags is not None:
        yield Used(session.tags.size() or 0)
    for file in session.unused:
        octets = file.count()
        yield Reject(base, octets, "a file that is not in the mapping")
        base += octets
    if options.session is not None:
        yield SourceMetadata({"recording": {"session_id": options.session}})


def _learned(rows: TableRows, choice: FlightChoice) -> Iterator[SourceMetadata]:
    """Yield what the rows of a table showed."""
    told = {name: " ".join(words) for name, words in choice.told.items() if words}
    if told:
        yield SourceMetadata({"recording": told})
    for topic, count in rows.repeated.items():
        yield SourceMetadata({f"source/{split_topic(topic)[0]}": {"repeated_rows": str(count)}})
    if rows.appender and rows.appender.steps:
        steps, count = rows.appender.steps, rows.appender.step_count
        record = {"clock_steps": json.dumps(steps), "clock_step_count": str(count)}
        yield SourceMetadata({"recording": record})


def _only(mapping: Mapping, source: str) -> Mapping:
    """Return a mapping without the topics of other sources that are of a kind with those of this
    one.

    Raises:
        ConversionError: it has no such source.
    """
    topics = [topic for table in mapping.tables for topic in table.topics]
    kinds = {topic.kind for topic in topics if topic.source == source}
    if not kinds:
        raise ConversionError(
            f"the mapping {mapping.name!r} has no source {source!r}; it has "
            f"{sorted({topic.source for topic in topics} - {''})}"
        )
    tables = [
        replace(
            table,
            topics=tuple(
                topic for topic in table.topics if topic.source == source or topic.kind not in kinds
            ),
        )
        for table in mapping.tables
    ]
    return replace(mapping, tables=tuple(table for table in tables if table.topics))
