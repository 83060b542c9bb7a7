"""Geodetic coordinates and rates: the way there and back, and what belongs together."""

import numpy as np
import pymap3d
from hypothesis import given
from hypothesis import strategies as st

from spoofbench.attacks.pvt import (
    GeodeticMotion,
    epochs_s,
    interval_s,
    metres_per_unit,
    motion_of,
    with_motion,
)
from spoofbench.table import Table
from spoofbench.testing import drive


def _pvt(seed: int = 0) -> Table:
    return drive(seed, 120.0, flaws=False)["/gnss0/gnss/pvt"]


def test_a_rows_own_motion_changes_nothing() -> None:
    table = _pvt()
    assert with_motion(table, motion_of(table)) == table


@given(north=st.floats(-2000, 2000), east=st.floats(-2000, 2000), up=st.floats(-100, 100))
def test_metres_are_those_of_the_ellipsoid(north: float, east: float, up: float) -> None:
    table = _pvt()
    motion = motion_of(table)
    scale = metres_per_unit(motion.position)
    moved = with_motion(
        table, GeodeticMotion(motion.position + np.array([north, east, -up]) / scale, motion.rate)
    )
    before, after = ((t["lat_deg"], t["lon_deg"], t["height_m"]) for t in (table, moved))
    ned = np.column_stack(pymap3d.geodetic2ned(*after, *before))
    # the tangent plane leaves the ellipsoid by d^2 / 2R and its north turns with longitude
    distance = np.hypot(north, east)
    tolerance = 1e-3 + 2e-6 * distance + distance**2 / 6e6
    assert np.abs(ned - [north, east, -up]).max() <= tolerance + abs(up) * 1e-3


def test_position_and_rate_agree_on_a_true_drive() -> None:
    table = drive(1, 120.0, 10.0, flaws=False)["/gnss0/gnss/pvt"]
    motion, epoch = motion_of(table), epochs_s(table)
    n = epoch.size
    travelled = (
        (motion.rate[1:] + motion.rate[:-1]).sum(axis=0) / 2 * (epoch[-1] - epoch[0]) / (n - 1)
    )
    scale = metres_per_unit(motion.position)[0]
    error = (motion.position[-1] - motion.position[0] - travelled) * scale
    length = np.abs((motion.position[-1] - motion.position[0]) * scale).sum()
    assert np.abs(error).max() < 5.0 + 1e-3 * length


def test_speed_and_course_stand_in_for_velocity() -> None:
    table = _pvt()
    north, east = table["vel_n_mps"], table["vel_e_mps"]
    course = np.degrees(np.arctan2(east, north)) % 360
    level = table.replace(
        speed_mps=np.hypot(north, east), course_deg=course, vel_n_mps=None, vel_e_mps=None
    )
    assert np.allclose(motion_of(level).rate, motion_of(table).rate, rtol=1e-12, atol=1e-15)
    motion = motion_of(level)
    turned = with_motion(level, GeodeticMotion(motion.position, motion.rate * [-1, -1, 1]))
    assert "vel_n_mps" not in turned
    fast = level["speed_mps"] > 1
    assert np.allclose((turned["course_deg"] - course)[fast] % 360, 180)


def test_a_receiver_without_course_stands_still_or_holds_it() -> None:
    n = np.arange(5)
    table = Table(
        "gnss/pvt",
        n * 10**9,
        {
            "speed_mps": np.array([0, 2.0, 2.0, 2.0, 0]),
            "course_deg": np.array([np.nan, np.nan, 90.0, np.nan, np.nan]),
        },
    )
    rate = motion_of(table).rate[:, :2] * metres_per_unit(motion_of(table).position)[:, :2]
    assert np.allclose(rate, [[0, 0], [0, 2], [0, 2], [0, 2], [0, 0]])
    never = motion_of(table.replace(course_deg=None)).rate[:, :2]
    assert np.isnan(never[1:4]).all()
    assert np.all(never[[0, 4]] == 0)


def test_heights_move_together_and_velocity_fields_agree() -> None:
    table = _pvt()
    table = table.replace(
        height_msl_m=table["height_m"] - 47.0,
        speed_mps=np.hypot(table["vel_n_mps"], table["vel_e_mps"]),
        course_deg=np.degrees(np.arctan2(table["vel_e_mps"], table["vel_n_mps"])) % 360,
    )
    motion = motion_of(table)
    moved = with_motion(
        table,
        GeodeticMotion(
            motion.position + np.array([0, 0, 3.0]),
            motion.rate + np.array([2.0, -1.0, 0.5]) / metres_per_unit(motion.position),
        ),
    )
    assert np.allclose(moved["height_msl_m"], moved["height_m"] - 47.0)
    assert np.allclose(moved["height_m"] - table["height_m"], 3.0)
    assert np.allclose(moved["speed_mps"], np.hypot(moved["vel_n_mps"], moved["vel_e_mps"]))
    assert np.allclose(
        moved["speed_mps"] * np.sin(np.radians(moved["course_deg"])), moved["vel_e_mps"], atol=1e-9
    )


def test_longitude_goes_round() -> None:
    n = 40
    longitude = (179.99 + 0.001 * np.arange(n) + 180) % 360 - 180
    table = Table(
        "gnss/pvt",
        np.arange(n) * 10**9,
        {"lat_deg": np.full(n, 10.0), "lon_deg": longitude, "height_m": np.zeros(n)},
    )
    motion = motion_of(table)
    assert np.allclose(np.diff(motion.position[:, 1]), np.radians(0.001))
    moved = with_motion(
        table, GeodeticMotion(motion.position + np.array([0, np.radians(0.005), 0]), motion.rate)
    )
    assert np.all(np.abs(moved["lon_deg"]) <= 180)
    assert np.allclose((moved["lon_deg"] - longitude) % 360, 0.005)


@given(seed=st.integers(0, 10_000), rate_hz=st.sampled_from([1.0, 5.0, 10.0]))
def test_jitter_leaves_the_epochs(seed: int, rate_hz: float) -> None:
    rng = np.random.default_rng(seed)
    kept = np.flatnonzero(rng.random(200) > 0.1)
    stamps = kept / rate_hz + rng.uniform(-0.05, 0.05, kept.size) / rate_hz
    table = Table("gnss/pvt", np.round(stamps * 1e9).astype(np.int64), {})
    epochs = epochs_s(table)
    assert np.allclose(np.diff(epochs), np.diff(kept) / rate_hz, rtol=2e-3)
    assert abs(interval_s(table) - 1 / rate_hz) < 0.05 / rate_hz
