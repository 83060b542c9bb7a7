"""What is to be converted: a file, a folder or an archive, read in bounded memory, unpacked where
it is packed.
"""

import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import IO

from spoofbench.conversion.unpacking import (
    MAX_UNPACKED_BYTES,
    ReadStats,
    bounded,
    open_unpacked,
    packing_of,
)
from spoofbench.errors import ConversionError, LimitError

__all__ = ["HEAD_BYTES", "MAX_MEMBERS", "MAX_UNPACKED_BYTES", "Member", "Source"]

HEAD_BYTES = 65_536
MAX_MEMBERS = 100_000

_ZIP = b"PK\x03\x04"
_PIECE_BYTES = 2**20


@dataclass(frozen=True, slots=True)
class Source:
    """A file, a folder or an archive.

    ``head`` holds the first bytes of what :meth:`open` reads; a folder has none. A zip archive is
    not unpacked by :meth:`open`: its files are its :meth:`members`. A packed file that is damaged
    ends where the damage begins; ``stats`` says so, and how much each stream gave.
    """

    path: Path
    head: bytes
    stats: ReadStats = field(default_factory=ReadStats, compare=False, repr=False)

    @classmethod
    def of(cls, path: Path) -> "Source":
        """Return the source at a path.

        Raises:
            ConversionError: it cannot be read, is neither file nor folder, or nothing of it can be
                unpacked.
        """
        if path.is_dir():
            return cls(path, b"")
        if path.exists() and not path.is_file():
            raise ConversionError(
                f"{str(path)!r} is neither a file nor a folder; save what it gives to a file first"
            )
        source = cls(path, b"")
        with source.open() as file:
            head = file.read(HEAD_BYTES)
        if not head and source.stats.damage:
            raise ConversionError(f"{path.name!r} cannot be unpacked: {source.stats.damage['']}")
        return cls(path, head)

    @property
    def is_archive(self) -> bool:
        """Whether it is a zip archive."""
        return self.head.startswith(_ZIP)

    def reset(self) -> "Source":
        """Return the source as if nothing of it had been read."""
        return replace(self, stats=ReadStats())

    def open(self) -> IO[bytes]:
        """Return the file's bytes as a stream; one packed by gzip, zstd, bzip2 or xz is unpacked as
        it is read.

        Raises:
            ConversionError: it cannot be read; LimitError: while reading, if it unpacks to too
                much.
        """
        try:
            return open_unpacked(self.path, self.stats)
        except OSError as error:
            raise ConversionError(
                f"{str(self.path)!r} cannot be read: {error.strerror or error}"
            ) from error

    def members(self) -> Mapping[str, "Member"]:
        """Return the files in a folder or a zip archive by their paths within it, ``/`` between the
        parts, sorted; a lone file has none.

        Of files of one name in an archive the last counts, as for other programs.

        Raises:
            ConversionError: the archive's directory cannot be read; LimitError: it has too many
                files.
        """
        if self.path.is_dir():
            paths = sorted(path for path in self.path.rglob("*") if path.is_file())
            found = [
                Member(
                    path.relative_to(self.path).as_posix(),
                    path.stat().st_size,
                    path,
                    None,
                    self.stats,
                )
                for path in paths
            ]
        elif self.is_archive:
            try:
                with zipfile.ZipFile(self.path) as archive:
                    infos = [info for info in archive.infolist() if not info.is_dir()]
            except (
                OSError,
                zipfile.BadZipFile,
                ValueError,
                IndexError,
                NotImplementedError,
            ) as error:
                raise ConversionError(
                    f"the archive {self.path.name!r} cannot be read: {error}"
                ) from error
            infos.sort(key=lambda info: info.filename)
            found = [
                Member(info.filename, info.file_size, self.path, info, self.stats) for info in infos
            ]
        else:
            found = []
        if len(found) > MAX_MEMBERS:
            raise LimitError(
                f"{self.path.name!r} holds {len(found):,} files, more than {MAX_MEMBERS:,}"
            )
        return MappingProxyType({member.name: member for member in found})

    def beside(self, is_wanted: Callable[[str], bool]) -> Mapping[str, "Member"]:
        """Return the files in this file's folder and below whose paths in it are wanted: from then
        on they are the source's content.

        For a file that is no log itself but says which files are, such as a mapping.

        Raises:
            LimitError: as :meth:`members`.
        """
        folder = Source(self.path.parent, b"", self.stats)
        found = {
            name: member
            for name, member in folder.members().items()
            if member.path != self.path and is_wanted(name)
        }
        self.stats.beside.update({name: member.path for name, member in found.items()})
        return MappingProxyType(found)

    def size(self) -> int:
        """Return how many unpacked bytes there are; of members that were not read to their end, the
        declared size.

        Raises:
            ConversionError, LimitError: as :meth:`open` and :meth:`members`.
        """
        if self.stats.beside:
            return sum(
                self.stats.ended.get(name, path.stat().st_size)
                for name, path in self.stats.beside.items()
            )
        if self.path.is_dir() or self.is_archive:
            return sum(
                self.stats.ended.get(member.name, member.size) for member in self.members().values()
            )
        if packing_of(self.path) is None:
            return self.path.stat().st_size
        if "" not in self.stats.ended:
            with self.open() as file:
                while file.read(_PIECE_BYTES):
                    pass
        return self.stats.ended[""]


@dataclass(frozen=True, slots=True)
class Member:
    """A file in a folder or in an archive; ``size`` is that on the disk, or what the archive
    declares.
    """

    name: str
    size: int
    path: Path
    info: zipfile.ZipInfo | None
    stats: ReadStats = field(default_factory=ReadStats, compare=False, repr=False)

    def open(self) -> IO[bytes]:
        """Return the file's bytes as a stream, unpacked as it is read.

        Raises:
            ConversionError: it cannot be read; LimitError: while reading, if it unpacks to too
                much.
        """
        try:
            if self.info is None:
                return open_unpacked(self.path, self.stats, self.name)
            archive = zipfile.ZipFile(self.path)
            try:
                return bounded(archive.open(self.info), archive, self.stats, self.name)
            except BaseException:
                archive.close()
                raise
        except (OSError, zipfile.BadZipFile, RuntimeError, NotImplementedError) as error:
            raise ConversionError(
                f"{self.name!r} in {self.path.name!r} cannot be unpacked: {error}"
            ) from error
