"""Serialised messages to numpy: a message's byte layout is walked once and laid over all messages
that share it.

ROS 2: plain CDR (Object Management Group, CORBA 3.0, chapter 15.3): four bytes of encapsulation,
then the fields in order, each scalar aligned to its size from there; a sequence is a 4-byte count
and its elements, a string a 4-byte length and its bytes with a closing zero. ROS 1: the same
without encapsulation, alignment and closing zero, little-endian.
"""

import struct
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench_converters.rosbag.definitions import Definitions

MAX_FIELDS = 4096
MAX_LAYOUTS = 8
KNOWN_LAYOUTS = 64
ENCODINGS = frozenset({"cdr", "ros1"})
_ENCAPSULATIONS = {b"\x00\x00": ">", b"\x00\x01": "<"}
_MAX_DEPTH = 16
_MAX_STEPS = 65_536
_TAIL_BYTES = 3  # some writers pad to four bytes
_SCALARS = {
    "bool": "u1", "byte": "u1", "char": "u1", "int8": "i1", "uint8": "u1", "int16": "i2",
    "uint16": "u2", "int32": "i4", "uint32": "u4",
    "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8",
}  # fmt: skip


class LayoutError(Exception):
    """A message that cannot be decoded, and why."""


Failure = tuple[int, str]
"""Place of a message that cannot be decoded, and why."""


@dataclass(frozen=True, slots=True)
class Group:
    """Messages of one layout: their places in the given sequence, and one structured row each.

    Fields bear dotted paths (``header.seq``, ``status.0.level``); sequences and arrays of scalars
    are subarrays.
    """

    index: NDArray[np.intp]
    rows: NDArray[Any]


class Decoder:
    """Decodes messages of one type; a layout that was walked once serves as long as messages have
    it.

    Args:
        name: the type.
        types: definitions of that type and those within it.
        encoding: ``cdr`` or ``ros1``.
    """

    def __init__(self, name: str, types: Definitions, encoding: str = "cdr") -> None:
        self._name = name
        self._types = types
        self._encoding = encoding
        self._known: dict[int, list[_Layout]] = {}

    def decode(
        self, octets: NDArray[np.uint8], starts: NDArray[np.int64], lengths: NDArray[np.int64]
    ) -> tuple[list[Group], list[Failure]]:
        """Return all messages by layout, and each that cannot be decoded.

        Args:
            octets: bytes among which the messages lie.
            starts: where each starts, ``(n,)``.
            lengths: bytes of each, ``(n,)``.
        """
        groups: list[Group] = []
        failures: list[Failure] = []
        for length in np.unique(lengths).tolist():
            index, passes = np.flatnonzero(lengths == length), 0
            while index.size:
                first = int(starts[index[0]])
                try:
                    layout = self._layout(octets[first : first + length].tobytes())
                except LayoutError as error:
                    failures.append((int(index[0]), str(error)))
                    index = index[1:]
                    continue
                passes += 1
                tried = index if passes <= MAX_LAYOUTS else index[:1]
                rows = windows(octets, length)[starts[tried]].view(layout.dtype)
                same = layout.fits(rows)
                groups.append(Group(tried, rows) if same.all() else Group(tried[same], rows[same]))
                index = np.concatenate([tried[~same], index[tried.size :]])
        return groups, failures

    def _layout(self, message: bytes) -> "_Layout":
        known = self._known.setdefault(len(message), [])
        for layout in known:
            if layout.fits(np.frombuffer(message, layout.dtype))[0]:
                return layout
        layout = _walk(message, self._name, self._types, self._encoding)
        known.insert(0, layout)
        del known[MAX_LAYOUTS:]
        if len(self._known) > KNOWN_LAYOUTS:
            del self._known[next(iter(self._known))]
        return layout


def windows(octets: NDArray[np.uint8], length: int) -> NDArray[np.void]:
    """Return a view of the so many bytes from each place on, ``(n - length + 1,)``; what is taken
    from it is copied as a whole.
    """
    return np.ndarray((octets.size - length + 1,), f"V{length}", octets, strides=(1,))


