"""Fields of NMEA 0183 sentences, all sentences of one type at once: where they stand, and the numbers in them.

A field that is empty, or that the sentence ends before, is absent. Numbers are read by their digits, so a
value is the float that ``float()`` makes of the same text.
"""

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from spoofbench_converters.stream.contract import Frames

MAX_FIELD = 24  # characters; the longest that a receiver writes is a longitude of 14
_EXACT_DIGITS = 15  # below 2^53, so that one division rounds once
_DOT, _MINUS, _PLUS = (ord(sign) - ord("0") & 0xFF for sign in ".-+")
_POWERS = 10 ** np.arange(19, dtype=np.int64)

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """One field of each of ``n`` sentences: int64 ``begin`` within ``octets``, and ``length``, 0 where absent."""

    octets: NDArray[np.uint8]
    begin: Ints
    length: Ints

    def first(self) -> NDArray[np.uint8]:
        """The first character of each, 0 where absent; uint8 ``(n,)``."""
        return self.at(0)

    def at(self, place: int) -> NDArray[np.uint8]:
        """The character at a place of each, 0 beyond its end; uint8 ``(n,)``."""
        if not self.octets.size:
            return np.zeros(self.begin.size, np.uint8)
        found = self.octets[np.minimum(self.begin + place, self.octets.size - 1)]
        return np.where(self.length > place, found, 0).astype(np.uint8)

    def texts(self) -> list[str]:
        """Return the fields as text; a loop, for the few that are names."""
        return [
            bytes(self.octets[b : b + n]).decode("ascii", "replace") for b, n in zip(self.begin.tolist(), self.length.tolist(), strict=True)
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
        self.body_end = np.where((frames.lengths > 3) & (frames.octets[star] == ord("*")), star, ends) if ends.size else ends
        self._commas = np.append(np.flatnonzero(frames.octets == ord(",")), frames.octets.size)
        self._first = np.searchsorted(self._commas, frames.starts)
        self.fields = np.searchsorted(self._commas, self.body_end) - self._first

    def addresses(self) -> Cells:
        """The address of each frame, such as ``GPGGA``."""
        return self._between(self.starts + 1, np.minimum(self._commas[self._first], self.body_end))

    def cells(self, rows: Ints, number: int | Ints) -> Cells:
        """Field ``number`` of these frames, the first after the address being 1; one for all, or one for each."""
        first, fields = self._first[rows], self.fields[rows]
        last = self._commas.size - 1
        begin = self._commas[np.minimum(first + number - 1, last)] + 1
        end = np.where(number < fields, self._commas[np.minimum(first + number, last)], self.body_end[rows])
        return self._between(np.where(number <= fields, begin, end), end)

    def _between(self, begin: Ints, end: Ints) -> Cells:
        return Cells(self._octets, begin, np.maximum(end - begin, 0))


@dataclass(frozen=True, slots=True, eq=False)
class Decimals:
    """Fixed-point numbers: ``mantissa`` / 10^``places``, int64 ``(n,)``; ``readable`` also where ``present`` is not."""

    mantissa: Ints
    places: Ints
    present: Bools
    readable: Bools

    def floats(self) -> NDArray[np.float64]:
        """The values, float64 ``(n,)``, NaN where absent or not readable."""
        values = self.mantissa / _POWERS[self.places]
        return np.where(self.present & self.readable, values, np.nan)


def decimals(cells: Cells) -> Decimals:
    """Read fixed-point numbers: an optional sign, digits, and a point before, among or after them."""
    n = cells.begin.size
    mantissa, places, readable = np.zeros(n, np.int64), np.zeros(n, np.int64), cells.length == 0
    for length in np.unique(cells.length).tolist():
        if 0 < length <= MAX_FIELD:
            rows = np.flatnonzero(cells.length == length)
            digits = sliding_window_view(cells.octets, length)[cells.begin[rows]] - np.uint8(ord("0"))
            mantissa[rows], places[rows], readable[rows] = _read(digits)
    return Decimals(mantissa, places, cells.length > 0, readable)


def _read(digits: NDArray[np.uint8]) -> tuple[Ints, Ints, Bools]:
    """Return mantissas, places and readability of texts of one length, given as characters minus ``0``, ``(k, length)``."""
    k, length = digits.shape
    point = np.all(digits == _DOT, axis=0)
    if point.sum() <= 1 and length - point.sum() in range(1, _EXACT_DIGITS + 1) and bool(np.all((digits < 10) | point)):
        kept = np.flatnonzero(~point)
        values = (digits[:, kept].astype(np.float64) @ _POWERS[kept.size - 1 :: -1].astype(np.float64)).astype(np.int64)
        after = length - 1 - int(np.argmax(point)) if point.any() else 0
        return values, np.full(k, after), np.ones(k, bool)
    return _read_mixed(digits)


def _read_mixed(digits: NDArray[np.uint8]) -> tuple[Ints, Ints, Bools]:
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


def hexadecimal(character: NDArray[np.uint8]) -> Ints:
    """Values of single hexadecimal digits, -1 where it is none; int64 ``(n,)``."""
    table = np.full(256, -1, np.int64)
    for digit in "0123456789ABCDEFabcdef":
        table[ord(digit)] = int(digit, 16)
    return table[character]


def one_of(character: NDArray[np.uint8], letters: str) -> Bools:
    """Which characters are among the letters."""
    return np.isin(character, np.frombuffer(letters.encode(), np.uint8))
