"""The figures of Tanil et al. 2018, as ours come out."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from spoofbench.arrays import Floats
from spoofbench_papers.assessment import draw_risk
from spoofbench_papers.figures import new_figure, save_figure
from spoofbench_papers.integrity import Scenario, published
from spoofbench_papers.integrity.closed_loop import Response
from spoofbench_papers.integrity.model import ALTITUDE
from spoofbench_papers.reproduction import Picture

Table = Mapping[str, Sequence[Any]]


def failure_mode(path: Path, worst: Mapping[str, float], scenario: Scenario) -> None:
    """Draw the slope in the plane of lambda and mu, and contours of the joint density about the
    worst-case fault (Fig 3).
    """
    figure, axes = new_figure(9.4, 4.2, columns=2)
    line = np.linspace(0, 40, 2)
    axes[0].plot(line, worst["rho_m"] * line, label="failure-mode slope")
    axes[0].plot(worst["lambda"], worst["mu_m"], "k+", ms=10, label="worst-case fault")
    axes[0].set_xlabel("lambda")
    axes[0].set_ylabel("mean vertical error, m")
    degrees = scenario.epochs() * scenario.measurements
    root, error = np.linspace(52, 66, 300), np.linspace(8, 11.5, 200)
    density = stats.ncx2.logpdf(root**2, degrees, worst["lambda"] ** 2) + np.log(2 * root)
    joint = density[None, :] + stats.norm.logpdf(
        error[:, None], worst["mu_m"], worst["sigma_eps_m"]
    )
    lines = axes[1].contour(
        root,
        error,
        (joint - joint.max()) / np.log(10),
        levels=np.arange(-7, 0),
        colors="k",
        linewidths=0.6,
        linestyles="-",
    )
    axes[1].clabel(lines, fmt="1e%d", fontsize=7)
    axes[1].axvline(worst["threshold"], color="#a32020", ls="--", label="threshold T")
    axes[1].set_xlabel("square root of the test statistic q")
    axes[1].set_ylabel("vertical error, m")
    for panel in axes:
        panel.axhline(scenario.alert_limit_m, color="#3b6fb6", ls="--", label="alert limit")
        panel.legend(fontsize=8)
    save_figure(figure, path)


def mirrored(
    path: Path,
    altitudes: Mapping[int, tuple[Floats, Floats]],
    rate_hz: float,
) -> None:
    """Draw altitude and its estimate's error (m, ``(epochs,)`` each), one panel per attack period
    (Fig 5).
    """
    figure, axes = new_figure(9.0, 3.4, columns=len(altitudes))
    for panel, (period, (state, error)) in zip(np.atleast_1d(axes), altitudes.items(), strict=True):
        time = np.arange(state.size) / rate_hz
        panel.plot(time, state, label="altitude")
        panel.plot(time, error, label="error of its estimate")
        panel.set_title(f"{period} s", fontsize=10)
        panel.set_xlabel("time, s")
        panel.set_ylabel("m")
        panel.legend(fontsize=7)
    save_figure(figure, path)


def samples(path: Path, table: Table) -> None:
    """Draw how far the sampled risk is from the exact one over the tracking error (Fig 6, Eq
    61).
    """
    figure, axes = new_figure(6.0, 3.6)
    risk = {
        (s, m, sigma): value
        for s, m, sigma, period, value in zip(
            *(
                table[name]
                for name in ("scenario", "method", "sigma_mm", "period_s", "log10_integrity_risk")
            ),
            strict=True,
        )
        if period == 140
    }
    for scenario in sorted({key[0] for key in risk}):
        for method in sorted({key[1] for key in risk} - {"exact"}):
            sigmas = sorted({key[2] for key in risk})
            gap = [
                risk[scenario, method, sigma] - risk[scenario, "exact", sigma] for sigma in sigmas
            ]
            axes.plot(
                sigmas,
                gap,
                marker=".",
                label=f"{scenario}, {method.removeprefix('samples-')} samples",
            )
    axes.axhline(0, color="k", lw=0.6)
    axes.set_xlabel("altitude tracking error (1 sigma), mm")
    axes.set_ylabel("decades, sampled minus exact")
    axes.legend(fontsize=8)
    save_figure(figure, path)


def draw(
    out: Path, tables: Mapping[str, Mapping[str, Sequence[Any]]], motion: Mapping[int, Response]
) -> list[Picture]:
    """Draw Figs 3 to 7 into a folder: tables by name, the closed loop's motion by period (s)."""
    altitudes = {
        period: (-r.state[:, ALTITUDE], -r.error[:, ALTITUDE]) for period, r in motion.items()
    }
    fig3 = {name: values[0] for name, values in tables["fig3"].items()}
    failure_mode(out / "fig3", fig3, published("tanil2018-C"))
    draw_risk(out / "fig4", tables["fig4"], ("period_s", "attack period, s"), ("rate_hz", "Hz"))
    mirrored(out / "fig5", altitudes, published("tanil2018-C").rate_hz)
    exact = _where(tables["fig6"], "method", "exact")
    draw_risk(out / "fig6", exact, ("period_s", "attack period, s"), ("sigma_mm", "mm"))
    samples(out / "fig6-samples", tables["fig6"])
    draw_risk(out / "fig7", tables["fig7"], ("delay_s", "attack delay, s"), ("sigma_mm", "mm"))
    return [
        Picture(
            "fig3",
            (
                "Fig 3, scenario C: the failure-mode slope, the worst-case fault (+) and lines of "
                "constant joint density about it."
            ),
        ),
        Picture(
            "fig4", "Fig 4: integrity risk over the attack period, by GNSS rate; perfect tracking."
        ),
        Picture(
            "fig5",
            (
                "Fig 5, scenario C: the aircraft's altitude and the error of its estimate mirror "
                "each other; faults scaled to 10 m."
            ),
        ),
        Picture(
            "fig6",
            (
                "Fig 6: integrity risk over the attack period, by altitude tracking error (1 "
                "sigma), averaged exactly; 2 Hz."
            ),
        ),
        Picture(
            "fig6-samples",
            (
                "What averaging over 20 samples does to Fig 6: log10 of the risk, sampled minus "
                "exact, 140 s."
            ),
        ),
        Picture(
            "fig7",
            (
                "Fig 7: integrity risk over the attack's delay, by tracking error; the detector "
                "starts 200 s before landing."
            ),
        ),
    ]


def _where(table: Mapping[str, Sequence[Any]], name: str, value: Any) -> dict[str, list[Any]]:
    rows = np.flatnonzero(np.asarray(table[name]) == value).tolist()
    return {column: [values[row] for row in rows] for column, values in table.items()}
