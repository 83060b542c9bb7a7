"""Statistics: against scipy's independent implementations, hand calculation and their own laws."""

from random import Random
from typing import Any

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


SESSION_COUNTS = st.lists(
    st.tuples(st.integers(0, 60), st.sampled_from([0.25, 0.5, 1.0, 3.0])), min_size=5, max_size=16
)
SHARES = st.lists(st.integers(0, 20).map(lambda n: n / 20), min_size=5, max_size=16)


@given(SESSION_COUNTS)
def test_ends_of_a_rate_are_where_the_tails_of_the_negative_binomial_hold_a_fortieth(
    sessions: list[tuple[int, float]],
) -> None:
    episodes, hours = np.array(sessions).T
    found = statistics.rate_interval(episodes, hours)
    assert found is not None
    total = episodes.sum()
    assert found.value == pytest.approx(total / hours.sum())
    assert 0 <= found.lo <= found.value < found.hi < np.inf
    n = len(sessions)
    spread = ((episodes - found.value * hours) ** 2).sum() * n / (n - 1) / total if total else 1.0
    phi = max(spread, ((n - 1) * spread + 8 * 30) / (n + 7))

    def counts(rate: float) -> Any:
        return stats.nbinom(rate * hours.sum() / (phi - 1), 1 / phi)

    assert counts(found.hi).cdf(total) == pytest.approx(0.025, rel=1e-6)
    if total:
        assert counts(found.lo).sf(total - 1) == pytest.approx(0.025, rel=1e-6)


def test_the_sessions_that_a_rate_needs() -> None:
    assert statistics.rate_interval([3], [2]) == statistics.poisson_rate(3, 2)
    assert statistics.rate_interval([3, 0], [2, 0]) == statistics.poisson_rate(3, 2)
    for n in (2, 3, 4):
        assert statistics.rate_interval([3] * n, [2] * n) is None
    assert statistics.rate_interval([], []) is None
    assert statistics.rate_interval([0] * 5, [0] * 5) is None


def test_no_episode_leaves_a_rate_possible() -> None:
    none = statistics.rate_interval([0] * 7, [1.5] * 7)
    single = statistics.poisson_rate(0, 7 * 1.5)
    assert none is not None
    assert single is not None
    assert (none.value, none.lo) == (0, 0)
    assert single.hi < none.hi < np.inf


def test_too_few_episodes_are_said() -> None:
    assert statistics.too_few_episodes([4, 5, 5, 5, 5], [1] * 5)
    assert not statistics.too_few_episodes([5] * 5, [1] * 5)
    assert not statistics.too_few_episodes([5] * 5 + [0], [1] * 5 + [0]), "no hours, no session"
    assert not statistics.too_few_episodes([1], [1]), "one session needs no dispersion"


@given(SESSION_COUNTS)
def test_a_rate_and_its_interval_scale_with_the_unit_of_time(
    sessions: list[tuple[int, float]],
) -> None:
    episodes, hours = np.array(sessions).T
    found, in_days = (statistics.rate_interval(episodes, h) for h in (hours, hours / 24))
    assert found is not None
    assert in_days is not None
    assert (in_days.lo, in_days.hi) == pytest.approx((24 * found.lo, 24 * found.hi))


@given(SHARES)
def test_a_share_lies_within_an_interval_that_has_a_width(shares: list[float]) -> None:
    found = statistics.share_interval(shares)
    assert found is not None
    assert found.value == pytest.approx(np.mean(shares))
    assert 0 <= found.lo <= found.value + 1e-9
    assert found.value - 1e-9 <= found.hi <= 1
    assert found.hi - found.lo > 0.01


@given(SHARES)
def test_shares_turned_round_turn_the_interval_round(shares: list[float]) -> None:
    found, missed = (statistics.share_interval(s) for s in (shares, 1 - np.array(shares)))
    assert found is not None
    assert missed is not None
    assert (missed.lo, missed.hi) == pytest.approx((1 - found.hi, 1 - found.lo), abs=1e-9)


