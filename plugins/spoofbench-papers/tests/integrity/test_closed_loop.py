"""The closed loop of Eq (37): the aircraft follows the false altitude, and nothing of it reaches
the monitor.
"""

import numpy as np
import pytest
from spoofbench_papers.integrity import ALTITUDE, Run, Scenario, worst_fault
from spoofbench_papers.integrity.closed_loop import altitude_autopilot, boeing_747, respond
from spoofbench_papers.integrity.filtering import covariances


def test_autopilot_is_stable() -> None:
    aircraft = boeing_747()
    assert (
        np.linalg.eigvals(
            aircraft.dynamics - aircraft.control @ altitude_autopilot(aircraft)
        ).real.max()
        < -0.1
    )


@pytest.mark.parametrize("period_s", [140, 200, 280])
def test_altitude_mirrors_its_error(calibrated: tuple[Scenario, Run], period_s: float) -> None:
    scenario, run = calibrated
    run = covariances(run.model, run.start, scenario.epochs(period_s))
    fault = worst_fault(run)
    aircraft = boeing_747()
    response = respond(
        run,
        aircraft,
        altitude_autopilot(aircraft),
        fault.scaled(10 / fault.vertical_error_m).measurement,
        0.5,
    )
    assert np.corrcoef(response.state[:, ALTITUDE], response.error[:, ALTITUDE])[0, 1] < -0.999
    assert (
        np.corrcoef(response.aircraft[:, 4], response.error[:, ALTITUDE])[0, 1] > 0.999
    )  # the altitude is up, the error down


def test_monitor_does_not_see_the_autopilot(quick: tuple[Scenario, Run]) -> None:
    run = quick[1]
    aircraft = boeing_747()
    gains, fault = altitude_autopilot(aircraft), worst_fault(run)
    responses = [
        respond(run, aircraft, factor * gains, fault.measurement, 0.5) for factor in (0.0, 0.5, 1.0)
    ]
    for response in responses:
        np.testing.assert_allclose(
            response.error, fault.error, atol=1e-12 * np.abs(fault.error).max()
        )
        np.testing.assert_allclose(
            response.innovation, fault.innovation, atol=1e-10 * np.abs(fault.innovation).max()
        )
    assert (
        np.abs(responses[1].state - responses[2].state).max()
        > 1e-3 * np.abs(responses[2].state).max()
    )
