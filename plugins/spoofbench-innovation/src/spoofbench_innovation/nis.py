"""Does the innovation monitor's filter fit a recording? Normalised innovations squared (NIS)
against chi-square::

    python -m spoofbench_innovation.nis drive.mcap [--lag-s 0.34] [--json] [--picture nis]

On a genuine recording the NIS of an epoch should be chi-square of as many degrees of freedom as it
has measurements, and those of different epochs independent. The first part of the recording
calibrates: its mean gives an inflation factor, which is then frozen. The rest is judged as it is
(raw) and with that factor. GNSS errors last, since the receiver filters: single epochs can fit
while sums over many do not. What that makes of the cumulative test is the last block.
"""

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
from scipy import stats

from spoofbench import codec
from spoofbench.arrays import Floats, Indices
from spoofbench.errors import RecordingError, SpoofbenchError
from spoofbench.recording import Recording
from spoofbench_innovation.error_model import GradeName
from spoofbench_innovation.filtering import Innovations
from spoofbench_innovation.monitor import InnovationMonitor, InnovationStatistic

QUANTILES = (0.5, 0.9, 0.99, 0.999)
LAGS = (1, 10, 60)
SUM_EPOCHS = 280
"""Epochs of the sum that the last block is about: 280 s at 1 Hz, as the longest of Tanil et al.
(2018).
"""
_CORRELATED_EPOCHS = 120
_PARTS: Mapping[str, slice] = {"all": slice(0, 6), "position": slice(0, 3), "velocity": slice(3, 6)}


def measure(
    recording: Recording, monitor: InnovationMonitor, calibration_s: float
) -> dict[str, Any]:
    """Return all numbers of a genuine recording.

    Args:
        recording: with IMU and GNSS, without attack.
        monitor: its filter; ``inflation`` is not used.
        calibration_s: length of the part, from the alignment on, that calibrates.

    Raises:
        RecordingError: the filter is aligned nowhere, or too late for two parts of at least 100
            epochs.
    """
    found, filtered = monitor.filtered(recording)
    complete = np.flatnonzero((filtered.run >= 0) & (filtered.measured == 6))
    since_s = (found.time_ns[complete] - found.time_ns[complete[:1]]) * 1e-9
    first, rest = complete[since_s < calibration_s], complete[since_s >= calibration_s]
    if min(first.size, rest.size) < 100:
        raise RecordingError(
            f"{first.size} epochs with all measurements calibrate and {rest.size} are left to "
            "judge; both must be at least 100"
        )
    inflation = float(_squared(filtered, first, "all").mean() / 6)
    raw, inflated = replace(monitor, inflation=1.0), replace(monitor, inflation=inflation)
    return {
        "calibration": {"epochs": first.size, "inflation": inflation},
        "raw": {**_judged(filtered, rest, 1.0), "exceeding": _exceeding(recording, raw, rest)},
        "inflated": {
            **_judged(filtered, rest, inflation),
            "exceeding": _exceeding(recording, inflated, rest),
        },
        "autocorrelation": {
            "nis": _autocorrelations(_squared(filtered, rest, "all")),
            **{
                name: _autocorrelations(filtered.value[rest, column])
                for column, name in enumerate(("x", "y", "down", "vx", "vy", "vdown"))
            },
        },
        "cumulative": _of_sums(_squared(filtered, rest, "all"), inflation, monitor.p_fa),
    }


def _squared(filtered: Innovations, epochs: Indices, part: str) -> Floats:
    """NIS of these epochs' position, velocity or both, ``(k,)``."""
    components = _PARTS[part]
    value, covariance = (
        filtered.value[epochs, components],
        filtered.covariance[epochs, components, components],
    )
    return np.asarray(np.vecdot(value, np.linalg.solve(covariance, value[:, :, None])[:, :, 0]))


def _judged(filtered: Innovations, epochs: Indices, inflation: float) -> dict[str, Any]:
    nis = _squared(filtered, epochs, "all") / inflation
    return {
        "epochs": int(epochs.size),
        "mean_per_measurement": {
            part: float(
                _squared(filtered, epochs, part).mean()
                / inflation
                / (components.stop - components.start)
            )
            for part, components in _PARTS.items()
        },
        "quantiles": {
            str(q): {"nis": float(np.quantile(nis, q)), "chi_square": float(stats.chi2.ppf(q, 6))}
            for q in QUANTILES
        },
    }


def _exceeding(
    recording: Recording, monitor: InnovationMonitor, epochs: Indices
) -> dict[str, float]:
    """Share of these epochs above the threshold, by statistic."""
    return {
        statistic: float(
            replace(monitor, statistic=statistic).detect(recording).alert[epochs].mean()
        )
        for statistic in get_args(InnovationStatistic)
    }


def _autocorrelations(series: Floats) -> dict[str, float]:
    return {
        str(lag): float(np.corrcoef(series[:-lag], series[lag:])[0, 1])
        for lag in LAGS
        if lag < series.size - 1
    }


