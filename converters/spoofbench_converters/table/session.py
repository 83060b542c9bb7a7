"""Which files are which tables of a mapping."""

import fnmatch
import io
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import IO, Literal

import numpy as np

from spoofbench.converting import Member, Rejects, Source
from spoofbench.converting.sources import HEAD_BYTES
from spoofbench.errors import ConversionError, LimitError
from spoofbench_converters.table import arrays
from spoofbench_converters.table.mapping import Mapping, TableSpec, load_mapping, ready_names
from spoofbench_converters.table.matfile import read_mat
from spoofbench_converters.table.rows import used_columns
from spoofbench_converters.table.text import Head, Records, Rows, read_head
from spoofbench_converters.table.topic import resolve

MAX_SNIFFED = 1000

FileFormat = Literal["csv", "parquet", "mat", "npy"]


@dataclass(frozen=True, slots=True)
class File:
    """A file of a session.

    Attributes:
        name: path within the folder or archive.
        head: its first bytes.
        share: of a file that holds several tables, how many of its bytes are accounted to this one.
    """

    name: str
    content: Source | Member
    head: bytes
    share: int | None = None

    @property
    def format(self) -> FileFormat:
        if self.head.startswith(b"PAR1"):
            return "parquet"
        if self.head.startswith((b"MATLAB 5.0 MAT-file", b"MATLAB 7.3 MAT-file")):
            return "mat"
        return "npy" if self.head.startswith(b"\x93NUMPY") else "csv"

    def open(self) -> IO[bytes]:
        return self.content.open()

    def whole(self) -> bytes:
        """Return the file's bytes.

        Raises:
            LimitError: it is too large for a format that cannot be streamed.
        """
        with self.open() as file:
            content = file.read(arrays.MAX_FILE_BYTES + 1)
        if len(content) > arrays.MAX_FILE_BYTES:
            raise LimitError(f"{self.name!r} has more than {arrays.MAX_FILE_BYTES:,} bytes")
        return content

    def seekable(self) -> IO[bytes]:
        """Return the file as one that can be read in any order: from a copy where it is packed."""
        file = self.open()
        if _is_plain(file):
            return file
        with file:
            copy = tempfile.TemporaryFile()  # noqa: SIM115 - the caller closes it
            shutil.copyfileobj(file, copy, 2**20)
        copy.seek(0)
        return copy

    def size(self) -> int | None:
        """Return how many bytes it has, None where that shows only when it is unpacked."""
        if self.share is not None:
            return self.share
        if isinstance(self.content, Member):
            return self.content.size
        with self.open() as file:
            return self.content.path.stat().st_size if _is_plain(file) else None


def _is_plain(file: IO[bytes]) -> bool:
    """Whether a file is read from the disk as it is."""
    return isinstance(file, io.BufferedReader) and isinstance(file.raw, io.FileIO)


@dataclass(slots=True)
class Session:
    """A mapping and the files of its tables; a MAT file may hold several tables, and arrays of several files may be one.

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


def open_session(source: Source, given: str | None) -> Session:
    """Return the files of a log by table, with the mapping that the user gives, that the log is, or that knows it.

    Raises:
        ConversionError: there is no mapping for it, or a table has no file.
    """
    own = mapping_of(source)
    if own is not None:
        return _session(own, _files(Source(source.path.parent, b""), own), is_lone=False)
    files = _files(source, None)
    if given is not None:
        session = _session(load_mapping(given), files, is_lone=not source.members())
        _find_tags(session, source)
        return session
    for mapping in _ready():
        if mapping.recognised and _knows(mapping, files):
            return _session(mapping, files, is_lone=not source.members())
    raise ConversionError(
        f"no ready mapping knows the table {source.path.name!r}: write one and give it with --mapping FILE.toml, or name one of "
        f"{', '.join(ready_names())}"
    )


def _find_tags(session: Session, source: Source) -> None:
    """Find the time tags beside a lone file."""
    beside = source.path.with_name(f"{source.path.name}.tag")
    anchor = session.mapping.anchor
    if anchor is not None and anchor.tags is not None and session.tags is None and source.path.is_file() and beside.is_file():
        content = Source.of(beside)
        session.tags = File(beside.name, content, content.head, share=0)


def sniff(source: Source) -> float:
    """Return 1 for a mapping, 0.9 for a log whose tables are exactly those of a ready mapping, else 0."""
    try:
        if mapping_of(source) is not None:
            return 1.0
        if (
            source.path.is_file()
            and not source.is_archive
            and b"\n" not in source.head
            and not source.head.startswith((b"PAR1", b"MATLAB"))
        ):
            return 0.0
        if len(source.members()) > MAX_SNIFFED:
            return 0.0
        files = _files(source, None)
        return 0.9 if any(mapping.recognised and _knows(mapping, files) for mapping in _ready()) else 0.0
    except ConversionError:
        return 0.0


def mapping_of(source: Source) -> Mapping | None:
    """Return the mapping that a source is, None if it is none.

    Raises:
        ConversionError: it is one, but not sound.
    """
    if source.path.suffix != ".toml" or b"[table." not in source.head:
        return None
    return load_mapping(source.path)


@cache
def _ready() -> tuple[Mapping, ...]:
    return tuple(load_mapping(name) for name in ready_names())


def _files(source: Source, mapping: Mapping | None) -> list[File]:
    members = source.members()
    if not members:
        return [File(source.path.name, source, source.head)]
    patterns = _patterns(mapping) if mapping else None
    found = []
    for name, member in members.items():
        if patterns is not None and not any(fits(name, pattern) for pattern in patterns):
            continue
        hidden = any(part.startswith((".", "__MACOSX")) for part in name.split("/"))
        with member.open() as file:
            found.append(File(name, member, b"" if hidden else file.read(HEAD_BYTES)))
    return found


def _patterns(mapping: Mapping) -> list[str]:
    tags = mapping.anchor.tags if mapping.anchor else None
    return [pattern for table in mapping.tables for pattern in table.files] + ([tags] if tags else [])


def fits(name: str, pattern: str) -> bool:
    """Whether a path fits a pattern; one without a slash is held against the file's own name."""
    return fnmatch.fnmatchcase(name if "/" in pattern else name.rpartition("/")[2], pattern)


