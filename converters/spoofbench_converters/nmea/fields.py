"""Fields of NMEA 0183 sentences, all sentences of one type at once: where they stand, and the
numbers in them.

A field that is empty, or that the sentence ends before, is absent. Numbers are read by their
digits, so a value is the float that ``float()`` makes of the same text.
"""

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from spoofbench.arrays import Bools, Floats, Ints, Octets
from spoofbench.gnss_time import SECOND_NS, midnight
from spoofbench_converters.serial.contract import ABSENT_NS, Frames

MAX_FIELD = 24  # characters; the longest that a receiver writes is a longitude of 14
_SMALL = 4  # digits, so that values fit 16 bits
_EXACT_DIGITS = 15  # below 2^53, so that one division rounds once
_DOT, _MINUS, _PLUS = (ord(sign) - ord("0") & 0xFF for sign in ".-+")
_POWERS = 10 ** np.arange(19, dtype=np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class FieldCells:
    """One field of each of ``n`` sentences.

    Attributes:
        octets: the piece of the log that they stand in.
        begin: int64 ``(n,)``, where each field begins in it.
        length: int64 ``(n,)``, of each field, 0 where absent.
    """

    octets: Octets
    begin: Ints
    length: Ints

    def first(self) -> Octets:
        """The first character of each, 0 where absent; uint8 ``(n,)``."""
        return self.at(0)

    def at(self, index: int) -> Octets:
        """The character at an index of each, 0 beyond its end; uint8 ``(n,)``."""
        if not self.octets.size:
            return np.zeros(self.begin.size, np.uint8)
        found = self.octets.take(self.begin + index, mode="clip")
        found[self.length <= index] = 0
        return found

    def texts(self) -> list[str]:
        """Return the fields as text; a loop, for the few that are names."""
        return [
            bytes(self.octets[b : b + n]).decode("ascii", "replace")
            for b, n in zip(self.begin.tolist(), self.length.tolist(), strict=True)
        ]


class Sentences:
    """The fields of the frames of one piece of a log.

    Attributes:
        body_end: int64 ``(k,)``, where each sentence's last field ends, before ``*hh``.
        fields: int64 ``(k,)``, how many fields follow each address.
    """

    def __init__(self, frames: Frames) -> None:
        self._octets = frames.octets
        self.starts = frames.starts
        ends = frames.starts + frames.lengths
        star = np.maximum(ends - 3, 0)
        self.body_end = (
            np.where((frames.lengths > 3) & (frames.octets[star] == ord("*")), star, ends)
            if ends.size
            else ends
        )
        self._commas = np.append(np.flatnonzero(frames.octets == ord(",")), frames.octets.size)
        self._first = np.searchsorted(self._commas, frames.starts)
        self.fields = np.searchsorted(self._commas, self.body_end) - self._first

    def addresses(self) -> FieldCells:
        """The address of each frame, such as ``GPGGA``."""
        return self._between(self.starts + 1, np.minimum(self._commas[self._first], self.body_end))

    def of(self, rows: Ints) -> "SentenceFields":
        """Return the fields of these frames, int64 ``(n,)``."""
        return SentenceFields(
            self._octets, self._commas, self._first[rows], self.fields[rows], self.body_end[rows]
        )

    def _between(self, begin: Ints, end: Ints) -> FieldCells:
        return FieldCells(self._octets, begin, np.maximum(end - begin, 0))


class SentenceFields:
    """The fields of sentences of one type; the first after the address is 1."""

    _KEPT = 24  # ends of fields that are remembered, for the next field begins there

    def __init__(
        self, octets: Octets, commas: Ints, first: Ints, count: Ints, body_end: Ints
    ) -> None:
        self.count = count
        self._octets, self._commas, self._first, self._body_end = octets, commas, first, body_end
        self._fewest = int(count.min(initial=MAX_FIELD))
        self._ends: dict[int, Ints] = {}

    def cells(self, number: int) -> FieldCells:
        """One field of every sentence."""
        begin, end = self._end(number - 1) + 1, self._end(number)
        return FieldCells(self._octets, begin, np.maximum(end - begin, 0))

    def _end(self, number: int) -> Ints:
        """Where a field ends."""
        if number not in self._ends:
            if number < self._fewest:
                end = self._commas.take(self._first + number, mode="clip")
            else:
                comma = self._commas.take(self._first + number, mode="clip")
                end = np.where(number < self.count, comma, self._body_end)
            if number >= self._KEPT:
                return end
            self._ends[number] = end
        return self._ends[number]


@dataclass(frozen=True, slots=True, eq=False)
class Decimals:
    """Fixed-point numbers: ``mantissa`` / 10^``places``, int64 ``(n,)``; ``readable`` also where
    ``present`` is not.
    """

    mantissa: Ints
    places: Ints
    present: Bools
    readable: Bools

    def floats(self) -> Floats:
        """The values, float64 ``(n,)``, NaN where absent or not readable."""
        values = (
            self.mantissa / _POWERS[self.places]
            if self.places.any()
            else self.mantissa.astype(np.float64)
        )
        values[~(self.present & self.readable)] = np.nan
        return values


def decimals(cells: FieldCells) -> Decimals:
    """Read fixed-point numbers: an optional sign, digits, and a point before, among or after
    them.
    """
    small = _small_integers(cells)
    if small is not None:
        return small
    n = cells.begin.size
    mantissa, places, present = np.zeros(n, np.int64), np.zeros(n, np.int64), cells.length > 0
    readable = ~present
    for length in np.flatnonzero(
        np.bincount(np.minimum(cells.length, MAX_FIELD + 1), minlength=1)
    ).tolist():
        if 0 < length <= MAX_FIELD:
            rows = np.flatnonzero(cells.length == length)
            digits = sliding_window_view(cells.octets, length)[cells.begin[rows]]
            digits -= np.uint8(ord("0"))
            mantissa[rows], places[rows], readable[rows] = _read(digits)
    return Decimals(mantissa, places, present, readable)


def _small_integers(cells: FieldCells) -> Decimals | None:
    """Read integers of up to four digits, which most fields of satellites are; None where any field
    is something else.
    """
    longest = int(cells.length.max(initial=0))
    if longest > _SMALL or not cells.octets.size:
        return None
    value = np.zeros(cells.begin.size, np.uint16)
    for index in range(longest):
        there = cells.length > index
        digit = cells.octets.take(cells.begin + index, mode="clip") - np.uint8(ord("0"))
        if np.any(there & (digit > 9)):
            return None
        value = np.where(there, value * np.uint16(10) + digit, value)
    return Decimals(
        value.astype(np.int64),
        np.zeros(value.size, np.int64),
        cells.length > 0,
        np.ones(value.size, bool),
    )


def _read(digits: Octets) -> tuple[Ints, Ints | int, Bools | bool]:
    """Return mantissas, places and readability of texts of one length, given as characters minus
    ``0``, ``(k, length)``.
    """
    length = digits.shape[1]
    point = digits[0] == _DOT
    count = length - int(point.sum())
    if (
        length - 1 <= count <= _EXACT_DIGITS
        and count > 0
        and bool(np.all((digits < 10) != point) and np.all(digits[:, point] == _DOT))
    ):
        weights = np.zeros(length)
        weights[~point] = _POWERS[count - 1 :: -1]
        after = length - 1 - int(np.argmax(point)) if count < length else 0
        return (digits.astype(np.float64) @ weights).astype(np.int64), after, True
    return _read_mixed(digits)


def _read_mixed(digits: Octets) -> tuple[Ints, Ints, Bools]:
    k, length = digits.shape
    value, places, count, points = (np.zeros(k, np.int64) for _ in range(4))
    readable = np.ones(k, bool)
    for column in range(length):
        digit = digits[:, column]
        numeral, point = digit < 10, digit == _DOT
        signed = (digit == _MINUS) | (digit == _PLUS) if column == 0 else np.zeros(k, bool)
        value = np.where(numeral & (count < 18), value * 10 + digit, value)
        places += numeral & (points > 0)
        count += numeral & ((value > 0) | (points > 0))
        points += point
        readable &= numeral | point | signed
    readable &= (points <= 1) & (count < 18) & np.any(digits < 10, axis=1)
    return np.where(digits[:, 0] == _MINUS, -value, value), np.minimum(places, 18), readable


def hexadecimal(character: Octets) -> Ints:
    """Values of single hexadecimal digits, -1 where it is none; int64 ``(n,)``."""
    table = np.full(256, -1, np.int64)
    for digit in "0123456789ABCDEFabcdef":
        table[ord(digit)] = int(digit, 16)
    return table[character]


def one_of(character: Octets, letters: str) -> Bools:
    """Return which characters ``(n,)`` are among the letters, bool ``(n,)``."""
    return np.isin(character, np.frombuffer(letters.encode(), np.uint8))


_PIVOT = 80  # two-digit years: 80 to 99 are 1980 to 1999, 00 to 79 are 2000 to 2079


def time_of_day(cells: FieldCells) -> tuple[Ints, Bools]:
    """Read ``hhmmss.sss`` as nanoseconds, int64 ``(n,)``, ``ABSENT_NS`` where empty; and which
    fields are readable, bool ``(n,)``.

    A leap second, ``235960``, is 86,400 s; so is ``240000``.
    """
    read = decimals(cells)
    scale = 10 ** np.minimum(read.places, 9)
    whole = read.mantissa // scale
    hours, minutes, seconds = whole // 10_000, whole // 100 % 100, whole % 100
    fraction = read.mantissa % scale * (SECOND_NS // scale)
    midnight = (hours == 24) & (minutes == 0) & (seconds == 0)
    plausible = (
        ((hours < 24) | midnight)
        & (minutes < 60)
        & ((seconds < 60) | ((hours == 23) & (minutes == 59) & (seconds == 60)))
    )
    readable = read.readable & (
        ~read.present | (plausible & (read.mantissa >= 0) & (read.places <= 9))
    )
    value = ((hours * 60 + minutes) * 60 + seconds) * SECOND_NS + fraction
    return np.where(read.present & readable, value, ABSENT_NS), readable


def date_of(cells: FieldCells) -> tuple[Ints, Bools]:
    """Read ``ddmmyy`` as the Unix nanoseconds of its midnight, int64 ``(n,)``, ``ABSENT_NS`` where
    empty; and which fields are readable, bool ``(n,)``.
    """
    read = decimals(cells)
    value, exists = midnight(
        full_year(read.mantissa % 100), read.mantissa // 100 % 100, read.mantissa // 10_000
    )
    readable = read.readable & (~read.present | ((cells.length == 6) & (read.places == 0) & exists))
    return np.where(read.present & readable, value, ABSENT_NS), readable


def full_year(year: Ints) -> Ints:
    """Return years of which those below 100 are 1980 to 2079, int64 ``(n,)``."""
    return np.where(year < 100, year + np.where(year >= _PIVOT, 1900, 2000), year)
