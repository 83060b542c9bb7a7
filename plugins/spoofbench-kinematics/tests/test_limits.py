"""The envelopes have the figures of their sources."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from spoofbench_kinematics.limits import (
    LIMITS,
    airliner_speed_excess,
    airspeed_limits_mps,
    standard_atmosphere,
    standard_wind_mps,
)

KNOT, FOOT = 1852 / 3600, 0.3048


@pytest.mark.parametrize(
    ("height_m", "temperature_k", "pressure_pa"),
    [
        (0, 288.15, 101_325),
        (5000, 255.65, 54_020),
        (11_000, 216.65, 22_632),
        (15_000, 216.65, 12_045),
        (20_000, 216.65, 5_475),
    ],
)
def test_the_atmosphere_is_the_standard_one(
    height_m: float, temperature_k: float, pressure_pa: float
) -> None:
    """ICAO Doc 7488, by geopotential height."""
    temperature, pressure = standard_atmosphere(np.array([height_m], float))
    assert temperature == pytest.approx([temperature_k])
    assert pressure == pytest.approx([pressure_pa], rel=1e-4)


def test_the_figures_of_the_readme() -> None:
    height = np.array([38_000.0]) * FOOT
    fastest, slowest = airspeed_limits_mps(height)
    wind = standard_wind_mps(height)
    assert (slowest / KNOT).round().tolist() == [223]
    assert (slowest / 1.3 / KNOT).round().tolist() == [171]
    assert (wind / KNOT).round().tolist() == [123]
    assert ((slowest - wind) / KNOT).round().tolist() == [100]
    assert ((fastest + wind) / KNOT).round().tolist() == [651]


def test_at_sea_level_the_operating_limit_is_true_airspeed() -> None:
    fastest, _ = airspeed_limits_mps(np.array([0.0]))
    assert fastest == pytest.approx([365 * KNOT])


@given(st.floats(0, 13_000), st.floats(0, 1))
def test_what_lies_between_the_limits_takes_no_wind(height_m: float, share: float) -> None:
    height = np.array([height_m])
    fastest, slowest = airspeed_limits_mps(height)
    assert slowest < fastest
    assert airliner_speed_excess(slowest + share * (fastest - slowest), height) == 0


@given(st.floats(0, 13_000), st.floats(0.1, 3))
def test_what_lies_beyond_takes_that_share_of_the_standard_wind(
    height_m: float, share: float
) -> None:
    height = np.array([height_m])
    fastest, slowest = airspeed_limits_mps(height)
    wind = standard_wind_mps(height)
    assert airliner_speed_excess(fastest + share * wind, height) == pytest.approx(share)
    is_clean = height_m > 20_000 * FOOT
    assert airliner_speed_excess(slowest - share * wind, height) == pytest.approx(
        share if is_clean else 0
    )


@given(st.floats(6_200, 13_000), st.floats(-600, 600), st.floats(0, 60))
def test_pressure_altitude_or_height_hardly_matters(
    height_m: float, difference_m: float, speed_mps: float
) -> None:
    """Not by a tenth of the standard wind."""
    heights = np.array([height_m, max(height_m + difference_m, 6_200)])
    one, other = airliner_speed_excess(np.full(2, speed_mps), heights)
    assert abs(one - other) < 0.1


def test_unknown_stays_unknown() -> None:
    nan = np.array([np.nan])
    assert np.isnan(airliner_speed_excess(nan, np.array([9000.0]))).all()
    assert np.isnan(airliner_speed_excess(np.array([100.0]), nan)).all()
    assert np.isnan(LIMITS["car"].speed_excess(nan, nan)).all()
