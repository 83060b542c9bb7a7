"""What is to be converted: a file, a folder or an archive, read in bounded memory, unpacked where it is packed."""

import bz2
import gzip
import io
import lzma
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import IO, Any, cast

from spoofbench.errors import ConversionError, LimitError

HEAD_BYTES = 65_536
MAX_UNPACKED_BYTES = 64 * 2**30
MAX_MEMBERS = 100_000

_ZSTD_WINDOW_BYTES = 128 * 2**20
_ZIP = b"PK\x03\x04"
_PACKED = {b"\x1f\x8b": "gzip", b"\x28\xb5\x2f\xfd": "zstd", b"BZh": "bzip2", b"\xfd7zXZ\x00": "xz"}


@dataclass(frozen=True, slots=True)
class Source:
    """A file, a folder or an archive.

    ``head`` holds the first bytes of what :meth:`open` reads; a folder has none. A zip archive is not
    unpacked by :meth:`open`: its files are its :meth:`members`.
    """

    path: Path
    head: bytes

    @classmethod
    def of(cls, path: Path) -> "Source":
        """Return the source at a path.

        Raises:
            ConversionError: it cannot be read.
        """
        try:
            if path.is_dir():
                return cls(path, b"")
            with open_unpacked(path) as file:
                return cls(path, file.read(HEAD_BYTES))
        except OSError as error:
            raise ConversionError(f"{str(path)!r} cannot be read: {error.strerror or error}") from error

    @property
    def is_archive(self) -> bool:
        """Whether it is a zip archive."""
        return self.head.startswith(_ZIP)

    def open(self) -> IO[bytes]:
        """Return the file's bytes as a stream; one packed by gzip, zstd, bzip2 or xz is unpacked as it is read.

        Raises:
            ConversionError: it cannot be read; LimitError, ConversionError: while reading, if it unpacks to too much, or is damaged.
        """
        try:
            return open_unpacked(self.path)
        except OSError as error:
            raise ConversionError(f"{str(self.path)!r} cannot be read: {error.strerror or error}") from error

    def members(self) -> Mapping[str, "Member"]:
        """Return the files in a folder or a zip archive by their paths within it, ``/`` between the parts, sorted; a lone file has none.

        Raises:
            ConversionError: the archive's directory cannot be read; LimitError: it has too many files.
        """
        if self.path.is_dir():
            paths = sorted(path for path in self.path.rglob("*") if path.is_file())
            found = [Member(path.relative_to(self.path).as_posix(), path.stat().st_size, path, None) for path in paths]
        elif self.is_archive:
            try:
                with zipfile.ZipFile(self.path) as archive:
                    infos = [info for info in archive.infolist() if not info.is_dir()]
            except (OSError, zipfile.BadZipFile, ValueError, NotImplementedError) as error:
                raise ConversionError(f"the archive {self.path.name!r} cannot be read: {error}") from error
            found = [Member(info.filename, info.file_size, self.path, info) for info in sorted(infos, key=lambda info: info.filename)]
        else:
            found = []
        if len(found) > MAX_MEMBERS:
            raise LimitError(f"{self.path.name!r} holds {len(found):,} files, more than {MAX_MEMBERS:,}")
        return MappingProxyType({member.name: member for member in found})


@dataclass(frozen=True, slots=True)
class Member:
    """A file in a folder or in an archive; ``size`` is what the archive declares."""

    name: str
    size: int
    path: Path
    info: zipfile.ZipInfo | None

    def open(self) -> IO[bytes]:
        """Return the file's bytes as a stream, unpacked as it is read.

        Raises:
            ConversionError: it cannot be read; LimitError, ConversionError: while reading, if it unpacks to too much, or is damaged.
        """
        if self.info is None:
            return open_unpacked(self.path)
        try:
            archive = zipfile.ZipFile(self.path)
            return bounded(archive.open(self.info), f"{self.name!r} in {self.path.name!r}", archive)
        except (OSError, zipfile.BadZipFile, RuntimeError, NotImplementedError) as error:
            raise ConversionError(f"{self.name!r} in {self.path.name!r} cannot be unpacked: {error}") from error


def open_unpacked(path: Path) -> IO[bytes]:
    """Return a file's bytes as a stream, unpacked where the content says that it is packed.

    Raises:
        OSError: it cannot be opened.
    """
    file = path.open("rb")
    head = file.read(6)
    file.seek(0)
    packing = next((name for magic, name in _PACKED.items() if head.startswith(magic)), None)
    if packing is None:
        return file
    if packing == "zstd":
        import zstandard

        decompressor = zstandard.ZstdDecompressor(max_window_size=_ZSTD_WINDOW_BYTES)
        stream: Any = decompressor.stream_reader(file, read_across_frames=True, closefd=True)
    else:
        stream = {"gzip": gzip.GzipFile, "bzip2": bz2.BZ2File, "xz": lzma.LZMAFile}[packing](cast(Any, file))
    return bounded(stream, repr(path.name), file)


def bounded(stream: IO[bytes], name: str, beneath: Any) -> IO[bytes]:
    """Return a stream that fails in one sentence at damage and above 64 GiB, and closes what is beneath with it."""
    return cast(IO[bytes], io.BufferedReader(_Bounded(stream, name, beneath), 2**20))


class _Bounded(io.RawIOBase):
    def __init__(self, stream: IO[bytes], name: str, beneath: Any) -> None:
        self._stream, self._name, self._beneath = stream, name, beneath
        self._read = 0

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        try:
            piece = self._stream.read(len(buffer))
        except Exception as error:  # each packing has errors of its own
            raise ConversionError(f"{self._name} cannot be unpacked after {self._read:,} bytes: {error}") from error
        self._read += len(piece)
        if self._read > MAX_UNPACKED_BYTES:
            raise LimitError(f"{self._name} unpacks to more than {MAX_UNPACKED_BYTES:,} bytes")
        buffer[: len(piece)] = piece
        return len(piece)

    def close(self) -> None:
        if not self.closed:
            self._stream.close()
            self._beneath.close()
        super().close()
