"""Rows of ``gnss/signal`` from the satellites in view, in use, and their residuals."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench.conversion import Columns
from spoofbench.conversion.rows import take
from spoofbench.table import Column
from spoofbench_converters.nmea import satellites
from spoofbench_converters.nmea.batch import RESIDUAL, USE
from spoofbench_converters.nmea.fields import Bools, Ints
from spoofbench_converters.nmea.sky import UNKNOWN, YES

_SVIDS = 1_024


def rows(view: Columns, tables: Mapping[str, Columns]) -> dict[str, Any]:
    """Return the columns of ``gnss/signal`` of satellites in view; the tables are those of the same
    receiver.
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
    nothing is left.
    """
    key = (_key(view["epoch"], view) << 8) | (view["signal"] + 1)
    order = np.argsort(key, kind="stable")
    double = np.zeros(key.size, bool)
    double[order[1:]] = (key[order[1:]] == key[order[:-1]]) & (view["svid"][order[1:]] > 0)
    if not double.any():
        return view, np.empty(0, np.int64)
    kept = take(view, ~double)
    return kept, np.setdiff1d(view["frame"][double], kept["frame"])


def taken(columns: Mapping[str, NDArray[Any] | Column], kept: Ints) -> dict[str, Any]:
    """Return these rows of columns."""
    return {
        name: Column(column.values[kept], None if column.valid is None else column.valid[kept])
        if isinstance(column, Column)
        else column[kept]
        for name, column in columns.items()
    }


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
    used[_said(view, sentences, np.ones(sentences["epoch"].size, bool))] = 0
    used[_said(view, sentences, sentences["full"])] = UNKNOWN
    if USE in tables:
        listed = _among(_key(view["epoch"], view), np.sort(_key(tables[USE]["epoch"], tables[USE])))
        used[listed & (view["svid"] > 0)] = YES
    return used


def _said(view: Columns, sentences: Columns, which: Bools) -> Bools:
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
    system, or of the same place.
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
    place = np.minimum(np.searchsorted(slots[order], wanted), order.size - 1)
    match = slots[order][place] == wanted
    satellite = _key(in_use["epoch"], in_use)[order][place[match]]
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
    of the same place among them.
    """
    epoch = table["epoch"]
    place = np.arange(epoch.size) - np.searchsorted(epoch, epoch, "left")
    return epoch * 64 + np.where(table["covers"] > 0, table["covers"], 16 + np.minimum(place, 47))
