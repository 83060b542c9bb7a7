"""Message records to columns, whole runs of rows at a time.

The layout of one message is learned by walking it; then the tags, the text lengths and the
continuation bits of all rows of that size are compared with it, and those that agree are columns at
constant offsets. What is left after a few layouts goes through the official protobuf decoder.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from spoofbench.arrays import Bools, Indices, Ints, Octets
from spoofbench.codec.channels import DELIMITED, FIXED32, FIXED64, VARINT, TopicChannel, WireField
from spoofbench.codec.container import MessageRecords
from spoofbench.codec.records import MESSAGE, gather, group_by_value
from spoofbench.errors import FormatError
from spoofbench.schema import Field, Kind

_LAYOUTS = 8  # learned per call and size of message
_KNOWN = 64  # kept per size
_CONSTANT = 2000  # bytes of a layout; beyond it the official decoder is quicker
_FEW = 16  # rows that are decoded one by one sooner than their layout is learned
_SIGNED = {FieldDescriptor.TYPE_INT64, FieldDescriptor.TYPE_SFIXED64}
_NARROW = {
    FieldDescriptor.TYPE_INT32: np.int32,
    FieldDescriptor.TYPE_ENUM: np.int32,
    FieldDescriptor.TYPE_UINT32: np.uint32,
}
_FIXED = {
    FieldDescriptor.TYPE_DOUBLE: "<f8",
    FieldDescriptor.TYPE_FLOAT: "<f4",
    FieldDescriptor.TYPE_FIXED32: "<u4",
    FieldDescriptor.TYPE_SFIXED32: "<i4",
    FieldDescriptor.TYPE_FIXED64: "<u8",
    FieldDescriptor.TYPE_SFIXED64: "<i8",
}


Values = tuple[NDArray[Any], Bools | None]
"""Values of a field ``(n,)``, and which rows have it, None where all do."""

Categories = dict[str, dict[bytes, int]]
"""By text or bytes field, the code of each value met so far."""


def empty_categories(kind: Kind) -> Categories:
    """Return the categories of a kind's text and bytes fields before any value is met."""
    return {f.name: {} for f in kind.fields.values() if f.category in ("text", "bytes")}


