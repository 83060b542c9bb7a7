"""Comparing rows: sign-flip tests, Holm, and the differences' intervals."""

from itertools import pairwise
from random import Random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from spoofbench.scoring import comparison
from spoofbench.scoring.comparison import compare_with_first, holm, sign_flip_p

SHARE = st.integers(0, 10).map(lambda tenths: tenths / 10)


@given(st.lists(st.integers(-20, 20), min_size=2, max_size=9))
def test_sign_flip_agrees_with_scipy(twentieths: list[int]) -> None:
    """In whole numbers: scipy's ties are relative to the sum seen, which may round to 0."""
    reference = stats.permutation_test(
        (twentieths,), np.sum, permutation_type="samples", n_resamples=2**9
    )
    assert sign_flip_p(np.array(twentieths) / 20) == pytest.approx(reference.pvalue)


def test_sign_flip_by_chance_agrees_with_the_exact_test(monkeypatch: pytest.MonkeyPatch) -> None:
    differences = np.random.default_rng(5).normal(0.5, 1, 12)
    exact = sign_flip_p(differences)
    monkeypatch.setattr(comparison, "_EXACT_SESSIONS", 11)
    drawn = sign_flip_p(differences)
    assert drawn == pytest.approx(exact, abs=0.005)
    assert drawn == sign_flip_p(differences), "seeded"
    assert drawn != sign_flip_p(differences, seed=1)
    assert sign_flip_p(np.ones(40)) == 2**-15, "never 0"


def test_five_sessions_never_tell_two_rows_apart() -> None:
    five, six = (compare_with_first([np.zeros(n), np.ones(n)])[0] for n in (5, 6))
    assert (five.p, five.told_apart, five.sessions_needed) == (2 / 2**5, False, 6)
    assert (six.p, six.told_apart, six.sessions_needed) == (2 / 2**6, True, None)


@pytest.mark.parametrize(("comparisons", "sessions"), [(1, 6), (20, 10), (51, 11), (52, 12)])
def test_the_fewest_sessions_are_those_that_can_pass_holm(comparisons: int, sessions: int) -> None:
    assert comparison.fewest_sessions(comparisons) == sessions
    for n, passes in ((sessions, True), (sessions - 1, False)):
        rows = np.zeros((comparisons + 1, n))
        rows[1] = 1
        compared = compare_with_first(rows)
        assert compared[0].told_apart == passes
        assert not any(one.told_apart for one in compared[1:])


def test_holm_by_hand() -> None:
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.9, 0.8]) == [1, 1]
    assert holm([]) == []


@given(st.lists(st.floats(0, 1), min_size=1, max_size=8))
def test_holm_keeps_the_order_and_lies_between_raw_and_bonferroni(p: list[float]) -> None:
    adjusted = holm(p)
    by_raw = sorted(zip(p, adjusted, strict=True))
    assert all(one[1] <= after[1] for one, after in pairwise(by_raw))
    for raw, one in by_raw:
        assert raw <= one <= min(1, len(p) * raw) + 1e-12


def test_sessions_that_only_one_row_knows_do_not_count() -> None:
    first = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, np.nan]
    other = [0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 1.0]
    full, none = compare_with_first([first, other, [np.nan] * 7], largest=1)
    assert full.sessions == 6
    assert full.difference is not None
    assert full.difference.value == pytest.approx(0.1)
    assert none == comparison.Comparison(0, None, None, told_apart=False, sessions_needed=None)


def test_a_figure_without_bound_gets_no_interval() -> None:
    rows = np.arange(16.0).reshape(2, 8)
    assert compare_with_first(rows)[0].difference is None
    seconds = compare_with_first(rows, largest=16)[0].difference
    shares = compare_with_first(rows / 16, largest=1)[0].difference
    assert seconds is not None
    assert shares is not None
    assert (seconds.value, seconds.lo, seconds.hi) == pytest.approx(
        (16 * shares.value, 16 * shares.lo, 16 * shares.hi)
    )


@given(st.lists(st.tuples(SHARE, SHARE), min_size=5, max_size=10))
def test_turning_the_comparison_round_turns_the_difference(
    pairs: list[tuple[float, float]],
) -> None:
    one, other = np.array(pairs).T
    there, back = (compare_with_first(rows, 1)[0] for rows in ([one, other], [other, one]))
    assert there.p == pytest.approx(back.p)
    assert there.sessions_needed == back.sessions_needed
    assert there.difference is not None
    assert back.difference is not None
    assert there.difference.lo == pytest.approx(-back.difference.hi)
    assert -1 <= there.difference.lo < there.difference.value + 1e-9
    assert there.difference.lo < there.difference.hi <= 1


@given(st.lists(st.tuples(SHARE, SHARE), min_size=1, max_size=10), st.randoms())
def test_the_order_of_the_sessions_changes_nothing(
    pairs: list[tuple[float, float]], random: Random
) -> None:
    shuffled = random.sample(pairs, len(pairs))
    one, other = (compare_with_first(np.array(rows).T, 1)[0] for rows in (pairs, shuffled))
    assert one.p == pytest.approx(other.p)
    assert one.told_apart == other.told_apart
    assert one.sessions_needed == other.sessions_needed


def test_sessions_needed_grow_with_the_spread_and_never_lie_within_those_there_are() -> None:
    rng = np.random.default_rng(0)
    noise = rng.normal(size=12)
    noise -= noise.mean()
    needed = [comparison.sessions_needed(0.1 + spread * noise, 3) for spread in (0.01, 0.3, 1.0)]
    assert needed[0] == 13
    assert needed[1] is not None
    assert needed[2] is not None
    assert 13 < needed[1] < needed[2]
    assert comparison.sessions_needed(noise, 3) is None, "no difference seen"


def test_about_the_needed_sessions_do_tell_apart_four_times_in_five() -> None:
    rng = np.random.default_rng(0)
    seen = rng.normal(size=9)
    seen = 0.6 + (seen - seen.mean()) / seen.std(ddof=1)
    needed = comparison.sessions_needed(seen, 1)
    assert needed is not None
    assert 15 < needed < 40
    apart = [sign_flip_p(rng.normal(0.6, 1, needed)) <= 0.05 for _ in range(200)]
    assert 0.7 < np.mean(apart) < 0.9
