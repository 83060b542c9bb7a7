"""GPS time and UTC."""

import numpy as np
from numpy.typing import NDArray

from spoofbench_converters.stream.contract import ABSENT_NS, WEEK_NS

Ints = NDArray[np.int64]

SECOND_NS = 1_000_000_000
MS_NS = 1_000_000
GPS_EPOCH_NS = 315_964_800 * SECOND_NS  # 1980-01-06 UTC

_LEAPS = np.array(  # first days with one more second between GPS time and UTC (IERS Bulletin C)
    [
        "1981-07-01", "1982-07-01", "1983-07-01", "1985-07-01", "1988-01-01", "1990-01-01", "1991-01-01", "1992-07-01", "1993-07-01",
        "1994-07-01", "1996-01-01", "1997-07-01", "1999-01-01", "2006-01-01", "2009-01-01", "2012-07-01", "2015-07-01", "2017-01-01",
    ],
    "datetime64[ns]",
).astype(np.int64)  # fmt: skip
LEAP_SECONDS = _LEAPS.size
"""GPS time minus UTC since the last announced leap second."""


def leap_seconds(gps_ns: Ints) -> Ints:
    """Return announced GPS time minus UTC, in s, at GPS times in ns since 1980-01-06."""
    return np.searchsorted(_LEAPS + np.arange(1, _LEAPS.size + 1) * SECOND_NS, gps_ns + GPS_EPOCH_NS, "right").astype(np.int64)


def week_of(gps_ns: Ints, tow_ns: Ints) -> Ints:
    """Return the week that lays a time of week nearest to GPS times."""
    return np.asarray((gps_ns - tow_ns + WEEK_NS // 2) // WEEK_NS)


def utc_ns(fields: NDArray[np.void]) -> Ints:
    """Return Unix nanoseconds of the fields year, month, day, hour, min, sec and nano; ``ABSENT_NS`` where they are no date.

    Nanoseconds are signed: seconds are rounded to the nearest one. Second 60 is the second after 59.
    """
    year, month, day, hour, minute, second = (fields[name].astype(np.int64) for name in ("year", "month", "day", "hour", "min", "sec"))
    possible = (year >= 1980) & (year < 2200) & (month >= 1) & (month <= 12) & (day >= 1) & (day <= 31)
    possible &= (hour < 24) & (minute < 60) & (second <= 60) & (np.abs(fields["nano"].astype(np.int64)) < SECOND_NS)
    months = (np.where(possible, year - 1970, 0) * 12 + np.where(possible, month - 1, 0)).astype("datetime64[M]")
    first = months.astype("datetime64[D]").astype(np.int64)
    possible &= day <= (months + 1).astype("datetime64[D]").astype(np.int64) - first
    seconds = (((first + day - 1) * 24 + hour) * 60 + minute) * 60 + second
    return np.where(possible, seconds * SECOND_NS + fields["nano"], ABSENT_NS)
