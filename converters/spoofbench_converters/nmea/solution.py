"""The solution of each epoch of a receiver, from all its sentences.

Position, speed, course and heights count only where their sentence says that they are valid; where
it has no word of its own (VTG of old, GST) the other sentences of the epoch decide. Where several
give a value, the finest text counts, and of equally fine ones the first in the order in which they
are named here. A fix with a height and without a dimension is 3D, one whose sentence leaves the
height empty 2D; where no sentence has a height its type is absent.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench.arrays import Bools, Floats, Ints
from spoofbench.conversion import Columns
from spoofbench.gnss_time import (
    DAY_NS,
    SECOND_NS,
    leap_seconds,
    utc_to_gps,
    week_and_tow,
    wrap_difference,
)
from spoofbench.schema.v1 import gnss_pb2 as enums
from spoofbench.table import Column
from spoofbench_converters.nmea.fields import one_of
from spoofbench_converters.serial.contract import ABSENT_NS

ONE_PER_EPOCH = (
    "GGA",
    "RMC",
    "GNS",
    "GLL",
    "PUBX00",
    "VTG",
    "GST",
    "GBS",
    "PGRME",
    "ZDA",
    "PUBX04",
)
_POSITIONS = ("GGA", "GNS", "PUBX00", "RMC", "GLL")
_TIMES = ("RMC", "GGA", "GNS", "GLL", "PUBX00", "GST", "GBS", "GRS", "ZDA", "PUBX04")
_DATES = ("RMC", "ZDA", "PUBX04")

_PLAIN = 99  # a fix of the dimension that GSA or the height gives
_OF_QUALITY = {
    1: _PLAIN,
    2: enums.FIX_TYPE_DIFFERENTIAL,
    3: _PLAIN,
    4: enums.FIX_TYPE_RTK_FIXED,
    5: enums.FIX_TYPE_RTK_FLOAT,
    6: enums.FIX_TYPE_DEAD_RECKONING,
    7: enums.FIX_TYPE_UNSPECIFIED,
    8: enums.FIX_TYPE_SIMULATED,
    9: enums.FIX_TYPE_DIFFERENTIAL,
}
_OF_MODE = {
    "D": enums.FIX_TYPE_DIFFERENTIAL, "R": enums.FIX_TYPE_RTK_FIXED, "F": enums.FIX_TYPE_RTK_FLOAT,
    "E": enums.FIX_TYPE_DEAD_RECKONING,
    "S": enums.FIX_TYPE_SIMULATED, "M": enums.FIX_TYPE_UNSPECIFIED,
}  # fmt: skip
_OF_STATUS = {
    "NF": enums.FIX_TYPE_NONE, "DR": enums.FIX_TYPE_DEAD_RECKONING, "G2": enums.FIX_TYPE_2D,
    "G3": enums.FIX_TYPE_3D,
    "D2": enums.FIX_TYPE_DIFFERENTIAL, "D3": enums.FIX_TYPE_DIFFERENTIAL,
    "RK": enums.FIX_TYPE_GNSS_DEAD_RECKONING,
    "TT": enums.FIX_TYPE_TIME_ONLY,
}  # fmt: skip
# later ones have the last word
_TELLS: Mapping[str, tuple[str, Mapping[int, int] | Mapping[str, int]]] = {
    "VTG": ("mode", _OF_MODE), "GLL": ("mode", _OF_MODE), "RMC": ("mode", _OF_MODE),
    "GNS": ("mode", _OF_MODE),
    "GGA": ("quality", _OF_QUALITY), "PUBX00": ("nav_status", _OF_STATUS),
}  # fmt: skip


class Solution:
    """The epochs of one receiver.

    Args:
        count: how many epochs there are.
        tables: by type, what its sentences say, with the ``epoch`` of each; of those in
            ``ONE_PER_EPOCH`` one per epoch.
    """

    def __init__(self, count: int, tables: Mapping[str, Columns]) -> None:
        self.count = count
        self._tables = tables
        self._own = {name: _VALID[name](tables[name]) for name in _VALID if name in tables}
        positive, negative = np.zeros(count, bool), np.zeros(count, bool)
        for name, valid in self._own.items():
            positive[tables[name]["epoch"][valid]] = True
            negative[tables[name]["epoch"][~valid]] = True
        self.invalid: Bools = negative & ~positive
        self._fix = positive

    def rows(self) -> dict[str, NDArray[Any] | Column]:
        """Return the columns of ``gnss/pvt``, ``(count,)``."""
        columns = {
            name: self._finest(name, "lat_deg_step", _POSITIONS) for name in ("lat_deg", "lon_deg")
        }
        columns |= {
            name: self._finest(name, f"{name}_step", sentences)
            for name, sentences in _GRADED.items()
        }
        columns |= {name: self._first(name, sentences) for name, sentences in _FIRST.items()}
        separation = self._finest("separation_m", "separation_m_step", ("GGA", "GNS"))
        columns["height_m"] = np.where(
            np.isnan(columns["height_m"]),
            _sum(columns["height_msl_m"], separation),
            columns["height_m"],
        )
        columns |= self._accuracies()
        satellites = self._counted("num_sv", ("GNS", "PUBX00", "GGA"))
        fix_type = self._fix_type(
            ~np.isnan(columns["height_msl_m"]) | ~np.isnan(columns["height_m"])
        )
        return {
            **columns,
            "num_sv": Column(np.maximum(satellites, 0).astype(np.uint32), satellites >= 0),
            "fix_type": Column(fix_type, fix_type != enums.FIX_TYPE_UNSPECIFIED),
            **self._gps_time(),
        }

    def claimed(self) -> tuple[Ints, Ints]:
        """Return UTC as claimed and its period, ``(count,)``, as
        :class:`spoofbench_converters.serial.contract.Epochs` wants them.
        """
        tod_ns = self._time_of_day()
        dated = self._dated(tod_ns)
        complete = dated != ABSENT_NS
        return np.where(complete, dated, tod_ns), np.where(
            complete | (tod_ns == ABSENT_NS), 0, DAY_NS
        )

    def _time_of_day(self) -> Ints:
        """The time with most decimals."""
        tod_ns, best = np.full(self.count, ABSENT_NS), np.full(self.count, -1)
        for name in self._present(_TIMES):
            table = self._tables[name]
            better = (table["tod_ns"] != ABSENT_NS) & (table["tod_places"] > best[table["epoch"]])
            tod_ns[table["epoch"][better]] = table["tod_ns"][better]
            best[table["epoch"][better]] = table["tod_places"][better]
        return tod_ns

    def _dated(self, tod_ns: Ints) -> Ints:
        """The time of day with the date of the epoch, which is that of its own sentence's time;
        ``ABSENT_NS`` without a valid one.
        """
        dated = np.full(self.count, ABSENT_NS)
        for name in self._present(_DATES):
            table = self._tables[name]
            epoch = table["epoch"]
            usable = (
                self._usable(name)
                & (table["date_ns"] != ABSENT_NS)
                & (table["tod_ns"] != ABSENT_NS)
                & (dated[epoch] == ABSENT_NS)
            )
            epoch, date_ns, own = epoch[usable], table["date_ns"][usable], table["tod_ns"][usable]
            dated[epoch] = date_ns + own + wrap_difference(tod_ns[epoch] - own, DAY_NS)
        return dated

    def _gps_time(self) -> dict[str, NDArray[Any] | Column]:
        tod_ns = self._time_of_day()
        dated = self._dated(tod_ns)
        complete = dated != ABSENT_NS
        utc_ns = np.where(complete, dated, 0)
        # the Unix time of an inserted second is that of the second after it
        inserted = tod_ns >= DAY_NS
        week, tow_ns = week_and_tow(utc_to_gps(utc_ns, leap_seconds(utc_ns) - inserted))
        complete &= week >= 0
        denied = self.invalid & (tod_ns != ABSENT_NS)
        return {
            "gps_week": Column(np.where(complete, week, 0).astype(np.uint32), complete),
            "tow_s": np.where(complete, tow_ns / SECOND_NS, np.nan),
            "time_valid": Column(complete, complete | denied),
        }

    def _accuracies(self) -> dict[str, Floats]:
        """Accuracies as given, else from standard deviations by axis; these are also the diagonal
        of the covariance.
        """
        north, east, down = (
            self._first(name, ("GST", "GBS")) for name in ("sigma_n_m", "sigma_e_m", "sigma_d_m")
        )
        horizontal, vertical = (
            self._first(name, ("PUBX00", "PGRME")) for name in ("h_acc_m", "v_acc_m")
        )
        return {
            "h_acc_m": np.where(np.isnan(horizontal), np.hypot(north, east), horizontal),
            "v_acc_m": np.where(np.isnan(vertical), down, vertical),
            "cov_nn_m2": north**2,
            "cov_ee_m2": east**2,
            "cov_dd_m2": down**2,
        }

    def _fix_type(self, has_height: Bools) -> NDArray[np.int32]:
        dimension = self._counted("dimension", ("GSA",))
        flat = np.full(self.count, enums.FIX_TYPE_UNSPECIFIED)
        for name in self._present(("GGA", "GNS", "PUBX00")):
            flat[self._tables[name]["epoch"]] = enums.FIX_TYPE_2D
        plain = np.where(has_height, enums.FIX_TYPE_3D, flat)
        plain = np.where(
            dimension == 2, enums.FIX_TYPE_2D, np.where(dimension == 3, enums.FIX_TYPE_3D, plain)
        )
        fix = np.where(
            self._fix,
            plain,
            np.where(
                self.invalid | (dimension == 1), enums.FIX_TYPE_NONE, enums.FIX_TYPE_UNSPECIFIED
            ),
        )
        for name in self._present(tuple(_TELLS)):
            table = self._tables[name]
            column, meaning = _TELLS[name]
            found = _look_up(table[column], meaning)
            found = np.where(found == _PLAIN, plain[table["epoch"]], found)
            known = (found >= 0) & self._fix[table["epoch"]] & self._usable(name)
            fix[table["epoch"][known]] = found[known]
        return fix.astype(np.int32)

    def _present(self, names: Sequence[str]) -> list[str]:
        return [name for name in names if name in self._tables]

    def _usable(self, name: str) -> Bools:
        epoch = self._tables[name]["epoch"]
        if name in self._own:
            return self._own[name]
        valid = ~self.invalid[epoch]
        return valid & (self._tables[name]["mode"] != ord("N")) if name == "VTG" else valid

    def _finest(self, column: str, step: str, names: Sequence[str]) -> Floats:
        values, best = np.full(self.count, np.nan), np.full(self.count, np.inf)
        for name in self._present(names):
            table = self._tables[name]
            better = self._usable(name) & (table[step] < best[table["epoch"]])
            values[table["epoch"][better]] = table[column][better]
            best[table["epoch"][better]] = table[step][better]
        return values

    def _counted(self, column: str, names: Sequence[str]) -> Ints:
        """The first count of each epoch, whatever the fix, -1 where absent."""
        values = np.full(self.count, -1)
        for name in self._present(names):
            table = self._tables[name]
            rows = np.flatnonzero((table[column] >= 0) & (values[table["epoch"]] < 0))[
                ::-1
            ]  # of several in an epoch the first stays
            values[table["epoch"][rows]] = table[column][rows]
        return values

    def _first(self, column: str, names: Sequence[str]) -> Floats:
        values = np.full(self.count, np.nan)
        for name in self._present(names):
            table = self._tables[name]
            given = ~np.isnan(table[column]) & np.isnan(values[table["epoch"]])
            if column not in _WHATEVER_FIX:
                given &= self._usable(name)
            rows = np.flatnonzero(given)[::-1]  # of several in an epoch the first stays
            values[table["epoch"][rows]] = table[column][rows]
        return values


_GRADED = {
    "height_msl_m": ("GGA", "GNS"),
    "height_m": ("PUBX00",),
    "speed_mps": ("RMC", "VTG", "PUBX00"),
    "course_deg": ("RMC", "VTG", "PUBX00"),
}
_FIRST = {
    "vel_d_mps": ("PUBX00",),
    "hdop": ("GNS", "GGA", "GSA", "PUBX00"),
    "vdop": ("GSA", "PUBX00"),
    "pdop": ("GSA",),
    "diff_age_s": ("GGA", "GNS", "PUBX00"),
}
_WHATEVER_FIX = frozenset(("hdop", "vdop", "pdop"))


def _status_valid(table: Columns) -> Bools:
    """Whether RMC and GLL are valid: by the status, without one by the mode."""
    by_mode = (table["mode"] != 0) & (table["mode"] != ord("N"))
    return np.asarray(
        np.where(
            table["status"] == 0,
            by_mode,
            (table["status"] == ord("A")) & (table["mode"] != ord("N")),
        )
    )


_VALID: Mapping[str, Callable[[Columns], Bools]] = {
    "GGA": lambda table: table["quality"] > 0,
    "RMC": _status_valid,
    "GLL": _status_valid,
    "GNS": lambda table: (table["mode"] != 0) & ~one_of(table["mode"], "N"),
    "PUBX00": lambda table: (
        ~np.isin(table["nav_status"], [0, *(ord(a) << 8 | ord(b) for a, b in ("NF", "TT"))])
    ),
}


def _look_up(values: NDArray[np.generic], meaning: Mapping[int, int] | Mapping[str, int]) -> Ints:
    """Return what values, letters or pairs of letters mean, -1 where nothing."""
    found = np.full(values.size, -1)
    for key, fix in meaning.items():
        value = key if isinstance(key, int) else int.from_bytes(key.encode(), "big")
        found[values == value] = fix
    return found


def _sum(height: Floats, separation: Floats) -> Floats:
    """Height above the ellipsoid, to the resolution of a tenth of a micrometre that sums of
    decimals keep.
    """
    return np.round(height + separation, 7)
