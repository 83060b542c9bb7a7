"""Probabilities against simulation and against independent formulas."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from spoofbench_papers.integrity import ALTITUDE, Run, Scenario, monitor_of, worst_fault
from spoofbench_papers.integrity.filtering import covariances
from spoofbench_papers.integrity.risk import log_missed
from spoofbench_papers.integrity.scenario import ScenarioError
from spoofbench_papers.integrity.tracking import (
    _conditional,
    drawn,
    exact,
    log_general_chi2,
    log_general_chi2_near,
    sampled,
    tracking,
)

RUNS = 5000


def _simulate(
    run: Run, fault: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return q and the last vertical error, each ``(runs,)``, from random numbers."""
    model = run.model
    roots = [
        np.linalg.cholesky(part + 1e-18 * np.eye(len(part)))
        for part in (run.start, model.process, model.noise)
    ]
    error = rng.standard_normal((RUNS, len(run.start))) @ roots[0].T
    statistic = np.zeros(RUNS)
    for k in range(len(run)):
        error = error @ model.transition.T - rng.standard_normal(error.shape) @ roots[1].T
        noise = rng.standard_normal((RUNS, len(model.noise))) @ roots[2].T
        innovation = noise + fault[k] - error @ model.observation.T
        error = error + innovation @ run.gain[k].T
        statistic += np.einsum(
            "ri,ri->r", innovation, np.linalg.solve(run.innovation[k], innovation.T).T
        )
    return statistic, error[:, ALTITUDE]


def test_monte_carlo(quick: tuple[Scenario, Run]) -> None:
    scenario, run = quick
    rng, degrees = np.random.default_rng(2), len(run) * scenario.measurements
    worst = worst_fault(run).scaled(20.0)
    clean, error = _simulate(run, np.zeros_like(worst.measurement), rng)
    assert stats.kstest(clean, stats.chi2(degrees).cdf).pvalue > 1e-3
    assert abs(np.corrcoef(clean, error)[0, 1]) < 3 / RUNS**0.5
    faulty, error = _simulate(run, worst.measurement, rng)
    assert stats.kstest(faulty, stats.ncx2(degrees, 400).cdf).pvalue > 1e-3
    assert error.mean() == pytest.approx(worst.vertical_error_m, abs=4 * error.std() / RUNS**0.5)


@pytest.mark.parametrize(("factor", "independent"), [(1.0, True), (0.9, False)])
def test_estimate_error_and_innovation_are_independent(
    quick: tuple[Scenario, Run], factor: float, independent: bool
) -> None:
    """Appendix A holds for the optimal gain at every epoch, and for no other."""
    run = quick[1]
    model = run.model
    worst = 0.0
    for k in range(len(run)):
        predicted = run.predicted[k]
        gain = factor * run.gain[k]
        kept = np.eye(len(predicted)) - gain @ model.observation
        covariance = -kept @ predicted @ model.observation.T + gain @ model.noise
        updated = kept @ predicted @ kept.T + gain @ model.noise @ gain.T
        scale = np.sqrt(np.outer(np.diag(updated), np.diag(run.innovation[k])))
        worst = max(worst, float(np.abs(covariance / scale).max()))
    assert worst < 1e-10 if independent else worst > 1e-3


@pytest.mark.parametrize(
    ("degrees", "threshold", "shift", "within"),
    [
        (10, 5.0, 0.0, 1e-6),
        (10, 8.0, 30.0, 1e-6),
        (10, 30.0, 3.0, 1e-3),
        (300, 200.0, 50.0, 1e-11),
        (300, 400.0, 9.0, 1e-11),
    ],
)
def test_general_chi_square_agrees_with_its_special_cases(
    degrees: int, threshold: float, shift: float, within: float
) -> None:
    for weight in (1.0, 2.0):
        ours = log_general_chi2(
            threshold * weight, np.array([weight]), np.array([float(degrees)]), np.array([[shift]])
        )[0]
        assert ours == pytest.approx(
            float(np.log(stats.ncx2.cdf(threshold, degrees, max(shift, 1e-300)))), abs=within
        )


def test_general_chi_square_agrees_with_samples_and_with_its_approximation() -> None:
    rng = np.random.default_rng(3)
    weights, degrees, shifts = (
        np.array([1.0, 1.7, 4.0]),
        np.array([6.0, 1.0, 1.0]),
        np.array([[2.0, 0.5, 9.0]]),
    )
    draws = sum(
        w * stats.ncx2.rvs(d, s, size=400_000, random_state=rng)
        for w, d, s in zip(weights, degrees, shifts[0], strict=True)
    )
    for threshold in (15.0, 25.0, 60.0):
        exact_log = log_general_chi2(threshold, weights, degrees, shifts)[0]
        share = float(np.mean(draws < threshold))
        assert np.exp(exact_log) == pytest.approx(
            share, abs=5 * (share * (1 - share) / draws.size) ** 0.5
        )
        assert log_general_chi2_near(threshold, weights, degrees, shifts)[0] == pytest.approx(
            exact_log, abs=0.1
        )


def test_tracking_errors_exact_and_sampled_agree(quick: tuple[Scenario, Run]) -> None:
    scenario, run = quick
    of = tracking(run, monitor_of(scenario, run))
    draws = drawn(of, 20_000, np.random.default_rng(4))
    for sigma in (0.0, 0.0005, 0.001):
        ours = exact(of, sigma)
        assert sampled(of, sigma, draws).log10_risk == pytest.approx(ours.log10_risk, abs=0.05)


def test_conditional_parts_add_up(quick: tuple[Scenario, Run]) -> None:
    """Without tracking errors the conditional statistic is the noncentral chi-square of the
    whole.
    """
    scenario, run = quick
    of = tracking(run, monitor_of(scenario, run))
    weights, degrees, shifts = _conditional(of, 0.0, 7.0, np.zeros(1))
    assert degrees.sum() == len(run) * scenario.measurements
    assert shifts.sum() == pytest.approx(49.0, rel=1e-9)
    ours = log_general_chi2(of.monitor.threshold_squared, weights, degrees, shifts)[0]
    assert ours == pytest.approx(
        float(log_missed(49.0, of.monitor.threshold_squared, of.monitor.degrees)), abs=1e-9
    )


def test_a_covariance_without_meaning_is_refused(quick: tuple[Scenario, Run]) -> None:
    model = replace(quick[1].model, noise=-quick[1].model.noise)
    with pytest.raises(ScenarioError, match="lost its meaning"):
        covariances(model, np.zeros_like(model.initial), 1)
