"""GPS time, UTC and the calendar, in integer nanoseconds.

Unix time (``utc_ns``) counts from 1970-01-01 without leap seconds, GPS time (``gps_ns``) from
1980-01-06 with them (IS-GPS-200, section 3.3.4; leap seconds of IERS Bulletin C). Every function
takes and gives int64 arrays of one shape, or what broadcasts to one; scalars are arrays of shape
``()``.
"""

import numpy as np
from numpy.typing import ArrayLike

from spoofbench.arrays import Bools, Ints, Times

SECOND_NS = 1_000_000_000
DAY_NS = 86_400 * SECOND_NS
WEEK_NS = 7 * DAY_NS
ROLLOVER_NS = 1024 * WEEK_NS
"""The legacy navigation message counts weeks in ten bits."""
GPS_EPOCH_NS = 315_964_800 * SECOND_NS
"""1980-01-06 UTC, Unix nanoseconds."""
YEARS = range(1980, 2200)
"""Years that the calendar of a receiver may name."""

_STEPS_NS = np.array(  # days before which a second was inserted
    [
        "1981-07-01", "1982-07-01", "1983-07-01", "1985-07-01", "1988-01-01", "1990-01-01",
        "1991-01-01", "1992-07-01", "1993-07-01",
        "1994-07-01", "1996-01-01", "1997-07-01", "1999-01-01", "2006-01-01", "2009-01-01",
        "2012-07-01", "2015-07-01", "2017-01-01",
    ],
    "datetime64[ns]",
).astype(np.int64)  # fmt: skip
LEAP_SECONDS = int(_STEPS_NS.size)
"""GPS time minus UTC since the last announced leap second."""


def leap_seconds(utc_ns: ArrayLike) -> Ints:
    """Return announced GPS time minus UTC, in s, at Unix times."""
    return np.asarray(np.searchsorted(_STEPS_NS, np.asarray(utc_ns, np.int64), "right"), np.int64)


def leap_seconds_at_gps(gps_ns: ArrayLike) -> Ints:
    """Return announced GPS time minus UTC, in s, at GPS times."""
    steps = _STEPS_NS - GPS_EPOCH_NS + np.arange(1, _STEPS_NS.size + 1) * SECOND_NS
    return np.asarray(np.searchsorted(steps, np.asarray(gps_ns, np.int64), "right"), np.int64)


def gps_to_utc(gps_ns: ArrayLike, leap_s: ArrayLike | None = None) -> Times:
    """Return Unix time of GPS time.

    Args:
        gps_ns: nanoseconds since 1980-01-06.
        leap_s: GPS time minus UTC, in s; as announced for the time where it is None.
    """
    gps = np.asarray(gps_ns, np.int64)
    leap = leap_seconds_at_gps(gps) if leap_s is None else np.asarray(leap_s, np.int64)
    return np.asarray(gps + (GPS_EPOCH_NS - leap * SECOND_NS))


def utc_to_gps(utc_ns: ArrayLike, leap_s: ArrayLike | None = None) -> Times:
    """Return GPS time of Unix time.

    Args:
        utc_ns: nanoseconds since 1970-01-01. Unix time has no name for an inserted second: it
            repeats the second after it, for which ``leap_s`` is one less than announced.
        leap_s: GPS time minus UTC, in s; as announced for the time where it is None.
    """
    utc = np.asarray(utc_ns, np.int64)
    leap = leap_seconds(utc) if leap_s is None else np.asarray(leap_s, np.int64)
    return np.asarray(utc - (GPS_EPOCH_NS - leap * SECOND_NS))


def week_and_tow(gps_ns: ArrayLike) -> tuple[Ints, Times]:
    """Return the GPS week, counted without rollover, and the time of week in ns."""
    gps = np.asarray(gps_ns, np.int64)
    return np.asarray(gps // WEEK_NS), np.asarray(gps % WEEK_NS)


def gps_of_week(week: ArrayLike, tow_ns: ArrayLike) -> Times:
    """Return the GPS time of a week, counted without rollover, and a time of week in ns."""
    return np.asarray(np.asarray(week, np.int64) * WEEK_NS + np.asarray(tow_ns, np.int64))


def nearest_week(gps_ns: ArrayLike, tow_ns: ArrayLike) -> Ints:
    """Return the week in which a time of week lies nearest to a GPS time."""
    lead = np.asarray(gps_ns, np.int64) - np.asarray(tow_ns, np.int64)
    return np.asarray((lead + WEEK_NS // 2) // WEEK_NS)


def wrap_difference(difference_ns: ArrayLike, period_ns: ArrayLike) -> Ints:
    """Return differences of clocks that start over after a period, reduced by whole periods to
    ``[-period // 2, period - period // 2)``. Works in any unit.
    """
    period = np.asarray(period_ns, np.int64)
    half = period // 2
    return np.asarray((np.asarray(difference_ns, np.int64) + half) % period - half)


def midnight(
    year: ArrayLike, month: ArrayLike, day: ArrayLike, years: range = YEARS
) -> tuple[Times, Bools]:
    """Return the Unix time at which days of the Gregorian calendar begin, and which days exist.

    A day outside ``years`` counts as none; its time is 0.
    """
    year, month, day = (np.asarray(field, np.int64) for field in (year, month, day))
    exists = (year >= years.start) & (year < years.stop) & (month >= 1) & (month <= 12) & (day >= 1)
    months = np.where(exists, (year - 1970) * 12 + month - 1, 0).astype("datetime64[M]")
    first, after = (when.astype("datetime64[D]").astype(np.int64) for when in (months, months + 1))
    exists = np.asarray(exists & (day <= after - first))
    return np.where(exists, (first + day - 1) * DAY_NS, 0), exists


def calendar_to_utc(
    year: ArrayLike,
    month: ArrayLike,
    day: ArrayLike,
    hour: ArrayLike,
    minute: ArrayLike,
    second: ArrayLike,
    nanosecond: ArrayLike = 0,
) -> tuple[Times, Bools]:
    """Return the Unix time of calendar fields, and which of them are a date and a time.

    Second 60 is the second after 59. Nanoseconds may be negative, as where a receiver rounds its
    seconds to the nearest. The time is 0 where the fields are none.
    """
    date_ns, exists = midnight(year, month, day)
    hour, minute, second, nanosecond = (
        np.asarray(field, np.int64) for field in (hour, minute, second, nanosecond)
    )
    exists = np.asarray(
        exists
        & ((hour >= 0) & (hour < 24))
        & ((minute >= 0) & (minute < 60))
        & ((second >= 0) & (second <= 60))
        & (np.abs(nanosecond) < SECOND_NS)
    )
    of_day_ns = ((hour * 60 + minute) * 60 + second) * SECOND_NS + nanosecond
    return np.where(exists, date_ns + of_day_ns, 0), exists
