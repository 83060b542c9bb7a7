"""Borio's statistics on a recording with GNSS and IMU: as it is, and with GNSS replayed after a delay.

    python benchmarks/reproductions/borio_drive.py drive.mcap [--lag-s 0.34] [--json]

The paper's data are not public. Its figures 8 and 9 stand beside this: genuine statistics above 0.8 for most of the
time, below 0.6 with but sporadic exceptions where GNSS and IMU are of different runs. Here the replay is
the same receiver's own past. The lag is a property of the receiver: 0.34 s is that of the drive of the demo.
"""

import argparse
import json
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray
from spoofbench_correlation import Correlation, ZeroVelocity

from spoofbench import codec
from spoofbench.detecting import detect
from spoofbench.errors import SpoofbenchError
from spoofbench.recording import Recording, Table

STATISTICS = ("M_acc", "M_ag", "H_acc", "H_ag", "M", "H")
DELAYS_S = (0, 1, 2, 3, 5, 10, 300)
SETTINGS: dict[str, dict[str, Any]] = {
    "low_pass": {},
    "constant": {"gravity": "constant"},
    "descent": {"gravity": "descent"},
    "median 3": {"median_filter": 3},
    "median 5": {"median_filter": 5},
    "median 7": {"median_filter": 7},
    "adaptive": {"adaptive": True},
    "lag 0": {"lag_s": 0.0},
}


def replayed(recording: Recording, delay_s: float) -> Recording:
    """Return the part of the recording for which there is a past, each PVT row as its receiver gave it ``delay_s`` before."""
    topic = recording.topics("gnss/pvt")[0]
    table = recording[topic]
    start = int(table.time_ns[0]) + round(delay_s * 1e9)
    times = table.time_ns[table.time_ns >= start]
    past = times - round(delay_s * 1e9)
    after = np.searchsorted(table.time_ns, past).clip(1, len(table) - 1)
    nearest = np.where(past - table.time_ns[after - 1] < table.time_ns[after] - past, after - 1, after)
    rows = table.take(nearest)
    falsified = Table("gnss/pvt", times, {name: rows.column(name) for name in rows})
    return recording.between(start, recording.span.end_ns).replace({topic: falsified})


def coefficients(recording: Recording, statistic: str, lag_s: float, **parameters: Any) -> NDArray[np.float64]:
    """The available values of a statistic."""
    detector = Correlation(**{"statistic": statistic, "lag_s": lag_s, **parameters})
    decisions = detect(detector, recording)
    return 1 - decisions.score[decisions.available] * (1 - detector.threshold)


def correlations(recording: Recording, lag_s: float) -> list[dict[str, Any]]:
    """Distribution of each statistic for each delay of the replay; 0 is the genuine recording."""
    rows = []
    for delay_s in DELAYS_S:
        variant = replayed(recording, delay_s)
        for statistic in STATISTICS:
            values = coefficients(variant, statistic, lag_s)
            quantiles = dict(zip(("p01", "median", "p99"), np.percentile(values, [1, 50, 99]).tolist(), strict=True))
            rows.append(
                {"delay_s": delay_s, "statistic": statistic, **quantiles, "alerts": float((values < 0.7).mean()), "epochs": values.size}
            )
    return rows


def settings(recording: Recording, lag_s: float) -> list[dict[str, Any]]:
    """Genuine medians of each statistic for other ways to estimate gravity, to filter, to weigh."""
    return [
        {"setting": name, **{s: float(np.median(coefficients(recording, s, **{"lag_s": lag_s, **parameters}))) for s in STATISTICS}}
        for name, parameters in SETTINGS.items()
    ]


def contradictions(recording: Recording, lag_s: float) -> list[dict[str, Any]]:
    """Contradicted seconds per minute over the whole recording, genuine and replayed by 300 s."""
    rows = []
    for delay_s in (0, 300):
        variant = replayed(recording, delay_s)
        whole_s = variant.span.duration_s
        row: dict[str, Any] = {"delay_s": delay_s}
        for kind in ("gnss_still", "imu_still", "either"):
            detector = ZeroVelocity(contradiction=kind, window_s=whole_s, min_share=0.5, threshold_per_min=1.0, lag_s=lag_s)
            row[f"{kind}_per_min"] = float(detect(detector, variant).score[-1])
        rows.append(row)
    return rows


def measure(recording: Recording, lag_s: float) -> dict[str, list[dict[str, Any]]]:
    """All tables."""
    return {
        "correlations": correlations(recording, lag_s),
        "settings": settings(recording, lag_s),
        "contradictions": contradictions(recording, lag_s),
    }


TITLES = {
    "correlations": "Correlation over 120 s: quantiles, and the share of epochs below 0.7, by delay of the replay",
    "settings": "Genuine medians for other settings",
    "contradictions": "Zero velocity: contradicted seconds per minute",
}


def _print(tables: dict[str, list[dict[str, Any]]]) -> None:
    for name, rows in tables.items():
        print(f"\n{TITLES[name]}\n" + "".join(f"{key:>20}" if "per_min" in key else f"{key:>10}" for key in rows[0]))
        for row in rows:
            cells = (f"{value:.3f}" if isinstance(value, float) else str(value) for value in row.values())
            print("".join(f"{cell:>20}" if "per_min" in key else f"{cell:>10}" for key, cell in zip(row, cells, strict=True)))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("recording", help="converted recording (.mcap) of at least ten minutes")
    parser.add_argument("--lag-s", type=float, default=0.34, help="how late the receiver's velocities are")
    parser.add_argument("--json", action="store_true", help="print for machines")
    arguments = parser.parse_args()
    try:
        tables = measure(codec.read(arguments.recording), arguments.lag_s)
    except (SpoofbenchError, OSError) as error:
        sys.exit(f"borio_drive: {error}")
    if arguments.json:
        print(json.dumps(tables))
    else:
        _print(tables)


if __name__ == "__main__":
    main()
