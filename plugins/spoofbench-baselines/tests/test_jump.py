"""The jump check measures the step that the velocity does not explain, in metres."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from spoofbench_baselines import Jump

from spoofbench.detector import Decisions, detect, is_baseline
from spoofbench.navigation.gnss import radii_m
from spoofbench.recording import Recording
from spoofbench.schema.v1 import gnss_pb2
from spoofbench.table import Table
from spoofbench.testing import check_detector

S = 1_000_000_000
START = 1_700_000_000 * S


@check_detector("jump")
def test_jump_keeps_the_contract(check: Callable[[], None]) -> None:
    check()


def track(
    time_s: np.ndarray,
    north_m: np.ndarray,
    east_m: np.ndarray,
    lat_deg: float = 48.0,
    lon_deg: float = 11.0,
    **columns: Any,
) -> Recording:
    """Positions along a short track, with the velocities that belong to it unless given."""
    meridian, normal = radii_m(np.radians(lat_deg), 0.0)
    east_rad = east_m / (normal * np.cos(np.radians(lat_deg)))
    pvt = {
        "lat_deg": lat_deg + np.degrees(north_m / meridian),
        "lon_deg": (lon_deg + np.degrees(east_rad) + 180) % 360 - 180,
        "vel_n_mps": np.gradient(north_m, time_s),
        "vel_e_mps": np.gradient(east_m, time_s),
        **columns,
    }
    time_ns = START + np.round(time_s * 1e9).astype(np.int64)
    return Recording({"/g/gnss/pvt": Table("gnss/pvt", time_ns, pvt)})


def decisions(recording: Recording, **parameters: float) -> Decisions:
    return detect(Jump(**parameters), recording)


@given(
    st.floats(-60, 60),
    st.floats(-60, 60),
    st.floats(-80, 80),
    st.sampled_from([0.0, 179.9999, -179.9999]),
    st.floats(0.1, 3),
)
def test_a_steady_motion_explains_itself_anywhere(
    north: float, east: float, lat: float, lon: float, step_s: float
) -> None:
    time_s = np.arange(20) * step_s
    made = decisions(track(time_s, north * time_s, east * time_s, lat, lon))
    assert made.available.tolist() == [False, *[True] * 19]
    assert made.score[1:].max() * 12.2 < 0.2


@given(st.integers(1, 18), st.floats(0.5, 1000), st.floats(0, 2 * np.pi), st.floats(1, 100))
def test_the_score_is_the_step_over_the_threshold(
    row: int, jump_m: float, direction: float, threshold_m: float
) -> None:
    time_s, zeros = np.arange(20.0), np.zeros(20)
    moved = np.where(time_s >= row, jump_m, 0.0)
    recording = track(
        time_s,
        moved * np.cos(direction),
        moved * np.sin(direction),
        vel_n_mps=zeros,
        vel_e_mps=zeros,
    )
    score = decisions(recording, threshold_m=threshold_m).score[1:]
    np.testing.assert_allclose(
        score * threshold_m, np.where(time_s[1:] == row, jump_m, 0.0), rtol=1e-3, atol=1e-3
    )


def test_a_steady_acceleration_is_no_jump() -> None:
    time_s = np.arange(10.0)
    recording = track(time_s, 2 * time_s**2, 0 * time_s, vel_n_mps=4 * time_s)
    assert decisions(recording).score[1:].max() * 12.2 < 0.05


def test_speed_and_course_serve_as_well() -> None:
    time_s = np.arange(10.0)
    moving = track(time_s, 10 * time_s, 10 * time_s)
    table = moving["/g/gnss/pvt"].replace(
        vel_n_mps=None,
        vel_e_mps=None,
        speed_mps=np.full(10, np.hypot(10, 10)),
        course_deg=[45] * 10,
    )
    made = decisions(moving.replace({"/g/gnss/pvt": table}))
    assert made.available[1:].all()
    assert made.score[1:].max() * 12.2 < 0.01


def test_a_gap_is_not_judged_and_a_short_one_is() -> None:
    time_s = np.array([0.0, 1, 2, 5, 6, 9.5, 10])
    made = decisions(track(time_s, 0 * time_s, 0 * time_s))
    assert made.available.tolist() == [False, True, True, True, True, False, True]


@pytest.mark.parametrize(
    "lacking",
    [
        {"vel_e_mps": np.nan},
        {"lat_deg": np.nan},
        {"lat_deg": np.inf},
        {"lon_deg": 1e300},
        {"vel_n_mps": np.inf},
        {"fix_type": gnss_pb2.FIX_TYPE_DEAD_RECKONING},
    ],
    ids=str,
)
def test_a_row_that_lacks_something_is_stepped_over(lacking: dict[str, float]) -> None:
    time_s = np.arange(6.0)
    fixes = {"fix_type": np.full(6, gnss_pb2.FIX_TYPE_3D)}
    table = track(time_s, 5 * time_s, 0 * time_s, **fixes)["/g/gnss/pvt"]
    ((name, value),) = lacking.items()
    changed = table[name].copy()
    changed[2] = value
    made = decisions(Recording({"/g/gnss/pvt": table.replace(**{name: changed})}))
    assert made.available.tolist() == [False, True, False, True, True, True]
    assert made.score[made.available].max() < 0.01


def test_it_says_that_it_is_a_baseline() -> None:
    assert is_baseline(Jump())


@pytest.mark.parametrize("name", ["threshold_m", "longest_gap_s"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_refuses_what_is_no_limit(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        Jump(**{name: value})
