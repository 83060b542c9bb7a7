"""Cells as numbers and words: whole columns at once, times exact to the nanosecond; and one text as
a moment.
"""

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from decimal import ROUND_HALF_EVEN, ROUND_HALF_UP, Decimal
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spoofbench_converters.text.lines import BLANK, QUOTE

MAX_NUMBER_BYTES = 48
MAX_COUNT = 2**63 - 2**10
_NUMBER = r"^[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,15})?$"
_PLAIN = r"^[+-]?[0-9]{1,18}(\.[0-9]{0,18})?$"
_MAX_EXPONENT = 100  # numbers from 1e100 on are as good as infinite


@dataclass(frozen=True, slots=True)
class Notation:
    """How texts say numbers.

    Attributes:
        absent: texts that say that there is none.
        trims: whether blanks around a number are no part of it.
        max_bytes: longer texts are no numbers; None: any length will do.
        to_even: whether a half is rounded to the even number, else away from zero.
    """

    absent: tuple[str, ...]
    trims: bool
    max_bytes: int | None
    to_even: bool

    def without_long(self, texts: Any) -> tuple[Any, NDArray[np.bool_]]:
        """Return an Arrow array of texts with those that are too long null, and which were,
        bool ``(n,)``.
        """
        import pyarrow as pa
        import pyarrow.compute as pc

        if self.max_bytes is None:
            return texts, np.zeros(len(texts), bool)
        cells = TextCells.of(texts)
        long = cells.ends - cells.starts > self.max_bytes
        if long.any():
            texts = pc.if_else(pa.array(long), pa.scalar(None, pa.string()), texts)
        return texts, long

    def numbers(self, texts: Any) -> tuple[Any, NDArray[np.bool_]]:
        """Return an Arrow array of texts with those that are no numbers null, and which of these
        say neither that there is none, bool ``(n,)``.
        """
        import pyarrow as pa
        import pyarrow.compute as pc

        trimmed = pc.utf8_trim_whitespace(texts) if self.trims else texts
        is_number = pc.match_substring_regex(trimmed, _NUMBER)
        is_absent = pc.is_in(trimmed, pa.array(self.absent))
        good = pc.fill_null(pc.or_(is_number, is_absent), True)
        numbers = pc.if_else(is_number, trimmed, pa.scalar(None, pa.string()))
        return numbers, ~good.to_numpy(zero_copy_only=False).astype(bool)