def _session(mapping: Mapping, files: Sequence[File], *, is_lone: bool) -> Session:
    """Give each file to its table.

    Raises:
        ConversionError: a file fits two tables, or none does.
    """
    session = Session(mapping)
    tags = mapping.anchor.tags if mapping.anchor else None
    for file in files:
        if tags is not None and fits(file.name, tags):
            session.tags = file
            continue
        tables = _tables_of(mapping, file, is_lone)
        if len(tables) > 1 and file.format != "mat":
            raise ConversionError(
                f"{file.name!r} fits the tables {[table.name for table in tables]} of the mapping {mapping.name!r}: narrow their 'files'"
            )
        size = file.size() or 0
        for place, table in enumerate(tables):
            share = size * (place + 1) // len(tables) - size * place // len(tables) if file.format == "mat" else None
            session.files.setdefault(table.name, []).append(replace(file, share=share))
        if not tables:
            session.unused.append(file)
    if not session.files:
        raise ConversionError(f"the mapping {mapping.name!r} has no table for any of {[file.name for file in files[:10]]}")
    return session


def _tables_of(mapping: Mapping, file: File, is_lone: bool) -> list[TableSpec]:
    tables = [table for table in mapping.tables if not table.messages and table.layout.format in (None, file.format)]
    named = [table for table in tables if any(fits(file.name, pattern) for pattern in table.files) or not table.files]
    if not is_lone and (len(named) < 2 or file.format == "npy"):
        return named
    fitting = [table for table in named or tables if _has_columns(table, file, exact=False)]
    if not fitting and len(named or tables) == 1:
        return named or tables  # its columns are then named in the error
    return fitting


