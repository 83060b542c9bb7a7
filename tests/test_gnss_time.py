"""GPS time and UTC: known differences, and that the two ways of asking agree."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spoofbench.gnss_time import (
    GPS_EPOCH_NS,
    LEAP_SECONDS,
    SECOND_NS,
    leap_seconds,
    leap_seconds_at_gps,
)


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


@given(st.integers(GPS_EPOCH_NS, 2**62))
def test_both_ways_agree(utc_ns: int) -> None:
    gps_ns = utc_ns - GPS_EPOCH_NS + int(leap_seconds(utc_ns)) * SECOND_NS
    assert leap_seconds_at_gps(gps_ns) == leap_seconds(utc_ns)
