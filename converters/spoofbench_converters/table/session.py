"""Which files are which tables of a mapping."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

from spoofbench.conversion import Source
from spoofbench.errors import ConversionError
from spoofbench_converters.table.files import (
    File,
    array_name,
    files_in,
    files_of,
    fits,
    is_json,
)
from spoofbench_converters.table.mapping import Mapping, TableSpec, load_mapping, ready_names
from spoofbench_converters.table.reading import columns_of, minimum_width, required_columns
from spoofbench_converters.table.text import read_head
from spoofbench_converters.table.topic import resolve

MAX_SNIFFED = 1000


@dataclass(slots=True)
class TableSession:
    """A mapping and the files of its tables; a MAT file may hold several tables, and arrays of
    several files may be one.

    Attributes:
        files: by table.
        unused: those of no table.
        tags: RTKLIB's time tags of the mapping's anchor.
    """

    mapping: Mapping
    files: dict[str, list[File]] = field(default_factory=dict)
    unused: list[File] = field(default_factory=list)
    tags: File | None = None

    def tables(self) -> Iterator[TableSpec]:
        """Return the tables that have files."""
        yield from (table for table in self.mapping.tables if self.files.get(table.name))


def open_session(source: Source, given: str | None) -> TableSession:
    """Return the files of a log by table, with the mapping that the user gives, that the log is, or
    that knows it.

    Raises:
        ConversionError: there is no mapping for it, or a table has no file.
    """
    own = mapping_of(source)
    if own is not None:
        patterns = _patterns(own)
        files = files_in(
            source.companion_files(lambda name: any(fits(name, pattern) for pattern in patterns))
        )
        if not files:
            raise ConversionError(
                f"beside the mapping {source.path.name!r} lies none of the 'files' of its tables: "
                f"{patterns}"
            )
        return _session(own, files, is_lone=False)
    files = files_of(source)
    if given is not None:
        session = _session(load_mapping(given), files, is_lone=not source.members())
        _find_tags(session, source)
        return session
    for mapping in _ready():
        if mapping.recognised and _knows(mapping, files):
            return _session(mapping, files, is_lone=not source.members())
    raise ConversionError(
        f"no ready mapping knows the table {source.path.name!r}: write one and give it with "
        "--mapping FILE.toml, or name one of "
        f"{', '.join(ready_names())}"
    )


def _find_tags(session: TableSession, source: Source) -> None:
    """Find the time tags beside a lone file."""
    beside = source.path.with_name(f"{source.path.name}.tag")
    anchor = session.mapping.anchor
    if (
        anchor is not None
        and anchor.tags is not None
        and session.tags is None
        and source.path.is_file()
        and beside.is_file()
    ):
        content = Source.of(beside)
        session.tags = File(beside.name, content, content.head, share=0)


def sniff(source: Source) -> float:
    """Return 1 for a mapping, 0.9 for a log whose tables are exactly those of a ready mapping, else
    0.
    """
    if _is_mapping(source):
        return 1.0
    try:
        if (
            source.path.is_file()
            and not source.is_archive
            and b"\n" not in source.head
            and not source.head.startswith((b"PAR1", b"MATLAB"))
            and not is_json(source.head)
        ):
            return 0.0
        if len(source.members()) > MAX_SNIFFED:
            return 0.0
        files = files_of(source)
        return (
            0.9
            if any(mapping.recognised and _knows(mapping, files) for mapping in _ready())
            else 0.0
        )
    except ConversionError:
        return 0.0


def mapping_of(source: Source) -> Mapping | None:
    """Return the mapping that a source is, None if it is none.

    Raises:
        ConversionError: it is one, but not sound.
    """
    return load_mapping(source.path) if _is_mapping(source) else None


def _is_mapping(source: Source) -> bool:
    return source.path.suffix == ".toml" and b"[table." in source.head


@cache
def _ready() -> tuple[Mapping, ...]:
    return tuple(load_mapping(name) for name in ready_names())


def _patterns(mapping: Mapping) -> list[str]:
    tags = mapping.anchor.tags if mapping.anchor else None
    return [pattern for table in mapping.tables for pattern in table.files] + (
        [tags] if tags else []
    )


def _session(mapping: Mapping, files: Sequence[File], *, is_lone: bool) -> TableSession:
    """Give each file to its table.

    Raises:
        ConversionError: a file fits two tables, or none does.
    """
    session = TableSession(mapping)
    tags = mapping.anchor.tags if mapping.anchor else None
    for file in files:
        if tags is not None and fits(file.name, tags):
            session.tags = file
            continue
        tables = [] if file.is_hidden and not is_lone else _tables_of(mapping, file, is_lone)
        if len(tables) > 1 and file.format != "mat":
            raise ConversionError(
                f"{file.name!r} fits the tables {[table.name for table in tables]} of the mapping "
                f"{mapping.name!r}: narrow their 'files'"
            )
        size = file.size() or 0
        for place, table in enumerate(tables):
            share = (
                size * (place + 1) // len(tables) - size * place // len(tables)
                if file.format == "mat"
                else None
            )
            session.files.setdefault(table.name, []).append(replace(file, share=share))
        if not tables:
            session.unused.append(file)
    if not session.files:
        raise ConversionError(
            f"the mapping {mapping.name!r} has no table for any of "
            f"{[file.name for file in files[:10]]}"
        )
    return session


def _tables_of(mapping: Mapping, file: File, is_lone: bool) -> list[TableSpec]:
    tables = [
        table
        for table in mapping.tables
        if not table.messages and table.layout.format in (None, file.format)
    ]
    named = [
        table
        for table in tables
        if any(fits(file.name, pattern) for pattern in table.files) or not table.files
    ]
    if not is_lone and (len(named) < 2 or file.format == "npy"):
        return named
    fitting = [table for table in named or tables if _has_columns(table, file, exact=False)]
    if not fitting and len(named or tables) == 1:
        return named or tables  # its columns are then named in the error
    return fitting


def _knows(mapping: Mapping, files: Sequence[File]) -> bool:
    """Whether the files are exactly tables of a mapping; beside tables that are known by their
    files' names, others may lie.
    """
    seen = [file for file in files if file.head]
    known = [
        [table for table in mapping.tables if _is_exactly(table, file, len(files) > 1)]
        for file in seen
    ]
    if len(files) == 1:
        return any(known)
    is_whole = {table.name for tables in known for table in tables} == {
        table.name for table in mapping.tables
    }
    names = [array_name(file) for file, tables in zip(seen, known, strict=True) if tables]
    return (
        is_whole
        and len(names) == len(set(names))
        and (
            all(known) or (len(mapping.tables) > 1 and all(table.files for table in mapping.tables))
        )
    )


def _is_exactly(table: TableSpec, file: File, is_named: bool) -> bool:
    if is_named and table.files and not any(fits(file.name, pattern) for pattern in table.files):
        return False
    if table.layout.format not in (None, file.format):
        return False
    if file.format == "npy":
        return bool(table.files) and is_named
    if is_named and table.files and not table.layout.header and file.format == "csv":
        return read_head(file.head, table.layout, file.name).width == len(table.columns)
    return _has_columns(table, file, exact=True)


def _has_columns(table: TableSpec, file: File, *, exact: bool) -> bool:
    """Whether a file has the columns of a table; ``exact``: all, and no other, so that it can be no
    other table.
    """
    try:
        if file.format == "csv" and table.layout.format in (None, "csv"):
            return _text_fits(table, file, exact)
        names = set(columns_of(table, file))
    except ConversionError:
        return False
    lacking = required_columns(table) - names
    return not lacking and (
        not exact
        or file.format in ("mat", "npy")
        or (bool(table.columns) and names <= set(table.columns))
    )


def _text_fits(table: TableSpec, file: File, exact: bool) -> bool:
    head = read_head(file.head, table.layout, file.name)
    if table.signature and not any(
        comment.startswith(table.signature) for comment in head.comments
    ):
        return False
    if table.layout.header:
        names = set(head.names)
        wanted = {
            column[0] for name in table.wanted() if (column := resolve(name, frozenset(names)))
        }
        lacking = [
            name
            for name, optional in table.wanted().items()
            if not optional and resolve(name, frozenset(names)) is None
        ]
        return (
            not lacking
            and bool(wanted)
            and (not exact or (bool(table.columns) and names <= set(table.columns)))
        )
    return minimum_width(table) <= head.width <= len(table.columns) and (
        not exact or bool(table.signature)
    )