def _knows(mapping: Mapping, files: Sequence[File]) -> bool:
    """Whether the files are exactly tables of a mapping; beside tables that are known by their files' names, others may lie."""
    seen = [file for file in files if file.head]
    known = [[table for table in mapping.tables if _is_exactly(table, file, len(files) > 1)] for file in seen]
    if len(files) == 1:
        return any(known)
    is_whole = {table.name for tables in known for table in tables} == {table.name for table in mapping.tables}
    names = [_array_name(file) for file, tables in zip(seen, known, strict=True) if tables]
    return (
        is_whole
        and len(names) == len(set(names))
        and (all(known) or (len(mapping.tables) > 1 and all(table.files for table in mapping.tables)))
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
    """Whether a file has the columns of a table; ``exact``: all, and no other, so that it can be no other table."""
    try:
        if file.format == "csv" and table.layout.format in (None, "csv"):
            return _text_fits(table, file, exact)
        names = set(columns_of(table, file))
    except ConversionError:
        return False
    lacking = _required(table) - names
    return not lacking and (not exact or file.format in ("mat", "npy") or (bool(table.columns) and names <= set(table.columns)))


def _text_fits(table: TableSpec, file: File, exact: bool) -> bool:
    head = read_head(file.head, table.layout, file.name)
    if table.signature and not any(comment.startswith(table.signature) for comment in head.comments):
        return False
    if table.layout.header:
        names = set(head.names)
        wanted = {column[0] for name in table.wanted() if (column := resolve(name, frozenset(names)))}
        lacking = [name for name, optional in table.wanted().items() if not optional and resolve(name, frozenset(names)) is None]
        return not lacking and bool(wanted) and (not exact or (bool(table.columns) and names <= set(table.columns)))
    return _least_width(table) <= head.width <= len(table.columns) and (not exact or bool(table.signature))


def _required(table: TableSpec) -> set[str]:
    known = frozenset(table.columns) if table.columns else None
    return {
        (resolve(name, known) or (name, False))[0] if known else name.removeprefix("-")
        for name, optional in table.wanted().items()
        if not optional
    }


def _least_width(table: TableSpec) -> int:
    """Return how many columns a table without header has at least: up to the last that it may not lack."""
    required = _required(table)
    return max((place + 1 for place, name in enumerate(table.columns) if name in required), default=1)


def columns_of(table: TableSpec, file: File) -> tuple[str, ...]:
    """Return the names of a file's columns."""
    if file.format == "parquet":
        with file.seekable() as opened:
            return arrays.parquet_columns(opened, file.name)
    if file.format == "mat":
        return arrays.column_names(*_mat(table, file))
    return ()


def _mat(table: TableSpec, file: File) -> tuple[arrays.Arrays, tuple[str, ...]]:
    """Return a table's variables in a MAT file, and the names of the columns of a matrix: the mapping's, or those beside it in the file."""
    variable = table.layout.variable
    names = [variable] if variable else [name.partition("[")[0].removeprefix("-") for name in table.wanted()]
    labels = f"{variable}_label"
    numbers, texts = read_mat(file.whole(), file.name, frozenset([*names, labels]))
    if not numbers:
        raise ConversionError(f"{file.name!r} has no variable of numbers {' or '.join(map(repr, names))}")
    if variable and variable not in numbers:
        return {name.removeprefix(f"{variable}."): array for name, array in numbers.items()}, ()
    return numbers, table.columns or texts.get(labels, ())


def rows(table: TableSpec, files: Sequence[File], base: int) -> Iterator[Rows | Rejects]:
    """Yield the rows of a table's files, the first of which lies at ``base`` in the source, in file order."""
    if files[0].format == "npy":
        yield from _npy_rows(table, files, base)
        return
    for file in files:
        for item in _file_rows(table, file, base):
            base += int(item.lengths.sum()) + (item.besides if isinstance(item, Rows) else 0)
            yield item


def _file_rows(table: TableSpec, file: File, base: int) -> Iterator[Rows | Rejects]:
    if file.format == "parquet":
        with file.seekable() as opened:
            octets = opened.seek(0, io.SEEK_END)
            opened.seek(0)
            wanted = used_columns(table, arrays.parquet_columns(opened, file.name))
            yield from arrays.parquet_rows(opened, file.name, wanted, base, octets)
    elif file.format == "mat":
        found, names = _mat(table, file)
        used_columns(table, arrays.column_names(found, names))
        yield from arrays.rows_of(found, names, arrays.Shares(base, file.size() or 0, _length(found)))
    else:
        head = read_head(file.head, table.layout, file.name)
        names = _names(table, head, file.name)
        with file.open() as opened:
            yield from Records(table.layout, names, used_columns(table, names), base).read(opened, head)


def _names(table: TableSpec, head: Head, name: str) -> tuple[str, ...]:
    """Return the names of a text file's columns.

    Raises:
        ConversionError: it has more or fewer columns than the mapping names.
    """
    if table.layout.header:
        if not head.names:
            raise ConversionError(f"{name!r} has no header within its first {HEAD_BYTES:,} bytes")
        return head.names
    if head.width and not _least_width(table) <= head.width <= len(table.columns):
        raise ConversionError(f"{name!r} has {head.width} columns, where the mapping's table {table.name!r} names {len(table.columns)}")
    return table.columns[: head.width] if head.width else table.columns


def _npy_rows(table: TableSpec, files: Sequence[File], base: int) -> Iterator[Rows | Rejects]:
    found: dict[str, np.ndarray] = {}
    for file in files:
        name = _array_name(file)
        if name in found:
            raise ConversionError(f"two arrays are called {name!r}: convert one session at a time")
        with file.open() as opened:
            found[name] = arrays.read_npy(opened, file.name)
    together: arrays.Arrays = arrays.matched(found, table.layout.index) if table.layout.index else found
    used_columns(table, arrays.column_names(together))
    octets = sum(file.size() or 0 for file in files)
    yield from arrays.rows_of(together, (), arrays.Shares(base, octets, _length(together)))


def _array_name(file: File) -> str:
    """Return the name of an array: its folder's and its own."""
    return "/".join(file.name.removesuffix(".npy").split("/")[-2:])


def _length(found: arrays.Arrays) -> int:
    return max((array.shape[0] for array in found.values()), default=0)
