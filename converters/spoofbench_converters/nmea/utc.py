"""UTC as sentences tell it, and GPS time from it."""

import numpy as np
from numpy.typing import NDArray

from spoofbench.gnss_time import DAY_NS, GPS_EPOCH_NS, SECOND_NS, WEEK_NS, leap_seconds
from spoofbench_converters.nmea.fields import Bools, Cells, Ints, decimals
from spoofbench_converters.serial.contract import ABSENT_NS

_PIVOT = 80  # two-digit years: 80 to 99 are 1980 to 1999, 00 to 79 are 2000 to 2079


def time_of_day(cells: Cells) -> tuple[Ints, Bools]:
    """Read ``hhmmss.sss`` as nanoseconds, ``ABSENT_NS`` where empty; and which fields are readable.

    A leap second, ``235960``, is 86,400 s; so is ``240000``.
    """
    read = decimals(cells)
    scale = 10 ** np.minimum(read.places, 9)
    whole = read.mantissa // scale
    hours, minutes, seconds = whole // 10_000, whole // 100 % 100, whole % 100
    fraction = read.mantissa % scale * (SECOND_NS // scale)
    midnight = (hours == 24) & (minutes == 0) & (seconds == 0)
    plausible = (
        ((hours < 24) | midnight)
        & (minutes < 60)
        & ((seconds < 60) | ((hours == 23) & (minutes == 59) & (seconds == 60)))
    )
    readable = read.readable & (
        ~read.present | (plausible & (read.mantissa >= 0) & (read.places <= 9))
    )
    value = ((hours * 60 + minutes) * 60 + seconds) * SECOND_NS + fraction
    return np.where(read.present & readable, value, ABSENT_NS), readable


def date(cells: Cells) -> tuple[Ints, Bools]:
    """Read ``ddmmyy`` as the Unix nanoseconds of its midnight, ``ABSENT_NS`` where empty; and which
    fields are readable.
    """
    read = decimals(cells)
    value, possible = day_of(
        read.mantissa // 10_000, read.mantissa // 100 % 100, read.mantissa % 100
    )
    readable = read.readable & (
        ~read.present | ((cells.length == 6) & (read.places == 0) & possible)
    )
    return np.where(read.present & readable, value, ABSENT_NS), readable


def day_of(day: Ints, month: Ints, year: Ints) -> tuple[Ints, Bools]:
    """Return the Unix nanoseconds of midnight, and which days are in the calendar; years below 100
    are 1980 to 2079.
    """
    year = np.where(year < 100, year + np.where(year >= _PIVOT, 1900, 2000), year)
    possible = (
        (day >= 1) & (day <= 31) & (month >= 1) & (month <= 12) & (year >= 1980) & (year < 2200)
    )
    months = (np.where(possible, year - 1970, 0) * 12 + np.where(possible, month - 1, 0)).astype(
        "datetime64[M]"
    )
    first = months.astype("datetime64[D]").astype(np.int64)
    possible &= day <= (months + 1).astype("datetime64[D]").astype(np.int64) - first
    return (first + np.where(possible, day - 1, 0)) * DAY_NS, possible


def gps_week_and_tow(utc_ns: Ints, leap: Bools) -> tuple[Ints, NDArray[np.float64]]:
    """Return the GPS week and the seconds into it of Unix times.

    ``leap`` says which times are within an inserted second, whose Unix time is that of the second
    after it.
    """
    elapsed = utc_ns - GPS_EPOCH_NS + (leap_seconds(utc_ns) - leap) * SECOND_NS
    return elapsed // WEEK_NS, (elapsed % WEEK_NS) / SECOND_NS


def nearest_turn(difference_ns: Ints) -> Ints:
    """Differences of times of day, brought to within half a day of zero."""
    return (difference_ns + DAY_NS // 2) % DAY_NS - DAY_NS // 2
