"""Statistics: against scipy's independent implementations, hand calculation and their own laws."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy import stats

from spoofbench.scoring import statistics


@given(st.integers(0, 500), st.floats(0.01, 1000))
def test_garwood_ends_are_where_the_tails_hold_a_fortieth(count: int, hours: float) -> None:
    rate = statistics.poisson_rate(count, hours)
    assert rate is not None
    assert rate.value == count / hours
    assert stats.poisson.cdf(count, rate.hi * hours) == pytest.approx(0.025, rel=1e-6)
    assert (
        rate.lo == 0
        if count == 0
        else stats.poisson.sf(count - 1, rate.lo * hours) == pytest.approx(0.025, rel=1e-6)
    )


@given(st.integers(0, 60), st.integers(1, 60))
def test_clopper_pearson_agrees_with_binomtest(count: int, trials: int) -> None:
    assume(count <= trials)
    found = statistics.proportion(count, trials)
    assert found is not None
    expected = stats.binomtest(count, trials).proportion_ci(0.95, "exact")
    assert (found.lo, found.hi) == pytest.approx((expected.low, expected.high), abs=1e-9)


def test_nothing_to_estimate_is_none() -> None:
    empty = np.empty(0)
    assert statistics.poisson_rate(0, 0.0) is None
    assert statistics.proportion(0, 0) is None
    assert statistics.survival_curve([], []) is None
    assert statistics.roc_curve(empty, np.ones(3)) is None
    assert statistics.roc_curve(np.full(3, np.nan), np.ones(3)) is None
    assert statistics.roc_curve(np.ones(3), empty) is None


def test_kaplan_meier_by_hand() -> None:
    """Detections at 1, 2, 2 and 5 s; censored at 2 and 4 s: S = 5/6, 5/6 * 3/5 = 1/2, 0."""
    curve = statistics.survival_curve([1, 2, 2, 2, 4, 5], [True, True, True, False, False, True])
    assert curve is not None
    assert curve.time_s.tolist() == [1, 2, 5]
    assert curve.undetected == pytest.approx([5 / 6, 1 / 2, 0])
    assert curve.quantile_s(0.5) == 2
    assert curve.quantile_s(0.9) == 5
    assert curve.restricted_mean_s(6) == pytest.approx(1 + 5 / 6 + 3 / 2)
    assert curve.restricted_mean_s(3) == pytest.approx(1 + 5 / 6 + 1 / 2)


def test_never_detected_has_no_quantile_and_the_whole_horizon() -> None:
    curve = statistics.survival_curve([60, 60], [False, False])
    assert curve is not None
    assert curve.quantile_s(0.5) is None
    assert curve.restricted_mean_s(60) == 60


@given(st.lists(st.tuples(st.integers(0, 20), st.booleans()), min_size=1, max_size=30))
def test_kaplan_meier_agrees_with_scipy(observations: list[tuple[int, bool]]) -> None:
    times, flags = zip(*observations, strict=True)
    curve = statistics.survival_curve(times, flags)
    assert curve is not None
    data = stats.CensoredData(
        uncensored=[t for t, detected in observations if detected],
        right=[t for t, detected in observations if not detected],
    )
    reference = stats.ecdf(data).sf
    at = np.arange(0, 21)
    ours = np.append(1.0, curve.undetected)[np.searchsorted(curve.time_s, at, "right")]
    assert ours == pytest.approx(reference.evaluate(at), abs=1e-12)


@given(st.lists(st.integers(0, 60), min_size=1, max_size=30))
def test_restricted_mean_is_the_plain_mean_where_all_attacks_are_equally_long(
    times: list[int],
) -> None:
    curve = statistics.survival_curve(times, [t < 60 for t in times])
    assert curve is not None
    assert curve.restricted_mean_s(60) == pytest.approx(np.mean(times))
    assert curve.restricted_mean_s(30) == pytest.approx(np.minimum(times, 30).mean())


SCORES = st.lists(
    st.sampled_from([0.0, 0.5, 0.9, 1.0, 1.1, 3.0, np.inf, np.nan]), min_size=1, max_size=30
).map(np.array)


@given(SCORES, SCORES, st.sampled_from([0.25, 0.5, 2.0, 8.0]))
def test_scaling_scores_and_threshold_together_changes_nothing(
    clean: np.ndarray, spoofed: np.ndarray, scale: float
) -> None:
    curve, scaled = (
        statistics.roc_curve(clean, spoofed),
        statistics.roc_curve(scale * clean, scale * spoofed),
    )
    assert (curve is None) == (scaled is None)
    if curve is not None and scaled is not None:
        np.testing.assert_array_equal(curve, scaled)


@given(SCORES, SCORES)
def test_roc_agrees_with_a_loop_over_thresholds(clean: np.ndarray, spoofed: np.ndarray) -> None:
    curve = statistics.roc_curve(clean, spoofed)
    if curve is None:
        assert np.isnan(clean).all()
        return
    usable = clean[~np.isnan(clean)]
    points = {(0.0, 0.0)}
    for threshold in {*clean.tolist(), *spoofed.tolist()}:
        if threshold == threshold:
            points.add((float((usable >= threshold).mean()), float((spoofed >= threshold).mean())))
    assert set(zip(*(axis.tolist() for axis in curve), strict=True)) == points
    assert curve[0][-1] == 1
    assert curve[1][-1] == pytest.approx((~np.isnan(spoofed)).mean())


@given(SCORES, SCORES)
def test_whole_area_is_the_chance_that_a_spoofed_score_beats_a_clean_one(
    clean: np.ndarray, spoofed: np.ndarray
) -> None:
    assume(not np.isnan(clean).any())
    assume(not np.isnan(spoofed).any())
    curve = statistics.roc_curve(clean, spoofed)
    assert curve is not None
    wins = (spoofed[:, None] > clean).mean() + 0.5 * (spoofed[:, None] == clean).mean()
    assert statistics.partial_auc(*curve, 1.0) == pytest.approx(wins)


def test_partial_area_of_perfect_blind_and_unavailable_detectors() -> None:
    low, high = np.linspace(0, 0.9, 200), np.linspace(1.1, 2, 200)
    areas = []
    for clean, spoofed in (
        (low, high),
        (low, low),
        (high, low),
        (low, np.where(np.arange(200) % 2, high, np.nan)),
    ):
        curve = statistics.roc_curve(clean, spoofed)
        assert curve is not None
        areas.append(statistics.partial_auc(*curve, 0.01))
    assert areas == pytest.approx([1, 0.005, 0, 0.5], abs=1e-12)


def test_session_bootstrap() -> None:
    values = [0.0, 100.0] * 10
    sessions = [f"s{row // 4}" for row in range(20)]
    assert statistics.session_interval(values[:16], sessions[:16]) is None
    assert statistics.session_interval(values, sessions) == (50, 50), (
        "every session has the same mean"
    )
    spread = statistics.session_interval(values, [f"s{row % 10}" for row in range(20)])
    assert spread == statistics.session_interval(values, [f"s{row % 10}" for row in range(20)]), (
        "seeded"
    )
    assert spread is not None
    assert spread[0] < 50 < spread[1]


@given(st.lists(st.floats(0, 100), min_size=5, max_size=12))
def test_bootstrap_interval_lies_within_the_values(values: list[float]) -> None:
    found = statistics.session_interval(values, [str(row) for row in range(len(values))])
    assert found is not None
    assert min(values) - 1e-9 <= found[0] <= found[1] <= max(values) + 1e-9
