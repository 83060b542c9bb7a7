"""Integrity risk over the attack's period, the GNSS rate, the spoofer's tracking error and the
attack's delay.

Each study returns columns of one length, shape ``(rows,)``. Risks are those of the worst case over
the fault's magnitude; they are given as log10 besides, since the smallest cannot be written as a
number.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from spoofbench_papers.integrity import monitor_of, monitored, slopes_squared
from spoofbench_papers.integrity.filtering import Run
from spoofbench_papers.integrity.risk import WorstCase, worst_case
from spoofbench_papers.integrity.scenario import Scenario
from spoofbench_papers.integrity.tracking import Tracking, drawn, exact, sampled, tracking

Columns = dict[str, list[Any]]

PAPER_SAMPLES, ENOUGH_SAMPLES = 20, 20_000


def over_rates(
    scenario: Scenario, rates_hz: Sequence[float], periods_s: Sequence[float]
) -> Columns:
    """Return ``rate_hz period_s integrity_risk log10_integrity_risk slope_m deviation_m error_m
    noncentrality``.
    """
    rows = []
    for rate in rates_hz:
        at = scenario.at(rate_hz=float(rate))
        run = monitored(at, max(periods_s))
        for period in periods_s:
            monitor = monitor_of(at, run, epochs=at.epochs(period))
            worst = worst_case(monitor)
            rows.append(
                {
                    "rate_hz": rate,
                    "period_s": period,
                    **risk(worst),
                    "slope_m": monitor.slope_m,
                    "deviation_m": monitor.deviation_m,
                }
            )
    return columns(rows)


def over_tracking(
    scenario: Scenario,
    run: Run,
    sigmas_m: Sequence[float],
    periods_s: Sequence[float],
    samples: Sequence[int] = (),
) -> Columns:
    """Return ``sigma_mm period_s integrity_risk log10_integrity_risk error_m noncentrality
    method``.

    ``method`` is ``exact``, or ``samples-<m>`` for each number of samples asked for.
    """
    rows = []
    for period in periods_s:
        of = _tracking(scenario, run, 1, scenario.epochs(period))
        draws = {count: drawn(of, count, np.random.default_rng(0)) for count in samples}
        for sigma in sigmas_m:
            worst = {"exact": exact(of, sigma)} | {
                f"samples-{count}": sampled(of, sigma, draws[count]) for count in samples
            }
            rows += [
                {"sigma_mm": 1000 * sigma, "period_s": period, **risk(case), "method": method}
                for method, case in worst.items()
            ]
    return columns(rows)


def over_delays(
    scenario: Scenario, run: Run, sigmas_m: Sequence[float], delays_s: Sequence[float]
) -> Columns:
    """Return ``sigma_mm delay_s integrity_risk log10_integrity_risk error_m noncentrality`` of
    attacks that start late in the run.
    """
    rows = []
    for delay in delays_s:
        of = _tracking(scenario, run, round(delay * scenario.rate_hz) + 1, len(run))
        rows += [
            {"sigma_mm": 1000 * sigma, "delay_s": delay, **risk(exact(of, sigma))}
            for sigma in sigmas_m
        ]
    return columns(rows)


def late_slopes(run: Run, firsts: Sequence[int]) -> Columns:
    """Return ``first_epoch last_epoch rho_squared_m2`` of attacks from each epoch on to the end of
    the run, epochs counted from 1.
    """
    return columns(
        [
            {
                "first_epoch": first,
                "last_epoch": len(run),
                "rho_squared_m2": float(slopes_squared(run, first)[-1]),
            }
            for first in firsts
        ]
    )


def risk(worst: WorstCase) -> dict[str, float]:
    """Return a worst case as a row: a risk below the smallest number is 0 there, and as it is in
    its logarithm.
    """
    with np.errstate(under="ignore"):
        value = float(np.power(10.0, worst.log10_risk))
    return {
        "integrity_risk": value,
        "log10_integrity_risk": float(worst.log10_risk),
        "error_m": float(worst.error_m),
        "noncentrality": float(worst.noncentrality),
    }


def columns(rows: Sequence[dict[str, Any]]) -> Columns:
    """Return rows of equal keys as columns."""
    return {name: [row[name] for row in rows] for name in (rows[0] if rows else ())}


def _tracking(scenario: Scenario, run: Run, first: int, last: int) -> Tracking:
    return tracking(run.until(last), monitor_of(scenario, run, first, last), first)
