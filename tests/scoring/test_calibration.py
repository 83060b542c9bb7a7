"""Thresholds: exact where a count at every candidate is affordable, and they hold on new data."""

from collections.abc import Sequence
from math import floor, inf, isinf, nan
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from spoofbench.arrays import Bools, Floats, Times
from spoofbench.detector import Decisions
from spoofbench.recording import Interval, Recording
from spoofbench.scoring.calibration import (
    NO_CLEAN_TIME,
    EpisodeCurve,
    Threshold,
    detection_times_s,
    episode_curve,
    leave_one_out,
    threshold,
    total,
)
from spoofbench.scoring.grid import build_truth, score_on_grid
from spoofbench.scoring.metrics import alarm_level, count_episodes, find_events
from spoofbench.scoring.score import score_decisions
from spoofbench.scoring.statistics import poisson_rate
from spoofbench.table import Table

S = 1_000_000_000
SCORES = st.sampled_from([-1.0, 0.0, 0.2, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, nan])


class Clean(NamedTuple):
    """One clean task."""

    time_ns: Times
    level: Floats
    counted: Bools
    epoch_ns: int

    def curve(self) -> EpisodeCurve:
        return episode_curve(*self)

    def episodes_above(self, factor: float) -> int:
        return count_episodes(self.time_ns, self.level > factor, self.counted, self.epoch_ns)


