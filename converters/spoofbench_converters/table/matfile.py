"""MAT files of versions 5 to 7: their matrices of numbers and lists of texts (MathWorks, MAT-File
Format, R2024b, chapter 1).

Elements are read within the bounds of the file, whatever they claim, and unpacked no further than a
limit.
"""

import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench.errors import ConversionError, LimitError

MAX_UNPACKED_BYTES = 2**30
MAX_CELLS = 10_000

_HEADER = 128
_MATRIX, _COMPRESSED = 14, 15
_NUMBERS = {
    1: "i1",
    2: "u1",
    3: "i2",
    4: "u2",
    5: "i4",
    6: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
}
_TEXTS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16"}
_CELL, _STRUCT, _CHAR, _NUMERIC = 1, 2, 4, range(6, 16)
_COMPLEX = 0x0800

Numbers = dict[str, NDArray[Any]]
Texts = dict[str, tuple[str, ...]]


class _Damaged(Exception):
    pass


@dataclass(frozen=True, slots=True)
class _Reader:
    """Elements of a piece of a file, in its byte order (``<`` or ``>``)."""

    octets: memoryview
    order: str

    def elements(self) -> Iterator[tuple[int, memoryview]]:
        """Yield type and content of each element."""
        place = 0
        while place + 8 <= len(self.octets):
            kind, size = struct.unpack_from(f"{self.order}II", self.octets, place)
            if kind >> 16:  # small: type and size in four bytes, the content in the next four
                kind, size, start, step = kind & 0xFFFF, kind >> 16, place + 4, 8
                if size > 4:
                    raise _Damaged("an element is larger than its place")
            else:
                start, step = place + 8, 8 + size + (0 if kind == _COMPRESSED else -size % 8)
            if start + size > len(self.octets):
                raise _Damaged("an element is cut off")
            yield kind, self.octets[start : start + size]
            place += step

    def within(self, octets: memoryview) -> list[tuple[int, memoryview]]:
        """Return the elements of an element."""
        return list(_Reader(octets, self.order).elements())

    def numbers(self, element: tuple[int, memoryview]) -> NDArray[Any]:
        kind, octets = element
        if kind not in _NUMBERS:
            raise _Damaged(f"an element of type {kind} is no list of numbers")
        dtype = np.dtype(f"{self.order}{_NUMBERS[kind]}")
        return np.frombuffer(octets, dtype, len(octets) // dtype.itemsize).astype(
            dtype.newbyteorder("=")
        )


def read_mat(octets: bytes, name: str, wanted: frozenset[str]) -> tuple[Numbers, Texts]:
    """Return the wanted variables of a MAT file: matrices of real numbers, ``(n,)`` or ``(n, k)``;
    and cell arrays of texts.

    The fields of a structure of one element are called ``name.field``.

    Raises:
        ConversionError: it is of version 7.3, or damaged; LimitError: it unpacks to too much.
    """
    if octets.startswith(b"MATLAB 7.3"):
        raise ConversionError(
            f"{name!r} is a MAT file of version 7.3; save it with '-v7' in MATLAB"
        )
    reader = _Reader(memoryview(octets)[_HEADER:], "<" if octets[126:128] == b"IM" else ">")
    numbers: Numbers = {}
    texts: Texts = {}
    room = MAX_UNPACKED_BYTES
    try:
        for kind, content in reader.elements():
            if kind == _COMPRESSED:
                if _name_of(_unpacked(content, 4096), reader.order) not in wanted:
                    continue
                unpacked = _unpacked(content, room + 1)
                room -= len(unpacked)
                if room < 0:
                    raise LimitError(f"{name!r} unpacks to more than {MAX_UNPACKED_BYTES:,} bytes")
                content = memoryview(unpacked)[8:]
            elif kind != _MATRIX:
                continue
            _matrix(_Reader(content, reader.order), "", wanted, numbers, texts)
    except _Damaged as error:
        raise ConversionError(f"the MAT file {name!r} is damaged: {error}") from error
    return numbers, texts


def _unpacked(content: memoryview, max_bytes: int) -> bytes:
    try:
        return zlib.decompressobj().decompress(content, max_bytes)
    except zlib.error as error:
        raise _Damaged(str(error)) from error


def _name_of(octets: bytes, order: str) -> str:
    """Return the name of the matrix that starts like this."""
    found = []
    try:
        for element in _Reader(memoryview(octets)[8:], order).elements():
            found.append(element)
            if len(found) == 3:
                return bytes(found[2][1]).decode("latin-1")
    except _Damaged:
        pass
    return ""


def _matrix(
    reader: _Reader, prefix: str, wanted: frozenset[str], numbers: Numbers, texts: Texts
) -> None:
    """Add a matrix, the fields of a structure, or a cell array of texts."""
    elements = list(reader.elements())
    if len(elements) < 3:
        return
    flags, dims = reader.numbers(elements[0]), reader.numbers(elements[1]).astype(np.int64)
    name = prefix + bytes(elements[2][1]).decode("latin-1")
    if not flags.size or dims.size != 2 or (dims < 0).any() or not (prefix or name in wanted):
        return
    kind, count, content = int(flags[0]) & 0xFF, math.prod(dims.tolist()), elements[3:]
    if kind in _NUMERIC and not int(flags[0]) & _COMPLEX and content:
        values = reader.numbers(content[0])
        if values.size != count:
            raise _Damaged(f"{name!r} has {values.size:,} numbers where {count:,} are declared")
        numbers[name] = values if 1 in dims else values.reshape(dims.tolist(), order="F")
    elif kind == _CELL and count == len(content) <= MAX_CELLS:
        words = [_text(reader, cell) for cell in content]
        if None not in words:
            texts[name] = tuple(word or "" for word in words)
    elif kind == _STRUCT and count == 1 and len(content) >= 2 and not prefix:
        _fields(reader, name, content, numbers, texts)


def _fields(
    reader: _Reader,
    name: str,
    content: list[tuple[int, memoryview]],
    numbers: Numbers,
    texts: Texts,
) -> None:
    width = reader.numbers(content[0])
    if not width.size or not 0 < int(width[0]) <= 64:
        raise _Damaged(f"the structure {name!r} has field names of no length")
    names = [
        bytes(content[1][1][place : place + int(width[0])])
        for place in range(0, len(content[1][1]), int(width[0]))
    ]
    for field, (kind, octets) in zip(names, content[2:], strict=False):
        if kind == _MATRIX:
            own = field.partition(b"\0")[0].decode("latin-1")
            _matrix(_Reader(octets, reader.order), f"{name}.{own}", frozenset(), numbers, texts)


def _text(reader: _Reader, cell: tuple[int, memoryview]) -> str | None:
    """Return the text of a cell with one line of it, None if it holds anything else."""
    elements = reader.within(cell[1]) if cell[0] == _MATRIX else []
    if len(elements) < 4 or elements[3][0] not in _TEXTS:
        return None
    flags = reader.numbers(elements[0])
    if not flags.size or int(flags[0]) & 0xFF != _CHAR:
        return None
    encoding = _TEXTS[elements[3][0]]
    if encoding == "utf-16":
        encoding = "utf-16-le" if reader.order == "<" else "utf-16-be"
    return bytes(elements[3][1]).decode(encoding, "replace").strip()
