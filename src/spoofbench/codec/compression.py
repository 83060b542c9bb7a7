"""Compression of chunks, and its bounded reverse, with a zstd context per thread."""

import threading
import zlib
from typing import Any, Literal

import lz4.frame
import numpy as np
import zstandard
from numpy.typing import NDArray

from spoofbench.errors import FormatError

Compression = Literal["zstd", "lz4", "none"]

_own = threading.local()


class Compress:
    """Checksum and compression of a payload."""

    def __init__(self, compression: Compression, level: int) -> None:
        self._compression, self._level = compression, level
        self._own = threading.local()

    def __call__(self, payload: NDArray[np.uint8]) -> tuple[int, Any]:
        crc = zlib.crc32(payload.data)
        if self._compression == "none":
            return crc, payload
        if self._compression == "lz4":
            return crc, lz4.frame.compress(payload)
        if not hasattr(self._own, "context"):
            self._own.context = zstandard.ZstdCompressor(self._level)
        return crc, self._own.context.compress(payload)


def decompress(
    data: NDArray[np.uint8], compression: str, size: int, where: str
) -> NDArray[np.uint8]:
    """Return what data unpack to; no more than the declared size is ever allocated.

    Raises:
        FormatError: they do not unpack, or to more than that, or the compression is unknown.
    """
    if compression == "":
        return data
    if not size:
        return np.empty(0, np.uint8)
    try:
        if compression == "zstd":
            return _from_zstd(data, size, where)
        if compression == "lz4":
            return _from_lz4(data, size, where)
    except (zstandard.ZstdError, RuntimeError) as error:
        raise FormatError(f"{where} does not unpack: {error}") from error
    raise FormatError(f"{where} is compressed by {compression!r}; zstd, lz4 and none can be read")


def _from_zstd(data: NDArray[np.uint8], size: int, where: str) -> NDArray[np.uint8]:
    declared = zstandard.frame_content_size(data.data)
    if declared not in (-1, size):
        raise FormatError(f"{where} declares {size!r} bytes but its zstd frame {declared!r}")
    if not hasattr(_own, "zstd"):
        _own.zstd = zstandard.ZstdDecompressor()
    return np.frombuffer(_own.zstd.decompress(data, max_output_size=size), np.uint8)


def _from_lz4(data: NDArray[np.uint8], size: int, where: str) -> NDArray[np.uint8]:
    unpacker = lz4.frame.LZ4FrameDecompressor()
    records = unpacker.decompress(bytes(data), max_length=size)
    if not unpacker.eof and unpacker.decompress(b"", max_length=1):
        raise FormatError(f"{where} unpacks to more than the {size!r} bytes that it declares")
    return np.frombuffer(records, np.uint8)
