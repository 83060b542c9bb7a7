"""Weeks and calendar fields as UBX messages give them."""

import numpy as np
from numpy.typing import NDArray

from spoofbench.gnss_time import SECOND_NS, WEEK_NS
from spoofbench_converters.serial.contract import ABSENT_NS

Ints = NDArray[np.int64]

MS_NS = 1_000_000


def week_of(gps_ns: Ints, tow_ns: Ints) -> Ints:
    """Return the week that lays a time of week nearest to GPS times."""
    return np.asarray((gps_ns - tow_ns + WEEK_NS // 2) // WEEK_NS)


def utc_ns(fields: NDArray[np.void]) -> Ints:
    """Return Unix nanoseconds of the fields year, month, day, hour, min, sec and nano;
    ``ABSENT_NS`` where they are no date.

    Nanoseconds are signed: seconds are rounded to the nearest one. Second 60 is the second after
    59.
    """
    year, month, day, hour, minute, second = (
        fields[name].astype(np.int64) for name in ("year", "month", "day", "hour", "min", "sec")
    )
    possible = (
        (year >= 1980) & (year < 2200) & (month >= 1) & (month <= 12) & (day >= 1) & (day <= 31)
    )
    possible &= (
        (hour < 24)
        & (minute < 60)
        & (second <= 60)
        & (np.abs(fields["nano"].astype(np.int64)) < SECOND_NS)
    )
    months = (np.where(possible, year - 1970, 0) * 12 + np.where(possible, month - 1, 0)).astype(
        "datetime64[M]"
    )
    first = months.astype("datetime64[D]").astype(np.int64)
    possible &= day <= (months + 1).astype("datetime64[D]").astype(np.int64) - first
    seconds = (((first + day - 1) * 24 + hour) * 60 + minute) * 60 + second
    return np.where(possible, seconds * SECOND_NS + fields["nano"], ABSENT_NS)
