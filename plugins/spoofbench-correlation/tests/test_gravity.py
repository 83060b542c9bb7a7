"""Estimates of gravity against loops, and against a gravity that is known."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spoofbench_correlation import gravity

NORM = 9.855


def drive(seed: int, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Specific force and angular rate of planar driving in a sensor that is turned at random, and
    gravity there.
    """
    rng = np.random.default_rng(seed)
    turned, _ = np.linalg.qr(rng.normal(0, 1, (3, 3)))
    moving = np.arange(n) % 200 >= 60
    force = np.stack(
        [
            rng.normal(0, 1.2, n) * moving,
            rng.normal(0, 1.2, n) * moving,
            -NORM + rng.normal(0, 0.05, n),
        ]
    )
    rate = np.stack(
        [rng.normal(0, 0.005, n), rng.normal(0, 0.005, n), rng.normal(0, 0.15, n) * moving]
    )
    return turned @ force, turned @ rate, turned @ np.array([0, 0, -NORM])


def angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    return math.degrees(
        math.acos(min(1.0, float(a @ b) / float(np.linalg.norm(a) * np.linalg.norm(b))))
    )


@settings(deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 500),
    st.floats(0.5, 200),
    st.sampled_from([0.1, 1.0, 40.0, 1e5]),
)
def test_low_pass_is_its_recursion(seed: int, n: int, time_constant: float, longest: float) -> None:
    rng = np.random.default_rng(seed)
    values, dt = rng.normal(5, 1, (2, n)), rng.uniform(0, longest, n)
    values[:, rng.random(n) < 0.2] = np.nan
    found = gravity.low_pass(values, dt, time_constant)
    state: list[float] | None = None
    for k in range(n):
        if not np.isnan(values[0, k]):
            gain = 1 - math.exp(-dt[k] / time_constant)
            state = [
                y + gain * (x - y)
                for x, y in zip(values[:, k].tolist(), state or values[:, k].tolist(), strict=True)
            ]
        assert found[:, k] == pytest.approx(
            [math.nan, math.nan] if state is None else state, rel=1e-9, nan_ok=True
        )


def test_constant_is_the_mean_of_the_past() -> None:
    force, dt = (
        np.array([[1.0, np.nan, 3, 8], [0, 0, 0, 4], [9, 9, 9, 9]]),
        np.array([1.0, 1, 1, 2]),
    )
    assert gravity.constant(force, dt)[0] == pytest.approx([1, 1, 2, 5])
    assert np.isnan(gravity.constant(force[:, 1:2], dt[1:2])).all()


def test_static_norm_is_the_mean_over_standstill_so_far() -> None:
    force = np.array([[3.0, 0, 0, 6], [4, 5, 9, 8], [0, 0, 0, 0]])
    found = gravity.static_norm(force, np.array([False, True, False, True]))
    assert found == pytest.approx([math.nan, 5, 5, 7.5], nan_ok=True)


def literal_descent(
    force: np.ndarray, rate: np.ndarray, g: float, w: float, time_constant: float
) -> np.ndarray:
    """Borio's Eq (13), averaged, with Eq (14), descended by its numerical gradient."""
    samples: list[tuple[float, np.ndarray, np.ndarray]] = []
    keep = math.exp(-1 / time_constant)
    u, estimates = None, []
    for a, omega in zip(force.T, rate.T, strict=True):
        samples = [(weight * keep, *sample) for weight, *sample in samples] + [
            (1 - keep if samples else 1.0, a, omega)
        ]

        def cost(direction: np.ndarray, samples: list = samples) -> float:
            total = math.fsum(
                weight * ((a @ direction - g) ** 2 - w * (omega @ direction) ** 2)
                for weight, a, omega in samples
            )
            return total + gravity.PENALTY * g**2 * (direction @ direction - 1) ** 2

        if u is None:
            u = a / np.linalg.norm(a)
        for _ in range(gravity.DESCENT_STEPS):
            slope = np.array(
                [(cost(u + step) - cost(u - step)) / 2e-5 for step in 1e-5 * np.eye(3)]
            )
            u = u - slope / (gravity.CURVATURE * g**2)
        u = u / np.linalg.norm(u)
        estimates.append(g * u)
    return np.array(estimates).T


def test_descent_follows_the_gradient_of_the_cost() -> None:
    force, rate, _ = drive(1, 60)
    found = gravity.descent(force, rate, np.ones(60), np.full(60, NORM), 100.0, 30.0)
    np.testing.assert_allclose(found, literal_descent(force, rate, NORM, 100.0, 30.0), atol=1e-5)


@pytest.mark.parametrize("seed", range(5))
def test_descent_finds_gravity_however_the_sensor_is_turned(seed: int) -> None:
    force, rate, true = drive(seed, 1500)
    found = gravity.descent(force, rate, np.ones(1500), np.full(1500, NORM), 100.0, 30.0)
    assert np.median([angle_deg(found[:, k], true) for k in range(300, 1500)]) < 1
    np.testing.assert_allclose(np.linalg.norm(found, axis=0), NORM)


def test_descent_waits_for_the_static_norm() -> None:
    force, rate, _ = drive(6, 50)
    g = np.where(np.arange(50) < 20, np.nan, NORM)
    found = gravity.descent(force, rate, np.ones(50), g, 100.0, 30.0)
    assert np.isnan(found).all(axis=0).tolist() == (np.arange(50) < 20).tolist()


@pytest.mark.parametrize("force", [np.zeros((3, 5)), np.full((3, 5), np.nan), np.empty((3, 0))])
def test_nothing_to_descend_on(force: np.ndarray) -> None:
    n = force.shape[1]
    assert np.isnan(
        gravity.descent(force, np.zeros((3, n)), np.ones(n), np.full(n, NORM), 1.0, 30.0)
    ).all()
