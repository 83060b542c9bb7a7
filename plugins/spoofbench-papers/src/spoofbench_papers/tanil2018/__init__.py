"""Tanil et al. 2018, Figs 3-7: the integrity risk of a worst-case attack on a B747's final
approach.

Two scenarios: C, whose geometry and warm-up are tuned so that the printed numbers come out, and N,
an ordinary geometry, where only trends can be compared.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from spoofbench_papers.figures import save_table
from spoofbench_papers.integrity import (
    Run,
    Scenario,
    monitor_of,
    monitored,
    published,
    studies,
    worst_case,
    worst_fault,
)
from spoofbench_papers.integrity.closed_loop import (
    Response,
    altitude_autopilot,
    boeing_747,
    respond,
)
from spoofbench_papers.reproduction import Progress, Reproduced
from spoofbench_papers.tanil2018 import pictures
from spoofbench_papers.tanil2018.cells import cells

TITLE = "Tanil et al. 2018: an INS monitor against spoofers that track the vehicle"
PAPER = (
    "C. Tanil, S. Khanafseh, M. Joerger, B. Pervan: An INS Monitor to Detect GNSS Spoofers "
    "Capable of Tracking Vehicle Position, "
    "IEEE Transactions on Aerospace and Electronic Systems 54(1), 2018."
)

SCENARIOS = ("C", "N")
RATES_HZ = (0.5, 1.0, 2.0, 4.0, 8.0)
PERIODS_S = (130, 135, 140, 150, 160, 170, 180, 190, 200, 210)
SIGMAS_M = (0.0, 0.001, 0.002, 0.003, 0.0035, 0.004, 0.005, 0.006)
DELAYS_S = (0, 10, 20, 30, 40, 50, 60)
DETECTOR_WINDOW_S = 200
LATE_EPOCHS = (1, 41, 81, 121, 141)
MOTION_PERIODS_S = (140, 200, 280)
SAMPLES = (studies.PAPER_SAMPLES, studies.ENOUGH_SAMPLES)


def reproduce(out: Path, data: Path | None, quick: bool, progress: Progress) -> Reproduced:
    """Write ``fig3`` to ``fig7`` and ``late`` as Parquet and as pictures; see
    :class:`spoofbench_papers.reproduction.Reproduction`.
    """
    del data
    rates, periods = ((1.0, 2.0), (130, 135, 140, 210)) if quick else (RATES_HZ, PERIODS_S)
    sigmas = (0.0, 0.003, 0.004) if quick else SIGMAS_M
    delays = (0, 20, 60) if quick else DELAYS_S
    tables: dict[str, list[Mapping[str, Sequence[Any]]]] = {
        name: [] for name in ("fig3", "fig4", "fig6", "fig7", "late")
    }
    for number, name in enumerate(SCENARIOS):
        scenario = published(f"tanil2018-{name}")
        run = monitored(scenario, max(PERIODS_S))
        window = run.until(scenario.epochs(DETECTOR_WINDOW_S))
        parts: dict[str, Callable[[], studies.Columns]] = {
            "fig3": partial(_worst, scenario, run.until(scenario.epochs())),
            "late": partial(_late, scenario, run),
            "fig4": partial(studies.over_rates, scenario, rates, periods),
            "fig6": partial(studies.over_tracking, scenario, run, sigmas, periods, SAMPLES),
            "fig7": partial(studies.over_delays, scenario, window, sigmas, delays),
        }
        for done, (part, make) in enumerate(parts.items()):
            columns = make()
            tables[part].append({"scenario": [name] * len(next(iter(columns.values()))), **columns})
            progress((number + (done + 1) / len(parts)) / len(SCENARIOS) * 0.95)
    joined = {name: _joined(parts) for name, parts in tables.items()}
    for name, table in joined.items():
        save_table(table, out / f"{name}.parquet")
    motion = _motion(published("tanil2018-C"))
    return Reproduced(cells(joined, motion), pictures.draw(out, joined, motion), NOTES)


NOTES = (
    (
        "C is calibrated: satellite geometry and warm-up, on which the paper is silent, were "
        "tuned until its numbers came out. "
        "Agreement of C with the printed numbers is therefore no confirmation of them; agreement "
        "of trends is."
    ),
    (
        "The estimator cannot have reached a steady state: with constant ambiguities the vertical "
        "deviation falls like 1/sqrt(t). "
        "A finite warm-up is implied."
    ),
    (
        "The plateau with the GNSS rate does not come out: rho hardly depends on the rate, and the "
        "degrees of freedom make the risk grow."
    ),
    (
        f"The paper averages over {studies.PAPER_SAMPLES} samples of the tracking error, biased "
        "low by orders of magnitude beyond 3 mm: "
        f"fig6.parquet has the exact value beside {studies.PAPER_SAMPLES} and "
        f"{studies.ENOUGH_SAMPLES} samples."
    ),
    (
        "Eq (75) as printed has a misplaced inverse, and Eq (33) leaves out gravity and Coriolis "
        "terms; both are corrected here."
    ),
    (
        "The autopilot's gains are not published; ours is a linear quadratic regulator. Nothing "
        "but Fig 5 depends on it."
    ),
)


def _worst(scenario: Scenario, run: Run) -> studies.Columns:
    monitor = monitor_of(scenario, run)
    worst = worst_case(monitor)
    row = {
        "threshold": monitor.threshold_squared**0.5,
        "lambda": worst.noncentrality,
        "mu_m": worst.error_m,
        "sigma_eps_m": monitor.deviation_m,
        "rho_m": monitor.slope_m,
        "integrity_risk": 10**worst.log10_risk,
    }
    return studies.columns([row])


def _late(scenario: Scenario, run: Run) -> studies.Columns:
    parts = [
        studies.late_slopes(run.until(scenario.epochs(period)), LATE_EPOCHS)
        for period in (scenario.period_s, DETECTOR_WINDOW_S)
    ]
    return _joined(parts)


def _motion(scenario: Scenario) -> dict[int, Response]:
    """The closed loop's response to worst-case faults scaled to 10 m, by attack period."""
    aircraft = boeing_747()
    gains, whole = altitude_autopilot(aircraft), monitored(scenario, max(MOTION_PERIODS_S))
    responses = {}
    for period in MOTION_PERIODS_S:
        run = whole.until(scenario.epochs(period))
        fault = worst_fault(run)
        scaled = fault.scaled(-scenario.alert_limit_m / fault.vertical_error_m)
        responses[period] = respond(run, aircraft, gains, scaled.measurement, 1 / scenario.rate_hz)
    return responses


def _joined(parts: Sequence[Mapping[str, Sequence[Any]]]) -> dict[str, list[Any]]:
    return {name: [value for part in parts for value in part[name]] for name in parts[0]}
