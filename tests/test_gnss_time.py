"""GPS time and UTC: known values, that the ways of asking agree, and the calendar of Python."""

import calendar
from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spoofbench.gnss_time import (
    DAY_NS,
    GPS_EPOCH_NS,
    LEAP_SECONDS,
    SECOND_NS,
    WEEK_NS,
    YEARS,
    calendar_to_utc,
    gps_of_week,
    gps_to_utc,
    leap_seconds,
    leap_seconds_at_gps,
    midnight,
    nearest_week,
    utc_to_gps,
    week_and_tow,
    wrap_difference,
)

UTC_NS = st.integers(GPS_EPOCH_NS, 2**62)


@pytest.mark.parametrize(
    ("day", "seconds"),
    [
        ("1980-01-06", 0),
        ("1981-06-30", 0),
        ("1981-07-01", 1),
        ("1999-08-22", 13),
        ("2005-12-31", 13),
        ("2016-12-31", 17),
        ("2017-01-01", 18),
    ],
)
def test_known_differences(day: str, seconds: int) -> None:
    assert leap_seconds(np.datetime64(day, "ns").astype(np.int64)) == seconds
    assert LEAP_SECONDS == 18


@given(UTC_NS)
def test_both_ways_agree(utc_ns: int) -> None:
    gps_ns = utc_ns - GPS_EPOCH_NS + int(leap_seconds(utc_ns)) * SECOND_NS
    assert leap_seconds_at_gps(gps_ns) == leap_seconds(utc_ns)
    assert utc_to_gps(utc_ns) == gps_ns
    assert gps_to_utc(gps_ns) == utc_ns


@given(UTC_NS, st.integers(-5, 60))
def test_given_leap_seconds_go_before_announced_ones(utc_ns: int, leap_s: int) -> None:
    assert gps_to_utc(utc_to_gps(utc_ns, leap_s), leap_s) == utc_ns
    assert utc_to_gps(utc_ns, leap_s) - utc_to_gps(utc_ns, 0) == leap_s * SECOND_NS


def test_an_inserted_second_takes_its_own_place_in_gps_time() -> None:
    after = np.datetime64("2017-01-01", "ns").astype(np.int64)
    half_past = after + SECOND_NS // 2  # Unix time of 23:59:60.5, and of 00:00:00.5
    assert utc_to_gps(half_past) - utc_to_gps(half_past, leap_seconds(half_past) - 1) == SECOND_NS


@given(st.integers(0, 2**62))
def test_week_and_time_of_week_are_the_gps_time(gps_ns: int) -> None:
    week, tow_ns = week_and_tow(gps_ns)
    assert 0 <= tow_ns < WEEK_NS
    assert gps_of_week(week, tow_ns) == gps_ns


def test_second_rollover() -> None:
    week, tow_ns = week_and_tow(utc_to_gps(np.datetime64("2019-04-06T23:59:42", "ns").astype(int)))
    assert (week, tow_ns) == (2048, 0)


@given(st.integers(0, 2**61), st.integers(0, WEEK_NS - 1))
def test_the_nearest_week_is_at_most_half_a_week_away(gps_ns: int, tow_ns: int) -> None:
    near = int(gps_of_week(nearest_week(gps_ns, tow_ns), tow_ns))
    assert abs(near - gps_ns) <= WEEK_NS // 2
    assert (near - tow_ns) % WEEK_NS == 0


@given(st.integers(-(2**61), 2**61), st.integers(1, WEEK_NS))
def test_wrapped_differences_are_short_and_whole_periods_away(step: int, period: int) -> None:
    wrapped = int(wrap_difference(step, period))
    assert -(period // 2) <= wrapped < period - period // 2
    assert (wrapped - step) % period == 0


@given(
    st.integers(1960, 2270),
    st.integers(-1, 14),
    st.integers(-1, 33),
    st.sampled_from([YEARS, range(1970, 2262)]),
)
def test_days_are_those_of_the_calendar(year: int, month: int, day: int, years: range) -> None:
    utc_ns, exists = midnight(year, month, day, years)
    known = year in years and 1 <= month <= 12 and 1 <= day <= calendar.monthrange(year, month)[1]
    assert exists == known
    expected = int(datetime(year, month, day, tzinfo=UTC).timestamp()) * SECOND_NS if known else 0
    assert utc_ns == expected


@given(st.integers(0, 25), st.integers(0, 61), st.integers(0, 61), st.integers(-(10**9), 10**9))
def test_times_of_day_are_sums(hour: int, minute: int, second: int, nano: int) -> None:
    utc_ns, exists = calendar_to_utc(2024, 2, 29, hour, minute, second, nano)
    assert exists == (hour < 24 and minute < 60 and second <= 60 and abs(nano) < 10**9)
    date_ns = int(midnight(2024, 2, 29)[0])
    expected = date_ns + (hour * 3600 + minute * 60 + second) * SECOND_NS + nano
    assert utc_ns == (expected if exists else 0)


def test_fields_may_be_arrays_of_small_integers() -> None:
    year, small = np.array([2023, 2024], np.uint16), np.array([28, 29], np.uint8)
    utc_ns, exists = calendar_to_utc(year, np.uint8(2), small, np.uint8(23), 59, 60)
    assert exists.tolist() == [True, True]
    assert utc_ns.tolist() == [int(midnight(y, 3, 1)[0]) for y in (2023, 2024)]
    assert midnight([2023, 2024], 2, 29)[1].tolist() == [False, True]
    assert DAY_NS * 7 == WEEK_NS