@dataclass(slots=True)
class _Layout:
    """Byte layout under construction: fields with their offsets, and the counts that hold it
    together.
    """

    message: bytes
    types: Definitions
    order: str = "<"
    aligned: bool = False
    at: int = 0
    steps: int = 0
    names: list[str] = field(default_factory=list)
    formats: list[Any] = field(default_factory=list)
    offsets: list[int] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)
    dtype: np.dtype[Any] = field(default_factory=lambda: np.dtype([]))

    def close(self) -> None:
        """Make the dtype of a whole message."""
        names, formats, offsets = self.names, self.formats, self.offsets
        if self.aligned:
            names, formats, offsets = ["#", *names], ["S2", *formats], [0, *offsets]
        self.dtype = np.dtype(
            {"names": names, "formats": formats, "offsets": offsets, "itemsize": len(self.message)}
        )

    def fits(self, rows: NDArray[Any]) -> NDArray[np.bool_]:
        """Which messages have the encapsulation and the counts of the one that was walked."""
        same = (
            np.asarray(rows["#"] == self.message[:2]) if self.aligned else np.ones(rows.size, bool)
        )
        for name, value in self.counts.items():
            same &= rows[name] == value
        return same

    def place(
        self, name: str, code: str, shape: tuple[int, ...] = (), align: int | None = None
    ) -> int:
        """Add one field at the next aligned place; return its offset."""
        item = np.dtype(code)
        if self.aligned:
            self.at += -(self.at - 4) % (align or item.itemsize)
        offset = self.at
        self.at += item.itemsize * int(np.prod(shape))
        if self.at > len(self.message):
            raise LayoutError("the message is shorter than its definition")
        if len(self.names) >= MAX_FIELDS:
            raise LayoutError(f"the message has more than {MAX_FIELDS} fields")
        self.names.append(name)
        self.formats.append((item, shape) if shape else item)
        self.offsets.append(offset)
        return offset

    def count(self, name: str) -> int:
        """Add the count of a sequence or string; return its value here."""
        offset = self.place(f"{name}#", f"{self.order}u4")
        value: int = struct.unpack_from(f"{self.order}I", self.message, offset)[0]
        self.counts[f"{name}#"] = value
        if value > len(self.message) - self.at:
            raise LayoutError(f"the field {name!r} is longer than the message")
        return value


def _walk(message: bytes, name: str, types: Definitions, encoding: str) -> _Layout:
    layout = _Layout(message, types)
    if encoding == "cdr":
        order = _ENCAPSULATIONS.get(message[:2])
        if order is None:
            raise LayoutError("the encapsulation is not plain CDR")
        layout.order, layout.aligned, layout.at = order, True, 4
    _walk_type(layout, "", name, 0)
    if len(message) - layout.at > (_TAIL_BYTES if layout.aligned else 0):
        raise LayoutError("the message is longer than its definition")
    layout.close()
    return layout


def _walk_type(layout: _Layout, prefix: str, name: str, depth: int) -> None:
    if depth > _MAX_DEPTH:
        raise LayoutError(f"the definition of {name!r} contains itself")
    if name not in layout.types:
        raise LayoutError(f"no definition of {name!r}")
    fields = layout.types[name][1]
    if not fields:
        raise LayoutError(f"the definition of {name!r} has no fields")
    for field_name, description in fields:
        _walk_field(layout, f"{prefix}{field_name}", description, depth)


def _walk_field(layout: _Layout, path: str, description: Any, depth: int) -> None:
    from rosbags.interfaces import Nodetype

    layout.steps += 1
    if layout.steps > _MAX_STEPS:
        raise LayoutError(f"the message has more than {_MAX_STEPS:,} fields")
    kind, inner = description
    if kind == Nodetype.NAME:
        _walk_type(layout, f"{path}.", inner, depth + 1)
    elif kind == Nodetype.BASE:
        _walk_base(layout, path, inner[0], None)
    else:
        element, length = inner
        length = length if kind == Nodetype.ARRAY else layout.count(path)
        if element[0] == Nodetype.BASE and element[1][0] != "string":
            _walk_base(layout, path, element[1][0], length)
        else:
            for place in range(length):
                _walk_field(layout, f"{path}.{place}", element, depth)


def _walk_base(layout: _Layout, path: str, base: str, length: int | None) -> None:
    if base == "string":
        length_in_bytes = layout.count(path)
        if length_in_bytes:
            layout.place(path, f"S{length_in_bytes}", align=1)
    elif base not in _SCALARS:
        raise LayoutError(f"the field {path!r} is of the type {base!r}, which cannot be decoded")
    elif length != 0:
        layout.place(path, f"{layout.order}{_SCALARS[base]}", () if length is None else (length,))
