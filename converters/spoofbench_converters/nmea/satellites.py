"""Satellites and signals: from the numbers of NMEA 0183 and of its makers to constellation,
satellite and RINEX code.

NMEA 0183 4.11 numbers satellites within the system that the talker or a system id names; before it,
and still beside it, one range of numbers holds them all, with makers' own extensions (u-blox,
Quectel, SkyTraq, Android).
"""

import numpy as np
from numpy.typing import NDArray

from spoofbench.arrays import Ints

GPS, SBAS, GALILEO, BEIDOU, IMES, QZSS, GLONASS, NAVIC = range(1, 9)  # as in the schema
NO_SIGNAL = -1

_OF_TALKER = {
    "GP": GPS,
    "GL": GLONASS,
    "GA": GALILEO,
    "GB": BEIDOU,
    "BD": BEIDOU,
    "GQ": QZSS,
    "QZ": QZSS,
    "GI": NAVIC,
    "IM": IMES,
}
_OF_SYSTEM_ID = np.array([0, GPS, GLONASS, GALILEO, BEIDOU, QZSS, NAVIC])

_COMMON = (
    (1, 32, GPS, 0), (33, 64, SBAS, 87), (65, 99, GLONASS, -64), (120, 158, SBAS, 0),
    (173, 182, IMES, -172), (183, 191, QZSS, -182),
    (193, 200, QZSS, -192), (201, 264, BEIDOU, -200), (301, 336, GALILEO, -300),
    (401, 464, BEIDOU, -400),
)  # fmt: skip
_RANGES = {  # first number, last number, constellation, and what to add
    0: _COMMON,
    GPS: _COMMON,
    SBAS: ((33, 64, SBAS, 87), (120, 158, SBAS, 0)),
    GALILEO: (
        (1, 36, GALILEO, 0),
        (37, 64, SBAS, 87),
        (101, 136, GALILEO, -100),
        (301, 336, GALILEO, -300),
    ),
    BEIDOU: (
        (1, 64, BEIDOU, 0),
        (101, 164, BEIDOU, -100),
        (201, 264, BEIDOU, -200),
        (401, 464, BEIDOU, -400),
    ),
    IMES: ((1, 10, IMES, 0), (173, 182, IMES, -172)),
    QZSS: ((1, 10, QZSS, 0), (33, 64, SBAS, 87), (183, 191, QZSS, -182), (193, 202, QZSS, -192)),
    GLONASS: ((1, 32, GLONASS, 0), (33, 64, SBAS, 87), (65, 99, GLONASS, -64)),
    NAVIC: ((1, 15, NAVIC, 0), (33, 64, SBAS, 87), (901, 918, NAVIC, -900)),
}
_NUMBERS = 1_000

# by signal id from 1, NMEA 0183 4.11; X and Z where it does not tell the components of a band apart
_SIGNALS = {
    GPS: ("1C", "1W", "1M", "2W", "2S", "2L", "5I", "5Q"),
    SBAS: ("1C", None, None, None, None, None, "5I", "5Q"),
    GLONASS: ("1C", "1P", "2C", "2P"),
    GALILEO: ("5X", "7X", "8X", "6A", "6X", "1A", "1X"),
    BEIDOU: ("2I", "2Q", "1X", "1Z", "5X", "7Z", "8X", "6I", "6Q", "6Z", "7I", "7Q"),
    QZSS: ("1C", "1S", "1L", "1Z", "2S", "2L", "5I", "5Q", "6S", "6E"),
    NAVIC: ("5A", "9A", "5B", "9B", "1X"),
}
SIGNALS = tuple(sorted({code for codes in _SIGNALS.values() for code in codes if code}))


Shorts = NDArray[np.int16]


def _tables() -> tuple[Shorts, Shorts, Shorts]:
    constellation, svid = np.zeros((9, _NUMBERS), np.int16), np.zeros((9, _NUMBERS), np.int16)
    for named, ranges in _RANGES.items():
        constellation[named] = named
        for first, last, found, shift in ranges:
            constellation[named, first : last + 1] = found
            svid[named, first : last + 1] = np.arange(first, last + 1) + shift
    signal = np.full((9, 16), NO_SIGNAL, np.int16)
    for named, codes in _SIGNALS.items():
        for number, code in enumerate(codes, 1):
            signal[named, number] = SIGNALS.index(code) if code else NO_SIGNAL
    return constellation, svid, signal


_CONSTELLATION, _SVID, _SIGNAL = _tables()


def of_talkers(talkers: list[str]) -> Ints:
    """Return the constellation that each of ``t`` talkers names, 0 for none; int64 ``(t,)``."""
    return np.array([_OF_TALKER.get(talker, 0) for talker in talkers], np.int64)


def of_system_id(system: Ints) -> Ints:
    """Return the constellation of NMEA system ids ``(n,)``, 0 for those that are none; int64
    ``(n,)``.
    """
    return _OF_SYSTEM_ID[np.where((system > 0) & (system < _OF_SYSTEM_ID.size), system, 0)]


def identify(named: Ints, number: Ints) -> tuple[Shorts, Shorts]:
    """Return constellation and number within it, int16 ``(n,)``, 0 where unknown.

    Args:
        named: int64 ``(n,)``, the constellation that each sentence names, or 0.
        number: int64 ``(n,)``, of the satellite, as the sentence has it.
    """
    index = named * _NUMBERS + np.where((number > 0) & (number < _NUMBERS), number, 0)
    return _CONSTELLATION.take(index), _SVID.take(index)


def signal_of(constellation: Ints | Shorts, signal_id: Ints) -> Shorts:
    """Return indices in ``SIGNALS``, int16 ``(n,)``, ``NO_SIGNAL`` where a sentence has no signal
    id or one that is not known.

    Args:
        constellation: integers ``(n,)``.
        signal_id: int64 ``(n,)``, of NMEA 0183 4.11.
    """
    return _SIGNAL.take(
        constellation * 16 + np.where((signal_id > 0) & (signal_id < 16), signal_id, 0)
    )
