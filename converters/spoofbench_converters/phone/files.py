"""The files of a log: the one, or those of a folder or zip archive; and tables of delimited text in
them.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import IO

from spoofbench.conversion import Reject, Rejects, Source, Used
from spoofbench.errors import ConversionError
from spoofbench_converters.text.columns import WRONG_WIDTH, ColumnReader
from spoofbench_converters.text.lines import BOM, Lines, read_lines

HEAD_BYTES = 2**16
NO_KIND = "a file of no kind in the schema"
ANOTHER = "another file beside the log: not read, convert it by itself"
MAX_HEADS = 256
_TEXT = re.compile(r"\.(csv|txt|tsv)(\.(gz|zst|bz2|xz))?$", re.IGNORECASE)


@dataclass(frozen=True)
class PhoneFile:
    """A file of a log; ``origin`` is where it begins in the log, its files joined in the order of
    their names.
    """

    name: str
    origin: int
    size: int
    open: Callable[[], IO[bytes]]

    @cached_property
    def head(self) -> bytes:
        """The first 64 KiB, without a byte order mark."""
        with self.open() as file:
            return file.read(HEAD_BYTES).removeprefix(BOM)

    @property
    def stem(self) -> str:
        """The file's name without folders and suffix."""
        return _TEXT.sub("", self.name.rpartition("/")[2])

    def rejected(self, reason: str = NO_KIND) -> Reject:
        """Return the account of a file of a folder or archive that nothing is read from."""
        return Reject(self.origin, self.size, reason)


def parts_of(source: Source) -> list[PhoneFile]:
    """Return a log's files, as large as the archive's directory or the disk says; that of a lone
    file is not known.

    Raises:
        ConversionError: the archive's directory cannot be read.
    """
    if not source.path.is_dir() and not source.is_archive:
        return [PhoneFile("", 0, 0, source.open)]
    return [
        PhoneFile(member.name, 0, member.size, member.open) for member in source.members().values()
    ]


def laid_out(parts: Sequence[PhoneFile]) -> list[PhoneFile]:
    """Return a folder's or archive's files as large as they unpack to, which damage may make less,
    each with where it begins.
    """
    placed, origin = [], 0
    for part in parts:
        size = _size(part)
        placed.append(replace(part, origin=origin, size=size))
        origin += size
    return placed


def text_parts(parts: Sequence[PhoneFile]) -> list[PhoneFile]:
    """Return the files that may be text, by their names within the log; a lone file may."""
    return [part for part in parts if not part.name or _TEXT.search(part.name)][:MAX_HEADS]


@dataclass(frozen=True, slots=True)
class HeaderSchema:
    """The schema of a table: names of its columns, what parts them, and whether numbers have a
    decimal comma.
    """

    names: tuple[str, ...]
    delimiter: str
    decimal_comma: bool

    @classmethod
    def of(cls, head: bytes) -> "HeaderSchema":
        """Read the schema from a file's first lines; without a line there are no names."""
        header, _, rest = head.decode("utf-8", "replace").partition("\n")
        bare = re.sub(r'"[^"]*"', '""', header)
        delimiter = max(",;\t", key=bare.count)
        names = tuple(
            name.strip().strip('"').strip()
            for name in re.split(rf'{delimiter}(?=(?:[^"]*"[^"]*")*[^"]*$)', header.rstrip("\r"))
        )
        return cls(names, delimiter, delimiter != "," and "," in rest.partition("\n")[0])

    def index(self, normal: Callable[[str], str] = str) -> Mapping[str, int]:
        """Return each column's number by name; of columns of one name the first counts."""
        index: dict[str, int] = {}
        for number, name in enumerate(self.names):
            index.setdefault(normal(name), number)
        return index


def read_columns(
    file: PhoneFile, schema: HeaderSchema, normal: Callable[[str], str] = str
) -> Iterator[ColumnReader | Used | Reject | Rejects]:
    """Yield the rows of a table, and the account of all else: its header, blank lines, lines of
    another width.
    """
    index, header = schema.index(normal), True
    with file.open() as opened:
        for lines in read_lines(opened, file.origin, schema.delimiter):
            if not isinstance(lines, Lines):
                yield lines
                continue
            blank = lines.ends == lines.starts
            if header:
                blank[:1], header = True, False
            if blank.any():
                yield Used(int(lines.lengths[blank].sum()))
            right = lines.cells == len(schema.names)
            yield from lines.rejects(~blank & ~right, WRONG_WIDTH)
            right &= ~blank
            if right.any():
                whole = lines if right.all() else lines.take(right)
                yield ColumnReader(whole, index, schema.delimiter, schema.decimal_comma)


def only(parts: Sequence[PhoneFile], what: str) -> PhoneFile | None:
    """Return the one file there is, None where there is none.

    Raises:
        ConversionError: there are several.
    """
    if len(parts) > 1:
        raise ConversionError(
            f"there are several {what}, {parts[0].name!r} and {parts[1].name!r} among them; "
            "convert one at a time"
        )
    return parts[0] if parts else None


def used_whole(file: PhoneFile) -> Used:
    """Return the account of a file that says something about the log: all of its bytes."""
    return Used(_size(file))


def _size(file: PhoneFile) -> int:
    """Return how many bytes a file unpacks to."""
    size = 0
    with file.open() as opened:
        while piece := opened.read(2**20):
            size += len(piece)
    return size


def records(part: PhoneFile, limit: int = 1000) -> list[dict[str, str]]:
    """Read a small table of texts: its first rows within 64 KiB, by column name."""
    import csv
    import io

    schema = HeaderSchema.of(part.head)
    reader = csv.DictReader(
        io.StringIO(part.head.decode("utf-8", "replace"), newline=""), delimiter=schema.delimiter
    )
    try:
        rows = [row for row, _ in zip(reader, range(limit), strict=False)]
    except csv.Error as error:
        raise ConversionError(f"the table {part.name!r} cannot be read: {error}") from error
    return [
        {name: text or "" for name, text in row.items() if isinstance(name, str)} for row in rows
    ]
