"""Receivers that leave the course out when they are slow: an attacked row leaves it out by its new
speed.
"""

from functools import cache

import numpy as np
import pytest

from spoofbench.attacks import Attack, make_variant
from spoofbench.attacks.extrapolation import Extrapolate, ExtrapolateSmooth
from spoofbench.attacks.synthetic import DragOff, ZeroAcceleration
from spoofbench.recording import Interval, Recording
from spoofbench.table import Table
from spoofbench.testing import drive

PVT = "/gnss0/gnss/pvt"
SLOWEST_MPS = 1.0
MADE_UP: list[Attack] = [
    ZeroAcceleration(),
    ZeroAcceleration(0.5),
    DragOff(),
    DragOff(4.0),
    Extrapolate(),
    ExtrapolateSmooth(),
]


@cache
def _drive(velocity: bool) -> Recording:
    clean = drive(12, 400.0)
    table = clean[PVT]
    north, east = table["vel_n_mps"], table["vel_e_mps"]
    speed = np.round(np.hypot(north, east), 2)
    course = np.where(
        speed < SLOWEST_MPS, np.nan, np.round(np.degrees(np.arctan2(east, north)) % 360, 1) % 360
    )
    table = table.replace(speed_mps=speed, course_deg=course)
    return clean.replace(
        {PVT: table if velocity else table.replace(vel_n_mps=None, vel_e_mps=None)}
    )


def _windows(clean: Recording) -> list[Interval]:
    """Ten windows of 30 s, of which some begin at rest and some in motion."""
    starts_ns = clean.span.start_ns + np.arange(60, 360, 30) * 10**9
    return [Interval(start_ns, start_ns + 30 * 10**9) for start_ns in starts_ns.tolist()]


@pytest.mark.parametrize("velocity", [True, False], ids=["with velocity", "speed and course alone"])
@pytest.mark.parametrize("attack", MADE_UP, ids=repr)
def test_rows_below_the_receivers_limit_alone_lack_a_course(attack: Attack, velocity: bool) -> None:
    clean = _drive(velocity)
    blank_before = with_course_before = 0
    for window in _windows(clean):
        before, after = (
            r[PVT].between(window.start_ns, window.end_ns)
            for r in (clean, make_variant("any", attack, clean, window, 0))
        )
        known = after.valid("speed_mps")
        blank, speed = ~after.valid("course_deg")[known], after["speed_mps"][known]
        assert np.all(speed[blank] < SLOWEST_MPS + 0.05)
        assert np.all(speed[~blank] > SLOWEST_MPS - 0.05)
        blank_before += int((before.valid("speed_mps") & ~before.valid("course_deg")).sum())
        with_course_before += int(before.valid("course_deg").sum())
    assert min(blank_before, with_course_before) > 20


def test_a_few_exceptions_do_not_hide_the_limit() -> None:
    clean = _drive(True)
    table = clean[PVT]
    odd = np.random.default_rng(0).random(len(table)) < 0.01
    course = np.where(odd, np.where(table.valid("course_deg"), np.nan, 10.0), table["course_deg"])
    clean = clean.replace(
        {PVT: table.replace(course_deg=np.where(table.valid("speed_mps"), course, np.nan))}
    )
    for window in _windows(clean):
        after = make_variant("any", DragOff(4.0), clean, window, 0)[PVT].between(
            window.start_ns, window.end_ns
        )
        fast = after["speed_mps"] > SLOWEST_MPS + 0.5
        assert after.valid("course_deg")[fast].all()


def test_courses_missing_for_other_reasons_stay_missing() -> None:
    clean = _drive(True)
    table = clean[PVT]
    course = np.degrees(np.arctan2(table["vel_e_mps"], table["vel_n_mps"])) % 360
    lost = np.random.default_rng(0).random(len(table)) < 0.1
    clean = clean.replace({PVT: table.replace(course_deg=np.where(lost, np.nan, course))})
    for window in _windows(clean):
        variant = make_variant("any", DragOff(4.0), clean, window, 0)
        assert np.array_equal(variant[PVT].valid("course_deg"), clean[PVT].valid("course_deg"))


def _creeping(course_at_first: bool) -> Recording:
    """A car that goes north at 15 m/s, creeps at 0.5 m/s without a course from 30 to 90 s, and
    drives on; or creeps first.
    """
    time_s = np.arange(120.0)
    slow = (time_s >= 30) & (time_s < 90) if course_at_first else time_s < 90
    speed = np.where(slow, 0.5, 15.0)
    lat = 47.0 + np.cumsum(speed) / 111_177
    columns = {
        "lat_deg": lat,
        "lon_deg": np.full(120, 8.0),
        "height_m": np.zeros(120),
        "speed_mps": speed,
    }
    return Recording(
        {
            PVT: Table(
                "gnss/pvt",
                (time_s * 1e9).astype(np.int64),
                {**columns, "course_deg": np.where(slow, np.nan, 0.0)},
            )
        }
    )


@pytest.mark.parametrize("course_at_first", [True, False])
@pytest.mark.parametrize(
    ("direction_deg", "speed_mps", "course_deg"),
    [(0.0, 4.5, 0.0), (180.0, 3.5, 180.0), (90.0, np.hypot(4, 0.5), 83.0)],
)
def test_speed_moves_with_the_position_where_the_course_is_blank(
    course_at_first: bool, direction_deg: float, speed_mps: float, course_deg: float
) -> None:
    clean, window = _creeping(course_at_first), Interval(40 * 10**9, 70 * 10**9)
    attack = DragOff(4.0, ramp_s=0.0, direction_deg=direction_deg)
    made = make_variant("any", attack, clean, window, 0)[PVT].between(
        window.start_ns, window.end_ns
    )
    assert np.allclose(made["speed_mps"], speed_mps, atol=0.05)
    assert np.allclose((made["course_deg"] - course_deg + 180) % 360, 180, atol=0.5)
