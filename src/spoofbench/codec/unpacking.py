"""Message records to columns, whole runs of rows at a time.

The layout of one message is learned by walking it; then the tags, the text lengths and the
continuation bits of all rows of that size are compared with it, and those that agree are columns at
constant offsets. What is left after a few layouts goes through the official protobuf decoder.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from spoofbench.codec.columns import Values
from spoofbench.codec.container import MESSAGE, Messages, gather, groups
from spoofbench.codec.protobuf import DELIMITED, FIXED32, FIXED64, VARINT, Reading, Wire
from spoofbench.errors import FormatError
from spoofbench.schema import Field

_LAYOUTS = 8  # learned per stretch of messages and size
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


@dataclass(frozen=True, slots=True)
class _Layout:
    """Where the bytes of a message record that never change are, and where the values."""

    constant: tuple[tuple[int, int, int], ...]  # column, mask, value
    fields: tuple[tuple[Wire, int, int], ...]  # wire, column, width

    def fits(self, rows: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Which rows ``(n, size)`` have this layout."""
        fit = np.ones(len(rows), bool)
        for column, mask, value in self.constant:
            byte = rows[:, column]
            fit &= (byte if mask == 0xFF else byte & mask) == value
        return fit


def _varint(data: bytes, at: int, most: int) -> tuple[int, int] | None:
    """Return value and end of a varint of at most so many bytes, None where it is longer or cut
    off.
    """
    value = 0
    for index, byte in enumerate(data[at : at + most]):
        value |= (byte & 0x7F) << 7 * index
        if byte < 0x80:
            return value, at + index + 1
    return None


def _learn(record: bytes, wires: dict[tuple[int, int], Wire]) -> _Layout | None:
    """Learn the layout of one message record; None where only the official decoder can tell what it
    holds.
    """
    constant: list[tuple[int, int, int]] = []
    fields: dict[int, tuple[Wire, int, int]] = {}
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
    return _Layout(tuple(constant), tuple(fields.values()))


class Decoder:
    """Decodes the messages of one channel."""

    def __init__(self, reading: Reading, words: dict[str, dict[bytes, int]]) -> None:
        self._reading = reading
        self._wires = {(wire.number, wire.wire_type): wire for wire in reading.wires}
        self._known: dict[int, list[_Layout]] = {}
        self._words = words

    def decode(self, messages: Messages, where: str) -> dict[str, Values]:
        """Return the fields that at least one of the messages has.

        Raises:
            FormatError: a message is not what the channel's schema says.
        """
        rows = messages.starts.size
        parts: list[tuple[NDArray[np.intp] | None, dict[str, Values]]] = []
        for size, which in groups(messages.sizes):
            block = _block(
                messages.buffer, messages.starts if which is None else messages.starts[which], size
            )
            parts += self._peel(block, which, where)
        if len(parts) == 1 and parts[0][0] is None:
            return parts[0][1]
        return _assembled(rows, parts)

    def _peel(
        self, block: NDArray[np.uint8], which: NDArray[np.intp] | None, where: str
    ) -> list[tuple[NDArray[np.intp] | None, dict[str, Values]]]:
        """Decode equally long records ``(n, size)``: rows of one layout at a time, the rest one by
        one.
        """
        known = self._known.setdefault(block.shape[1], [])
        parts: list[tuple[NDArray[np.intp] | None, dict[str, Values]]] = []
        first_new = len(known)
        for attempt in range(min(first_new + _LAYOUTS, _KNOWN)):
            if attempt == len(known):
                layout = _learn(block[0].tobytes(), self._wires) if self._reading.is_plain else None
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

    def _values(self, block: NDArray[np.uint8], layout: _Layout) -> dict[str, Values]:
        values: dict[str, Values] = {}
        for wire, column, width in layout.fields:
            values[wire.field.name] = self._value(block, wire, column, width), None
        for wire in self._reading.wires:
            if not wire.has_presence and wire.field.name not in values:
                values[wire.field.name] = self._zero(wire.field, len(block)), None
        return values

    def _zero(self, field: Field, rows: int) -> NDArray[Any]:
        code = self._codes(field, [b""])[0] if field.name in self._words else 0
        return np.full(rows, code, field.dtype)

    def _codes(self, field: Field, values: list[bytes]) -> NDArray[np.int32]:
        words = self._words[field.name]
        return np.fromiter(
            (words.setdefault(value, len(words)) for value in values), np.int32, len(values)
        )

    def _value(self, block: NDArray[np.uint8], wire: Wire, column: int, width: int) -> NDArray[Any]:
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

    def _one_by_one(self, block: NDArray[np.uint8], where: str) -> dict[str, Values]:
        """Decode records by the official decoder."""
        message = self._reading.message()
        columns: dict[str, list[Any]] = {wire.field.name: [] for wire in self._reading.wires}
        for row in block:
            try:
                message.ParseFromString(row[MESSAGE.itemsize :].tobytes())
            except DecodeError as error:
                raise FormatError(
                    f"{where} holds a message that is no {self._reading.kind.message.full_name}: "
                    f"{error}"
                ) from error
            for wire in self._reading.wires:
                absent = wire.has_presence and not message.HasField(wire.field.name)
                columns[wire.field.name].append(
                    None if absent else getattr(message, wire.field.name)
                )
        return {
            wire.field.name: self._column(wire.field, columns[wire.field.name])
            for wire in self._reading.wires
        }

    def _column(self, field: Field, values: list[Any]) -> Values:
        valid = np.array([value is not None for value in values], bool)
        if field.name in self._words:
            given = [
                value.encode() if isinstance(value, str) else value
                for value in values
                if value is not None
            ]
            codes = np.full(len(values), -1, np.int32)
            codes[valid] = self._codes(field, given)
            return codes, valid
        if field.category == "float":
            return np.array(
                [np.nan if value is None else value for value in values], field.dtype
            ), None
        return _cast(
            np.array([0 if value is None else value for value in values], object), field
        ), valid


def _block(buffer: NDArray[np.uint8], starts: NDArray[np.int64], size: int) -> NDArray[np.uint8]:
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
    rows: int, parts: list[tuple[NDArray[np.intp] | None, dict[str, Values]]]
) -> dict[str, Values]:
    """Put the parts' rows in their places."""
    values: dict[str, NDArray[Any]] = {}
    valid: dict[str, NDArray[np.bool_]] = {}
    for which, part in parts:
        for name, (column, mask) in part.items():
            if name not in values:
                values[name], valid[name] = np.zeros(rows, column.dtype), np.zeros(rows, bool)
            where: Any = slice(None) if which is None else which
            values[name][where] = column
            valid[name][where] = True if mask is None else mask
    return {name: (column, valid[name]) for name, column in values.items()}
