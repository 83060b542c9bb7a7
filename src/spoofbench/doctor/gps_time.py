"""GPS time and UTC (IS-GPS-200, 3.3.4; leap seconds of IERS Bulletin C)."""

import numpy as np
from numpy.typing import NDArray

from spoofbench.recording import Table

SECOND_NS = 1_000_000_000
WEEK_S = 604_800
ROLLOVER_S = 1024 * WEEK_S
"""The legacy navigation message counts weeks in ten bits."""

_GPS_EPOCH = np.datetime64("1980-01-06", "s")
_LEAPS = np.array(
    [
        *("1981-07-01", "1982-07-01", "1983-07-01", "1985-07-01", "1988-01-01", "1990-01-01", "1991-01-01", "1992-07-01", "1993-07-01"),
        *("1994-07-01", "1996-01-01", "1997-07-01", "1999-01-01", "2006-01-01", "2009-01-01", "2012-07-01", "2015-07-01", "2017-01-01"),
    ],
    "datetime64[s]",
)


def leap_seconds(unix_s: float) -> int:
    """Return GPS time minus UTC at a Unix time, s."""
    return int(np.searchsorted(_LEAPS, np.datetime64(int(unix_s), "s"), "right"))


def claimed_gps_s(table: Table) -> NDArray[np.float64]:
    """Return the GPS time that a ``gnss/pvt`` table claims, in seconds since 1970 as if it were UTC; ``(n,)``, NaN where unknown."""
    epoch_s = float(_GPS_EPOCH.astype(np.int64))
    week = np.where(table.valid("gps_week"), table["gps_week"].astype(np.float64), np.nan)
    return np.asarray(epoch_s + week * WEEK_S + table["tow_s"])
