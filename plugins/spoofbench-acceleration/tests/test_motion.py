"""What GNSS and the IMU say of the motion, against literal loops, rotation matrices and a
circle.
"""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from spoofbench_acceleration import motion as m

from spoofbench.table import Table

G = 9.81


def test_first_difference_of_velocity() -> None:
    motion = m.motion_from_velocity(
        np.array([1.0, 0.5]), np.array([[0.0, 0, 0], [2, 0, 0], [2, 1, -1]])
    )
    np.testing.assert_array_equal(motion.acceleration_mps2, [[np.nan] * 3, [2, 0, 0], [0, 2, -2]])
    np.testing.assert_array_equal(motion.velocity_mps, [[np.nan] * 3, [1, 0, 0], [2, 0.5, -0.5]])


@given(
    st.lists(st.floats(0.05, 2.0), min_size=2, max_size=20), st.floats(-3, 3), st.floats(-20, 20)
)
def test_second_difference_of_position_is_exact_for_constant_acceleration(
    steps: list[float], a: float, v: float
) -> None:
    time_s = np.concatenate([[0.0], np.cumsum(steps)])
    position = np.outer(v * time_s + a * time_s**2 / 2, [1.0, 0.5, -0.2])
    motion = m.motion_from_position(np.diff(time_s), position)
    assert np.isnan(motion.acceleration_mps2[:2]).all()
    np.testing.assert_allclose(
        motion.acceleration_mps2[2:], np.tile([a, a / 2, -a / 5], (time_s.size - 2, 1)), atol=1e-9
    )


def test_the_second_difference_is_the_papers_on_even_intervals() -> None:
    position = np.random.default_rng(0).normal(0, 1, (20, 3))
    motion = m.motion_from_position(np.full(19, 0.1), position)
    for k in range(2, 20):
        np.testing.assert_allclose(
            motion.acceleration_mps2[k],
            (position[k] - 2 * position[k - 1] + position[k - 2]) / 0.01,
        )


@given(st.integers(0, 2**32 - 1), st.sampled_from(["forward", "up"]))
def test_specific_force_is_that_of_the_rotated_body(seed: int, axis: str) -> None:
    """Against scipy's rotations: NED turned by yaw, pitch, roll, as the paper's Eq (1) with R
    full.
    """
    rng = np.random.default_rng(seed)
    roll, pitch, heading = (
        rng.uniform(-1, 1, 30),
        rng.uniform(-1, 1, 30),
        rng.uniform(-np.pi, np.pi, 30),
    )
    acceleration = rng.normal(0, 3, (30, 3))
    motion = m.GnssMotion(np.zeros((30, 3)), acceleration)
    body = (
        Rotation.from_euler("ZYX", np.column_stack([heading, pitch, roll]))
        .inv()
        .apply(acceleration - [0, 0, G])
    )
    expected = body[:, 0] if axis == "forward" else -body[:, 2]
    np.testing.assert_allclose(
        m.specific_force(motion, (roll, pitch, heading), axis, G), expected, atol=1e-12
    )


def test_level_and_straight_the_vertical_axis_feels_gravity_and_the_up_acceleration() -> None:
    motion = m.GnssMotion(np.zeros((1, 3)), np.array([[1.0, 2.0, -0.5]]))
    level = (np.zeros(1), np.zeros(1), np.zeros(1))
    assert m.specific_force(motion, level, "up", G)[0] == pytest.approx(G + 0.5)


@given(st.floats(0, 2 * np.pi), st.sampled_from([-1.0, 1.0]))
def test_roll_of_a_coordinated_turn_in_every_heading(start: float, side: float) -> None:
    """100 m/s on a circle of 2 km: atan(v^2 / (r g)) = 27 deg, to the side of the turn, also when
    heading north.
    """
    rate, time_s = side * 100.0 / 2000, np.arange(200) * 0.1
    heading = start + rate * time_s
    velocity = 100 * np.column_stack([np.cos(heading), np.sin(heading), np.zeros(200)])
    motion = m.motion_from_velocity(np.diff(time_s), velocity)
    roll = m.roll_rad(motion, G, 1.0)
    np.testing.assert_allclose(roll[1:], side * math.atan(100**2 / 2000 / G), rtol=1e-4)
    np.testing.assert_allclose(
        m.specific_force(motion, (roll, np.zeros(200), heading), "up", G)[1:],
        math.hypot(5, G),
        rtol=1e-3,
    )


def test_pitch_and_heading_are_held_when_slow_and_unknown_before() -> None:
    velocity = np.array([[0.1, 0, 0], [10, 0, -1], [0.1, 0.1, 5], [np.nan] * 3, [0, 10, 0]])
    climb = math.atan(0.1)
    np.testing.assert_allclose(m.pitch_rad(velocity, 2.0), [np.nan, climb, climb, climb, 0])
    np.testing.assert_allclose(m.heading_rad(velocity, 2.0), [np.nan, 0, 0, 0, np.pi / 2])


def imu(time_s: Any, force: Any) -> Table:
    return Table(
        "imu", np.round(np.asarray(time_s) * 1e9).astype(np.int64), {"accel_z_mps2": force}
    )


def test_the_force_is_felt_along_the_axis_that_the_letters_name() -> None:
    time_s = np.arange(1, 41) * 0.1
    force = np.where(np.round(time_s, 3) <= 2.0, -9.0, -11.0)
    table, edges = imu(time_s, force), np.array([1, 2, 3]) * 1_000_000_000
    np.testing.assert_allclose(
        m.sensed_force(table, "frd", "up", edges), [np.nan, 9.0, 11.0], rtol=1e-12
    )
    np.testing.assert_allclose(
        m.sensed_force(table, "rdf", "forward", edges), [np.nan, -9.0, -11.0], rtol=1e-12
    )


def test_a_silent_imu_feels_nothing() -> None:
    time_s = np.concatenate([np.arange(1, 16) * 0.1, np.arange(19, 41) * 0.1])
    edges = np.array([1, 2, 3, 4]) * 1_000_000_000
    got = m.sensed_force(imu(time_s, np.ones(time_s.size)), "flu", "up", edges)
    np.testing.assert_allclose(got, [np.nan, np.nan, 1.0, 1.0], rtol=1e-12)