@given(SHARES, st.sampled_from([100.0, 300.0]))
def test_a_share_scales_with_what_is_largest(shares: list[float], largest: float) -> None:
    found = statistics.share_interval(shares)
    scaled = statistics.share_interval(largest * np.array(shares), largest)
    assert found is not None
    assert scaled is not None
    assert scaled.value == pytest.approx(largest * found.value)
    assert (scaled.lo, scaled.hi) == pytest.approx((largest * found.lo, largest * found.hi))


@pytest.mark.parametrize("share", [0.0, 0.25, 1.0])
def test_sessions_that_are_alike_count_as_one_outcome_each(share: float) -> None:
    found = statistics.share_interval([share] * 8)
    expected = statistics.proportion(share * 8, 8)
    assert found is not None
    assert expected is not None
    assert (found.lo, found.hi) == pytest.approx((expected.lo, expected.hi))
    assert found.hi > found.lo


def test_a_share_by_hand() -> None:
    """Mean 1/2 and variance 1/20: a correlation of 0.2 of 4 degrees of freedom, and 0.5 of 2."""
    found = statistics.share_interval([0.2, 0.4, 0.5, 0.6, 0.8])
    outcomes = 5 / 0.3 * (stats.norm.ppf(0.975) / stats.t.ppf(0.975, 4)) ** 2
    assert found is not None
    assert found.lo == pytest.approx(stats.beta.ppf(0.025, outcomes / 2, outcomes / 2 + 1))
    assert found.hi == pytest.approx(stats.beta.ppf(0.975, outcomes / 2 + 1, outcomes / 2))


def test_sessions_of_all_or_nothing_count_as_less_than_one_outcome_each() -> None:
    found = statistics.share_interval([1, 1, 1, 1, 0, 0, 0, 0])
    binomial = statistics.proportion(4, 8)
    assert found is not None
    assert binomial is not None
    assert found.lo < binomial.lo < 0.5 < binomial.hi < found.hi


def test_the_sessions_that_a_share_needs() -> None:
    assert statistics.share_interval([0.5] * 4) is None
    assert statistics.share_interval([0.5] * 4 + [np.nan] * 3) is None
    assert statistics.share_interval([0.5] * 5 + [np.nan] * 3) is not None
    for outside in (-0.1, 1.1):
        with pytest.raises(ValueError, match="between 0 and"):
            statistics.share_interval([0.5] * 5 + [outside])


@given(SHARES, st.randoms())
def test_the_order_of_the_sessions_changes_no_interval(shares: list[float], random: Random) -> None:
    shuffled = random.sample(shares, len(shares))
    hours = [1.0] * len(shares)
    for one, other in (
        (statistics.share_interval(shares), statistics.share_interval(shuffled)),
        (
            statistics.rate_interval(np.multiply(20, shares), hours),
            statistics.rate_interval(np.multiply(20, shuffled), hours),
        ),
    ):
        assert one is not None
        assert other is not None
        assert (one.value, one.lo, one.hi) == pytest.approx((other.value, other.lo, other.hi))


def test_means_by_session() -> None:
    values = [1.0, 3.0, np.nan, 5.0, np.nan, 7.0]
    sessions = ["b", "b", "b", "a", "c", "e"]
    means = statistics.session_means(values, sessions, ["a", "b", "c", "d"])
    assert means == pytest.approx([5, 2, np.nan, np.nan], nan_ok=True)
    by_code = statistics.session_means(values, [1.0, 1.0, 1.0, 0.0, 2.0, 9.0], np.arange(4))
    assert by_code == pytest.approx(means, nan_ok=True)


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
    assert curve.time_s.tolist() == [1, 2, 4, 5]
    assert curve.undetected == pytest.approx([5 / 6, 1 / 2, 1 / 2, 0])
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
def test_kaplan_meier_is_the_product_of_the_shares_that_stay(
    observations: list[tuple[int, bool]],
) -> None:
    curve = statistics.survival_curve(*zip(*observations, strict=True))
    assert curve is not None
    undetected, expected = 1.0, []
    for time in sorted({t for t, _ in observations}):
        at_risk = sum(t >= time for t, _ in observations)
        undetected *= 1 - sum(t == time and hit for t, hit in observations) / at_risk
        expected.append(undetected)
    assert curve.undetected == pytest.approx(expected, abs=1e-12)


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
