"""Satellites in view and in use (GSV, GSA, GRS, PUBX,03), and rows of ``gnss/signal`` from them.

Each reader returns tables whose ``row`` says which of the sentences a row is of.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench.arrays import Bools, Floats, Ints, Octets
from spoofbench.conversion import Columns
from spoofbench.conversion.rows import take
from spoofbench.table import Column
from spoofbench_converters.nmea import satellites
from spoofbench_converters.nmea.fields import hexadecimal
from spoofbench_converters.nmea.sentences import Reader

VIEW, USE, RESIDUAL = "satellites in view", "satellites in use", "residuals"
"""Names of the tables of satellites."""

GSA_SLOTS = 12
_MAX_BLOCKS = 64
UNKNOWN, NO, YES = -1, 0, 1


def gsv(read: Reader, named: Ints) -> tuple[Columns, Columns]:
    """Read satellites in view.

    After the blocks of four fields may stand a signal id (NMEA 4.10), and after that a system id
    (Qualcomm's PQGSV).

    Args:
        read: of ``n`` sentences.
        named: int64 ``(n,)``, the constellation that each talker names.

    Returns:
        By sentence, ``message``, its number among those of one talker and signal; by satellite,
        ``constellation svid signal cn0_dbhz elevation_deg azimuth_deg used``.
    """
    after = np.maximum(read.count - 3, 0)
    tail = np.where(after % 4 == 3, 0, after % 4)
    room = after - tail
    message = read.whole(2)
    signal_id, system = np.zeros(named.size, np.int64), np.zeros(named.size, np.int64)
    for size in np.unique(room[tail > 0]).tolist():
        signal_id = np.where(
            (room == size) & (tail > 0), hexadecimal(_letter(read, 4 + size)), signal_id
        )
        system = np.where(
            (room == size) & (tail == 2), hexadecimal(_letter(read, 5 + size)), system
        )
    named = np.where(system > 0, satellites.of_system_id(system), named)
    blocks = []
    for first in range(0, max(min(int(room.max(initial=0)), 4 * _MAX_BLOCKS), 1), 4):
        number = read.whole(4 + first, first < room)
        parts = [read.number(4 + first + index, first + index < room) for index in (1, 2, 3)]
        blocks.append(_satellites(number, parts, named, signal_id, np.full(named.size, UNKNOWN)))
    return {"message": message}, _flatten(blocks)


def pubx03(read: Reader, named: Ints) -> tuple[Columns, Columns]:
    """Read u-blox satellite status: number, use, azimuth, elevation, C/N0 and lock time of each.

    Arguments, ``(n,)``, and tables are those of :func:`gsv`.
    """
    blocks = []
    for first in range(3, max(min(int(read.count.max(initial=0)), 6 * _MAX_BLOCKS), 4), 6):
        there = first + 5 <= read.count
        number = read.whole(first, there)
        azimuth, elevation, cn0 = (read.number(first + index, there) for index in (2, 3, 4))
        status = _letter(read, first + 1)
        used = np.where(
            status == ord("U"),
            YES,
            np.where((status == ord("e")) | (status == ord("-")), NO, UNKNOWN),
        )
        blocks.append(
            _satellites(
                number, [elevation, azimuth, cn0], named, np.zeros(named.size, np.int64), used
            )
        )
    return {"message": np.zeros(named.size, np.int64)}, _flatten(blocks)


def gsa(read: Reader, named: Ints) -> tuple[Columns, Columns]:
    """Read satellites in use; arguments, ``(n,)``, are those of :func:`gsv`.

    Returns:
        By sentence, ``dimension`` (1 no fix, 2, 3), ``pdop hdop vdop``, ``covers``, the
        constellation that the sentence is about (0: whichever its numbers say), and ``full``,
        whether there was no room for more; by satellite, ``slot constellation svid``.
    """
    system = hexadecimal(_letter(read, 18))
    named = np.where(system > 0, satellites.of_system_id(system), named)
    columns: Columns = {"dimension": read.whole(2)}
    columns |= {
        name: read.dilution(15 + index) for index, name in enumerate(("pdop", "hdop", "vdop"))
    }
    slots = []
    for slot in range(GSA_SLOTS):
        constellation, svid = satellites.identify(named, read.whole(3 + slot))
        kept = np.flatnonzero(svid > 0)
        slots.append(
            take(
                {
                    "row": np.arange(named.size),
                    "slot": np.full(named.size, slot),
                    "constellation": constellation,
                    "svid": svid,
                },
                kept,
            )
        )
    rows = _flatten(slots)
    count = np.bincount(rows["row"], minlength=named.size)
    return columns | {"covers": named, "full": count >= GSA_SLOTS}, rows


def grs(read: Reader, named: Ints) -> tuple[Columns, Columns]:
    """Read residuals of the satellites in use, in the order of the GSA sentence of the same system.

    Arguments, ``(n,)``, are those of :func:`gsv`.

    Returns:
        By sentence, time of day, ``covers`` as of :func:`gsa` and ``signal``; by satellite, ``slot
        residual_m``.
    """
    system = hexadecimal(_letter(read, 15))
    signal_id = hexadecimal(_letter(read, 16))
    named = np.where(system > 0, satellites.of_system_id(system), named)
    columns = {**read.time(1), "covers": named, "signal": satellites.signal_of(named, signal_id)}
    slots = []
    for slot in range(GSA_SLOTS):
        residual = read.number(3 + slot)
        kept = np.flatnonzero(~np.isnan(residual))
        slots.append(
            take(
                {
                    "row": np.arange(named.size),
                    "slot": np.full(named.size, slot),
                    "residual_m": residual,
                },
                kept,
            )
        )
    return columns, _flatten(slots)


def _satellites(
    number: Ints, parts: list[Floats], named: Ints, signal_id: Ints, used: Ints
) -> Columns:
    """One block of all sentences: those that give anything of a satellite. A C/N0 of 0 is that of
    one not received: absent.
    """
    constellation, svid = satellites.identify(named, number)
    parts[2][parts[2] == 0] = np.nan
    columns: Columns = {
        "row": np.arange(named.size),
        "constellation": constellation,
        "svid": svid,
        "signal": satellites.signal_of(constellation, signal_id),
        **{
            name: part.astype(np.float32)
            for name, part in zip(("elevation_deg", "azimuth_deg", "cn0_dbhz"), parts, strict=True)
        },
        "used": used.astype(np.int16),
    }
    given = number > 0
    for part in parts:
        given |= ~np.isnan(part)
    return columns if given.all() else take(columns, np.flatnonzero(given))


def _letter(read: Reader, field: int) -> Octets:
    """The character of a field of one character, 0 where it is not one."""
    cells = read.cells(field)
    return np.where(cells.length == 1, cells.first(), 0).astype(np.uint8)


def _flatten(parts: list[Columns]) -> Columns:
    """Join tables and put their rows in the order of ``row``, and of the tables within it."""
    if not parts:
        return {"row": np.empty(0, np.int64)}
    if len(parts) == 1:
        return parts[0]
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return take(joined, np.argsort(joined["row"], kind="stable"))


_SVIDS = 1_024


def signal_rows(view: Columns, tables: Mapping[str, Columns]) -> dict[str, Any]:
    """Return the columns ``(n,)`` of ``gnss/signal`` of ``n`` satellites in view; the tables are
    those of the same receiver.
    """
    constellation, svid, signal = view["constellation"], view["svid"], view["signal"]
    used = np.where(view["used"] == UNKNOWN, _used(view, tables), view["used"])
    return {
        "constellation": Column(constellation.astype(np.int32), constellation > 0),
        "svid": Column(svid.astype(np.uint32), svid > 0),
        "signal": Column(signal.astype(np.int32), None, satellites.SIGNALS),
        **{name: view[name] for name in ("cn0_dbhz", "elevation_deg", "azimuth_deg")},
        "used": Column(used == YES, used != UNKNOWN),
        "residual_m": _residuals(view, tables),
    }


def without_doubles(view: Columns) -> tuple[Columns, Ints]:
    """Return satellites without a signal's second row in an epoch, and the sentences of which
    nothing is left, int64 ``(k,)``.
    """
    key = (_key(view["epoch"], view) << 8) | (view["signal"] + 1)
    order = np.argsort(key, kind="stable")
    double = np.zeros(key.size, bool)
    double[order[1:]] = (key[order[1:]] == key[order[:-1]]) & (view["svid"][order[1:]] > 0)
    if not double.any():
        return view, np.empty(0, np.int64)
    kept = take(view, ~double)
    return kept, np.setdiff1d(view["frame"][double], kept["frame"])


def _key(epoch: Ints, table: Columns) -> Ints:
    return (epoch * 16 + table["constellation"]) * _SVIDS + table["svid"]


def _used(view: Columns, tables: Mapping[str, Columns]) -> Ints:
    """Whether GSA sentences of the epoch list the satellite: no where they cover its system and had
    room for more.
    """
    used = np.full(view["epoch"].size, UNKNOWN)
    if "GSA" not in tables:
        return used
    sentences = tables["GSA"]
    used[_covered(view, sentences, np.ones(sentences["epoch"].size, bool))] = 0
    used[_covered(view, sentences, sentences["full"])] = UNKNOWN
    if USE in tables:
        listed = _among(_key(view["epoch"], view), np.sort(_key(tables[USE]["epoch"], tables[USE])))
        used[listed & (view["svid"] > 0)] = YES
    return used


def _covered(view: Columns, sentences: Columns, which: Bools) -> Bools:
    """Which satellites these GSA sentences are about; one that names no system is about all."""
    about = np.zeros(
        16 * (int(max(view["epoch"].max(initial=0), sentences["epoch"].max(initial=0))) + 1), bool
    )
    about[sentences["epoch"][which] * 16 + sentences["covers"][which]] = True
    return np.asarray(about[view["epoch"] * 16 + view["constellation"]] | about[view["epoch"] * 16])


def _among(keys: Ints, known: Ints) -> Bools:
    """Which keys are among those known, which are sorted."""
    if not known.size:
        return np.zeros(keys.size, bool)
    return np.asarray(known[np.minimum(np.searchsorted(known, keys), known.size - 1)] == keys)


def _residuals(view: Columns, tables: Mapping[str, Columns]) -> NDArray[np.float32]:
    """Residuals of GRS: the nth of a sentence is of the nth satellite in the GSA of the same
    system, or at the same index.
    """
    residuals = np.full(view["epoch"].size, np.nan, np.float32)
    if RESIDUAL not in tables or USE not in tables:
        return residuals
    in_use, given = tables[USE], tables[RESIDUAL]
    users = _sentence_keys(tables["GSA"])[np.searchsorted(tables["GSA"]["frame"], in_use["frame"])]
    givers = np.searchsorted(tables["GRS"]["frame"], given["frame"])
    slots = users * 16 + in_use["slot"]
    order = np.argsort(slots, kind="stable")
    wanted = _sentence_keys(tables["GRS"])[givers] * 16 + given["slot"]
    index = np.minimum(np.searchsorted(slots[order], wanted), order.size - 1)
    match = slots[order][index] == wanted
    satellite = _key(in_use["epoch"], in_use)[order][index[match]]
    signal, value = tables["GRS"]["signal"][givers[match]], given["residual_m"][match]
    for anywhere in (True, False):  # a residual with a signal goes to that signal alone
        rows_of = signal == satellites.NO_SIGNAL if anywhere else signal != satellites.NO_SIGNAL
        known = np.unique((satellite[rows_of] << 8) | (signal[rows_of] + 1), return_index=True)
        key = (_key(view["epoch"], view) << 8) | (0 if anywhere else view["signal"] + 1)
        at = np.minimum(np.searchsorted(known[0], key), max(known[0].size - 1, 0))
        if known[0].size:
            hit = known[0][at] == key
            residuals[hit] = value[rows_of][known[1][at[hit]]]
    return residuals


def _sentence_keys(table: Columns) -> Ints:
    """A number that is the same for the GSA and the GRS of one epoch and system; without a system,
    of the same index among them.
    """
    epoch = table["epoch"]
    index = np.arange(epoch.size) - np.searchsorted(epoch, epoch, "left")
    return epoch * 64 + np.where(table["covers"] > 0, table["covers"], 16 + np.minimum(index, 47))
