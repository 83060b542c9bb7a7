"""What is to be converted: a file, a folder or an archive, read as bounded streams.

Packed files are unpacked as they are read. A damaged one ends where the damage begins, and its
:class:`ReadStats` say so.
"""

import bz2
import gzip
import io
import lzma
import zipfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import IO, Any, cast

from spoofbench.errors import ConversionError, LimitError

HEAD_BYTES = 65_536
MAX_MEMBERS = 100_000
MAX_UNPACKED_BYTES = 64 * 2**30

_ZSTD_WINDOW_BYTES = 128 * 2**20
_UNPACKED_PIECE_BYTES = 65_536
"""What damage may cost of the intact bytes before it, however much is asked for at a time."""
_ZSTD_PIECE_BYTES = 1024
"""Packed bytes per piece: a zstd block of 4 bytes unpacks to 128 KiB at most, a piece to 32 MiB."""

_BUFFER_BYTES = 2**20
_MAGIC = {b"\x1f\x8b": "gzip", b"\x28\xb5\x2f\xfd": "zstd", b"BZh": "bzip2", b"\xfd7zXZ\x00": "xz"}
_DAMAGE = (EOFError, OSError, zlib.error, lzma.LZMAError, zipfile.BadZipFile)
_ZIP = b"PK\x03\x04"
_READ_BYTES = 2**20


@dataclass(slots=True)
class ReadStats:
    """What a source's streams gave, by the name of the member; the name of a lone file is empty.

    Attributes:
        ended: unpacked bytes of the streams that were read to their end, or to where they are
            damaged.
        damage: why a stream ended early.
        companions: where the files lie that a lone file names and that became part of the source.
    """

    ended: dict[str, int] = field(default_factory=dict)
    damage: dict[str, str] = field(default_factory=dict)
    companions: dict[str, Path] = field(default_factory=dict)


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

    def companion_files(self, is_wanted: Callable[[str], bool]) -> Mapping[str, "Member"]:
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
        self.stats.companions.update({name: member.path for name, member in found.items()})
        return MappingProxyType(found)

    def size(self) -> int:
        """Return how many unpacked bytes there are; of members that were not read to their end, the
        declared size.

        Raises:
            ConversionError, LimitError: as :meth:`open` and :meth:`members`.
        """
        if self.stats.companions:
            return sum(
                self.stats.ended.get(name, path.stat().st_size)
                for name, path in self.stats.companions.items()
            )
        if self.path.is_dir() or self.is_archive:
            return sum(
                self.stats.ended.get(member.name, member.size) for member in self.members().values()
            )
        if packing_of(self.path) is None:
            return self.path.stat().st_size
        if "" not in self.stats.ended:
            with self.open() as file:
                while file.read(_READ_BYTES):
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


def packing_of(path: Path) -> str | None:
    """Return how a file is packed, by its first bytes: ``gzip``, ``zstd``, ``bzip2``, ``xz`` or
    None.

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        head = file.read(6)
    return next((name for magic, name in _MAGIC.items() if head.startswith(magic)), None)


def open_unpacked(path: Path, stats: ReadStats, name: str = "") -> IO[bytes]:
    """Return a file's bytes as a stream, unpacked where the content says that it is packed.

    Raises:
        OSError: it cannot be opened.
    """
    packing = packing_of(path)
    file = path.open("rb")
    if packing is None:
        return file
    unpack: Any = {"gzip": gzip.GzipFile, "bzip2": bz2.BZ2File, "xz": lzma.LZMAFile, "zstd": _Zstd}[
        packing
    ]
    return bounded(unpack(fileobj=file) if packing == "gzip" else unpack(file), file, stats, name)


def bounded(stream: Any, beneath: Any, stats: ReadStats, name: str) -> IO[bytes]:
    """Return a stream that ends where the packing is damaged, fails above 64 GiB, and closes what
    is beneath with it.
    """
    return cast(IO[bytes], io.BufferedReader(_Bounded(stream, beneath, stats, name), _BUFFER_BYTES))


class _Bounded(io.RawIOBase):
    def __init__(self, stream: Any, beneath: Any, stats: ReadStats, name: str) -> None:
        self._stream, self._beneath, self._stats, self._name = stream, beneath, stats, name
        self._read = 0
        self._over = False

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        piece = b"" if self._over else self._piece(len(buffer))
        self._read += len(piece)
        if self._read > MAX_UNPACKED_BYTES:
            raise LimitError(f"{self._called!r} unpacks to more than {MAX_UNPACKED_BYTES:,} bytes")
        if not piece:
            self._over = True
            self._stats.ended[self._name] = self._read
        buffer[: len(piece)] = piece
        return len(piece)

    def _piece(self, limit: int) -> bytes:
        try:
            return bytes(self._stream.read1(min(limit, _UNPACKED_PIECE_BYTES)))
        except _DAMAGE as error:
            if isinstance(error, OSError) and error.errno is not None:
                raise ConversionError(
                    f"{self._called!r} cannot be read after {self._read:,} bytes: {error.strerror}"
                ) from error
            self._stats.damage[self._name] = str(error)
            return b""

    @property
    def _called(self) -> str:
        return self._name or Path(self._beneath.name).name

    def close(self) -> None:
        if not self.closed:
            self._stream.close()
            self._beneath.close()
        super().close()


class _Zstd:
    """Unpacks zstd frames; unlike the library's own reader it can tell a frame that was cut off."""

    def __init__(self, file: IO[bytes]) -> None:
        import zstandard

        self._error: type[Exception] = zstandard.ZstdError
        self._decompressor = zstandard.ZstdDecompressor(max_window_size=_ZSTD_WINDOW_BYTES)
        self._file, self._frame, self._ready = (
            file,
            self._decompressor.decompressobj(),
            memoryview(b""),
        )
        self._begun = False

    def read1(self, limit: int) -> bytes:
        while not self._ready:
            packed = self._frame.unused_data or self._file.read(_ZSTD_PIECE_BYTES)
            if not packed:
                if self._begun and not self._frame.eof:
                    raise EOFError("the last zstd frame is cut off")
                return b""
            if self._frame.eof:
                self._frame = self._decompressor.decompressobj()
            try:
                self._ready = memoryview(self._frame.decompress(packed))
            except self._error as error:
                raise EOFError(str(error)) from error
            self._begun = True
        piece, self._ready = self._ready[:limit], self._ready[limit:]
        return bytes(piece)

    def close(self) -> None:
        self._ready = memoryview(b"")
