"""Times that a logger writes before or after a sentence on its line: when it received the sentence.

Understood before a sentence: Unix time and ISO 8601, bare or in brackets, and ``NMEA,``
(GnssLogger); TAG blocks (NMEA 0183 4.10, section 7) with their ``c:``. After one: the same times
behind a comma, a semicolon or a blank, also on the next line if it begins with the comma
(GnssLogger before 2018). Unix time is in s, ms, µs or ns, told by its 10, 13, 16 or 19 digits.
Whatever else stands there is not the sentence's.
"""

import re
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from spoofbench.arrays import Bools, Ints, Octets
from spoofbench.gnss_time import SECOND_NS, midnight
from spoofbench_converters.serial.contract import ABSENT_NS

MAX_STAMP = 120
"""Longest text beside a sentence that is looked at, in bytes."""

_UNIX = r"(?P<unix>0{10}(?:\.0{1,9})?|0{13}(?:\.0{1,6})?|0{16}|0{19})"
_ISO = (
    r"(?P<day>0000[-/]00[-/]00)[T ](?P<clock>00:00:00)(?:[.,](?P<fraction>0{1,9}))? "
    r"?(?P<zone>Z|UTC|[+-]00:?00)?"
)
_TIME = rf"[\[(]?(?:{_UNIX}|{_ISO})[\])]?"
_FIELD = r"[a-z]:[^,\\*]*"
_SUM = r"\*(?P<sum>[0A-Fa-f]{2})\\"
_BEFORE = (
    re.compile(rf"(?:NMEA,)?(?:{_TIME}[ ,;:>\t-]+)?(?:NMEA,)?"),
    re.compile(rf"{_TIME}"),
    re.compile(rf"\\(?:{_FIELD},)*c:(?P<unix>0{{10}}|0{{13}})(?:,{_FIELD})*{_SUM}"),
    re.compile(rf"\\{_FIELD}(?:,{_FIELD})*{_SUM}"),
)
_AFTER = (re.compile(r"[ \t,;]*"), re.compile(rf"[ ,;\t]+{_TIME}[ ,;\t]*"))
_YEARS = range(1970, 2262)  # that Unix nanoseconds can hold
_NS_PER_UNIT = {10: 10**9, 13: 10**6, 16: 10**3, 19: 1}


class HostTimestamps:
    """What stands beside the sentences of one log.

    Attributes:
        without_zone: how many times had no zone and were not used.
    """

    def __init__(self, zone_is_utc: bool) -> None:
        """Take whether times without a zone are UTC."""
        self._zone_is_utc = zone_is_utc
        self.without_zone = 0

    def before(self, octets: Octets, starts: Ints, ends: Ints) -> tuple[Bools, Ints]:
        """Return which texts ``[start, end)`` before sentences are understood, and their times.

        Args:
            octets: a stretch of the log, ``(n,)``.
            starts, ends: int64 ``(k,)``.

        Returns:
            Bool ``(k,)``, and Unix ns, int64 ``(k,)``, ``ABSENT_NS`` where a text has no time.
        """
        return self._read(octets, starts, ends, _BEFORE)

    def after(self, octets: Octets, starts: Ints, ends: Ints) -> tuple[Bools, Ints]:
        """Do the same for texts ``(k,)`` behind sentences."""
        return self._read(octets, starts, ends, _AFTER)

    def _read(
        self, octets: Octets, starts: Ints, ends: Ints, patterns: tuple[re.Pattern[str], ...]
    ) -> tuple[Bools, Ints]:
        understood, times = np.zeros(starts.size, bool), np.full(starts.size, ABSENT_NS)
        lengths = ends - starts
        for length in np.unique(lengths[(lengths > 0) & (lengths <= MAX_STAMP)]).tolist():
            of_length = np.flatnonzero(lengths == length)
            texts = octets[starts[of_length, None] + np.arange(length)]
            for shape, alike in _shapes(texts):
                match = next(
                    (found for pattern in patterns if (found := pattern.fullmatch(shape))), None
                )
                if match is not None:
                    understood[of_length[alike]], times[of_length[alike]] = self._times(
                        texts[alike], match
                    )
        return understood, times

    def _times(self, texts: Octets, match: re.Match[str]) -> tuple[Bools, Ints]:
        groups = match.groupdict()
        right = (
            _tag_agrees(texts, match.start("sum"))
            if groups.get("sum")
            else np.ones(len(texts), bool)
        )
        times = np.full(len(texts), ABSENT_NS)
        if groups.get("unix"):
            times = _unix_ns(texts, match)
        elif groups.get("day") and (groups["zone"] or self._zone_is_utc):
            times = _iso_ns(texts, match)
        elif groups.get("day"):
            self.without_zone += len(texts)
        return right, np.where(right, times, ABSENT_NS)


