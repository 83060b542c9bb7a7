"""Satellites: how they are numbered, signals in view, raw observations, and the bits that they
broadcast.

Sources: u-blox F9 HPG 1.51 interface description (UBX-23010894), sections GNSS identifiers,
Satellite identifiers, Signal identifiers; u-blox 8/M8 receiver description (UBX-13003221), appendix
Satellite Numbering; RINEX 3.05, tables 9 to 15.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from spoofbench.arrays import Ints, Octets
from spoofbench.table import Column, encode_categories
from spoofbench_converters.serial.contract import EpochRows
from spoofbench_converters.ubx.batch import EpochBatch, FieldColumns, absent_where

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
    for _signal_id, _code in _codes.items():
        _CODE[_gnss, _signal_id] = _WORDS.index(_code)

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


def constellation(single: Octets) -> tuple[Ints, Ints]:
    """Return gnssId and svId, int64 ``(n,)``, of satellites in the single numbering, 255 where
    unknown.
    """
    return _SINGLE[single, 0], _SINGLE[single, 1]


def numbered(gnss: NDArray[np.integer], number: NDArray[np.integer]) -> FieldColumns:
    """Return the columns ``constellation`` and ``svid`` of gnssId and svId ``(n,)``; a GLONASS
    satellite of unknown slot has no number.
    """
    known = gnss <= NAVIC
    return {
        "constellation": Column(np.where(known, gnss.astype(np.int64) + 1, 0), known),
        "svid": Column(np.where(number == _NONE, 0, number.astype(np.int64)), number != _NONE),
    }


def signal_codes(gnss: NDArray[np.integer], signal: NDArray[np.integer]) -> Column:
    """Return the RINEX 3 band and attribute of each u-blox gnssId and sigId ``(n,)``, absent where
    not known.
    """
    return Column(_CODE[gnss, signal], None, _WORDS)


def signals(batch: EpochBatch, system: str, source: str) -> list[EpochRows]:
    """Return ``gnss/signal`` rows of NAV-SIG, with directions of NAV-SAT; where an epoch has no
    NAV-SIG of NAV-SAT, or NAV-SVINFO.

    A C/N0 of 0 is that of a satellite not received: absent, as its residual. Directions are absent
    where the elevation is out of range, which is how the receiver says that it does not know them
    (UBX-NAV-SAT, elev). Channels of NAV-SVINFO without a satellite have number 0.
    """
    names = ("SIG", "SAT", "SVINFO") if system == "NAV" else ("SIG", "SAT")
    frames = {name: batch.one_of(f"{system}-{name}") for name in names}
    found = []
    seen = np.zeros(batch.count, bool)
    for name, one in frames.items():
        fresh = ~seen[one.epoch]
        if name == "SVINFO":
            batch.refuse(one.index[~fresh], "NAV-SIG or NAV-SAT of its epoch says more")
        chosen = one.take(fresh)
        blocks, owner = batch.blocks(f"{system}-{name}", chosen)
        if name == "SVINFO":
            assigned = blocks["svid"] > 0
            blocks, owner = blocks[assigned], owner[assigned]
        columns = _signal(name, blocks)
        if name == "SIG":
            sky, sky_place = batch.blocks(f"{system}-SAT", frames["SAT"])
            columns |= _directions(chosen.epoch[owner], blocks, frames["SAT"].epoch[sky_place], sky)
        batch.use(chosen.index)
        seen[one.epoch] = True
        if blocks.size:
            found.append(batch.rows(source, "gnss/signal", chosen.index[owner], columns))
    return found


def _signal(name: str, blocks: NDArray[np.void]) -> FieldColumns:
    silent = blocks["cno"] == 0
    columns: FieldColumns = {"cn0_dbhz": absent_where(silent, blocks["cno"])}
    if name == "SIG":
        columns |= numbered(blocks["gnssId"], blocks["svId"])
        columns |= {
            "signal": signal_codes(blocks["gnssId"], blocks["sigId"]),
            "used": blocks["sigFlags"] & 0b111000 > 0,
        }
        columns["residual_m"] = absent_where(silent, blocks["prRes"] * 0.1)
        return columns
    if name == "SAT":
        columns |= numbered(blocks["gnssId"], blocks["svId"])
        columns |= {
            "used": blocks["flags"] & 8 > 0,
            "residual_m": absent_where(silent, blocks["prRes"] * 0.1),
        }
    else:
        columns |= numbered(*constellation(blocks["svid"]))
        columns |= {
            "used": blocks["flags"] & 1 > 0,
            "residual_m": absent_where(silent, blocks["prRes"] * 0.01),
        }
    return columns | _direction(blocks["elev"], blocks["azim"])


def _direction(elevation: NDArray[np.int8], azimuth: NDArray[np.int16]) -> FieldColumns:
    unknown = np.abs(elevation.astype(np.int64)) > 90
    return {
        "elevation_deg": absent_where(unknown, elevation),
        "azimuth_deg": absent_where(unknown | (azimuth < 0) | (azimuth > 360), azimuth),
    }


def _directions(
    epoch: Ints, blocks: NDArray[np.void], sky_epoch: Ints, sky: NDArray[np.void]
) -> FieldColumns:
    """Find each signal's satellite among those of NAV-SAT in its epoch."""
    wanted = epoch << 16 | blocks["gnssId"].astype(np.int64) << 8 | blocks["svId"]
    have = sky_epoch << 16 | sky["gnssId"].astype(np.int64) << 8 | sky["svId"]
    if not have.size:
        return {}
    order = np.argsort(have, kind="stable")
    owner = order[np.minimum(np.searchsorted(have[order], wanted), have.size - 1)]
    found = have[owner] == wanted
    columns = _direction(sky["elev"][owner], sky["azim"][owner])
    return {name: absent_where(~found, values) for name, values in columns.items()}


