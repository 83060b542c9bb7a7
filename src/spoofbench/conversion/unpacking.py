"""Packed files as streams: bounded, and honest about damage."""

import bz2
import gzip
import io
import lzma
import zipfile
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, cast

from spoofbench.errors import ConversionError, LimitError

MAX_UNPACKED_BYTES = 64 * 2**30

_ZSTD_WINDOW_BYTES = 128 * 2**20
# what damage may cost of the intact bytes before it, however much is asked for at a time
_PIECE_BYTES = 65_536
_ZSTD_PIECE_BYTES = 1024
"""Of packed bytes at a time: a zstd block of 4 bytes can unpack to 128 KiB, so that a piece gives
32 MiB at most.
"""

_BUFFER_BYTES = 2**20
_MAGIC = {b"\x1f\x8b": "gzip", b"\x28\xb5\x2f\xfd": "zstd", b"BZh": "bzip2", b"\xfd7zXZ\x00": "xz"}
_DAMAGE = (EOFError, OSError, zlib.error, lzma.LZMAError, zipfile.BadZipFile)


@dataclass(slots=True)
class ReadStats:
    """What a source's streams gave, by the name of the member; the name of a lone file is empty.

    Attributes:
        ended: unpacked bytes of the streams that were read to their end, or to where they are
            damaged.
        damage: why a stream ended early.
        beside: where the files lie that a lone file names and that were made part of the source.
    """

    ended: dict[str, int] = field(default_factory=dict)
    damage: dict[str, str] = field(default_factory=dict)
    beside: dict[str, Path] = field(default_factory=dict)


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
        self._stream, self._beneath, self._tally, self._name = stream, beneath, stats, name
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
            self._tally.ended[self._name] = self._read
        buffer[: len(piece)] = piece
        return len(piece)

    def _piece(self, most: int) -> bytes:
        try:
            return bytes(self._stream.read1(min(most, _PIECE_BYTES)))
        except _DAMAGE as error:
            if isinstance(error, OSError) and error.errno is not None:
                raise ConversionError(
                    f"{self._called!r} cannot be read after {self._read:,} bytes: {error.strerror}"
                ) from error
            self._tally.damage[self._name] = str(error)
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

    def read1(self, most: int) -> bytes:
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
        piece, self._ready = self._ready[:most], self._ready[most:]
        return bytes(piece)

    def close(self) -> None:
        self._ready = memoryview(b"")
