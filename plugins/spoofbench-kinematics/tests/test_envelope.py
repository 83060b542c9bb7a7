"""The envelope alerts where a limit was exceeded for long enough, and only there."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from spoofbench_kinematics import Envelope
from spoofbench_kinematics.motion import held, reported_motion

from spoofbench.detector import Decisions, detect, warm_up_s
from spoofbench.recording import Recording
from spoofbench.table import Table
from spoofbench.testing import check_detector, drive

S = 1_000_000_000
START = 1_700_000_000 * S
KNOT, FOOT = 1852 / 3600, 0.3048
FL380 = 38_000 * FOOT


@check_detector("envelope", vehicle="airliner")
def test_the_airliner_keeps_the_contract(check: Callable[[], None]) -> None:
    check()


@check_detector("envelope", vehicle="car")
def test_the_car_keeps_the_contract(check: Callable[[], None]) -> None:
    check()


def flight(speed: np.ndarray, height_m: float = FL380, **columns: Any) -> Recording:
    """Rows at 1 Hz with speed and course, as ADS-B has them, on a straight track to the east."""
    n = speed.size
    metres = np.cumsum(np.append(0.0, (speed[1:] + speed[:-1]) / 2))
    pvt = {
        "lat_deg": np.zeros(n),
        "lon_deg": np.degrees(metres / (6_378_137 + height_m)),
        "height_m": np.full(n, height_m),
        "speed_mps": speed,
        "course_deg": np.full(n, 90.0),
        **columns,
    }
    given = {name: values for name, values in pvt.items() if values is not None}
    return Recording({"/adsb/gnss/pvt": Table("gnss/pvt", START + np.arange(n) * S, given)})


def decisions(recording: Recording, **parameters: Any) -> Decisions:
    return detect(Envelope(**parameters), recording)


def test_a_jet_that_crawls_at_altitude_alerts_when_it_has_lasted() -> None:
    speed = np.r_[np.full(60, 230.0), np.full(60, 60 * KNOT), np.full(60, 230.0)]
    alert = decisions(flight(speed)).alert
    assert np.flatnonzero(alert).tolist() == list(range(75, 120))


def test_on_the_ground_it_may_stand() -> None:
    made = decisions(flight(np.zeros(60), height_m=4411.0))
    assert made.available[15:].all()
    assert not made.alert.any()


def test_too_fast_alerts_low_and_passes_high() -> None:
    speed = np.full(60, 300.0)
    assert decisions(flight(speed, height_m=500.0)).alert[15:].all()
    assert not decisions(flight(speed)).alert.any()


def test_climb_counts_reported_or_differenced() -> None:
    n, rate = 60, 60.0
    speed = np.full(n, 230.0)
    reported = flight(speed, vel_d_mps=np.full(n, -rate))
    differenced = flight(speed, height_m=5000.0)
    heights = 5000.0 + rate * np.arange(n)
    table = differenced["/adsb/gnss/pvt"].replace(height_m=heights)
    differenced = differenced.replace({"/adsb/gnss/pvt": table})
    assert decisions(reported).alert.nonzero()[0].min() == 15
    assert decisions(differenced).alert.nonzero()[0].min() == 25
    assert not decisions(flight(speed, vel_d_mps=np.full(n, 45.0))).alert.any()


def test_a_car_whose_velocity_changes_at_once_alerts_at_once() -> None:
    speed = np.r_[np.full(30, 15.0), np.full(30, 3.0)]
    made = decisions(flight(speed, height_m=100.0), vehicle="car")
    assert np.flatnonzero(made.alert).tolist() == [30]
    assert made.score[30] == pytest.approx(12 / (0.9 * 9.80665))


def test_without_a_velocity_positions_are_differenced() -> None:
    speed = np.r_[np.full(60, 230.0), np.full(60, 60 * KNOT)]
    recording = flight(speed, speed_mps=None, course_deg=None)
    motion = reported_motion(recording["/adsb/gnss/pvt"], 10.0, 24.0)
    assert motion.speed_mps[10:60] == pytest.approx(230.0, rel=1e-3)
    assert motion.speed_mps[71:] == pytest.approx(60 * KNOT, rel=1e-3)
    assert np.isnan(motion.speed_mps[:10]).all()
    made = decisions(recording)
    assert made.alert[90:].all()
    assert not made.alert[:75].any()


def test_a_speed_without_a_course_is_a_speed() -> None:
    recording = flight(np.full(60, 60 * KNOT), course_deg=None)
    assert decisions(recording).alert[15:].all()


def test_an_airliner_without_height_is_not_judged_and_a_car_is() -> None:
    recording = flight(np.full(60, 50.0), height_m=1000.0)
    table = recording["/adsb/gnss/pvt"].replace(height_m=None)
    recording = recording.replace({"/adsb/gnss/pvt": table})
    assert not decisions(recording).available.any()
    assert decisions(recording, vehicle="car").available.all()


def test_an_ordinary_drive_stays_within_the_envelope_of_a_car() -> None:
    made = decisions(drive(4, 240.0), vehicle="car")
    assert made.available.mean() > 0.9
    assert not made.alert.any()


def test_a_long_gap_begins_anew() -> None:
    recording = flight(np.full(120, 60 * KNOT))
    times = recording["/adsb/gnss/pvt"].time_ns
    kept = (times < times[40]) | (times >= times[70])
    recording = recording.replace({"/adsb/gnss/pvt": recording["/adsb/gnss/pvt"].take(kept)})
    made = decisions(recording)
    assert made.available.tolist() == [False] * 15 + [True] * 25 + [False] * 15 + [True] * 35


RATIOS = st.lists(
    st.tuples(st.integers(1, 40), st.floats(0, 3) | st.just(np.nan)), min_size=1, max_size=60
)


@given(RATIOS, st.integers(0, 80), st.integers(10, 60))
def test_held_agrees_with_a_loop(rows: list[tuple[int, float]], hold: int, gap: int) -> None:
    tenths = np.cumsum([step for step, _ in rows])
    ratio = np.array([value for _, value in rows])
    got = held(ratio, tenths * (S // 10), hold / 10, gap / 10)
    for row in range(len(rows)):
        expected, later = np.nan, None
        lowest = np.inf
        for earlier in range(row, -1, -1):
            if np.isnan(ratio[row]):
                break
            if np.isnan(ratio[earlier]):
                continue
            if later is not None and later - tenths[earlier] > gap:
                break
            later, lowest = tenths[earlier], min(lowest, ratio[earlier])
            if tenths[row] - tenths[earlier] >= hold:
                expected = lowest
                break
        np.testing.assert_equal(got[row], expected)


def test_it_says_how_long_it_warms_up() -> None:
    assert warm_up_s(Envelope()) == 25.0
    assert warm_up_s(Envelope(vehicle="car", hold_s=3.0)) == 13.0


@pytest.mark.parametrize(
    "parameters",
    [
        {"vehicle": "boat"},
        {"hold_s": -1.0},
        {"hold_s": np.nan},
        {"baseline_s": 0.0},
        {"baseline_s": 25.0},
        {"longest_gap_s": np.inf},
    ],
    ids=str,
)
def test_refuses_what_makes_no_sense(parameters: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="must be"):
        Envelope(**parameters)
