"""Columns to MCAP message records, whole runs of rows at a time.

All rows that have the same fields, each of the same width, have one byte layout: a constant
template with gaps for the times and the values. A layout is a numpy structured type, and packing is
assignment to it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from spoofbench.arrays import Bools, Indices, Ints, Octets
from spoofbench.codec.channels import DELIMITED, FIXED32, FIXED64, VARINT
from spoofbench.codec.records import LOG_TIME, MESSAGE, RECORD
from spoofbench.errors import RecordingError
from spoofbench.schema import Field
from spoofbench.table import Table

_ABSENT = -1
_WIRE_TYPES = {
    "<f8": FIXED64,
    "<i8": FIXED64,
    "<u8": FIXED64,
    "<f4": FIXED32,
    "<i4": FIXED32,
    "<u4": FIXED32,
}


class MessageEncoder(Protocol):
    """Encodes the rows that one channel gets, in the order of time.

    Attributes:
        channel_id: of the channel.
        times_ns: int64 ``(n,)``.
        sizes: int64 ``(n,)``, bytes of each row's message record.
    """

    @property
    def channel_id(self) -> int: ...
    @property
    def times_ns(self) -> Ints: ...
    @property
    def sizes(self) -> Ints: ...

    def encode(self, first: int, last: int, out: Octets, starts: Ints) -> None:
        """Write the records of the rows ``[first, last)`` to ``out``, each at its start,
        ``(n,)`` with n = last - first.
        """
        ...


class TableEncoder:
    """Encodes the rows of a table."""

    def __init__(self, channel_id: int, table: Table) -> None:
        self.channel_id = channel_id
        self.times_ns = table.time_ns
        self._columns = {name: table.column(name) for name in table}
        self._fields = table.kind.fields
        self._categories = {
            name: _encode_categories(name, column.categories)
            for name, column in self._columns.items()
            if column.categories is not None
        }
        widths = [self._widths(name) for name in self._columns]
        self._which, combinations = _distinct_widths(widths, len(table))
        self._layouts = [
            self._layout(dict(zip(self._columns, combination, strict=True)))
            for combination in combinations
        ]

    @cached_property
    def sizes(self) -> Ints:
        """Bytes of each row's record, ``(n,)``."""
        sizes = np.array([layout.template.size for layout in self._layouts], np.int64)
        return sizes[self._which] if sizes.size > 1 else np.repeat(sizes, self.times_ns.size)

    def encode(self, first: int, last: int, out: Octets, starts: Ints) -> None:
        """Write the records of the rows ``[first, last)`` to ``out``, each at its start,
        ``(n,)`` with n = last - first.
        """
        if len(self._layouts) == 1:
            layout, size = self._layouts[0], self._layouts[0].template.size
            if starts[-1] - starts[0] == (last - first - 1) * size:
                self._fill(layout, slice(first, last), out[starts[0] : starts[-1] + size])
                return
        which = self._which[first:last]
        for number in np.unique(which).tolist():
            rows = np.flatnonzero(which == number)
            layout = self._layouts[number]
            block = np.empty(rows.size * layout.template.size, np.uint8)
            self._fill(layout, rows + first, block)
            _scatter(out, starts[rows], block)

    def _widths(self, name: str) -> Ints | int:
        """Bytes that the value of a field takes in each row, -1 where absent; an int where all rows
        agree.
        """
        column, field = self._columns[name], self._fields[name]
        values = column.values
        if name in self._categories:
            table = np.array([len(value) for value in self._categories[name]] + [_ABSENT], np.int64)
            return np.asarray(table[values])
        valid = self._valid(name)
        width: Ints | int = 1 if field.category in ("boolean", "enum") else values.dtype.itemsize
        if field.category == "enum" and np.any((values < 0) | (values > 0x7F)):
            limits = 1 << np.arange(7, 64, 7, dtype=np.uint64)
            numbers = values.astype(np.int64).view(np.uint64)
            width = np.searchsorted(limits, numbers, "right") + 1
        elif valid.all():
            return int(width)
        return np.where(valid, width, _ABSENT)

    def _valid(self, name: str) -> Bools:
        column = self._columns[name]
        if column.values.dtype.kind == "f":
            return np.asarray(~np.isnan(column.values))
        return np.ones(column.values.size, bool) if column.valid is None else column.valid

    def _layout(self, widths: dict[str, int]) -> "_EncodeLayout":
        template = bytearray(MESSAGE.itemsize)
        formats: list[Any]
        names, offsets = ["log_time", "publish_time"], [LOG_TIME, LOG_TIME + 8]
        formats = ["<u8", "<u8"]
        for name, width in widths.items():
            if width == _ABSENT:
                continue
            field = self._fields[name]
            template += _prefix(field, width)
            if width:
                names.append(name)
                formats.append(_format(field, width))
                offsets.append(len(template))
            template += bytes(width)
        head = np.frombuffer(template, MESSAGE, 1)
        head["opcode"], head["channel"] = Opcode.MESSAGE, self.channel_id
        head["length"] = len(template) - RECORD.size
        dtype = np.dtype(
            {"names": names, "formats": formats, "offsets": offsets, "itemsize": len(template)}
        )
        return _EncodeLayout(np.frombuffer(bytes(template), np.uint8), dtype)

    def _fill(self, layout: "_EncodeLayout", rows: slice | Indices, out: Octets) -> None:
        out.reshape(-1, layout.template.size)[:] = layout.template
        records = out.view(layout.dtype)
        records["log_time"] = records["publish_time"] = self.times_ns[rows]
        for name in layout.dtype.names[2:]:  # type: ignore[index]
            values = self._columns[name].values[rows]
            if name in self._categories:
                width = layout.dtype[name].itemsize
                padded = [
                    category if len(category) == width else bytes(width)
                    for category in self._categories[name]
                ]
                records[name] = np.frombuffer(b"".join(padded), f"V{width}")[values]
            elif layout.dtype[name].shape:
                shifts = np.arange(0, 7 * layout.dtype[name].itemsize, 7, dtype=np.uint64)
                numbers = values.astype(np.int64).view(np.uint64)[:, None]
                digits = (numbers >> shifts) & np.uint64(0x7F)
                digits[:, :-1] |= np.uint64(0x80)
                records[name] = digits
            else:
                records[name] = values


