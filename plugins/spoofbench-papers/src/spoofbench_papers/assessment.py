"""An integrity assessment of one's own vehicle: from a scenario file to tables, pictures and a page
of numbers.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from spoofbench.results import write_whole
from spoofbench_papers.figures import make_folder, new_figure, save_figure, save_table
from spoofbench_papers.integrity import (
    Run,
    Scenario,
    load_scenario,
    monitor_of,
    monitored,
    studies,
    worst_case,
    worst_fault,
)
from spoofbench_papers.integrity.scenario import ScenarioError

PERIODS = (0.8, 0.9, 1.0, 1.1, 1.25, 1.5)
RATES = (0.25, 0.5, 1.0, 2.0)
DELAYS = (0.0, 0.1, 0.2, 0.3, 0.4)
SIGMAS_M = (0.0, 0.001, 0.002, 0.004, 0.008)
MOST_EPOCHS = 1200
"""Of an attack; memory grows with the square of their number, to some 2 GB."""

Table = Mapping[str, Sequence[Any]]


def assess(path: Path, out: Path, progress: Callable[[float], None]) -> dict[str, float]:
    """Assess a scenario and write everything into a folder.

    Writes ``summary.json``; ``fault.parquet``, the worst-case fault at the magnitude of the highest
    risk, by epoch and measurement (code, then carrier differences); ``periods_and_rates.parquet``,
    ``tracking.parquet`` and ``delays.parquet`` with their pictures. Grids are multiples of the
    scenario's own period and rate.

    Args:
        path: a scenario file, see :func:`spoofbench_papers.integrity.load_scenario`.
        out: the folder.
        progress: is told the share that is done, 0 to 1.

    Raises:
        ScenarioError: the scenario cannot be read or makes no sense, or its attack has too many
            epochs.
        ResultsError: the folder cannot be made, or a file not written.
    """
    scenario = load_scenario(path)
    if scenario.epochs() > MOST_EPOCHS:
        raise ScenarioError(
            f"the attack in {path.name!r} has {scenario.epochs()} epochs, {MOST_EPOCHS} at most "
            "can be assessed; lower period_s or rate_hz"
        )
    make_folder(out)
    periods = [round(scenario.period_s * factor, 3) for factor in PERIODS]
    run = monitored(scenario, max(periods))
    progress(0.2)
    own = run.until(scenario.epochs())
    summary = _summary(scenario, own)
    write_whole(
        out / "summary.json",
        partial(Path.write_text, data=json.dumps(summary, indent=1) + "\n", encoding="utf-8"),
    )
    save_table(_fault(own, summary["noncentrality"]), out / "fault.parquet")
    _draw_fault(out / "fault", own, summary["noncentrality"], scenario.rate_hz)
    parts: list[tuple[str, Table, tuple[str, str], tuple[str, str]]] = []
    rates = [scenario.rate_hz * factor for factor in RATES]
    delays = [scenario.period_s * factor for factor in DELAYS]
    for name, make, along, by in (
        (
            "periods_and_rates",
            partial(studies.over_rates, scenario, rates, periods),
            ("period_s", "attack period, s"),
            ("rate_hz", "Hz"),
        ),
        (
            "tracking",
            partial(studies.over_tracking, scenario, run, SIGMAS_M, periods),
            ("period_s", "attack period, s"),
            ("sigma_mm", "mm"),
        ),
        (
            "delays",
            partial(studies.over_delays, scenario, own, SIGMAS_M, delays),
            ("delay_s", "attack delay, s"),
            ("sigma_mm", "mm"),
        ),
    ):
        parts.append((name, make(), along, by))
        progress(0.2 + 0.25 * len(parts))
    for name, table, along, by in parts:
        named = {"scenario": [scenario.name] * len(table[along[0]]), **table}
        save_table(named, out / f"{name}.parquet")
        draw_risk(out / name, named, along, by)
    progress(1.0)
    return summary


def draw_risk(path: Path, table: Table, along: tuple[str, str], by: tuple[str, str]) -> None:
    """Draw log10 of the risk, one panel per scenario, one line per value of a column.

    Args:
        path: of the pictures, without suffix.
        table: with columns ``scenario`` and ``log10_integrity_risk``.
        along: the column of the horizontal axis, and its label.
        by: the column that tells lines apart, and its unit.
    """
    scenarios = sorted(set(table["scenario"]))
    figure, axes = new_figure(1.5 + 3.8 * len(scenarios), 4.0, columns=len(scenarios))
    for panel, scenario in zip(np.atleast_1d(axes), scenarios, strict=True):
        for value in sorted(set(table[by[0]])):
            rows = [
                i
                for i, s in enumerate(table["scenario"])
                if s == scenario and table[by[0]][i] == value
            ]
            rows.sort(key=lambda i: table[along[0]][i])
            risks = [table["log10_integrity_risk"][i] for i in rows]
            panel.plot(
                [table[along[0]][i] for i in rows], risks, marker=".", label=f"{value:g} {by[1]}"
            )
        panel.axhline(-9, color="k", lw=0.6, ls=":")
        panel.set_title(f"scenario {scenario}", fontsize=10, parse_math=False)
        panel.set_xlabel(along[1])
        panel.set_ylabel("log10 integrity risk")
    figure.legend(
        *np.atleast_1d(axes)[0].get_legend_handles_labels(), loc="outside right center", fontsize=8
    )
    save_figure(figure, path)


def _summary(scenario: Scenario, run: Run) -> dict[str, float]:
    monitor = monitor_of(scenario, run)
    return {
        "epochs": len(run),
        "measurements": scenario.measurements,
        "threshold": monitor.threshold_squared**0.5,
        "slope_m": monitor.slope_m,
        "deviation_m": monitor.deviation_m,
        **studies.risk(worst_case(monitor)),
    }


def _fault(run: Run, noncentrality: float) -> dict[str, Any]:
    fault = worst_fault(run).scaled(noncentrality).measurement
    epochs, count = fault.shape
    return {
        "epoch": np.repeat(np.arange(1, epochs + 1), count),
        "measurement": np.tile(np.arange(1, count + 1), epochs),
        "fault_m": fault.reshape(-1),
    }


def _draw_fault(path: Path, run: Run, noncentrality: float, rate_hz: float) -> None:
    fault = worst_fault(run).scaled(noncentrality)
    figure, axes = new_figure(9.0, 3.8, columns=2)
    time = np.arange(len(run)) / rate_hz
    axes[0].plot(time, fault.measurement[:, fault.measurement.shape[1] // 2 :])
    axes[0].set_ylabel("fault of the carrier differences, m")
    axes[1].plot(time, fault.error[:, :3], label=["north", "east", "down"])
    axes[1].set_ylabel("error of the estimated position, m")
    axes[1].legend(fontsize=8)
    for panel in axes:
        panel.set_xlabel("time since the start of the attack, s")
    save_figure(figure, path)
