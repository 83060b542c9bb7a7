"""The worst-case fault: three routes agree, nothing beats it, and it depends on nothing that it
should not.
"""

import numpy as np
import pytest
from scipy.linalg import block_diag
from spoofbench_papers.integrity import (
    ALTITUDE,
    Run,
    Scenario,
    fault_of_measurements,
    monitored,
    slopes_squared,
    worst_fault,
)
from spoofbench_papers.integrity.filtering import covariances

from spoofbench.arrays import Floats


@pytest.mark.parametrize("first", [1, 2, 21, 61])
def test_three_routes_agree(quick: tuple[Scenario, Run], first: int) -> None:
    run = quick[1]
    direction, slope = worst_direction(run, first)
    ours = worst_fault(run, first)
    assert slopes_squared(run, first)[-1] == pytest.approx(slope, rel=1e-9)
    assert ours.vertical_error_m**2 == pytest.approx(slope, rel=1e-9)
    dense = fault_of_measurements(run, direction)
    dense = dense.scaled(dense.noncentrality_squared**-0.5)
    np.testing.assert_allclose(
        ours.measurement, dense.measurement, atol=1e-9 * np.abs(dense.measurement).max()
    )
    assert not np.any(ours.measurement[: first - 1])


def test_slope_at_every_epoch_is_that_of_a_monitor_that_ends_there(
    quick: tuple[Scenario, Run],
) -> None:
    run = quick[1]
    shorter = covariances(run.model, run.start, 17)
    assert slopes_squared(run)[16] == pytest.approx(
        worst_fault(shorter).vertical_error_m ** 2, rel=1e-9
    )


def test_nothing_has_a_steeper_slope(quick: tuple[Scenario, Run]) -> None:
    run, rng = quick[1], np.random.default_rng(1)
    worst = worst_fault(run)
    epochs, count = worst.measurement.shape

    def slope(measurement: np.ndarray) -> float:
        fault = fault_of_measurements(run, measurement)
        return abs(fault.vertical_error_m) / fault.noncentrality_squared**0.5

    positions = run.model.observation[:, :3]
    ramps = (
        np.linspace(0, 1, epochs)[:, None] ** rng.uniform(0, 4)
        * rng.standard_normal(3)
        @ positions.T
        for _ in range(1000)
    )
    directions = (rng.standard_normal((epochs, count)) for _ in range(1000))
    nearby = (
        worst.measurement * (1 + 1e-3 * rng.standard_normal((epochs, count))) for _ in range(100)
    )
    for faults in (ramps, directions, nearby):
        assert max(map(slope, faults)) <= worst.vertical_error_m * (1 + 1e-12)


def test_slope_does_not_depend_on_the_reference_satellite(quick: tuple[Scenario, Run]) -> None:
    scenario = quick[0]
    slopes = [
        slopes_squared(monitored(scenario.at(reference=reference)))[-1] for reference in range(6)
    ]
    np.testing.assert_allclose(slopes, slopes[0], rtol=1e-6)


def test_worst_fault_is_the_linear_map_of_its_measurements(quick: tuple[Scenario, Run]) -> None:
    run = quick[1]
    worst = worst_fault(run)
    again = fault_of_measurements(run, worst.measurement)
    np.testing.assert_allclose(
        again.innovation, worst.innovation, atol=1e-9 * np.abs(worst.innovation).max()
    )
    np.testing.assert_allclose(again.error[:, ALTITUDE], worst.error[:, ALTITUDE], atol=1e-9)


def matrices(run: Run) -> tuple[Floats, Floats, Floats]:
    """By the paper's own equations (Tanil et al. 2018, Eqs 49-53), slow and large: return T A (1, k
    n), B (k n, k n) and S (k n, k n).
    """
    model, epochs, count = run.model, len(run), len(run.model.noise)
    states = len(model.transition)
    gains = np.zeros((states, 0))
    rows = []
    for k in range(epochs):
        b = np.hstack([-model.observation @ model.transition @ gains, np.eye(count)])
        rows.append(np.hstack([b, np.zeros((count, (epochs - k - 1) * count))]))
        gains = np.hstack(
            [
                (np.eye(states) - run.gain[k] @ model.observation) @ model.transition @ gains,
                run.gain[k],
            ]
        )
    return gains[ALTITUDE : ALTITUDE + 1], np.vstack(rows), block_diag(*run.innovation)


def worst_direction(run: Run, first: int) -> tuple[Floats, float]:
    """Return f (k, n) of Eq (59), or of Eq (75) with its inverse where it belongs, and rho^2 of Eq
    (54) for it.
    """
    hazard, b, s = matrices(run)
    skip = (first - 1) * len(run.model.noise)
    hazard, b = hazard[:, skip:], b[:, skip:]
    fault = np.linalg.solve(b.T @ np.linalg.solve(s, b), hazard.T)[:, 0]
    slope = float((hazard @ fault)[0] ** 2 / (fault @ b.T @ np.linalg.solve(s, b @ fault)))
    return np.concatenate([np.zeros(skip), fault]).reshape(len(run), -1), slope