def _of_sums(nis: Floats, inflation: float, p_fa: float) -> dict[str, float]:
    """What correlation makes of the false-alert probability of a sum over many epochs.

    The sum's variance is that of independent epochs times 1 + 2 sum rho; a gamma distribution of
    the same mean and variance gives the probability that it exceeds the threshold for ``p_fa``.
    """
    centred = nis - nis.mean()
    lags = range(1, min(_CORRELATED_EPOCHS, nis.size - 1))
    rho = [float(centred[:-lag] @ centred[lag:] / (centred @ centred)) for lag in lags]
    longer = max(1.0, 1 + 2 * sum(rho))
    mean, variance = SUM_EPOCHS * nis.mean(), SUM_EPOCHS * nis.var() * longer
    threshold = stats.chi2.isf(p_fa, 6 * SUM_EPOCHS)
    implied = [
        stats.gamma.sf(threshold * factor, mean**2 / variance, scale=variance / mean)
        for factor in (1.0, inflation)
    ]
    return {
        "epochs": SUM_EPOCHS,
        "variance_factor": longer,
        "nominal_p_fa": p_fa,
        "raw_p_fa": implied[0],
        "inflated_p_fa": implied[1],
    }


def draw(
    path: Path, recording: Recording, monitor: InnovationMonitor, numbers: Mapping[str, Any]
) -> None:
    """Draw histogram and quantiles of the judged part's NIS, as it is and inflated, into ``path``
    with .png and .svg.
    """
    from matplotlib.figure import Figure

    _, filtered = monitor.filtered(recording)
    complete = np.flatnonzero((filtered.run >= 0) & (filtered.measured == 6))[
        numbers["calibration"]["epochs"] :
    ]
    nis = np.sort(_squared(filtered, complete, "all"))
    expected = stats.chi2.ppf((np.arange(nis.size) + 0.5) / nis.size, 6)
    figure = Figure(figsize=(9.4, 4.0), layout="constrained")
    axes = figure.subplots(1, 2)
    line = np.linspace(0, 30, 300)
    inflation = numbers["calibration"]["inflation"]
    for label, factor in (("raw", 1.0), (f"covariance times {inflation:.2f}", inflation)):
        axes[0].hist(
            nis / factor, bins=np.linspace(0, 30, 61), density=True, histtype="step", label=label
        )
        axes[1].plot(expected, nis / factor, ".", ms=3, label=label)
    axes[0].plot(line, stats.chi2.pdf(line, 6), "k", lw=0.8, label="chi-square, 6")
    axes[0].set_xlabel("NIS of an epoch")
    axes[0].set_ylabel("density")
    axes[1].plot(expected, expected, "k", lw=0.8, label="as modelled")
    axes[1].set_xlabel("quantile of chi-square, 6")
    axes[1].set_ylabel("quantile of the NIS")
    for panel in axes:
        panel.legend(fontsize=8)
    for suffix in (".png", ".svg"):
        figure.savefig(path.with_suffix(suffix), dpi=110)


def lines(numbers: Mapping[str, Any]) -> Sequence[str]:
    """Return the numbers as lines for a terminal."""
    calibration, cumulative = numbers["calibration"], numbers["cumulative"]
    text = [
        (
            f"calibration: {calibration['epochs']} epochs, inflation "
            f"{calibration['inflation']:.3f}; all else is of the epochs after it"
        )
    ]
    text.append(f"{'':24}{'raw':>12}{'inflated':>12}{'as modelled':>14}")
    cases = [numbers["raw"], numbers["inflated"]]

    def row(name: str, values: Sequence[float], ideal: float) -> str:
        return f"{name:24}" + "".join(f"{value:12.4g}" for value in values) + f"{ideal:14.4g}"

    text += [
        row(f"mean / n, {part}", [case["mean_per_measurement"][part] for case in cases], 1)
        for part in _PARTS
    ]
    for q in map(str, QUANTILES):
        text.append(
            row(
                f"quantile {q}",
                [case["quantiles"][q]["nis"] for case in cases],
                cases[0]["quantiles"][q]["chi_square"],
            )
        )
    nominal = cumulative["nominal_p_fa"]
    text += [
        row(f"exceeding, {name}", [case["exceeding"][name] for case in cases], nominal)
        for name in get_args(InnovationStatistic)
    ]
    text.append(
        row(
            f"P_FA of {cumulative['epochs']} epochs' sum",
            [cumulative["raw_p_fa"], cumulative["inflated_p_fa"]],
            nominal,
        )
    )
    text.append(
        f"variance of that sum: {cumulative['variance_factor']:.1f} times that of independent "
        "epochs"
    )
    text.append(f"{'autocorrelation at lag':24}" + "".join(f"{lag:>12}" for lag in LAGS))
    text += [
        f"  {name:22}" + "".join(f"{value:12.2f}" for value in values.values())
        for name, values in numbers["autocorrelation"].items()
    ]
    return text


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m spoofbench_innovation.nis", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("recording", type=Path, help="genuine recording (.mcap) with IMU and GNSS")
    parser.add_argument(
        "--lag-s", type=float, default=0.0, help="how late the receiver's epochs are"
    )
    parser.add_argument(
        "--grade", choices=get_args(GradeName), default="automotive", help="of the IMU"
    )
    parser.add_argument(
        "--calibration-s", type=float, default=600.0, help="length of the part that calibrates"
    )
    parser.add_argument("--json", action="store_true", help="print for machines")
    parser.add_argument(
        "--picture", type=Path, help="draw histogram and quantiles into this file, .png and .svg"
    )
    arguments = parser.parse_args()
    try:
        monitor = InnovationMonitor(lag_s=arguments.lag_s, grade=arguments.grade)
        recording = codec.read(arguments.recording)
        numbers = measure(recording, monitor, arguments.calibration_s)
        if arguments.picture:
            draw(arguments.picture, recording, monitor, numbers)
    except (SpoofbenchError, OSError, ValueError) as error:
        sys.exit(f"nis: {error}")
    sys.stdout.write((json.dumps(numbers) if arguments.json else "\n".join(lines(numbers))) + "\n")


if __name__ == "__main__":
    main()
