"""The printed numbers of Tanil et al. 2018 that fix themselves, and those of the calibrated
scenario.
"""

import numpy as np
import pytest
from scipy import stats
from spoofbench_papers.integrity import Monitor, Run, Scenario, monitor_of, published, worst_case
from spoofbench_papers.integrity.risk import log_missed
from spoofbench_papers.integrity.scenario import ScenarioError
from spoofbench_papers.integrity.tracking import exact, tracking


def test_threshold(calibrated: tuple[Scenario, Run]) -> None:
    scenario, _ = calibrated
    assert scenario.epochs() == 281
    assert scenario.measurements == 10
    assert scenario.threshold_squared(281) ** 0.5 == pytest.approx(56.3990, abs=1e-4)


def test_missed_detection() -> None:
    assert np.exp(log_missed(718, 3180.852, 2810)) == pytest.approx(5.0963e-5, rel=1e-4)


def test_printed_triple_is_consistent() -> None:
    """(lambda, mu, I_r) = (26.8, 9.7 m, 5.9e-6) follow from Eq (45) with a slope of 0.36194 m and
    0.25 m deviation.
    """
    worst = worst_case(Monitor(0.36194, 0.25, float(stats.chi2.isf(1e-6, 2810)), 2810, 10.0))
    assert worst.error_m == pytest.approx(9.716, abs=1e-3)
    assert worst.noncentrality == pytest.approx(26.844, abs=3e-3)
    assert 10**worst.log10_risk == pytest.approx(5.82e-6, rel=2e-3)


def test_calibrated_scenario(calibrated: tuple[Scenario, Run]) -> None:
    monitor = monitor_of(*calibrated)
    worst = worst_case(monitor)
    assert monitor.slope_m == pytest.approx(0.361935, rel=2e-3)
    assert monitor.deviation_m == pytest.approx(0.25334, rel=5e-3)
    assert worst.noncentrality == pytest.approx(26.82, abs=0.08)
    assert worst.error_m == pytest.approx(9.707, abs=0.02)
    assert abs(worst.log10_risk - np.log10(5.96e-6)) < np.log10(1.2)


def test_tracking_errors_of_4_mm_are_detected(calibrated: tuple[Scenario, Run]) -> None:
    scenario, run = calibrated
    assert exact(tracking(run, monitor_of(scenario, run)), 0.004).log10_risk < -9


def test_unknown_scenario() -> None:
    with pytest.raises(ScenarioError, match="tanil2018-C"):
        published("nothing")