def observations(batch: EpochBatch, source: str) -> list[EpochRows]:
    """Return ``gnss/observation`` rows of RXM-RAWX, RXM-RAW, or, in epochs without either,
    RXM-MEASX.
    """
    found = []
    measured = np.zeros(batch.count, bool)
    for name in ("RXM-RAWX", "RXM-RAW", "RXM-MEASX"):
        frames = batch.one_of(name)
        fresh = ~measured[frames.epoch]
        batch.refuse(frames.index[~fresh], "RXM-RAWX or RXM-RAW of its epoch says more")
        batch.use(frames.index[fresh])
        measured[frames.epoch] = True
        chosen = frames.take(fresh)
        blocks, owner = batch.blocks(name, chosen)
        if blocks.size:
            read = {"RXM-RAW": _raw, "RXM-MEASX": _measx}
            columns = (
                read[name](blocks) if name in read else _rawx(blocks, chosen.head["version"][owner])
            )
            found.append(batch.rows(source, "gnss/observation", chosen.index[owner], columns))
    return found


def _rawx(blocks: NDArray[np.void], version: Octets) -> FieldColumns:
    """UBX-RXM-RAWX: standard deviations are 0.01 m and 0.002 Hz times a power of two, and steps of
    0.004 cycles, 15 of which mean none.

    Version 0, of u-blox M8, has no signal number: its receivers have the first signal only. Lock
    time stops at 64.5 s.
    """
    gnss, status = blocks["gnssId"], blocks["trkStat"]
    ranged, tracked = status & 1 > 0, status & 2 > 0
    code, carrier, doppler = (blocks[name] & 15 for name in ("prStdev", "cpStdev", "doStdev"))
    slot = blocks["freqId"].astype(np.int64) - 7
    return numbered(gnss, blocks["svId"]) | {
        "signal": signal_codes(gnss, np.where(version == 0, 0, blocks["sigId"])),
        "pseudorange_m": absent_where(~ranged, blocks["prMes"]),
        "carrier_cycles": absent_where(~tracked, blocks["cpMes"]),
        "doppler_hz": absent_where(np.zeros(gnss.size, bool), blocks["doMes"]),
        "cn0_dbhz": absent_where(blocks["cno"] == 0, blocks["cno"]),
        "lock_time_s": blocks["locktime"] * 1e-3,
        "pseudorange_std_m": absent_where(~ranged, 0.01 * 2.0**code),
        "carrier_std_cycles": absent_where(~tracked | (carrier == 15), 0.004 * carrier),
        "doppler_std_hz": 0.002 * 2.0**doppler,
        "frequency_slot": Column(np.where(gnss == GLONASS, slot, 0), gnss == GLONASS),
    }


