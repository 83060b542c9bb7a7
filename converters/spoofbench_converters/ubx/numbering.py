"""Constellations, satellites and signals, numbered as in the schema.

Sources: u-blox F9 HPG 1.51 interface description (UBX-23010894), sections GNSS identifiers,
Satellite identifiers, Signal identifiers; u-blox 8/M8 receiver description (UBX-13003221), appendix
Satellite Numbering; RINEX 3.05, tables 9 to 15.
"""

import numpy as np
from numpy.typing import NDArray

from spoofbench.table import Column
from spoofbench_converters.ubx.batch import Cells
from spoofbench_converters.ubx.frames import Ints

GPS, SBAS, GALILEO, BEIDOU, IMES, QZSS, GLONASS, NAVIC = range(
    8
)  # u-blox's gnssId; the schema's number is one higher
_NONE = 255

_CODES = {
    GPS: {0: "1C", 3: "2L", 4: "2S", 6: "5I", 7: "5Q"},
    SBAS: {0: "1C"},
    GALILEO: {0: "1C", 1: "1B", 3: "5I", 4: "5Q", 5: "7I", 6: "7Q", 8: "6B", 9: "6C", 10: "6A"},
    BEIDOU: {
        0: "2I",
        1: "2I",
        2: "7I",
        3: "7I",
        4: "6I",
        5: "1P",
        6: "1D",
        7: "5P",
        8: "5D",
        10: "6I",
    },
    QZSS: {0: "1C", 1: "1Z", 4: "2S", 5: "2L", 8: "5I", 9: "5Q", 12: "1E"},
    GLONASS: {0: "1C", 2: "2C"},
    NAVIC: {0: "5A"},
}
_WORDS = tuple(sorted({code for codes in _CODES.values() for code in codes.values()}))
_CODE = np.full((256, 256), -1, np.int32)
for _gnss, _codes in _CODES.items():
    for _signal, _code in _codes.items():
        _CODE[_gnss, _signal] = _WORDS.index(_code)

_SINGLE = np.full(
    (256, 2), _NONE
)  # gnssId and svId by the single number of receivers before u-blox 8
for _gnss, _first, _last, _number in (
    (GPS, 1, 32, 1),
    (BEIDOU, 33, 64, 6),
    (GLONASS, 65, 96, 1),
    (SBAS, 120, 158, 120),
    (BEIDOU, 159, 163, 1),
    (IMES, 173, 182, 1),
    (QZSS, 193, 202, 1),
    (GALILEO, 211, 246, 1),
):
    _SINGLE[_first : _last + 1, 0] = _gnss
    _SINGLE[_first : _last + 1, 1] = np.arange(_number, _number + _last - _first + 1)
_SINGLE[_NONE, 0] = GLONASS  # a satellite whose slot is not known yet


def constellation(single: NDArray[np.uint8]) -> tuple[Ints, Ints]:
    """Return gnssId and svId of satellites in the single numbering, 255 where unknown."""
    return _SINGLE[single, 0], _SINGLE[single, 1]


def numbered(gnss: NDArray[np.integer], number: NDArray[np.integer]) -> Cells:
    """Return the columns ``constellation`` and ``svid``; a GLONASS satellite of unknown slot has no
    number.
    """
    known = gnss <= NAVIC
    return {
        "constellation": Column(np.where(known, gnss.astype(np.int64) + 1, 0), known),
        "svid": Column(np.where(number == _NONE, 0, number.astype(np.int64)), number != _NONE),
    }


def signal_codes(gnss: NDArray[np.integer], signal: NDArray[np.integer]) -> Column:
    """Return the RINEX 3 band and attribute of each u-blox sigId, absent where not known."""
    return Column(_CODE[gnss, signal], None, _WORDS)
