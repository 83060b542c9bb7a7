"""What a receiver's rows say, whichever way it reports its velocity."""

from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from spoofbench.navigation.receiver import lacks_fix, velocity_ned
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
