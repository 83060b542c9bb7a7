"""Cells as numbers and words: whole columns at once, times exact to the nanosecond."""

from dataclasses import dataclass
from decimal import Decimal
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spoofbench_converters.text.lines import BLANK, QUOTE

MAX_NUMBER_BYTES = 48
_ABSENT = ("", "null", "NULL", "nan", "NaN", "None", "N/A", "inf", "-inf", "Infinity", "-Infinity")
_NUMBER = r"^[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,4})?$"
_EXACT = 2.0**52
_BEYOND_MEASURE = 1e100


class Floats(NamedTuple):
    """Values, float64 ``(n,)``, NaN where the cell is empty, says so, or is infinite or nearly so;
    and which cells are no numbers.
    """

    values: NDArray[np.float64]
    bad: NDArray[np.bool_]


class Integers(NamedTuple):
    """Values, int64 ``(n,)``; which cells have one; and which cells are no numbers."""

    values: NDArray[np.int64]
    present: NDArray[np.bool_]
    bad: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Where each of n cells starts and ends in ``octets``, int64 ``(n,)``; an empty one has no
    length.
    """

    octets: NDArray[np.uint8]
    starts: NDArray[np.int64]
    ends: NDArray[np.int64]

    @classmethod
    def of(cls, texts: Any) -> "Cells":
        """Return an Arrow array of texts, without a copy."""
        _, offsets, content = texts.buffers()
        bounds = np.frombuffer(offsets, np.int32)[texts.offset : texts.offset + len(texts) + 1]
        octets = np.empty(0, np.uint8) if content is None else np.frombuffer(content, np.uint8)
        return cls(octets, bounds[:-1].astype(np.int64), bounds[1:].astype(np.int64))

    def take(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> "Cells":
        """Return the cells that a mask or index array selects."""
        return Cells(self.octets, self.starts[rows], self.ends[rows])

    def stripped(self) -> "Cells":
        """Return the cells without one blank on either side, then without a pair of quotation
        marks.
        """
        if not self.starts.size:
            return self
        octets = self.octets
        used = octets[int(self.starts[0]) : int(self.ends[-1])]
        if not np.any((used == BLANK) | (used == QUOTE)):
            return self
        starts, ends = self.starts.copy(), self.ends.copy()
        for edge in (BLANK, QUOTE):
            filled = ends - starts > (edge == QUOTE)
            first = octets[np.minimum(starts, octets.size - 1)] == edge
            last = octets[np.maximum(ends - 1, 0)] == edge
            if edge == QUOTE:
                first = last = first & last
            starts += filled & first
            ends -= filled & last & (ends > starts)
        if np.array_equal(starts, self.starts) and np.array_equal(ends, self.ends):
            return self
        return Cells(octets, starts, ends)

    def texts(self) -> Any:
        """Return the cells as an Arrow array of texts, null where empty."""
        import pyarrow as pa

        lengths = self.ends - self.starts
        offsets = np.zeros(lengths.size + 1, np.int32)
        np.cumsum(lengths, out=offsets[1:])
        places = np.arange(int(offsets[-1])) + np.repeat(self.starts - offsets[:-1], lengths)
        return pa.Array.from_buffers(
            pa.string(),
            lengths.size,
            [
                pa.py_buffer(np.packbits(lengths > 0, bitorder="little")),
                pa.py_buffer(offsets),
                pa.py_buffer(self.octets[places].tobytes()),
            ],
        )


def stripped(texts: Any) -> Any:
    """Return an Arrow array of texts as :meth:`Cells.stripped` does, null where nothing is left."""
    cells = Cells.of(texts)
    inner = cells.stripped()
    return texts if inner is cells else inner.texts()


def floats(texts: Any, decimal_comma: bool = False) -> Floats:
    """Read an Arrow array of texts as decimal numbers, correctly rounded."""
    import pyarrow as pa
    import pyarrow.compute as pc

    cells = Cells.of(texts)
    long = cells.ends - cells.starts > MAX_NUMBER_BYTES
    if long.any():
        texts = pc.if_else(pa.array(long), pa.scalar(None, pa.string()), texts)
    if decimal_comma:
        texts = pc.replace_substring(texts, ",", ".")
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


def scaled(texts: Any, decimals: int = 0, decimal_comma: bool = False) -> Integers:
    """Read an Arrow array of texts as decimal numbers times ``10 ** decimals``, exactly; what lies
    beyond is rounded half up.

    Seconds with 9 decimals, or milliseconds with 6, are nanoseconds.
    """
    cells = Cells.of(texts)
    lengths = cells.ends - cells.starts
    plain = _Plain(lengths.size, decimals, ord("," if decimal_comma else "."))
    for place in range(min(int(lengths.max(initial=0)), MAX_NUMBER_BYTES)):
        plain.take(cells.octets.take(cells.starts + place, mode="clip"), place, place < lengths)
    values, present = plain.values()
    present &= lengths <= MAX_NUMBER_BYTES
    values[~present], bad = 0, np.zeros(lengths.size, bool)
    other = np.flatnonzero(~present & (lengths > 0))
    if other.size:
        values[other], present[other], bad[other] = _scaled_otherwise(
            cells.take(other), decimals, decimal_comma
        )
    return Integers(values, present, bad)


def _scaled_otherwise(cells: Cells, decimals: int, decimal_comma: bool) -> Integers:
    """Read cells of any form as :func:`scaled` does."""
    approximate = floats(cells.texts(), decimal_comma)
    with np.errstate(over="ignore"):
        scaled_floats = approximate.values * 10.0**decimals
    present = ~np.isnan(approximate.values)
    fits = present & (np.abs(scaled_floats) < 2.0**63 - 2.0**10)
    values = np.zeros(present.size, np.int64)
    small = fits & (np.abs(scaled_floats) < _EXACT / 64)
    values[small] = np.floor(scaled_floats[small] + 0.5).astype(np.int64)
    for row in np.flatnonzero(fits & ~small).tolist():
        text = (
            cells.octets[cells.starts[row] : cells.ends[row]].tobytes().decode("ascii", "replace")
        )
        values[row] = int(
            Decimal(text.replace(",", ".")).scaleb(decimals).to_integral_value("ROUND_HALF_UP")
        )
    return Integers(values, fits, approximate.bad | (present & ~fits))


class _Plain:
    """Digits of n numbers without an exponent, taken one place at a time."""

    def __init__(self, rows: int, decimals: int, point: int) -> None:
        self._decimals, self._point = decimals, point
        self._value = np.zeros(rows, np.uint64)
        self._digits = np.zeros(rows, np.int64)  # that count, after leading zeros
        self._fraction = np.full(rows, -1, np.int64)  # digits after the point; -1 before it
        self._pointed = False  # whether any has a point
        self._negative = np.zeros(rows, bool)
        self._up = np.zeros(rows, bool)
        self._numeral = np.zeros(rows, bool)
        self._broken = np.zeros(rows, bool)

    def take(self, octet: NDArray[np.uint8], place: int, within: NDArray[np.bool_]) -> None:
        """Take the octets at one place of all numbers; ``within``: which of them are so long."""
        digit = octet - np.uint8(48)
        is_digit = counted = within & (digit < 10)
        if self._pointed:
            counted = is_digit & (self._fraction < self._decimals)
            self._up |= is_digit & (self._fraction == self._decimals) & (digit >= 5)
            self._fraction += is_digit & (self._fraction >= 0)
        self._value = np.where(counted, self._value * np.uint64(10) + digit, self._value)
        self._digits += counted & (self._value > 0)
        self._numeral |= is_digit
        other = within & ~is_digit
        if other.any():
            self._mark(octet, place, other)

    def _mark(self, octet: NDArray[np.uint8], place: int, other: NDArray[np.bool_]) -> None:
        """Take points and signs; whatever else is no plain number."""
        is_point = other & (octet == self._point) & (self._fraction < 0)
        self._fraction[is_point] = 0
        self._pointed |= bool(is_point.any())
        is_sign = other & ((octet == ord("-")) | (octet == ord("+"))) & (place == 0)
        self._negative |= is_sign & (octet == ord("-"))
        self._broken |= other & ~is_point & ~is_sign

    def values(self) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Return the numbers, and which were read to their end and fit; the others mean nothing."""
        missing = self._decimals - np.clip(self._fraction, 0, self._decimals)
        ok = self._numeral & ~self._broken & (self._digits + missing <= 19)
        value = self._value * np.uint64(10) ** np.where(ok, missing, 0).astype(np.uint64) + self._up
        ok &= value < 2**63 - 2**10
        signed = value.astype(np.int64)
        return np.where(self._negative, -signed, signed), ok


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