@st.composite
def cleans(draw: st.DrawFn, scores: st.SearchStrategy[float] = SCORES) -> Clean:
    """Stretches of equal level, with gaps between some."""
    pieces = draw(st.lists(st.tuples(st.integers(1, 15), scores, st.booleans()), max_size=25))
    epoch_ns = draw(st.sampled_from([S // 5, S, 4 * S, 9 * S, 30 * S]))
    level = np.array([value for length, value, _ in pieces for _ in range(length)], np.float64)
    counted = np.array([known for length, _, known in pieces for _ in range(length)], bool)
    jitter = draw(st.integers(0, 99))
    steps = np.random.default_rng(jitter).integers(epoch_ns // 2, 3 * epoch_ns // 2, level.size)
    return Clean(np.cumsum(steps), level, counted & ~np.isnan(level), epoch_ns)


def candidates(tasks: Sequence[Clean]) -> list[float]:
    scores = {value for task in tasks for value in task.level[task.counted].tolist()}
    return sorted(value for value in scores if 0 < value < inf)


@given(cleans(SCORES | st.just(inf) | st.floats(0, 5)))
def test_a_curve_is_the_count_at_every_factor(clean: Clean) -> None:
    curve = clean.curve()
    factors = candidates([clean])
    for factor in [1e-9, *factors, *(factor * (1 + 1e-9) for factor in factors), 1e9]:
        assert curve.episodes_at(factor) == clean.episodes_above(factor)
    largest = clean.level[clean.counted].max(initial=0.0)
    assert curve.infinite == isinf(largest)
    assert largest == (curve.levels[0] if curve.levels.size else 0)
    assert (np.diff(curve.levels) < 0).all()
    assert curve.levels.size < 2 or curve.levels[-1] == ([*factors, inf])[0]


@given(st.lists(cleans(), max_size=5))
def test_leaving_one_out_is_summing_the_others(tasks: list[Clean]) -> None:
    curves = [task.curve() for task in tasks]
    for factor in [0.1, *candidates(tasks)]:
        assert total(curves).episodes_at(factor) == sum(
            task.episodes_above(factor) for task in tasks
        )
    for left_out, rest in enumerate(leave_one_out(curves)):
        direct = total(curve for index, curve in enumerate(curves) if index != left_out)
        assert rest.clean_ns == direct.clean_ns
        assert rest.levels.tolist() == direct.levels.tolist()
        assert rest.episodes.tolist() == direct.episodes.tolist()
    assert len(leave_one_out(curves)) == len(curves)


def by_counting(tasks: Sequence[Clean], target: float, hours: float) -> Threshold:
    """The rule, by counting at each candidate from the largest down."""
    scores = candidates(tasks)
    if any(np.isinf(task.level[task.counted]).any() for task in tasks):
        allowed = max(floor(target * hours) - 1, 0)
        return Threshold(None, "uncalibratable", hours, allowed, None, None)
    if not scores or target * hours < 1:
        factor = max([1.0, *scores])
        expected = 1 / hours if hours else None
        allowed = max(floor(target * hours) - 1, 0)
        if scores:
            return Threshold(factor, "raised only", hours, allowed, 0, expected)
        expected = (allowed + 1) / hours if hours else None
        return Threshold(factor, "no clean score", hours, allowed, 0, expected)
    allowed = floor(target * hours) - 1
    kept = inf
    for factor in reversed(scores):
        if sum(task.episodes_above(factor) for task in tasks) > allowed:
            break
        kept = factor
    remaining = sum(task.episodes_above(kept) for task in tasks)
    return Threshold(kept, "calibrated", hours, allowed, remaining, (allowed + 1) / hours)


@given(
    st.lists(cleans(), max_size=4) | st.lists(cleans(SCORES | st.just(inf)), max_size=2),
    st.sampled_from([0.1, 1.0, 10, 30, 60, 120, 300, 1000, 4000]),
)
def test_a_threshold_is_that_of_counting_at_each_candidate(
    tasks: list[Clean], target: float
) -> None:
    curve = total(task.curve() for task in tasks)
    found = threshold(curve, target)
    assert found == by_counting(tasks, target, curve.hours)
    if found.how == "calibrated":
        assert found.factor in candidates(tasks)
        assert found.episodes is not None
        assert found.episodes <= found.allowed
        assert found.largest_expected_per_hour is not None
        assert found.largest_expected_per_hour <= target * (1 + 1e-12)


@given(st.lists(cleans(SCORES), min_size=1, max_size=4), st.floats(1e-3, 1e3))
def test_scaling_all_scores_changes_no_alert_at_the_calibrated_point(
    tasks: list[Clean], scale: float
) -> None:
    curve = total(task.curve() for task in tasks)
    target = 40.0
    one = threshold(curve, target)
    assume(one.how == "calibrated")
    scaled = [task._replace(level=task.level * scale) for task in tasks]
    other = threshold(total(task.curve() for task in scaled), target)
    assert one.factor is not None
    assert other.factor is not None
    assert (other.how, other.episodes, other.hours) == (one.how, one.episodes, one.hours)
    for before, after in zip(tasks, scaled, strict=True):
        assert ((before.level > one.factor) == (after.level > other.factor)).all()


@given(cleans())
def test_factors_never_fall_as_the_target_does(clean: Clean) -> None:
    points = [threshold(clean.curve(), target) for target in (1000, 300, 100, 30, 10, 3, 1, 0.1)]
    factors = [point.factor for point in points if point.factor is not None]
    assert factors == sorted(factors)
    allowed = [point.allowed_per_hour for point in points if point.allowed_per_hour is not None]
    assert allowed == sorted(allowed, reverse=True)


def clean_of(peaks: dict[int, float], hours: float = 1.0) -> Clean:
    """A quiet recording at 1 Hz, of level -1, with these levels at some seconds."""
    level = np.full(round(hours * 3600), -1.0)
    level[list(peaks)] = list(peaks.values())
    return Clean(np.arange(level.size) * S, level, np.ones(level.size, bool), S)


def test_where_episodes_merge_the_larger_factor_is_taken() -> None:
    """Peaks 16 s apart and a lower one between them: 2 episodes above 4, 1 above 3. One is allowed:
    a sweep from below would stop at 3, at which half of the rise to 5 counts twice.
    """
    clean = clean_of({100: 5.0, 108: 4.0, 116: 5.0, 900: 2.0})
    assert [clean.curve().episodes_at(factor) for factor in (5, 4.5, 3, 1)] == [0, 2, 1, 2]
    assert threshold(clean.curve(), 2.0) == Threshold(5.0, "calibrated", 1.0, 1, 0, 2.0)
    assert threshold(clean.curve(), 3.0) == Threshold(2.0, "calibrated", 1.0, 2, 1, 3.0)


def test_all_ways_to_a_factor() -> None:
    quiet, peak = clean_of({}).curve(), clean_of({5: 0.3}).curve()
    assert threshold(quiet, 2.0) == Threshold(1.0, "no clean score", 1.0, 1, 0, 2.0)
    assert threshold(peak, 1.0) == Threshold(0.3, "calibrated", 1.0, 0, 0, 1.0)
    assert threshold(peak, 0.9) == Threshold(1.0, "raised only", 1.0, 0, 0, 1.0)
    assert threshold(clean_of({5: 7.0}, 0.5).curve(), 1.0) == Threshold(
        7.0, "raised only", 0.5, 0, 0, 2.0
    )
    endless = clean_of({5: inf}).curve()
    assert threshold(endless, 9.0) == Threshold(None, "uncalibratable", 1.0, 8, None, None)
    assert endless.episodes_at(1e300) == 1
    assert threshold(NO_CLEAN_TIME, 1.0) == Threshold(1.0, "no clean score", 0.0, 0, 0, None)
    assert threshold(NO_CLEAN_TIME, 1.0).allowed_per_hour is None
    assert threshold(peak, 4.0).allowed_per_hour == 3.0


@given(
    st.lists(
        st.tuples(st.integers(1, 90), st.sampled_from([0.5, 1.0, 1.5, 3.0, nan])),
        min_size=2,
        max_size=60,
    ),
    st.sampled_from([0.3, 1.1, 12.0]),
)
def test_a_curve_is_of_the_false_alerts_that_a_row_has(
    steps: list[tuple[int, float]], hold_s: float
) -> None:
    """Decisions between epochs and after gaps included."""
    time_ns = np.cumsum([tenths for tenths, _ in steps]) * (S // 10)
    score = np.array([value for _, value in steps])
    epochs = np.arange(0, time_ns[-1] // S + 2) * S
    level = np.zeros(epochs.size)
    pvt = Table("gnss/pvt", epochs, {"lat_deg": level, "lon_deg": level, "height_m": level})
    recording = Recording({"/gnss0/gnss/pvt": pvt})
    truth = build_truth(recording, recording)
    for factor in (1.0, 0.5, 2.0):
        decisions = Decisions(time_ns, score / factor, ~np.isnan(score))
        cells = score_decisions(decisions, truth, memory_s=0.0, hold_s=hold_s)
        raw = Decisions(time_ns, score, ~np.isnan(score))
        levels = alarm_level(epochs, score_on_grid(raw, truth, hold_s), raw.time_ns, raw.score)
        curve = episode_curve(epochs, levels, ~np.isnan(levels), truth.epoch_ns)
        assert curve.episodes_at(factor) == cells["episodes"]
        assert curve.hours == pytest.approx(cells["available_clean_h"])


@given(
    st.lists(st.tuples(st.integers(1, 9), SCORES | st.just(inf)), max_size=40),
    st.integers(0, 60),
    st.integers(1, 90),
)
def test_times_to_detection_are_those_of_the_events(
    steps: list[tuple[int, float]], start: int, length: int
) -> None:
    time_ns = np.cumsum(np.array([step for step, _ in steps], np.int64)) * S
    score = np.array([value for _, value in steps], np.float64)
    attack = Interval(start * S, (start + length) * S)
    factors = np.array([1.0, 0.1, 0.2, 2.2, 0.5, 3.0, 4.9, 5.0, 7.0])
    found = detection_times_s(time_ns, score, attack, factors)
    for factor, ttfd_s in zip(factors, found, strict=True):
        (event,) = find_events(
            time_ns, score > factor, [attack], hold_s=1.0, end_ns=0, unreviewed_ns=time_ns[:0]
        )
        assert event.ttfd_s == (None if np.isnan(ttfd_s) else ttfd_s)


def simulated(rng: np.random.Generator, hours: float) -> Clean:
    """A session: a short-correlated noise with excursions, at one epoch every 2 s."""
    n = round(hours * 1800)
    white = rng.standard_normal(n + 4)
    noise = np.convolve(white, np.ones(5) / 5**0.5, "valid")
    level = np.exp(noise * 0.4)
    return Clean(2 * S * np.arange(n), level, np.ones(n, bool), 2 * S)


def test_a_threshold_of_some_sessions_holds_on_others() -> None:
    """Of 16 sessions of an hour, eight fit and eight test, many times over. The rate on the eight
    has the expectation that the threshold states, which is the target, and the interval of a count
    covers it as often as it can where the threshold is itself uncertain.
    """
    rng = np.random.default_rng(2026)
    target, rates, covered = 1.0, [], 0
    for _ in range(150):
        tasks = [simulated(rng, 1.0) for _ in range(16)]
        fitted = threshold(total(task.curve() for task in tasks[:8]), target)
        assert (fitted.how, fitted.largest_expected_per_hour) == ("calibrated", target)
        assert fitted.factor is not None
        tested = total(task.curve() for task in tasks[8:])
        rate = poisson_rate(tested.episodes_at(fitted.factor), tested.hours)
        assert rate is not None
        rates.append(rate.value)
        covered += rate.lo <= target <= rate.hi
    error = np.std(rates) / len(rates) ** 0.5
    assert abs(np.mean(rates) - target) < 3 * error
    assert error < 0.06
    assert covered / len(rates) > 0.8
