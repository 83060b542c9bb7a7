"""Operating points of a folder: which material sets a threshold, that it is exact, and what curves
and transfer say of it.
"""

from collections.abc import Sequence
from math import floor, inf
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from spoofbench.arrays import Floats
from spoofbench.detector import Decisions
from spoofbench.scoring.metrics import count_episodes
from spoofbench.scoring.operating import TARGETS_PER_HOUR

S = 1_000_000_000
EPOCHS = 200
HOURS = EPOCHS / 3600
WHOLE: dict[str, Any] = {"calibration_start_ns": 0, "calibration_end_ns": EPOCHS * S}
NO_PART: dict[str, Any] = dict.fromkeys(WHOLE)

LEVELS = st.sampled_from([0.0, 0.3, 0.7, 1.0, 1.4, 2.0, 3.0])
SCORES = st.lists(st.tuples(st.integers(5, 40), LEVELS), min_size=5, max_size=12).map(
    lambda pieces: np.resize(np.repeat([b for _, b in pieces], [a for a, _ in pieces]), EPOCHS)
)
"""Stretches of equal score, one a second."""

TARGETS = st.sampled_from([1.0, 20.0, 60.0, 100.0, 200.0])

folders = settings(
    max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def decided(score: Floats, available: Any = None) -> Decisions:
    usable = np.ones(EPOCHS, bool) if available is None else available
    return Decisions(np.arange(EPOCHS) * S, score, usable)


def add(bench: Any, score: Floats, session: str, detector: str = "d", **about: Any) -> None:
    """Add an unattacked recording of a session, as in leave one session out."""
    known = {"recording": f"of-{session}", "session": session, "held_out": f'["{session}"]'}
    bench.add(detector, decisions=decided(score), **{**WHOLE, **known, **about})


def episodes(scores: Sequence[Floats], factor: float) -> int:
    time_ns, everywhere = np.arange(EPOCHS) * S, np.ones(EPOCHS, bool)
    return sum(count_episodes(time_ns, score > factor, everywhere, S) for score in scores)


def expected(scores: Sequence[Floats], target: float) -> tuple[float, str]:
    """The rule, candidate by candidate."""
    hours = len(scores) * HOURS
    candidates = sorted({value for score in scores for value in score.tolist() if value > 0})
    if not candidates:
        return 1.0, "no clean score"
    if target * hours < 1:
        return max(1.0, candidates[-1]), "raised only"
    allowed = floor(target * hours) - 1
    factor = candidates[-1]
    for candidate in reversed(candidates):
        if episodes(scores, candidate) > allowed:
            break
        factor = candidate
    return factor, "calibrated"


def calibrated(bench: Any, target: float) -> list[dict[str, Any]]:
    bench.suite["target_far_per_hour"] = target
    bench.score()
    rows: list[dict[str, Any]] = bench.rows("calibration")
    return rows


@folders
@given(st.lists(SCORES, min_size=2, max_size=5), TARGETS)
def test_each_session_is_judged_at_the_exact_threshold_of_the_others(
    bench: Any, tmp_path_factory: pytest.TempPathFactory, scores: list[Floats], target: float
) -> None:
    made = type(bench)(tmp_path_factory.mktemp("results"))
    for number, score in enumerate(scores):
        add(made, score, f"s{number}")
    rows = {row["held_out"]: row for row in calibrated(made, target)}
    assert len(rows) == len(scores)
    for number in range(len(scores)):
        others = [score for other, score in enumerate(scores) if other != number]
        row = rows[f'["s{number}"]']
        factor, how = expected(others, target)
        assert (row["factor"], row["how"]) == (factor, how)
        assert row["sessions"] == len(others)
        assert row["hours"] == pytest.approx(len(others) * HOURS)
        assert row["allowed"] == max(floor(target * len(others) * HOURS) - 1, 0)
        assert row["episodes"] == episodes(others, factor)
        if how == "calibrated":
            assert row["episodes"] <= row["allowed"]
            assert row["largest_expected_per_hour"] <= target * (1 + 1e-9)
        scored = next(
            row
            for row in made.rows("scores")
            if row["session"] == f"s{number}" and row["point"] == "calibrated"
        )
        assert scored["factor"] == factor
        assert scored["episodes"] == episodes([scores[number]], factor)


def steps(*heights: float) -> Floats:
    """An excursion of 1 s to each height, 20 s apart, over a floor of 0."""
    score = np.zeros(EPOCHS)
    score[10 : 10 + 20 * len(heights) : 20] = heights
    return score


@pytest.mark.parametrize(
    ("target", "allowed", "factor", "how"),
    [
        (0.9 / (2 * HOURS), 0, 5.0, "raised only"),
        (1.5 / (2 * HOURS), 0, 5.0, "calibrated"),
        (2.5 / (2 * HOURS), 1, 4.0, "calibrated"),
        (4.5 / (2 * HOURS), 3, 2.0, "calibrated"),
        (5.5 / (2 * HOURS), 4, 0.5, "calibrated"),
        (99 / (2 * HOURS), 98, 0.5, "calibrated"),
    ],
)
def test_one_episode_less_than_the_target_would_have_is_allowed(
    bench: Any, target: float, allowed: int, factor: float, how: str
) -> None:
    """K = floor(target x T) - 1 of the five excursions of two sessions remain, or fewer."""
    add(bench, steps(5.0, 2.0, 0.5), "one")
    add(bench, steps(4.0, 3.0), "two")
    add(bench, steps(9.0), "judged")
    row = next(row for row in calibrated(bench, target) if row["held_out"] == '["judged"]')
    assert (row["allowed"], row["factor"], row["how"]) == (allowed, factor, how)
    assert row["largest_expected_per_hour"] == pytest.approx((allowed + 1) / (2 * HOURS))


def test_where_the_target_cannot_be_resolved_thresholds_are_never_lowered(bench: Any) -> None:
    for detector, heights in (("low", (0.4, 0.2)), ("high", (3.0, 0.2)), ("silent", ())):
        for session in ("one", "two"):
            add(bench, steps(*heights), session, detector)
    rows = {row["detector"]: row for row in calibrated(bench, 1.0)}
    assert {name: (row["factor"], row["how"]) for name, row in rows.items()} == {
        "low": (1.0, "raised only"),
        "high": (3.0, "raised only"),
        "silent": (1.0, "no clean score"),
    }
    assert rows["low"]["largest_expected_per_hour"] == pytest.approx(1 / HOURS)


def test_an_infinite_clean_score_cannot_be_calibrated(bench: Any) -> None:
    add(bench, steps(inf), "one")
    add(bench, steps(2.0), "two")
    rows = {row["held_out"]: row for row in calibrated(bench, 100.0)}
    spoilt, good = rows['["two"]'], rows['["one"]']
    assert (spoilt["factor"], spoilt["how"], spoilt["episodes"]) == (None, "uncalibratable", None)
    assert good["how"] == "calibrated"
    points = {(row["session"], row["point"]) for row in bench.rows("scores")}
    assert points == {("one", "calibrated"), ("one", "published"), ("two", "published")}


def test_only_the_calibrating_part_of_the_same_class_counts(bench: Any) -> None:
    first: dict[str, Any] = {
        "calibration_end_ns": 100 * S,
        "judged_start_ns": 100 * S,
        "held_out": "[]",
    }
    early, late = np.zeros(EPOCHS), np.zeros(EPOCHS)
    early[20], late[150] = 2.0, 9.0
    add(bench, early + late, "one", **first)
    add(bench, steps(7.0), "other", **first, sensor_class="phone")
    rows = {row["sensor_class"]: row for row in calibrated(bench, 30.0)}
    assert (rows["car"]["factor"], rows["car"]["hours"]) == (2.0, pytest.approx(100 / 3600))
    assert rows["phone"]["factor"] == 7.0
    (row,) = (
        row
        for row in bench.rows("scores")
        if row["session"] == "one" and row["point"] == "calibrated"
    )
    assert (row["episodes"], row["available_clean_h"]) == (1, pytest.approx(100 / 3600))
    for row in bench.rows("curves"):
        if row["sensor_class"] == "car":
            judged = (row["episodes"], row["clean_h"])
            assert judged == (1, pytest.approx(100 / 3600)), "of the judged part alone"


def test_unavailable_time_is_no_time(bench: Any) -> None:
    available = np.arange(EPOCHS) >= 50
    about = {"session": "one", "recording": "one", **WHOLE}
    bench.add(
        "d", decisions=decided(np.where(available, steps(8.0, 8.0, 2.0), 9.0), available), **about
    )
    (row,) = calibrated(bench, 30.0)
    assert (row["factor"], row["hours"]) == (2.0, pytest.approx(150 / 3600))


def test_without_another_session_there_is_no_calibrated_point(bench: Any) -> None:
    add(bench, steps(2.0), "only")
    (row,) = calibrated(bench, 30.0)
    assert (row["how"], row["factor"], row["sessions"]) == ("no session", None, 0)
    assert {row["point"] for row in bench.rows("scores")} == {"published"}


def test_a_fitted_detector_takes_what_its_state_has_not_seen(bench: Any) -> None:
    """Its thresholds are from decisions that were made for the same sessions held out."""
    for held, height in (("one", 2.0), ("two", 3.0)):
        other = {"one": "two", "two": "one"}[held]
        about = {"held_out": f'["{held}"]', "fit_id": f"without-{held}"}
        add(bench, steps(height), other, **about, role="calibration")
        add(bench, steps(8.0), held, **about, calibration_start_ns=None, calibration_end_ns=None)
    rows = {row["held_out"]: row for row in calibrated(bench, 30.0)}
    assert {held: (row["factor"], row["fit_id"]) for held, row in rows.items()} == {
        '["one"]': (2.0, "without-one"),
        '["two"]': (3.0, "without-two"),
    }


def material(bench: Any, path: Path, scores: Sequence[Floats], about: dict[str, Any]) -> Any:
    """Sessions that calibrate and are judged, clean and under attack."""
    made = type(bench)(path)
    attacked = {**NO_PART, **about}
    for number, score in enumerate(scores):
        add(made, score, f"s{number}", **about)
        for attack, shift in (("weak", 0.5), ("strong", 2.0)):
            hit = score + shift * ((np.arange(EPOCHS) >= 120) & (np.arange(EPOCHS) < 150))
            made.add(
                "d",
                attack,
                decisions=decided(hit),
                recording=f"of-s{number}",
                session=f"s{number}",
                held_out=f'["s{number}"]',
                **attacked,
            )
    return made


@folders
@given(st.lists(SCORES, min_size=2, max_size=4), st.sampled_from(TARGETS_PER_HOUR.tolist()))
def test_at_the_target_the_curve_says_what_the_rows_say(
    bench: Any, tmp_path_factory: pytest.TempPathFactory, scores: list[Floats], target: float
) -> None:
    made = material(bench, tmp_path_factory.mktemp("results"), scores, {})
    calibrated(made, target)
    (point,) = (row for row in made.rows("curves") if row["target_per_hour"] == target)
    rows = [row for row in made.rows("scores") if row["point"] == "calibrated"]
    events = [row for row in made.rows("events") if row["point"] == "calibrated"]
    assert point["episodes"] == sum(row["episodes"] or 0 for row in rows)
    assert point["clean_h"] == pytest.approx(len(scores) * HOURS)
    assert point["attacks"] == len(events) == 2 * len(scores)
    assert point["detected"] == sum(event["detected"] for event in events)
    assert point["placebo_detected"] == sum(event["placebo_detected"] for event in events)
    share = np.mean([event["alerted_share"] for event in events])
    assert point["alerted_share"] == pytest.approx(share)


@folders
@given(st.lists(SCORES, min_size=2, max_size=4))
def test_along_the_curve_more_false_alerts_never_mean_fewer_alerts(
    bench: Any, tmp_path_factory: pytest.TempPathFactory, scores: list[Floats]
) -> None:
    made = material(bench, tmp_path_factory.mktemp("results"), scores, {})
    calibrated(made, 1.0)
    rows = made.rows("curves")
    assert [row["target_per_hour"] for row in rows] == TARGETS_PER_HOUR.tolist()
    shares = [row["alerted_share"] for row in rows]
    assert shares == sorted(shares)
    assert {row["clean_h"] for row in rows} == {rows[0]["clean_h"]}


@folders
@given(st.lists(SCORES, min_size=1, max_size=3), st.lists(SCORES, min_size=1, max_size=3), TARGETS)
def test_a_threshold_of_one_class_is_carried_to_another(
    bench: Any,
    tmp_path_factory: pytest.TempPathFactory,
    cars: list[Floats],
    phones: list[Floats],
    target: float,
) -> None:
    """From all sessions of the class, whatever is held out within the other."""
    made = material(bench, tmp_path_factory.mktemp("results"), phones, {"sensor_class": "phone"})
    for number, score in enumerate(cars):
        add(made, score, f"car{number}")
    calibrated(made, target)
    rows = {(row["fitted_on"], row["judged_on"]): row for row in made.rows("transfer")}
    assert rows.keys() == {("car", "phone"), ("phone", "car")}
    for (fitted_on, judged_on), row in rows.items():
        factor, _ = expected({"car": cars, "phone": phones}[fitted_on], target)
        judged = {"car": cars, "phone": phones}[judged_on]
        assert (row["detector"], row["factor"]) == ("d", factor)
        assert row["episodes"] == episodes(judged, factor)
        assert row["clean_h"] == pytest.approx(len(judged) * HOURS)
        assert row["attacks"] == (2 * len(phones) if judged_on == "phone" else 0)


def test_no_threshold_is_carried_from_a_session_that_is_judged(bench: Any) -> None:
    """One outing with two receivers: what was recorded then sets no threshold for itself."""
    add(bench, steps(2.0), "outing")
    add(bench, steps(9.0), "other")
    add(bench, steps(1.0), "outing", recording="phone", sensor_class="phone")
    calibrated(bench, 100.0)
    factors = {
        (row["fitted_on"], row["judged_on"]): row["factor"] for row in bench.rows("transfer")
    }
    assert factors == {("car", "phone"): expected([steps(9.0)], 100.0)[0]}


def test_nothing_is_carried_to_a_class_that_is_not_calibrated(bench: Any) -> None:
    add(bench, steps(2.0), "one")
    add(bench, steps(2.0), "two", sensor_class="phone", **NO_PART)
    calibrated(bench, 100.0)
    assert bench.rows("transfer") == []


def test_nothing_is_carried_within_a_class_or_from_what_cannot_be_calibrated(bench: Any) -> None:
    add(bench, steps(inf), "one")
    add(bench, steps(2.0), "two", sensor_class="phone")
    calibrated(bench, 100.0)
    found = [(row["fitted_on"], row["judged_on"]) for row in bench.rows("transfer")]
    assert found == [("phone", "car")]
