"""Kujur et al., Tables II and III, Figs 2-4: one parameter of the filter's error model wrong at a
time.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from spoofbench.arrays import Floats
from spoofbench_papers.figures import new_figure, save_figure, save_table
from spoofbench_papers.integrity import (
    LinearModel,
    Scenario,
    linear_model,
    monitored,
    published,
    worst_fault,
)
from spoofbench_papers.integrity.filtering import Expected, covariances, expected_statistic
from spoofbench_papers.reproduction import Cell, Picture, Progress, Reproduced

TITLE = "Kujur et al.: sensitivity of innovation monitors to uncertainty in error modelling"
PAPER = (
    "B. Kujur, C. Tanil, S. Khanafseh, B. Pervan: Sensitivity of Innovation Monitors to "
    "Uncertainty in Error Modeling."
)

GNSS = ("v_mrho", "v_mphi", "v_thrho", "v_thphi", "tau_mrho", "tau_mphi")
IMU = ("eta_a", "eta_w", "v_ba", "v_bw", "tau_ba", "tau_bw")
SIGMAS = {
    "v_mrho": "code_multipath_m",
    "v_mphi": "carrier_multipath_m",
    "v_thrho": "code_noise_m",
    "v_thphi": "carrier_noise_m",
}
WHITE = {"eta_a": "velocity_random_walk", "eta_w": "angle_random_walk"}
BIASES = {"ba": ("accel_bias_mps2", "accel_bias_s"), "bw": ("gyro_bias_radps", "gyro_bias_s")}
BOUNDS = {"lower": 0.5, "upper": 2.0}
MULTIPATH_BOUNDS = {"lower": 0.1, "upper": 10.0}


def believed(scenario: Scenario, parameter: str, bound: str) -> Scenario:
    """Return the scenario as a filter believes it that has one parameter at a bound (Tables II and
    III).

    Multipath deviations are steady-state ones, held when the time constant changes; the driving
    noise of biases is held when theirs does.
    """
    imu, gnss, factor = scenario.imu, scenario.gnss, BOUNDS[bound]
    if parameter in SIGMAS:
        return scenario.at(
            gnss=replace(gnss, **{SIGMAS[parameter]: getattr(gnss, SIGMAS[parameter]) * factor})
        )
    if parameter in WHITE:
        return scenario.at(
            imu=replace(imu, **{WHITE[parameter]: getattr(imu, WHITE[parameter]) * factor})
        )
    if parameter in ("tau_mrho", "tau_mphi"):
        field = {"tau_mrho": "code_multipath_s", "tau_mphi": "carrier_multipath_s"}[parameter]
        return scenario.at(
            gnss=replace(gnss, **{field: getattr(gnss, field) * MULTIPATH_BOUNDS[bound]})
        )
    deviation, time = BIASES[parameter[-2:]]
    if parameter.startswith("v_"):
        return scenario.at(imu=replace(imu, **{deviation: getattr(imu, deviation) * factor}))
    changed = {time: getattr(imu, time) * factor, deviation: getattr(imu, deviation) * factor**0.5}
    return scenario.at(imu=replace(imu, **changed))


def reproduce(out: Path, data: Path | None, quick: bool, progress: Progress) -> Reproduced:
    """Write ``sensitivity.parquet`` and Figs 2-4 in kind; see
    :class:`spoofbench_papers.reproduction.Reproduction`.
    """
    del data
    scenario = published("kujur")
    truth, run = linear_model(scenario), monitored(scenario)
    worst = worst_fault(run)
    fault = worst.scaled(scenario.alert_limit_m / abs(worst.vertical_error_m))
    warm_up = round(scenario.warm_up_s * scenario.rate_hz)
    nominal = expected_statistic(truth, truth, warm_up, fault.measurement)
    rows, simulated = [], []
    for place, (parameter, bound) in enumerate((p, b) for p in (*IMU, *GNSS) for b in BOUNDS):
        belief = linear_model(believed(scenario, parameter, bound))
        rows += list(
            _changes(
                parameter,
                bound,
                nominal,
                expected_statistic(truth, belief, warm_up, fault.measurement),
            )
        )
        progress((place + 1) / 30)
    shown = ("v_thphi", "tau_mphi", "eta_a") if quick else (*GNSS, *IMU)
    for parameter in shown:
        simulated += _simulated(truth, scenario, parameter, fault.measurement, 40 if quick else 400)
    table = {name: [row[name] for row in rows] for name in rows[0]}
    save_table(table, out / "sensitivity.parquet")
    save_table(
        {name: [row[name] for row in simulated] for name in simulated[0]},
        out / "monte_carlo.parquet",
    )
    _bars(out, rows, simulated)
    threshold = scenario.threshold_squared(len(run))
    _example(out, scenario, truth, fault.measurement)
    cells = [*_cells(rows), _detection(nominal, threshold)]
    pictures = [
        Picture(
            "fig3",
            (
                "Fig 3 in kind: change of E[q] without spoofing. Bars are analytic, crosses Monte "
                "Carlo with 95 % interval."
            ),
        ),
        Picture(
            "fig4",
            (
                "Fig 4 in kind: change of E[q] under the nominal model's worst-case fault, scaled "
                "to 10 m in 120 s."
            ),
        ),
        Picture(
            "fig2",
            (
                "Fig 2 in kind: E[q] over its threshold, right and wrong error model, under that "
                "fault."
            ),
        ),
    ]
    notes = [
        (
            "Geometry, warm-up (1800 s) and P_FA are not in the paper and are chosen here; nothing "
            "is tuned."
        ),
        (
            "The paper shows Figs 3 and 4 as bars without numbers: its text fixes signs and which "
            "parameters matter, and these are compared."
        ),
        _agreement(rows, simulated),
    ]
    progress(1.0)
    return Reproduced(cells, pictures, notes)


def _changes(
    parameter: str, bound: str, nominal: Expected, wrong: Expected
) -> Iterator[dict[str, Any]]:
    for case, ours, base in (
        ("spoof_free", wrong.by_noise, nominal.by_noise),
        ("spoofed", wrong.total, nominal.total),
    ):
        yield {
            "parameter": parameter,
            "bound": bound,
            "case": case,
            "change_pct": 100 * (ours / base - 1),
        }


def _simulated(
    truth: LinearModel, scenario: Scenario, parameter: str, fault: Floats, runs: int
) -> list[dict[str, Any]]:
    """Change of q from random runs, right and wrong filter on the same random numbers, with its 95
    % interval.
    """
    warm_up = round(scenario.warm_up_s * scenario.rate_hz)
    rows = []
    for bound in BOUNDS:
        models = {"right": truth, "wrong": linear_model(believed(scenario, parameter, bound))}
        for case, added in (("spoof_free", 0.0), ("spoofed", 1.0)):
            q = {
                name: random_statistics(truth, model, warm_up, added * fault, runs)
                for name, model in models.items()
            }
            change = 100 * (q["wrong"] - q["right"]) / q["right"].mean()
            half = 1.96 * float(change.std(ddof=1)) / runs**0.5
            rows.append(
                {
                    "parameter": parameter,
                    "bound": bound,
                    "case": case,
                    "change_pct": float(change.mean()),
                    "half_width_pct": half,
                }
            )
    return rows


def random_statistics(
    truth: LinearModel, belief: LinearModel, warm_up: int, fault: Floats, runs: int
) -> Floats:
    """Return the cumulative statistic of random runs, ``(runs,)``; equal arguments but the belief
    share their random numbers.
    """
    rng = np.random.default_rng(0)
    run = covariances(belief, belief.initial, warm_up + len(fault))
    roots = [_root(part) for part in (truth.initial, truth.process, truth.noise)]
    state = rng.standard_normal((runs, len(truth.initial))) @ roots[0].T
    estimate, statistic = np.zeros_like(state), np.zeros(runs)
    for k in range(len(run)):
        state = state @ truth.transition.T + rng.standard_normal(state.shape) @ roots[1].T
        measured = (
            state @ truth.observation.T + rng.standard_normal((runs, len(truth.noise))) @ roots[2].T
        )
        estimate = estimate @ belief.transition.T
        innovation = (
            measured
            - estimate @ truth.observation.T
            + (fault[k - warm_up] if k >= warm_up else 0.0)
        )
        estimate = estimate + innovation @ run.gain[k].T
        if k >= warm_up:
            statistic += np.einsum(
                "ri,ir->r", innovation, np.linalg.solve(run.innovation[k], innovation.T)
            )
    return statistic


def _root(covariance: Floats) -> Floats:
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0)))


def _cells(rows: list[dict[str, Any]]) -> Iterator[Cell]:
    change = {(row["parameter"], row["bound"], row["case"]): row["change_pct"] for row in rows}
    for case, most in (("spoof_free", 5.0), ("spoofed", 10.0)):
        least = min(max(abs(change[p, b, case]) for b in BOUNDS) for p in GNSS)
        largest = max(abs(change[p, b, case]) for p in IMU for b in BOUNDS)
        figure = "Fig 3" if case == "spoof_free" else "Fig 4"
        yield Cell(
            f"{figure}: GNSS parameters matter, IMU parameters hardly ({case.replace('_', ' ')})",
            None, least / largest, None, None,
            "trend only" if least > 15 and largest < most else "not reproduced",
            (
                f"the least sensitive GNSS parameter moves E[q] by {least:.1f} %, the most "
                f"sensitive IMU parameter by {largest:.1f} %"
            ),
        )  # fmt: skip
    signs = [(p, "upper", -1) for p in SIGMAS] + [(p, "lower", 1) for p in SIGMAS]
    signs += [(p, "upper", 1) for p in ("tau_mrho", "tau_mphi")] + [
        (p, "lower", -1) for p in ("tau_mrho", "tau_mphi")
    ]
    for case in ("spoof_free", "spoofed"):
        right = sum(np.sign(change[p, b, case]) == sign for p, b, sign in signs)
        yield Cell(
            f"signs of the GNSS parameters ({case.replace('_', ' ')})",
            f"{len(signs)} of {len(signs)}", f"{right} of {len(signs)}", None, None,
            "matches" if right == len(signs) else "not reproduced",
            (
                "overestimated deviations and underestimated multipath time constants lower the "
                "statistic, as the text says"
            ),
        )  # fmt: skip


def _detection(nominal: Expected, threshold: float) -> Cell:
    return Cell(
        "Fig 2: the worst-case fault of 10 m is detected with the right model", "q / T^2 > 1",
        nominal.total / threshold, None, None,
        "not reproduced" if nominal.total < threshold else "matches",
        (
            f"E[q] is {nominal.total:.0f} of a threshold of {threshold:.0f}: a fault that is the "
            "worst of the very model is not detected by it"
        ),
    )  # fmt: skip


def _agreement(rows: list[dict[str, Any]], simulated: list[dict[str, Any]]) -> str:
    key = ("parameter", "bound", "case")
    analytic = {tuple(row[name] for name in key): row["change_pct"] for row in rows}
    inside = sum(
        abs(analytic[tuple(row[name] for name in key)] - row["change_pct"]) <= row["half_width_pct"]
        for row in simulated
    )
    return (
        f"Monte Carlo beside the analytic change of E[q]: {inside} of {len(simulated)} of its 95 % "
        "intervals hold the analytic value."
    )


def _bars(out: Path, rows: list[dict[str, Any]], simulated: list[dict[str, Any]]) -> None:
    for name, case in (("fig3", "spoof_free"), ("fig4", "spoofed")):
        figure, axes = new_figure(8.0, 4.0)
        parameters = (*IMU, *GNSS)
        for shift, bound, color in ((-0.2, "lower", "#3b6fb6"), (0.2, "upper", "#d07a2d")):
            heights = [
                next(
                    r["change_pct"]
                    for r in rows
                    if (r["parameter"], r["bound"], r["case"]) == (p, bound, case)
                )
                for p in parameters
            ]
            axes.bar(
                np.arange(len(parameters)) + shift,
                heights,
                0.38,
                color=color,
                label=f"{bound} bound",
            )
            drawn = [r for r in simulated if r["bound"] == bound and r["case"] == case]
            places = [parameters.index(r["parameter"]) + shift for r in drawn]
            axes.errorbar(
                places,
                [r["change_pct"] for r in drawn],
                [r["half_width_pct"] for r in drawn],
                fmt="kx",
                ms=4,
                lw=1,
            )
        axes.set_xticks(np.arange(len(parameters)), parameters, rotation=40, ha="right")
        axes.set_ylabel("change of E[q], %")
        axes.axhline(0, color="k", lw=0.6)
        axes.legend()
        save_figure(figure, out / name)


def _example(out: Path, scenario: Scenario, truth: LinearModel, fault: Floats) -> None:
    """Draw E[q_k] / T_k^2 over the attack for the right model and for a carrier noise taken twice
    too large.
    """
    figure, axes = new_figure(7.0, 3.6)
    warm_up = round(scenario.warm_up_s * scenario.rate_hz)
    ends = range(5, len(fault) + 1, 5)
    for label, model in (
        ("right model", truth),
        ("carrier noise twice too large", linear_model(believed(scenario, "v_thphi", "upper"))),
    ):
        ratios = [
            expected_statistic(truth, model, warm_up, fault[:end]).total
            / scenario.threshold_squared(end)
            for end in ends
        ]
        axes.plot([(end - 1) / scenario.rate_hz for end in ends], ratios, label=label)
    axes.axhline(1, color="k", lw=0.8, ls="--")
    axes.set_xlabel("time since the start of the attack, s")
    axes.set_ylabel("E[q] / T^2")
    axes.legend()
    save_figure(figure, out / "fig2")
