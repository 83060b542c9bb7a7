"""A filter that believes in another error model: expectations against simulation, and the findings
of Kujur et al.
"""

from dataclasses import replace

import numpy as np
import pytest
from spoofbench_papers.integrity import Run, Scenario, linear_model, published, worst_fault
from spoofbench_papers.integrity.filtering import covariances, expected_statistic

RUNS = 4000


def test_true_belief_gives_the_chi_square_mean(quick: tuple[Scenario, Run]) -> None:
    scenario, run = quick
    fault = worst_fault(run).scaled(5.0)
    warm = round(scenario.warm_up_s * scenario.rate_hz)
    expected = expected_statistic(run.model, run.model, warm, fault.measurement)
    assert expected.by_noise == pytest.approx(len(run) * scenario.measurements, rel=1e-9)
    assert expected.by_fault == pytest.approx(25.0, rel=1e-9)


def test_wrong_belief_agrees_with_simulation() -> None:
    """Truth and filter differ in every time constant and deviation; the mean statistic of random
    runs is the expected one.
    """
    scenario = published("kujur").at(period_s=10.0)
    imu, gnss = scenario.imu, scenario.gnss
    wrong = scenario.at(
        imu=replace(
            imu,
            accel_bias_mps2=imu.accel_bias_mps2 * 20,
            accel_bias_s=30.0,
            velocity_random_walk=imu.velocity_random_walk * 3,
        ),
        gnss=replace(
            gnss,
            code_multipath_s=3.0,
            carrier_multipath_s=200.0,
            code_multipath_m=0.3,
            carrier_noise_m=0.004,
        ),
    )
    truth, belief = linear_model(scenario), linear_model(wrong)
    rng, warm, fault = np.random.default_rng(5), 40, np.full((11, scenario.measurements), 0.02)
    expected = expected_statistic(truth, belief, warm, fault)

    run = covariances(belief, belief.initial, warm + len(fault))
    roots = [
        np.linalg.cholesky(part + 1e-20 * np.eye(len(part)))
        for part in (truth.initial, truth.process, truth.noise)
    ]
    state = rng.standard_normal((RUNS, len(truth.initial))) @ roots[0].T
    estimate, statistic = np.zeros_like(state), np.zeros(RUNS)
    for k in range(len(run)):
        state = state @ truth.transition.T + rng.standard_normal(state.shape) @ roots[1].T
        estimate = estimate @ belief.transition.T
        measured = (
            state @ truth.observation.T + rng.standard_normal((RUNS, len(truth.noise))) @ roots[2].T
        )
        innovation = (
            measured + (fault[k - warm] if k >= warm else 0) - estimate @ truth.observation.T
        )
        estimate = estimate + innovation @ run.gain[k].T
        if k >= warm:
            statistic += np.einsum(
                "ri,ri->r", innovation, np.linalg.solve(run.innovation[k], innovation.T).T
            )
    assert statistic.mean() == pytest.approx(expected.total, abs=4 * statistic.std() / RUNS**0.5)


@pytest.mark.parametrize("factor", [0.5, 2.0])
@pytest.mark.parametrize(
    "field", ["code_noise_m", "carrier_noise_m", "code_multipath_m", "carrier_multipath_m"]
)
def test_monitor_is_sensitive_to_gnss_errors(field: str, factor: float) -> None:
    """Overestimated deviations lower the statistic, underestimated ones raise it, by more than 15 %
    (Kujur et al., Figs 3 and 4).
    """
    scenario = published("kujur")
    truth = linear_model(scenario)
    belief = linear_model(
        scenario.at(gnss=replace(scenario.gnss, **{field: getattr(scenario.gnss, field) * factor}))
    )
    fault = np.zeros((scenario.epochs(), scenario.measurements))
    nominal, changed = (
        expected_statistic(truth, model, 300, fault).by_noise for model in (truth, belief)
    )
    assert (changed / nominal - 1) * (1 if factor < 1 else -1) > 0.15