class ChannelDecoder:
    """Decodes the messages of one channel, and remembers the layouts that it met.

    Args:
        channel: whose messages they are.
        categories: of the kind's fields; new values are added.
    """

    def __init__(self, channel: TopicChannel, categories: Categories) -> None:
        self._channel = channel
        self._wires = {(wire.number, wire.wire_type): wire for wire in channel.wires}
        self._known: dict[int, list[_DecodeLayout]] = {}
        self._categories = categories

    def decode(self, messages: MessageRecords, where: str) -> dict[str, Values]:
        """Return the fields that at least one of the messages has, by name.

        ``where`` names the file in errors.

        Raises:
            FormatError: a message is not what the channel's schema says.
        """
        rows = messages.starts.size
        parts: list[tuple[Indices | None, dict[str, Values]]] = []
        for size, which in group_by_value(messages.sizes):
            block = _block(
                messages.buffer, messages.starts if which is None else messages.starts[which], size
            )
            parts += self._by_layout(block, which, where)
        if len(parts) == 1 and parts[0][0] is None:
            return parts[0][1]
        return _assembled(rows, parts)

    def _by_layout(
        self, block: Octets, which: Indices | None, where: str
    ) -> list[tuple[Indices | None, dict[str, Values]]]:
        """Decode equally long records ``(n, size)``: rows of one layout at a time, the rest one by
        one.
        """
        known = self._known.setdefault(block.shape[1], [])
        parts: list[tuple[Indices | None, dict[str, Values]]] = []
        first_new = len(known)
        for attempt in range(min(first_new + _LAYOUTS, _KNOWN)):
            if attempt == len(known):
                layout = _learn(block[0].tobytes(), self._wires) if self._channel.is_plain else None
                if layout is None:
                    break
                known.append(layout)
            layout = known[attempt]
            fit = layout.fits(block)
            if fit.all():
                return [*parts, (which, self._values(block, layout))]
            if fit.any():
                which = np.arange(len(block)) if which is None else which
                parts.append((which[fit], self._values(block[fit], layout)))
                block, which = block[~fit], which[~fit]
            if len(block) < _FEW and attempt + 1 >= first_new:
                break
        return [*parts, (which, self._one_by_one(block, where))]

    def _values(self, block: Octets, layout: "_DecodeLayout") -> dict[str, Values]:
        values: dict[str, Values] = {}
        for wire, column, width in layout.fields:
            values[wire.field.name] = self._value(block, wire, column, width), None
        for wire in self._channel.wires:
            if not wire.has_presence and wire.field.name not in values:
                values[wire.field.name] = self._zero(wire.field, len(block)), None
        return values

    def _zero(self, field: Field, rows: int) -> NDArray[Any]:
        code = self._codes(field, [b""])[0] if field.name in self._categories else 0
        return np.full(rows, code, field.dtype)

    def _codes(self, field: Field, values: list[bytes]) -> NDArray[np.int32]:
        categories = self._categories[field.name]
        return np.fromiter(
            (categories.setdefault(value, len(categories)) for value in values),
            np.int32,
            len(values),
        )

    def _value(self, block: Octets, wire: WireField, column: int, width: int) -> NDArray[Any]:
        rows, size = block.shape
        if wire.type in _FIXED:
            fixed: NDArray[Any] = np.ndarray(rows, _FIXED[wire.type], block.data, column, (size,))
            return _cast(fixed, wire.field)
        if wire.wire_type == DELIMITED:
            texts: list[bytes] = (
                np.ndarray(rows, f"V{width}", block.data, column, (size,)).tolist()
                if width
                else [b""] * rows
            )
            return self._codes(wire.field, texts)
        number = np.zeros(rows, np.uint64)
        for index in range(width):
            number |= (block[:, column + index] & 0x7F).astype(np.uint64) << np.uint64(7 * index)
        return _cast(_integers(number, wire.type), wire.field)

    def _one_by_one(self, block: Octets, where: str) -> dict[str, Values]:
        """Decode records by the official decoder."""
        message = self._channel.message()
        columns: dict[str, list[Any]] = {wire.field.name: [] for wire in self._channel.wires}
        for row in block:
            try:
                message.ParseFromString(row[MESSAGE.itemsize :].tobytes())
            except DecodeError as error:
                raise FormatError(
                    f"{where} holds a message that is no {self._channel.kind.message.full_name}: "
                    f"{error}"
                ) from error
            for wire in self._channel.wires:
                absent = wire.has_presence and not message.HasField(wire.field.name)
                columns[wire.field.name].append(
                    None if absent else getattr(message, wire.field.name)
                )
        return {
            wire.field.name: self._column(wire.field, columns[wire.field.name])
            for wire in self._channel.wires
        }

    def _column(self, field: Field, values: list[Any]) -> Values:
        valid = np.array([value is not None for value in values], bool)
        if field.name in self._categories:
            given = [
                value.encode() if isinstance(value, str) else value
                for value in values
                if value is not None
            ]
            codes = np.full(len(values), -1, np.int32)
            codes[valid] = self._codes(field, given)
            return codes, valid
        if field.category == "float":
            floats = [np.nan if value is None else value for value in values]
            return np.array(floats, field.dtype), None
        numbers = np.array([0 if value is None else value for value in values], object)
        return _cast(numbers, field), valid


@dataclass(frozen=True, slots=True)
class _DecodeLayout:
    """Where the bytes of a message record that never change are, and where the values."""

    constant: tuple[tuple[int, int, int], ...]  # column, mask, value
    fields: tuple[tuple[WireField, int, int], ...]  # wire, column, width

    def fits(self, rows: Octets) -> Bools:
        """Which rows ``(n, size)`` have this layout."""
        fit = np.ones(len(rows), bool)
        for column, mask, value in self.constant:
            byte = rows[:, column]
            fit &= (byte if mask == 0xFF else byte & mask) == value
        return fit