PHONE = Notation(
    (
        "",
        "null",
        "NULL",
        "nan",
        "NaN",
        "None",
        "N/A",
        "inf",
        "-inf",
        "Infinity",
        "-Infinity",
    ),
    trims=False,
    max_bytes=MAX_NUMBER_BYTES,
    to_even=False,
)
"""How apps write numbers."""


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
class TextCells:
    """Where each of n cells starts and ends in ``octets``, int64 ``(n,)``; an empty one has no
    length.
    """

    octets: NDArray[np.uint8]
    starts: NDArray[np.int64]
    ends: NDArray[np.int64]

    @classmethod
    def of(cls, texts: Any) -> "TextCells":
        """Return an Arrow array of texts, without a copy."""
        _, offsets, content = texts.buffers()
        bounds = np.frombuffer(offsets, np.int32)[texts.offset : texts.offset + len(texts) + 1]
        octets = np.empty(0, np.uint8) if content is None else np.frombuffer(content, np.uint8)
        return cls(octets, bounds[:-1].astype(np.int64), bounds[1:].astype(np.int64))

    def take(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> "TextCells":
        """Return the cells that a mask or index array selects."""
        return TextCells(self.octets, self.starts[rows], self.ends[rows])

    def stripped(self) -> "TextCells":
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
        return TextCells(octets, starts, ends)

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
    """Return an Arrow array of texts as :meth:`TextCells.stripped`, null where nothing is left."""
    cells = TextCells.of(texts)
    inner = cells.stripped()
    return texts if inner is cells else inner.texts()


def parsed(texts: Any, notation: Notation) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Read an Arrow array of texts as decimal numbers, correctly rounded; infinite ones are
    numbers.

    Returns:
        float64 ``(n,)``, NaN where there is no number, and which cells are wrong, bool ``(n,)``.
    """
    import pyarrow as pa

    texts, bad = notation.without_long(texts)
    try:
        values = texts.cast(pa.float64())
    except pa.ArrowInvalid:
        numbers, wrong = notation.numbers(texts)
        values, bad = numbers.cast(pa.float64()), bad | wrong
    return np.array(values.fill_null(np.nan).to_numpy(zero_copy_only=False), np.float64), bad


def floats(texts: Any, decimal_comma: bool = False) -> Floats:
    """Read an Arrow array of n texts as decimal numbers of an app, ``(n,)``, correctly rounded."""
    values, bad = parsed(_with_points(texts) if decimal_comma else texts, PHONE)
    values[~(np.abs(values) < 10.0**_MAX_EXPONENT)] = np.nan
    return Floats(values, bad)


def scaled(
    texts: Any, decimals: int = 0, decimal_comma: bool = False, notation: Notation = PHONE
) -> Integers:
    """Read an Arrow array of texts as decimal numbers times ``10 ** decimals``, exactly; what lies
    beyond is rounded.

    Seconds with 9 decimals, or milliseconds with 6, are nanoseconds.
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    texts, bad = notation.without_long(_with_points(texts) if decimal_comma else texts)
    if not _has_exponents(texts):
        try:
            values, present, beyond = _unscaled(pc.cast(texts, pa.decimal128(38, decimals)))
            return Integers(values, present, bad | beyond)
        except pa.ArrowInvalid:  # words, or more decimals
            pass
    numbers, wrong = notation.numbers(texts)
    is_plain = pc.match_substring_regex(numbers, _PLAIN)
    plain = pc.if_else(is_plain, numbers, pa.scalar(None, pa.string()))
    rounding: Any = "half_to_even" if notation.to_even else "half_towards_infinity"
    rounded = pc.round(pc.cast(plain, pa.decimal128(38, 18)), decimals, rounding)
    values, present, beyond = _unscaled(pc.cast(rounded, pa.decimal128(38, decimals)))
    others = pc.fill_null(pc.invert(is_plain), False).to_numpy(zero_copy_only=False)
    for row in np.flatnonzero(others).tolist():
        number = Decimal(numbers[row].as_py())
        if number.adjusted() >= _MAX_EXPONENT and number:
            continue  # as good as infinite: there is none
        value = _scaled_number(number, decimals, notation.to_even)
        present[row], beyond[row] = value is not None, value is None
        values[row] = value or 0
    return Integers(values, present, bad | wrong | beyond)


def _has_exponents(texts: Any) -> bool:
    """Return whether there may be an exponent: at ``1e-400`` and the like Arrow's cast to decimals
    reads out of bounds, and may crash.
    """
    octets = TextCells.of(texts).octets
    return bool(np.any((octets | 32) == ord("e")))


def _with_points(texts: Any) -> Any:
    import pyarrow.compute as pc

    return pc.replace_substring(texts, ",", ".")


def _unscaled(exact: Any) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return decimals without their point, 0 where there is none; which are there; and which are
    beyond what can be counted.
    """
    import pyarrow.compute as pc

    there = pc.is_valid(exact).to_numpy(zero_copy_only=False)
    filled = pc.fill_null(exact, 0)
    words = np.frombuffer(filled.buffers()[1], np.int64)[2 * filled.offset :][: 2 * len(filled)]
    low, high = words.reshape(-1, 2).T
    beyond = (high != low >> 63) | (low >= MAX_COUNT) | (low <= -MAX_COUNT)
    return np.where(beyond, 0, low), there & ~beyond, beyond


def _scaled_number(value: Decimal, decimals: int, to_even: bool) -> int | None:
    """Return one number times ``10**decimals``, None if that cannot be counted."""
    if value and value.adjusted() + decimals > 18:
        return None
    if value.adjusted() + decimals < -1:
        return 0
    rounding = ROUND_HALF_EVEN if to_even else ROUND_HALF_UP
    count = int(value.scaleb(decimals).to_integral_value(rounding))
    return count if abs(count) < MAX_COUNT else None


def words(cells: TextCells, longest: int = 32) -> NDArray[np.bytes_]:
    """Read cells as words, cut to their first bytes: an array of fixed-width bytes ``(n,)``."""
    lengths = np.minimum(cells.ends - cells.starts, longest)
    width = max(int(lengths.max(initial=0)), 1)
    reach = np.arange(width)
    within = reach < lengths[:, None]
    if not lengths.size or not cells.octets.size:
        return np.zeros(lengths.size, f"S{width}")
    places = np.where(within, cells.starts[:, None] + reach, 0)
    return np.where(within, cells.octets[places], np.uint8(0)).view(f"S{width}").reshape(-1)


def moment_ns(text: str) -> int:
    """Return the Unix time of an ISO date or time; without zone it is UTC.

    Raises:
        ValueError: it is none.
    """
    return unix_ns(datetime.fromisoformat(text))


def unix_ns(moment: datetime) -> int:
    """Return the Unix time of a moment; without zone it is UTC."""
    aware = moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment
    return (aware - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1) * 1000
