"""What a receiver reports, whichever way; radii, positions and gravity against pymap3d, a track
that is known, and printed values.
"""

from typing import Any

import numpy as np
import pymap3d
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymap3d import rcurve

from spoofbench.arrays import Floats
from spoofbench.navigation.gnss import (
    lacks_fix,
    local_position_ned,
    normal_gravity_mps2,
    radii_m,
    travelled_ned,
    velocity_ned,
)
from spoofbench.schema.v1 import gnss_pb2
from spoofbench.table import Column, Table


def pvt(rows: int, **columns: Any) -> Table:
    return Table("gnss/pvt", np.arange(rows, dtype=np.int64) * 1_000_000_000, columns)


@given(st.integers(0, 2**32 - 1))
def test_speed_and_course_are_as_good_as_components(seed: int) -> None:
    velocity = np.random.default_rng(seed).normal(0, 20, (8, 3))
    north, east, down = velocity.T
    polar = {
        "speed_mps": np.hypot(north, east),
        "course_deg": np.degrees(np.arctan2(east, north)) % 360,
    }
    whole = pvt(8, vel_n_mps=north, vel_e_mps=east, vel_d_mps=down)
    np.testing.assert_array_equal(velocity_ned(whole), velocity)
    found = velocity_ned(pvt(8, **polar))
    np.testing.assert_allclose(found[:, :2], velocity[:, :2], atol=1e-12)
    assert np.isnan(found[:, 2]).all()


def test_each_row_takes_what_it_has() -> None:
    nan = np.nan
    table = pvt(
        5,
        vel_n_mps=[3.0, 3, nan, nan, nan],
        vel_e_mps=[4.0, nan, 4, nan, nan],
        vel_d_mps=[1.0, 1, 1, 1, nan],
        speed_mps=[10.0, 10, 10, nan, 10],
        course_deg=[90.0, 90, 90, 90, nan],
    )
    expected = [[3, 4, 1], [0, 10, 1], [0, 10, 1], [nan, nan, 1], [nan, nan, nan]]
    np.testing.assert_allclose(velocity_ned(table), expected, atol=1e-12)


def test_components_go_before_a_course_that_contradicts_them() -> None:
    table = pvt(1, vel_n_mps=[3.0], vel_e_mps=[4.0], speed_mps=[10.0], course_deg=[200.0])
    np.testing.assert_array_equal(velocity_ned(table)[0, :2], [3.0, 4.0])


def test_a_course_that_is_given_goes_before_the_reported_one() -> None:
    table = pvt(2, speed_mps=[10.0, 10.0], course_deg=[0.0, np.nan])
    found = velocity_ned(table, np.array([90.0, 180.0]))
    np.testing.assert_allclose(found[:, :2], [[0, 10], [-10, 0]], atol=1e-12)


def test_a_course_that_is_none_gives_no_velocity() -> None:
    course = np.array([np.nan, np.inf, -np.inf, 1e300])
    assert np.isnan(velocity_ned(pvt(4, speed_mps=np.ones(4), course_deg=course))).all()


def test_a_receiver_without_any_velocity() -> None:
    assert np.isnan(velocity_ned(pvt(3, lat_deg=np.zeros(3)))).all()


def test_what_is_no_fix() -> None:
    kinds = dict(gnss_pb2.FixType.items())
    without = {"FIX_TYPE_NONE", "FIX_TYPE_DEAD_RECKONING", "FIX_TYPE_TIME_ONLY"}
    table = pvt(len(kinds), fix_type=np.array(list(kinds.values())))
    assert lacks_fix(table).tolist() == [name in without for name in kinds]
    unknown = Column(np.ones(2, np.uint8), np.array([True, False]))
    assert lacks_fix(pvt(2, fix_type=unknown)).tolist() == [True, False]
    assert not lacks_fix(pvt(3)).any()


@given(st.floats(-90, 90), st.floats(-100, 20_000))
def test_radii_are_pymap3ds(lat_deg: float, height_m: float) -> None:
    lat_rad = np.radians(lat_deg)
    expected = [f(lat_rad, deg=False) + height_m for f in (rcurve.meridian, rcurve.transverse)]
    assert radii_m(lat_rad, height_m) == pytest.approx(expected, rel=1e-14)


def _scattered() -> tuple[Floats, Floats, Floats]:
    """Fifty positions within some hundred metres, over the antimeridian."""
    rng = np.random.default_rng(1)
    lat, lon, height = (
        64 + rng.normal(0, 0.005, 50),
        -179.9999 + rng.normal(0, 0.01, 50),
        300 + rng.normal(0, 10, 50),
    )
    return lat, (lon + 180) % 360 - 180, height


def test_local_position_against_an_independent_library() -> None:
    lat, lon, height = _scattered()
    ours = local_position_ned(lat, lon, height)
    theirs = np.column_stack(pymap3d.geodetic2ned(lat, lon, height, lat[0], lon[0], height[0]))
    np.testing.assert_allclose(ours, theirs, atol=1.0)
    assert np.isnan(local_position_ned(*np.full((3, 4), np.nan))).all()


def test_both_ways_to_a_position_agree_nearby() -> None:
    positions = _scattered()
    np.testing.assert_allclose(travelled_ned(*positions), local_position_ned(*positions), atol=1.0)


def test_travelled_is_the_integral_of_velocity() -> None:
    """Over 50 km to the north-east, where one local frame would be tens of metres off, and over the
    antimeridian.
    """
    velocity, step_s, rows = np.array([40.0, 30.0, -0.1]), 1.0, 1000
    lat, lon, height = [np.radians(48.0)], [np.radians(179.8)], [100.0]
    for _ in range(rows - 1):
        up = height[-1] - velocity[2] * step_s / 2
        middle = lat[-1] + velocity[0] * step_s / 2 / (
            rcurve.meridian(lat[-1], deg=False) + height[-1]
        )
        normal = rcurve.transverse(middle, deg=False) + up
        lat.append(lat[-1] + velocity[0] * step_s / (rcurve.meridian(middle, deg=False) + up))
        lon.append(lon[-1] + velocity[1] * step_s / (normal * np.cos(middle)))
        height.append(height[-1] - velocity[2] * step_s)
    lon_deg = (np.degrees(lon) + 180) % 360 - 180
    assert lon_deg.min() < -179
    assert lon_deg.max() > 179
    np.testing.assert_allclose(
        travelled_ned(np.degrees(lat), lon_deg, np.array(height)),
        np.outer(np.arange(rows) * step_s, velocity),
        atol=1e-3,
    )


def test_unknown_positions_are_stepped_over() -> None:
    lat, lon, height = _scattered()
    lat[0], lon[7], height[9] = np.nan, np.nan, np.nan
    found = travelled_ned(lat, lon, height)
    np.testing.assert_array_equal(np.isnan(found[:, 0]), np.isnan(lat + lon))
    np.testing.assert_array_equal(np.isnan(found[:, 2]), np.isnan(height))
    assert found[1, :2].tolist() == [0, 0]
    assert found[0, 2] == 0


def test_normal_gravity() -> None:
    """WGS 84: 9.7803 at the equator, 9.8322 at the poles; 3.1 m/s^2 less per 1000 km."""
    assert normal_gravity_mps2(0.0, 0.0) == pytest.approx(9.7803253, abs=1e-6)
    assert normal_gravity_mps2(np.pi / 2, 0.0) == pytest.approx(9.8321849, abs=1e-6)
    change = normal_gravity_mps2(0.7, 1000.0) - normal_gravity_mps2(0.7, 0.0)
    assert change == pytest.approx(-3.086e-3)
