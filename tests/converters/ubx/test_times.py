"""The time that an epoch claims: UTC, or week and time of week, or time of week, or none, as the
messages' flags say.
"""

from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spoofbench_converters.serial.contract import ABSENT_NS

from spoofbench.gnss_time import DAY_NS, LEAP_SECONDS, WEEK_NS, leap_seconds_at_gps

PVT = "/gnss0/gnss/pvt"
_ZERO = datetime(1980, 1, 6, tzinfo=UTC)
_ALL, _RESOLVED = 7, 4


def _ns(time: datetime) -> int:
    return round((time - datetime(1970, 1, 1, tzinfo=UTC)) / timedelta(seconds=1)) * 10**9


def _calendar(time: datetime) -> dict[str, int]:
    return {
        "year": time.year,
        "month": time.month,
        "day": time.day,
        "hour": time.hour,
        "min": time.minute,
        "sec": time.second,
    }


def _tow_ms(time: datetime, leap: int) -> int:
    return round((time + timedelta(seconds=leap) - _ZERO) / timedelta(milliseconds=1)) % (
        7 * 86_400_000
    )


times = st.integers(1_483_900_000, 4_070_000_000).map(
    lambda seconds: datetime.fromtimestamp(seconds, UTC)
)  # 2017 to 2098


@settings(max_examples=40)
@given(times, st.integers(-999_999_999, 999_999_999))
def test_utc_with_signed_nanoseconds(ubx: Any, time: datetime, nano: int) -> None:
    decoded = ubx.decode(
        [
            ubx.message(
                "NAV-PVT",
                iTOW=_tow_ms(time, 18),
                valid=_ALL,
                nano=nano,
                fixType=3,
                flags=1,
                **_calendar(time),
            )
        ]
    )
    assert decoded.claimed_ns[0] == _ns(time) + nano
    assert decoded.period_ns[0] == 0
    assert decoded.tables[PVT]["gps_week"][0] == (time + timedelta(seconds=18) - _ZERO).days // 7
    assert decoded.tables[PVT]["time_valid"][0]


@settings(max_examples=40)
@given(times)
def test_week_and_time_of_week(ubx: Any, time: datetime) -> None:
    week = (time + timedelta(seconds=18) - _ZERO).days // 7
    for leap, flags in (
        (18, 7),
        (99, 3),
    ):  # 99 is not valid: the leap seconds announced by then count
        decoded = ubx.decode(
            [
                ubx.message(
                    "NAV-TIMEGPS",
                    iTOW=_tow_ms(time, 18),
                    fTOW=-500,
                    week=week,
                    leapS=leap,
                    valid=flags,
                ),
                ubx.message("NAV-POSLLH", iTOW=_tow_ms(time, 18)),
            ]
        )
        assert decoded.claimed_ns[0] == _ns(time) - 500
        assert decoded.period_ns[0] == 0


def test_time_that_is_not_fully_resolved_is_told_by_the_time_of_week(ubx: Any) -> None:
    time = datetime(2024, 3, 1, 12, tzinfo=UTC)
    wrong = _calendar(time + timedelta(seconds=3))  # leap seconds not known yet
    decoded = ubx.decode(
        [ubx.message("NAV-PVT", iTOW=_tow_ms(time, 18), valid=_ALL - _RESOLVED, **wrong)]
    )
    assert decoded.claimed_ns[0] == _ns(time)
    assert not decoded.tables[PVT]["time_valid"][0]


def test_a_default_date_is_none(ubx: Any) -> None:
    decoded = ubx.decode([ubx.message("NAV-PVT", iTOW=5000, year=2015, month=10, day=18, valid=0)])
    assert decoded.claimed_ns[0] == ABSENT_NS
    assert not decoded.tables[PVT].has("gps_week")
    assert not decoded.tables[PVT]["time_valid"][0]


def test_a_date_that_is_none_is_not_believed(ubx: Any) -> None:
    decoded = ubx.decode(
        [ubx.message("NAV-PVT", iTOW=5000, year=2023, month=2, day=30, valid=_ALL)]
    )
    assert decoded.period_ns[0] == WEEK_NS


def test_time_of_day_without_a_date(ubx: Any) -> None:
    decoded = ubx.decode(
        [ubx.message("NAV-PVT", iTOW=5000, year=2015, month=10, day=18, hour=7, sec=1, valid=2)]
    )
    assert (decoded.claimed_ns[0], decoded.period_ns[0]) == ((7 * 3600 + 1) * 10**9, DAY_NS)


def test_time_of_week_alone(ubx: Any) -> None:
    decoded = ubx.decode([ubx.message("NAV-HPPOSLLH", iTOW=320_594_400)])
    assert decoded.period_ns[0] == WEEK_NS
    assert (
        decoded.claimed_ns[0] + LEAP_SECONDS * 10**9 - _ns(_ZERO)
    ) % WEEK_NS == 320_594_400 * 10**6


@pytest.mark.parametrize(("name", "flags"), [("NAV-STATUS", 0), ("NAV-SOL", 0)])
def test_a_time_of_week_that_is_not_valid_is_none(ubx: Any, name: str, flags: int) -> None:
    decoded = ubx.decode(
        [ubx.message("NAV-POSLLH", iTOW=5000), ubx.message(name, iTOW=5000, flags=flags)]
    )
    assert decoded.claimed_ns[0] == ABSENT_NS


def test_leap_seconds_told_once_hold_on(ubx: Any) -> None:
    frames = [ubx.message("NAV-TIMELS", iTOW=0, currLs=20, valid=1)]
    frames += [
        ubx.message("NAV-SOL", iTOW=1000 * second, week=2300, flags=12) for second in range(3)
    ]
    decoded = ubx.decode(frames)
    assert decoded.claimed_ns[2] == _ns(_ZERO) + 2300 * WEEK_NS + (2 - 20) * 10**9
    assert decoded.about["gnss0"]["leap_seconds"] == "20"


def test_raw_weeks_turn_with_the_solutions_week(ubx: Any) -> None:
    frames = [
        ubx.message("RXM-RAWX", [{"svId": 1}], rcvTow=604_799.995, week=2299, leapS=18, recStat=1),
        ubx.message("NAV-POSLLH", iTOW=0),
    ]
    decoded = ubx.decode(frames)
    assert decoded.claimed_ns.tolist() == [_ns(_ZERO) + 2300 * WEEK_NS - 18 * 10**9]


def test_announced_leap_seconds() -> None:
    for day, leap in (
        ("1980-01-07", 0),
        ("2005-12-31", 13),
        ("2006-01-02", 14),
        ("2026-01-01", 18),
    ):
        gps_ns = _ns(datetime.fromisoformat(day).replace(tzinfo=UTC)) - _ns(_ZERO)
        assert leap_seconds_at_gps(np.array([gps_ns])).tolist() == [leap]


def test_a_leap_second_is_the_second_before_midnight(ubx: Any) -> None:
    told = {"year": 2016, "month": 12, "day": 31, "hour": 23, "min": 59, "sec": 60, "valid": _ALL}
    decoded = ubx.decode([ubx.message("NAV-PVT", iTOW=17_000, **told)])
    assert decoded.claimed_ns[0] == _ns(datetime(2017, 1, 1, tzinfo=UTC))
