"""Velocity, acceleration and heading rate of a receiver."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from spoofbench_correlation import series

from spoofbench.table import Table

SECOND = 1_000_000_000


def epochs(north: list[float], east: list[float], **columns: object) -> Table:
    time_ns = np.arange(len(north)) * SECOND
    return Table(
        "gnss/pvt",
        time_ns,
        {"vel_n_mps": north, "vel_e_mps": east, "vel_d_mps": np.zeros(len(north)), **columns},
    )


@given(st.floats(-10, 10), st.floats(-3.1, 3.1), st.floats(1.1, 50))
def test_heading_rate_is_the_turn_over_the_interval(
    heading: float, turn: float, speed: float
) -> None:
    headings = [heading, heading + turn]
    velocity = series.receiver_velocity(
        epochs([speed * math.cos(a) for a in headings], [speed * math.sin(a) for a in headings])
    )
    assert series.heading_rate(velocity) == pytest.approx([turn], abs=1e-12)


def test_a_right_turn_through_south_is_positive() -> None:
    velocity = series.receiver_velocity(epochs([-10, -10], [1, -1]))
    assert series.heading_rate(velocity) == pytest.approx([2 * math.atan(0.1)])


def test_a_reversal_is_half_a_turn_to_the_right() -> None:
    assert series.heading_rate(series.receiver_velocity(epochs([5, -5], [0, 0]))) == pytest.approx(
        [math.pi]
    )


def test_no_heading_rate_where_either_end_is_slow() -> None:
    velocity = series.receiver_velocity(epochs([2, 0.5, 0, 3, 3], [0, 0.5, 2, 0, 3]))
    assert series.heading_rate(velocity) == pytest.approx([0, 0, -math.pi / 2, math.pi / 4])


def test_acceleration_is_the_difference_over_the_interval() -> None:
    table = epochs([0, 1, 5], [0, -2, -2])
    velocity = series.receiver_velocity(
        Table("gnss/pvt", np.array([0, SECOND, 3 * SECOND]), {name: table[name] for name in table})
    )
    assert series.acceleration(velocity).tolist() == [[1, 2], [-2, 0], [0, 0]]


def test_the_last_row_of_a_time_counts() -> None:
    table = Table(
        "gnss/pvt",
        np.array([0, 0, SECOND]),
        {"vel_n_mps": [1.0, 2, 3], "vel_e_mps": [0.0, 0, 0], "vel_d_mps": [0.0, 0, 0]},
    )
    assert series.receiver_velocity(table).time_ns.tolist() == [0, SECOND]
    assert series.receiver_velocity(table).ned_mps[0].tolist() == [2, 3]


def test_speed_and_course_stand_in_for_a_velocity() -> None:
    table = epochs([math.nan, 7], [math.nan, 0], speed_mps=[10, 10], course_deg=[90, 90])
    assert series.receiver_velocity(table).ned_mps == pytest.approx(
        np.array([[0, 7], [10, 0], [0, 0]]), abs=1e-12
    )


def test_no_velocity_without_a_fix() -> None:
    velocity = series.receiver_velocity(epochs([1, 2, 3], [0, 0, 0], fix_type=[4, 1, 6]))
    assert np.isnan(velocity.ned_mps[0]).tolist() == [False, True, True]
    assert np.isnan(series.heading_rate(velocity)).all()


def test_a_dead_reckoned_velocity_is_not_compared_with_what_it_comes_from() -> None:
    velocity = series.receiver_velocity(epochs([1, 2, 3], [0, 0, 0], fix_type=[4, 2, 5]))
    assert np.isnan(velocity.ned_mps[0]).tolist() == [False, True, False]