def _shapes(texts: Octets) -> Iterator[tuple[str, NDArray[np.intp]]]:
    """Yield the distinct texts of one length with ``0`` for every digit, and the rows of each."""
    shapes = np.where((texts >= ord("0")) & (texts <= ord("9")), np.uint8(ord("0")), texts)
    if (shapes == shapes[0]).all():
        yield shapes[0].tobytes().decode("latin-1"), np.arange(len(texts))
        return
    distinct, which = np.unique(shapes, axis=0, return_inverse=True)
    order = np.argsort(which.reshape(-1), kind="stable")
    for shape, alike in zip(
        distinct, np.split(order, np.cumsum(np.bincount(which.reshape(-1)))[:-1]), strict=True
    ):
        yield shape.tobytes().decode("latin-1"), alike


def _number(texts: Octets, start: int, end: int) -> Ints:
    """Return the whole numbers in these columns; up to 18 digits are exact."""
    value = np.zeros(len(texts), np.int64)
    for column in range(start, end):
        value = value * 10 + (texts[:, column] - np.int64(ord("0")))
    return value


def _unix_ns(texts: Octets, match: re.Match[str]) -> Ints:
    start, end = match.span("unix")
    whole, _, fraction = match["unix"].partition(".")
    ns = _NS_PER_UNIT[len(whole)]
    high = _number(
        texts, start, start + 9
    )  # of all units the first nine digits are tens of seconds
    low = _number(texts, start + 9, start + len(whole)) * ns
    if fraction:
        low += _number(texts, end - len(fraction), end) * ns // 10 ** len(fraction)
    return np.where(high < 922_337_203, high * 10**10 + low, ABSENT_NS)


def _iso_ns(texts: Octets, match: re.Match[str]) -> Ints:
    day, clock = match.start("day"), match.start("clock")
    year, month, date = (
        _number(texts, day + first, day + last) for first, last in ((0, 4), (5, 7), (8, 10))
    )
    hour, minute, second = (_number(texts, clock + first, clock + first + 2) for first in (0, 3, 6))
    of_day = (hour * 60 + minute) * 60 + second
    date_ns, exists = midnight(year, month, date, _YEARS)
    exists &= (hour < 24) & (minute < 60) & (second <= 60)
    if match["zone"] and match["zone"][0] in "+-":
        at, end = match.span("zone")
        ahead = _number(texts, at + 1, at + 3) * 3600 + _number(texts, end - 2, end) * 60
        of_day -= np.where(texts[:, at] == ord("-"), -ahead, ahead)
    ns = date_ns + of_day * SECOND_NS
    if match["fraction"]:
        start, end = match.span("fraction")
        ns += _number(texts, start, end) * 10 ** (9 - (end - start))
    return np.where(exists, ns, ABSENT_NS)


def _tag_agrees(texts: Octets, at: int) -> Bools:
    """Whether the two hexadecimal digits at ``at`` are the XOR of what stands between the first
    backslash and ``*``.
    """
    reported = np.zeros(len(texts), np.uint8)
    for column in (at, at + 1):
        digit = texts[:, column]
        reported = reported * np.uint8(16) + np.where(
            digit > ord("9"),
            (digit & np.uint8(0x5F)) - np.uint8(ord("A") - 10),
            digit - np.uint8(ord("0")),
        )
    return np.asarray(reported == np.bitwise_xor.reduce(texts[:, 1 : at - 1], axis=1))
