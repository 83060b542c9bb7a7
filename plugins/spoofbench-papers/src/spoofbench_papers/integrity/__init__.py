"""How well an innovation monitor protects: covariance analysis, worst-case fault, integrity risk
(Tanil et al. 2018).

A :class:`~spoofbench_papers.integrity.scenario.Scenario` says the geometry, rates, error models and
thresholds; the rest is linear algebra, without one random number but where samples are asked for::

    scenario = load_scenario(Path("mine.toml"))
    run = monitored(scenario)
    print(worst_case(monitor_of(scenario, run)))
"""

from importlib import resources
from pathlib import Path

from spoofbench_papers.integrity.fault import (
    Fault,
    fault_of_measurements,
    slopes_squared,
    worst_fault,
)
from spoofbench_papers.integrity.filtering import Run, covariances, warmed_up
from spoofbench_papers.integrity.model import ALTITUDE, LinearModel, linear_model
from spoofbench_papers.integrity.risk import Monitor, WorstCase, worst_case
from spoofbench_papers.integrity.scenario import (
    GnssErrors,
    ImuErrors,
    InitialErrors,
    Scenario,
    ScenarioError,
    load_scenario,
)

__all__ = [
    "Fault",
    "GnssErrors",
    "ImuErrors",
    "InitialErrors",
    "LinearModel",
    "Monitor",
    "Run",
    "Scenario",
    "WorstCase",
    "covariances",
    "fault_of_measurements",
    "linear_model",
    "load_scenario",
    "monitor_of",
    "monitored",
    "published",
    "slopes_squared",
    "warmed_up",
    "worst_case",
    "worst_fault",
]


def published(name: str) -> Scenario:
    """Return a scenario that comes with spoofbench: ``tanil2018-C``, ``tanil2018-N`` or ``kujur``.

    Raises:
        ScenarioError: there is none of this name.
    """
    folder = Path(str(resources.files("spoofbench_papers.integrity"))) / "scenarios"
    known = sorted(path.stem for path in folder.glob("*.toml"))
    if name not in known:
        raise ScenarioError(f"there is no scenario {name!r}; there are {known}")
    return load_scenario(folder / f"{name}.toml")


def monitored(scenario: Scenario, period_s: float | None = None) -> Run:
    """Return the filter's covariances over the monitor's epochs, after the warm-up; the period is
    the scenario's unless given.
    """
    model = linear_model(scenario)
    start = warmed_up(model, round(scenario.warm_up_s * scenario.rate_hz))
    return covariances(model, start, scenario.epochs(period_s))


def monitor_of(scenario: Scenario, run: Run, first: int = 1, epochs: int | None = None) -> Monitor:
    """Return what decides the risk of the worst attack from an epoch on; the monitor ends after
    ``epochs`` (all, unless given).
    """
    last = len(run) if epochs is None else epochs
    return Monitor(
        slope_m=float(slopes_squared(run, first)[last - 1] ** 0.5),
        deviation_m=float(run.updated[last - 1, ALTITUDE, ALTITUDE] ** 0.5),
        threshold_squared=scenario.threshold_squared(last),
        degrees=last * scenario.measurements,
        alert_limit_m=scenario.alert_limit_m,
    )
