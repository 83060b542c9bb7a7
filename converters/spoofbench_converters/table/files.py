"""The files of a session: of a folder, an archive, or alone."""

import fnmatch
import io
import re
import shutil
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import IO, Literal

from spoofbench.conversion import Member, Source
from spoofbench.conversion.sources import HEAD_BYTES
from spoofbench.errors import ConversionError, LimitError

MAX_FILE_BYTES = 2 * 2**30
PIECE_BYTES = 2**22

FileFormat = Literal["csv", "parquet", "mat", "npy", "json"]

_RECORDS = re.compile(rb'\s*\[\s*\{\s*"')
_COLUMNS = re.compile(rb'\s*\{\s*"[^"]*"\s*:\s*\{\s*"\d+"\s*:')


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
        if self.head.startswith(b"\x93NUMPY"):
            return "npy"
        return "json" if is_json(self.head) else "csv"

    @property
    def is_hidden(self) -> bool:
        """Whether it is no part of a session by its name, such as what macOS puts into archives."""
        return any(part.startswith((".", "__MACOSX")) for part in self.name.split("/"))

    def open(self) -> IO[bytes]:
        return self.content.open()

    def whole(self) -> bytes:
        """Return the file's bytes.

        Raises:
            LimitError: it is too large for a format that cannot be streamed.
        """
        with self.open() as file:
            content = read_up_to(file, MAX_FILE_BYTES + 1)
        if len(content) > MAX_FILE_BYTES:
            raise LimitError(f"{self.name!r} has more than {MAX_FILE_BYTES:,} bytes")
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

    def count(self) -> int:
        """Return how many bytes it has, unpacked as far as that goes."""
        octets = 0
        with suppress(ConversionError), self.open() as file:
            while piece := file.read(PIECE_BYTES):
                octets += len(piece)
        return octets


def is_json(head: bytes) -> bool:
    """Whether the first bytes are those of a table in JSON: of records, or of columns."""
    return _RECORDS.match(head) is not None or is_columns(head)


def is_columns(head: bytes) -> bool:
    """Whether the first bytes are those of a table in JSON, column by column."""
    return _COLUMNS.match(head) is not None


def read_up_to(file: IO[bytes], octets: int) -> bytes:
    """Return the next bytes of a file, at most so many; what is not there costs no memory."""
    content = bytearray()
    while len(content) < octets and (piece := file.read(min(octets - len(content), PIECE_BYTES))):
        content += piece
    return bytes(content)


def _is_plain(file: IO[bytes]) -> bool:
    """Whether a file is read from the disk as it is."""
    return isinstance(file, io.BufferedReader) and isinstance(file.raw, io.FileIO)


def files_of(source: Source) -> list[File]:
    """Return the files of a log."""
    members = source.members()
    return files_in(members) if members else [File(source.path.name, source, source.head)]


def files_in(members: Mapping[str, Member]) -> list[File]:
    """Return members as files; of a hidden one no head is read."""
    found = []
    for name, member in members.items():
        found.append(File(name, member, b""))
        if not found[-1].is_hidden:
            with member.open() as file:
                found[-1] = replace(found[-1], head=file.read(HEAD_BYTES))
    return found


def fits(name: str, pattern: str) -> bool:
    """Whether a path fits a pattern; one without a slash is held against the file's own name."""
    return fnmatch.fnmatchcase(name if "/" in pattern else name.rpartition("/")[2], pattern)


def array_name(file: File) -> str:
    """Return the name of an array: its folder's and its own."""
    return "/".join(file.name.removesuffix(".npy").split("/")[-2:])
