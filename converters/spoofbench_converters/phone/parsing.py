"""Cells as numbers and words: whole columns at once, times exact to the nanosecond."""

from decimal import Decimal
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spoofbench_converters.phone.lines import Cells

LONGEST_NUMBER = 48
_ABSENT = ("", "null", "NULL", "nan", "NaN", "None", "N/A", "inf", "-inf", "Infinity", "-Infinity")
_NUMBER = r"^[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,4})?$"
_EXACT = 2.0**52
_BEYOND_MEASURE = 1e100


class Floats(NamedTuple):
    """Values, float64 ``(n,)``, NaN where the cell is empty, says so, or is infinite or nearly so; and which cells are no numbers."""

    values: NDArray[np.float64]
    bad: NDArray[np.bool_]


class Integers(NamedTuple):
    """Values, int64 ``(n,)``; which cells have one; and which cells are no numbers."""

    values: NDArray[np.int64]
    present: NDArray[np.bool_]
    bad: NDArray[np.bool_]


def floats(cells: Cells, decimal_comma: bool = False) -> Floats:
    """Read cells as decimal numbers, correctly rounded."""
    import pyarrow as pa
    import pyarrow.compute as pc

    lengths = cells.ends - cells.starts
    long = lengths > LONGEST_NUMBER
    texts = _texts(cells, np.where(long, 0, lengths), decimal_comma)
    try:
        values = texts.cast(pa.float64())
        bad = long
    except pa.ArrowInvalid:
        number = pc.match_substring_regex(texts, _NUMBER)
        absent = pc.is_in(texts, pa.array(_ABSENT))
        values = pc.if_else(number, texts, None).cast(pa.float64())
        good = pc.fill_null(pc.or_(number, absent), True)
        bad = long | ~good.to_numpy(zero_copy_only=False).astype(bool)
    found = np.array(values.fill_null(np.nan).to_numpy(zero_copy_only=False), np.float64)
    found[~(np.abs(found) < _BEYOND_MEASURE)] = np.nan
    return Floats(found, bad)


def scaled(cells: Cells, decimals: int = 0, decimal_comma: bool = False) -> Integers:
    """Read cells as decimal numbers times ``10 ** decimals``, exactly; what lies beyond is rounded half up.

    Seconds with 9 decimals, or milliseconds with 6, are nanoseconds.
    """
    lengths = np.minimum(cells.ends - cells.starts, LONGEST_NUMBER + 1)
    width = int(lengths.max(initial=0))
    plain = _Plain(lengths.size, decimals)
    point = b"," if decimal_comma else b"."
    for place in range(width):
        within = place < lengths
        octet = cells.octets[np.where(within, cells.starts + place, 0)] if cells.octets.size else np.zeros(lengths.size, np.uint8)
        plain.take(np.where(within, octet, 0), place, point[0])
    approximate = floats(cells, decimal_comma)
    with np.errstate(over="ignore"):
        scaled_floats = approximate.values * 10.0**decimals
    present = ~np.isnan(approximate.values)
    fits = present & (np.abs(scaled_floats) < 2.0**63 - 2.0**10)
    values = np.where(plain.ok & fits, plain.values(), 0)
    other = np.flatnonzero(fits & ~plain.ok)
    small = other[np.abs(scaled_floats[other]) < _EXACT / 64]
    values[small] = np.floor(scaled_floats[small] + 0.5).astype(np.int64)
    for row in np.setdiff1d(other, small).tolist():
        text = cells.octets[cells.starts[row] : cells.ends[row]].tobytes().decode("ascii", "replace")
        values[row] = int(Decimal(text.replace(",", ".")).scaleb(decimals).to_integral_value("ROUND_HALF_UP"))
    return Integers(values, fits, approximate.bad | (present & ~fits))


class _Plain:
    """Digits of n numbers without an exponent, taken one place at a time."""

    def __init__(self, rows: int, decimals: int) -> None:
        self._decimals = decimals
        self._value = np.zeros(rows, np.uint64)
        self._digits = np.zeros(rows, np.int64)
        self._fraction = np.full(rows, -1, np.int64)  # digits after the point; -1 before it
        self._negative = np.zeros(rows, bool)
        self._up = np.zeros(rows, bool)
        self._broken = np.zeros(rows, bool)

    def take(self, octet: NDArray[np.uint8], place: int, point: int) -> None:
        """Take the octets at one place of all numbers, 0 past their ends."""
        digit = octet - np.uint8(48)
        is_digit = digit < 10
        counted = is_digit & (self._fraction < self._decimals)
        self._value = np.where(counted, self._value * np.uint64(10) + digit, self._value)
        self._digits += counted & ((self._value > 0) | (digit > 0))
        self._up |= is_digit & (self._fraction == self._decimals) & (digit >= 5)
        after = self._fraction >= 0
        is_point = (octet == point) & ~after
        self._fraction += is_digit & after
        self._fraction[is_point] = 0
        is_sign = ((octet == ord("-")) | (octet == ord("+"))) & (place == 0)
        self._negative |= is_sign & (octet == ord("-"))
        self._broken |= ~(is_digit | is_point | is_sign | (octet == 0))

    @property
    def ok(self) -> NDArray[np.bool_]:
        """Which were read to their end and fit."""
        return np.asarray(~self._broken & (self._digits + self._missing() <= 19))

    def values(self) -> NDArray[np.int64]:
        """The numbers; those that are not :attr:`ok` mean nothing."""
        value = self._value * np.uint64(10) ** np.minimum(self._missing(), 19).astype(np.uint64) + self._up
        signed = value.astype(np.int64)
        return np.where(self._negative, -signed, signed)

    def _missing(self) -> NDArray[np.int64]:
        return self._decimals - np.clip(self._fraction, 0, self._decimals)


def words(cells: Cells, longest: int = 32) -> NDArray[np.bytes_]:
    """Read cells as words, cut to their first bytes: an array of fixed-width bytes ``(n,)``."""
    lengths = np.minimum(cells.ends - cells.starts, longest)
    width = max(int(lengths.max(initial=0)), 1)
    reach = np.arange(width)
    within = reach < lengths[:, None]
    if not lengths.size or not cells.octets.size:
        return np.zeros(lengths.size, f"S{width}")
    places = np.where(within, cells.starts[:, None] + reach, 0)
    return np.where(within, cells.octets[places], np.uint8(0)).view(f"S{width}").reshape(-1)


def _texts(cells: Cells, lengths: NDArray[np.int64], decimal_comma: bool) -> Any:
    """Return cells as an Arrow array of text, null where empty."""
    import pyarrow as pa

    offsets = np.zeros(lengths.size + 1, np.int32)
    np.cumsum(lengths, out=offsets[1:])
    places = np.arange(int(offsets[-1])) + np.repeat(cells.starts - offsets[:-1], lengths)
    octets = cells.octets[places]
    if decimal_comma:
        octets = np.where(octets == ord(","), np.uint8(ord(".")), octets)
    valid = np.packbits(lengths > 0, bitorder="little")
    ascii_only = np.where(octets < 128, octets, np.uint8(ord("?")))
    return pa.Array.from_buffers(
        pa.string(), lengths.size, [pa.py_buffer(valid), pa.py_buffer(offsets), pa.py_buffer(ascii_only.tobytes())]
    )
