"""The three sums against literal loops, and their thresholds."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from spoofbench_innovation.filtering import Innovations
from spoofbench_innovation.statistics import ratio, thresholds_squared


@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from(["cumulative", "windowed", "per-epoch"]),
    st.floats(0.5, 20),
)
def test_sums_against_a_loop(seed: int, statistic: Any, window_s: float) -> None:
    rng = np.random.default_rng(seed)
    size = int(rng.integers(1, 40))
    time_ns = np.cumsum(rng.integers(1, 3 * 10**9, size))
    value = rng.normal(0, 1, (size, 6))
    value[rng.random((size, 6)) < 0.3] = np.nan
    run = np.sort(rng.integers(-1, 3, size))
    spread = rng.normal(0, 1, (size, 6, 6))
    covariance = spread @ spread.swapaxes(1, 2) + np.eye(6)
    for k in range(size):
        absent = np.isnan(value[k])
        covariance[k][absent, :] = covariance[k][:, absent] = 0
        covariance[k][absent, absent] = 1
    got = ratio(time_ns, Innovations(value, covariance, run), statistic, window_s, 1e-3)
    for k in range(size):
        known = ~np.isnan(value[k])
        if run[k] < 0 or not known.any():
            assert np.isnan(got[k])
            continue
        q, degrees = 0.0, 0
        for i in range(k + 1):
            young = (
                statistic == "cumulative"
                or (statistic == "windowed" and time_ns[i] > time_ns[k] - round(window_s * 1e9))
                or i == k
            )
            rows = ~np.isnan(value[i])
            if run[i] == run[k] and young and rows.any():
                q += float(
                    value[i, rows]
                    @ np.linalg.inv(covariance[i][np.ix_(rows, rows)])
                    @ value[i, rows]
                )
                degrees += int(rows.sum())
        assert got[k] == pytest.approx(q / stats.chi2.isf(1e-3, degrees), rel=1e-8)


@given(
    st.lists(st.integers(1, 20_000), min_size=1, max_size=20),
    st.sampled_from([1e-9, 1e-6, 1e-3, 0.5]),
)
def test_thresholds(degrees: list[int], p_fa: float) -> None:
    np.testing.assert_allclose(
        thresholds_squared(np.array(degrees, float), p_fa), stats.chi2.isf(p_fa, degrees), rtol=1e-9
    )


def test_the_papers_threshold() -> None:
    """Tanil et al. (2018): T = 56.4 for 281 epochs of 10 measurements at 1e-6."""
    assert thresholds_squared(np.array([2810.0]), 1e-6)[0] ** 0.5 == pytest.approx(56.399, abs=1e-3)


def test_the_largest_innovations_leave_later_windows_as_they_are() -> None:
    found = Innovations(np.full((3, 6), 1e8), np.tile(np.eye(6), (3, 1, 1)), np.zeros(3, int))
    found.value[1:] = 0.1
    after = ratio(np.arange(3) * 10**9, found, "windowed", 1.0, 1e-6)
    assert after[0] > 1e7
    np.testing.assert_allclose(after[1:], 0.06 / stats.chi2.isf(1e-6, 6), atol=1e-4)