def _raw(blocks: NDArray[np.void]) -> FieldColumns:
    """UBX-RXM-RAW, GPS L1 of timing receivers before u-blox M8: mesQI from 4 on range and Doppler
    are good, from 5 on the carrier too.
    """
    gnss, number = constellation(blocks["sv"])
    good, locked = blocks["mesQI"] >= 4, blocks["mesQI"] >= 5
    return numbered(gnss, number) | {
        "signal": signal_codes(gnss, np.zeros_like(gnss)),
        "pseudorange_m": absent_where(~good, blocks["prMes"]),
        "carrier_cycles": absent_where(~locked, blocks["cpMes"]),
        "doppler_hz": absent_where(~good, blocks["doMes"]),
        "cn0_dbhz": absent_where(blocks["cno"] <= 0, blocks["cno"]),
    }


def _measx(blocks: NDArray[np.void]) -> FieldColumns:
    """UBX-RXM-MEASX: Doppler in steps of 0.2 Hz; its code phases are no pseudoranges, for they lack
    the whole milliseconds.
    """
    return numbered(blocks["gnssId"], blocks["svId"]) | {
        "doppler_hz": blocks["dopplerHz"] * 0.2,
        "cn0_dbhz": absent_where(blocks["cNo"] == 0, blocks["cNo"]),
    }


def navigation_data(batch: EpochBatch, source: str) -> list[EpochRows]:
    """Return ``gnss/navdata`` rows of RXM-SFRBX and RXM-SFRB: words of 32 bits as received, most
    significant byte first.

    A GPS word of 30 bits stands in the lower bits of its 32. RXM-SFRBX before version 2 names no
    signal.
    """
    found = []
    frames = batch.all_of("RXM-SFRBX")
    if frames.index.size:
        blocks, owner = batch.blocks("RXM-SFRBX", frames)
        words = blocks["dwrd"].astype(">u4").tobytes()
        ends = np.cumsum(np.bincount(owner, minlength=frames.index.size)) * 4
        gnss = frames.head["gnssId"]
        codes = signal_codes(gnss, frames.head["sigId"])
        columns = numbered(gnss, frames.head["svId"]) | {
            "signal": Column(
                np.where(frames.head["version"] >= 2, codes.values, -1).astype(np.int32),
                None,
                codes.categories,
            ),
            "subframe": _subframes(words, ends),
        }
        batch.use(frames.index)
        found.append(batch.rows(source, "gnss/navdata", frames.index, columns))
    frames = batch.all_of("RXM-SFRB")
    if frames.index.size:
        gnss, number = constellation(frames.head["svid"])
        words = frames.head["dwrd"].astype(">u4").tobytes()
        columns = numbered(gnss, number) | {
            "signal": signal_codes(gnss, np.zeros_like(gnss)),
            "subframe": _subframes(words, np.arange(1, frames.index.size + 1) * 40),
        }
        batch.use(frames.index)
        found.append(batch.rows(source, "gnss/navdata", frames.index, columns))
    return found


def _subframes(words: bytes, ends: Ints) -> Column:
    cuts = [0, *ends.tolist()]
    return encode_categories([words[start:end] for start, end in pairwise(cuts)])
