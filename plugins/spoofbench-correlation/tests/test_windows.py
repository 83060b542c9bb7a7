"""Correlation over trailing windows against sums taken one window at a time."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from spoofbench_correlation import windows

SECOND = 1_000_000_000


def literal(x: list[float], y: list[float]) -> tuple[float, float, float]:
    """Eq (8) with N terms: coefficient and the two standard deviations."""
    n = len(x)
    mean_x, mean_y = math.fsum(x) / n, math.fsum(y) / n
    std_x = math.sqrt(math.fsum((a - mean_x) ** 2 for a in x) / n)
    std_y = math.sqrt(math.fsum((b - mean_y) ** 2 for b in y) / n)
    covariance = math.fsum((a - mean_x) * (b - mean_y) for a, b in zip(x, y, strict=True)) / n
    return covariance / (std_x * std_y), std_x, std_y


def trailing(n: int, length: int) -> np.ndarray:
    return np.maximum(np.arange(n) - length + 1, 0)


@settings(deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(3, 1500),
    st.integers(2, 200),
    st.floats(0, 0.4),
    st.floats(-1e6, 1e6),
)
def test_agrees_with_sums_of_each_window(
    seed: int, n: int, length: int, lost: float, offset: float
) -> None:
    rng = np.random.default_rng(seed)
    x = offset + rng.normal(0, 1, (2, n))
    y = 0.7 * x + rng.normal(0, 1, (2, n)) - 3 * offset
    valid = rng.random(n) >= lost
    x[:, ~valid] = np.nan
    first = trailing(n, length)
    found = windows.correlate(x, y, valid, first)
    for row in (0, 1):
        for k in rng.choice(n, min(n, 25), replace=False):
            kept = np.flatnonzero(valid[first[k] : k + 1]) + first[k]
            if kept.size < 3:
                continue
            expected = literal(x[row, kept].tolist(), y[row, kept].tolist())
            assert (
                found.coefficient[row, k],
                found.std_x[row, k],
                found.std_y[row, k],
            ) == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("quiet", [1e-3, 1e-6])
def test_a_quiet_window_after_a_loud_one_keeps_its_digits(quiet: float) -> None:
    rng = np.random.default_rng(1)
    x = np.concatenate([rng.normal(0, 1, 300), quiet * rng.normal(0, 1, 300)])[None]
    y = x + quiet * 0.5 * rng.normal(0, 1, 600)
    found = windows.correlate(x, y, np.ones(600, bool), trailing(600, 120))
    for k in range(430, 600, 13):
        expected = literal(x[0, k - 119 : k + 1].tolist(), y[0, k - 119 : k + 1].tolist())[0]
        assert found.coefficient[0, k] == pytest.approx(expected, rel=1e-9)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 1400))
def test_the_future_changes_no_bit(seed: int, cut: int) -> None:
    rng = np.random.default_rng(seed)
    x, y, valid = rng.normal(0, 1, (1, 1500)), rng.normal(0, 1, (1, 1500)), rng.random(1500) > 0.1
    whole = windows.correlate(x, y, valid, trailing(1500, 120)).coefficient[:, :cut]
    part = windows.correlate(x[:, :cut], y[:, :cut], valid[:cut], trailing(cut, 120)).coefficient
    assert part.tobytes() == whole.tobytes()


@pytest.mark.parametrize("constant", [0.0, 1e-3, -7.3, 1e6])
def test_a_constant_has_no_correlation(constant: float) -> None:
    rng = np.random.default_rng(2)
    x = np.concatenate([rng.normal(0, 1, 200), np.full(300, constant)])[None]
    found = windows.correlate(x, rng.normal(0, 1, (1, 500)), np.ones(500, bool), trailing(500, 120))
    assert np.isnan(found.coefficient[0, 319:]).all()
    assert not np.isnan(found.coefficient[0, 1:319]).any()


def test_windows_of_no_valid_pair_have_no_correlation() -> None:
    x = np.random.default_rng(3).normal(0, 1, (1, 50))
    found = windows.correlate(x, x, np.arange(50) < 20, trailing(50, 10))
    assert np.isnan(found.coefficient[0, 29:]).all()
    assert found.coefficient[0, 1:20] == pytest.approx(np.ones(19))


@given(hnp.arrays(np.int64, st.integers(2, 400), elements=st.integers(-8_000_000, 8_000_000)))
def test_jitter_adds_no_pair_to_a_window_and_drops_none(jitter: np.ndarray) -> None:
    epochs = np.arange(jitter.size) * SECOND + jitter
    first = windows.first_of_window(epochs[:-1], epochs[1:], 120)
    assert first.tolist() == trailing(jitter.size - 1, 120).tolist()


def test_coverage_counts_the_seconds_of_valid_pairs() -> None:
    epochs = np.array([0, 1, 2, 5, 6, 7]) * SECOND
    first = windows.first_of_window(epochs[:-1], epochs[1:], 3)
    valid = np.array([True, True, False, True, True])
    assert windows.covered_s(np.diff(epochs) / 1e9, valid, first).tolist() == [1, 2, 0, 1, 2]


@given(
    hnp.arrays(float, st.tuples(st.just(2), st.integers(1, 40)), elements=st.floats(-1e6, 1e6)),
    st.sampled_from([1, 3, 5]),
)
def test_median_of_each_value_and_those_before_it(values: np.ndarray, length: int) -> None:
    found = windows.trailing_median(values, length)
    for row, column in np.ndindex(values.shape):
        if column < length - 1:
            assert np.isnan(found[row, column])
        else:
            assert (
                found[row, column]
                == sorted(values[row, column - length + 1 : column + 1])[length // 2]
            )
