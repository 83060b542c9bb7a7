"""Two scenarios: the calibrated one of Tanil et al. 2018 for its numbers, and a quick one for
laws.
"""

import pytest
from spoofbench_papers.integrity import Run, Scenario, monitored, published


@pytest.fixture(scope="session")
def calibrated() -> tuple[Scenario, Run]:
    scenario = published("tanil2018-C")
    return scenario, monitored(scenario)


@pytest.fixture(scope="session")
def quick() -> tuple[Scenario, Run]:
    scenario = published("tanil2018-N").at(warm_up_s=300.0, period_s=30.0)
    return scenario, monitored(scenario)
