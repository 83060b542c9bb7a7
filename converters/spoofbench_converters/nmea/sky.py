"""Satellites in view and in use: GSV, GSA, GRS and u-blox PUBX,03, one row per satellite of each sentence.

Every function returns tables whose ``row`` says which of the sentences each row is of.
"""

import numpy as np

from spoofbench.converting import Columns
from spoofbench.converting.ordering import take
from spoofbench_converters.nmea import satellites
from spoofbench_converters.nmea.fields import Ints, decimals, hexadecimal
from spoofbench_converters.nmea.sentences import Reader

GSA_SLOTS = 12
_MAX_BLOCKS = 64
UNKNOWN, NO, YES = -1, 0, 1


def gsv(read: Reader, named: Ints) -> tuple[Columns, Columns]:
    """Read satellites in view.

    ``named`` is the constellation that each talker names. After the blocks of four fields may stand a signal
    id (NMEA 4.10), and after that a system id (Qualcomm's PQGSV).

    Returns:
        By sentence, ``message``, its number among those of one talker and signal; by satellite, ``constellation
        svid signal cn0_dbhz elevation_deg azimuth_deg used``.
    """
    after = np.maximum(read.fields - 3, 0)
    tail = np.where(after % 4 == 3, 0, after % 4)
    message = read.number(2)
    signal_id = np.where(tail > 0, hexadecimal(_at(read, np.where(tail > 0, read.fields - tail + 1, 0))), 0)
    system = np.where(tail == 2, hexadecimal(_at(read, np.where(tail == 2, read.fields, 0))), 0)
    named = np.where(system > 0, satellites.of_system_id(system), named)
    blocks = []
    for block in range(min(int(((after + 1) // 4).max(initial=1)), _MAX_BLOCKS)):
        parts = [_number(read, np.where(block * 4 + place < after - tail, 4 + block * 4 + place, 0)) for place in range(4)]
        blocks.append(_satellites(parts, named, signal_id, np.full(named.size, UNKNOWN)))
    return {"message": np.nan_to_num(message).astype(np.int64)}, _flatten(blocks)


def pubx03(read: Reader, named: Ints) -> tuple[Columns, Columns]:
    """Read u-blox satellite status: number, use, azimuth, elevation, C/N0 and lock time of each; tables as of :func:`gsv`."""
    blocks = []
    for block in range(min(int(((read.fields - 2) // 6).max(initial=1)), _MAX_BLOCKS)):
        field = np.where(3 + block * 6 + 5 <= read.fields, 3 + block * 6, 0)
        number, azimuth, elevation, cn0 = (_number(read, np.where(field > 0, field + place, 0)) for place in (0, 2, 3, 4))
        status = _at(read, np.where(field > 0, field + 1, 0))
        used = np.where(status == ord("U"), YES, np.where((status == ord("e")) | (status == ord("-")), NO, UNKNOWN))
        blocks.append(_satellites([number, elevation, azimuth, cn0], named, np.zeros(named.size, np.int64), used))
    return {"message": np.zeros(named.size, np.int64)}, _flatten(blocks)


def gsa(read: Reader, named: Ints) -> tuple[Columns, Columns]:
    """Read satellites in use.

    Returns:
        By sentence, ``dimension`` (1 no fix, 2, 3), ``pdop hdop vdop``, ``covers``, the constellation that the
        sentence is about (0: whichever its numbers say), and ``full``, whether there was no room for more;
        by satellite, ``slot constellation svid``.
    """
    system = hexadecimal(_at(read, np.where(read.fields >= 18, 18, 0)))
    named = np.where(system > 0, satellites.of_system_id(system), named)
    columns: Columns = {"dimension": read.number(2)}
    columns |= {name: read.number(15 + place) for place, name in enumerate(("pdop", "hdop", "vdop"))}
    slots = []
    for slot in range(GSA_SLOTS):
        number = read.number(3 + slot)
        constellation, svid = satellites.identify(named, np.nan_to_num(number).astype(np.int64))
        kept = np.flatnonzero(~np.isnan(number) & (svid > 0))
        slots.append(
            take({"row": np.arange(named.size), "slot": np.full(named.size, slot), "constellation": constellation, "svid": svid}, kept)
        )
    rows = _flatten(slots)
    count = np.bincount(rows["row"], minlength=named.size)
    return columns | {"covers": named, "full": count >= GSA_SLOTS}, rows


def grs(read: Reader, named: Ints) -> tuple[Columns, Columns]:
    """Read residuals of the satellites in use, in the order of the GSA sentence of the same system.

    Returns:
        By sentence, time of day, ``covers`` as of :func:`gsa` and ``signal``; by satellite, ``slot residual_m``.
    """
    system = hexadecimal(_at(read, np.where(read.fields >= 15, 15, 0)))
    signal_id = hexadecimal(_at(read, np.where(read.fields >= 16, 16, 0)))
    named = np.where(system > 0, satellites.of_system_id(system), named)
    columns = {**read.time(1), "covers": named, "signal": satellites.signal_of(named, signal_id)}
    slots = []
    for slot in range(GSA_SLOTS):
        residual = read.number(3 + slot)
        kept = np.flatnonzero(~np.isnan(residual))
        slots.append(take({"row": np.arange(named.size), "slot": np.full(named.size, slot), "residual_m": residual}, kept))
    return columns, _flatten(slots)


def _satellites(parts: list[Ints], named: Ints, signal_id: Ints, used: Ints) -> Columns:
    """One block of all sentences: those that give anything of a satellite."""
    number, elevation, azimuth, cn0 = parts
    constellation, svid = satellites.identify(named, np.nan_to_num(number).astype(np.int64))
    columns = {
        "row": np.arange(named.size),
        "constellation": constellation,
        "svid": svid,
        "signal": satellites.signal_of(constellation, signal_id),
        "cn0_dbhz": cn0,
        "elevation_deg": elevation,
        "azimuth_deg": azimuth,
        "used": used,
    }
    return take(columns, np.flatnonzero(~np.all(np.isnan(np.stack(parts)), axis=0)))


def _number(read: Reader, field: Ints) -> Ints:
    """Numbers of a field whose place differs by sentence; 0 is no field."""
    cells = read.cells_at(field)
    found = decimals(cells)
    read.readable &= found.readable
    return found.floats()


def _at(read: Reader, field: Ints) -> Ints:
    """The character of fields of one character whose place differs by sentence, 0 where there is none."""
    cells = read.cells_at(field)
    return np.where(cells.length == 1, cells.first(), 0)


def _flatten(parts: list[Columns]) -> Columns:
    """Join tables and put their rows in the order of ``row``, and of the tables within it."""
    if not parts:
        return {"row": np.empty(0, np.int64)}
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return take(joined, np.argsort(joined["row"], kind="stable"))