@dataclass(frozen=True, slots=True)
class _EncodeLayout:
    """A record with gaps, uint8 ``(size,)``, and the structured type of what belongs in them."""

    template: Octets
    dtype: np.dtype[Any]


def _distinct_widths(
    widths: Sequence[Ints | int], rows: int
) -> tuple[Indices, list[tuple[int, ...]]]:
    """Number the distinct combinations of widths: the number of each row ``(n,)``, and the
    combinations.
    """
    which, count = np.zeros(rows, np.intp), 1
    for width in widths:
        if not isinstance(width, int) and rows:
            values, inverse = np.unique(width, return_inverse=True)
            if values.size > 1:
                _, which = np.unique(which * values.size + inverse, return_inverse=True)
                count = int(which.max()) + 1
    example = np.zeros(count, np.intp)
    example[which] = np.arange(rows)
    combinations = [
        tuple(width if isinstance(width, int) else int(width[row]) for width in widths)
        for row in example.tolist()
        if rows
    ]
    return which, combinations


def _prefix(field: Field, width: int) -> bytes:
    """Tag of a field, and length where it is text or bytes."""
    if field.category in ("text", "bytes"):
        return _varint(field.number << 3 | DELIMITED) + _varint(width)
    wire_type = (
        VARINT
        if field.category in ("boolean", "enum")
        else _WIRE_TYPES[np.dtype(field.dtype).newbyteorder("<").str]
    )
    return _varint(field.number << 3 | wire_type)


def _format(field: Field, width: int) -> Any:
    if field.category in ("text", "bytes"):
        return f"V{width}"
    if field.category == "enum":
        return "u1" if width == 1 else ("u1", (width,))
    return "u1" if field.category == "boolean" else np.dtype(field.dtype).newbyteorder("<")


def _varint(value: int) -> bytes:
    """Return a non-negative integer as a protobuf varint."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def _encode_categories(name: str, values: Sequence[str] | Sequence[bytes]) -> list[bytes]:
    try:
        return [value.encode() if isinstance(value, str) else value for value in values]
    except UnicodeEncodeError as error:
        raise RecordingError(
            f"field {name!r} holds {error.object!r}, which is not valid Unicode"
        ) from error


class BytesEncoder:
    """Adds the record heads to messages that are encoded already."""

    def __init__(self, channel_id: int, times_ns: Ints, messages: Sequence[bytes]) -> None:
        self.channel_id = channel_id
        self.times_ns = times_ns
        self._messages = messages
        self.sizes = np.array([MESSAGE.itemsize + len(message) for message in messages], np.int64)

    def encode(self, first: int, last: int, out: Octets, starts: Ints) -> None:
        """Write the records of the rows ``[first, last)`` to ``out``, each at its start,
        ``(n,)`` with n = last - first.
        """
        head = np.zeros(last - first, MESSAGE)
        head["opcode"], head["channel"] = Opcode.MESSAGE, self.channel_id
        head["length"] = self.sizes[first:last] - RECORD.size
        head["log_time"] = head["publish_time"] = self.times_ns[first:last]
        _scatter(out, starts, head.view(np.uint8))
        for start, message in zip(starts.tolist(), self._messages[first:last], strict=True):
            begin = start + MESSAGE.itemsize
            out[begin : begin + len(message)] = np.frombuffer(message, np.uint8)


def _scatter(out: Octets, starts: Ints, block: Octets) -> None:
    """Copy equally long stretches of ``block`` to ``out``, one to each start."""
    size = block.size // starts.size
    window: NDArray[Any] = np.ndarray(out.size - size + 1, f"V{size}", out.data, strides=(1,))
    window[starts] = block.view(f"V{size}")


def location_fixes(frame_id: str, table: Table) -> tuple[Ints, list[bytes]]:
    """Return the view of a ``gnss/pvt`` table for maps: times ``(m,)`` and encoded
    ``foxglove.LocationFix``.

    There is one for each row with latitude and longitude. Altitude is on the ellipsoid, NaN where
    absent; the covariance, row-major ENU in m^2, is given where all of it is known.
    """
    from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix

    rows = np.flatnonzero(table.valid("lat_deg") & table.valid("lon_deg"))
    times = table.time_ns[rows]
    position = np.stack([table[name][rows] for name in ("lat_deg", "lon_deg", "height_m")], axis=1)
    nn, ne, nd, ee, ed, dd = (
        table[f"cov_{pair}_m2"][rows] for pair in ("nn", "ne", "nd", "ee", "ed", "dd")
    )
    covariance = np.stack([ee, ne, -ed, ne, nn, -nd, -ed, -nd, dd], axis=1)
    known = np.isfinite(covariance).all(axis=1)
    messages = []
    for row, time in enumerate(times.tolist()):
        fix: Any = LocationFix(frame_id=frame_id)
        fix.timestamp.seconds, fix.timestamp.nanos = divmod(time, 1_000_000_000)
        fix.latitude, fix.longitude, fix.altitude = position[row].tolist()
        if known[row]:
            fix.position_covariance.extend(covariance[row].tolist())
            fix.position_covariance_type = LocationFix.KNOWN
        messages.append(fix.SerializeToString(deterministic=True))
    return times, messages