def _learn(record: bytes, wires: dict[tuple[int, int], WireField]) -> _DecodeLayout | None:
    """Learn the layout of one message record; None where only the official decoder can tell what it
    holds.
    """
    constant: list[tuple[int, int, int]] = []
    fields: dict[int, tuple[WireField, int, int]] = {}
    at = MESSAGE.itemsize
    while at < len(record):
        if len(constant) > _CONSTANT:
            return None
        begin, tag = at, _varint(record, at, 5)
        if tag is None or not 0 < tag[0] >> 3 < 1 << 29:
            return None
        number, wire_type, at = tag[0] >> 3, tag[0] & 7, tag[1]
        value = at
        if wire_type == VARINT:
            found = _varint(record, at, 10)
            if found is None:
                return None
            at = found[1]
        elif wire_type == DELIMITED:
            found = _varint(record, at, 5)
            if found is None:
                return None
            value = found[1]
            at = value + found[0]
        elif wire_type in (FIXED64, FIXED32):
            at += 8 if wire_type == FIXED64 else 4
        else:
            return None
        if at > len(record):
            return None
        head = value if wire_type == DELIMITED else tag[1]
        constant += [(column, 0xFF, record[column]) for column in range(begin, head)]
        if wire_type == VARINT:
            constant += [
                (column, 0x80, record[column] & 0x80) for column in range(value, min(at, value + 9))
            ]
            constant += [(column, 0xFE, 0) for column in range(value + 9, at)]
        if (number, wire_type) in wires:
            fields[number] = wires[number, wire_type], value, at - value
    return _DecodeLayout(tuple(constant), tuple(fields.values()))


def _varint(data: bytes, at: int, limit: int) -> tuple[int, int] | None:
    """Return value and end of a varint of at most ``limit`` bytes, None where it is longer or cut
    off.
    """
    value = 0
    for index, byte in enumerate(data[at : at + limit]):
        value |= (byte & 0x7F) << 7 * index
        if byte < 0x80:
            return value, at + index + 1
    return None


def _block(buffer: Octets, starts: Ints, size: int) -> Octets:
    """Return equally long records as rows ``(n, size)``; without a copy where they follow each
    other.
    """
    first, last = int(starts[0]), int(starts[-1])
    if last - first == (starts.size - 1) * size:
        return buffer[first : last + size].reshape(-1, size)
    return gather(buffer, f"V{size}", starts).view(np.uint8).reshape(-1, size)


def _integers(number: NDArray[np.uint64], declared: int) -> NDArray[Any]:
    """Read 64 bits of a varint as its declared type does."""
    if declared == FieldDescriptor.TYPE_BOOL:
        return np.asarray(number != 0)
    if declared in (FieldDescriptor.TYPE_SINT32, FieldDescriptor.TYPE_SINT64):
        if declared == FieldDescriptor.TYPE_SINT32:
            number = number & np.uint64(0xFFFFFFFF)
        return np.asarray(
            (number >> np.uint64(1)).view(np.int64) ^ -(number & np.uint64(1)).view(np.int64)
        )
    if declared in _SIGNED:
        return number.view(np.int64)
    if declared in _NARROW:
        return number.astype(np.uint32).view(_NARROW[declared])
    return number


def _cast(values: NDArray[Any], field: Field) -> NDArray[Any]:
    """Return the values as a field's type, unchanged apart from the precision of floats.

    Raises:
        FormatError: one does not fit.
    """
    dtype = np.dtype(field.dtype)
    if values.dtype == dtype:
        return values
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            cast = values.astype(dtype)
    except OverflowError as error:
        raise FormatError(
            f"field {field.name!r} holds a value that does not fit {dtype}"
        ) from error
    if dtype.kind != "f" and not np.array_equal(cast, values):
        raise FormatError(f"field {field.name!r} holds a value that does not fit {dtype}")
    return cast


def _assembled(
    rows: int, parts: list[tuple[Indices | None, dict[str, Values]]]
) -> dict[str, Values]:
    """Join parts, each with the indices of its rows (None: all), to columns of ``rows`` values."""
    values: dict[str, NDArray[Any]] = {}
    valid: dict[str, Bools] = {}
    for which, part in parts:
        for name, (column, mask) in part.items():
            if name not in values:
                values[name], valid[name] = np.zeros(rows, column.dtype), np.zeros(rows, bool)
            where: Any = slice(None) if which is None else which
            values[name][where] = column
            valid[name][where] = True if mask is None else mask
    return {name: (column, valid[name]) for name, column in values.items()}


def decode_categories(
    field: Field, categories: Iterable[bytes]
) -> tuple[str, ...] | tuple[bytes, ...]:
    """Return the values of a text or bytes field as its column has them, in the order of codes.

    Raises:
        FormatError: a text is not valid UTF-8.
    """
    if field.category == "bytes":
        return tuple(categories)
    try:
        return tuple(category.decode() for category in categories)
    except UnicodeDecodeError as error:
        raise FormatError(
            f"field {field.name!r} holds {error.object!r}, which is not valid UTF-8"
        ) from error
