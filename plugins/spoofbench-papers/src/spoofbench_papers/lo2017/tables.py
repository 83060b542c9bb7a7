"""Tables 1 and 2 of Lo et al. (2017): as printed, and over simulated approaches."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from spoofbench_acceleration.statistics import Executive

from spoofbench.arrays import Bools, Floats
from spoofbench_papers.lo2017.approach import APPROACHES, CHOSEN, RATE_HZ, Approach, Flights
from spoofbench_papers.lo2017.ensemble import (
    Spoofer,
    first_detection_s,
    flags,
    percentage,
    spoofed,
)

ByApproach = tuple[float | None, float | None, float | None, float | None]


@dataclass(frozen=True, slots=True)
class PrintedCase:
    """A row of Table 2: the spoofer, how late it knows, and by monitor what is printed for
    approaches 1 to 4.
    """

    name: str
    spoofer: Spoofer
    delay_s: float
    detection_pct: dict[Executive, ByApproach]
    ttfd_s: dict[Executive, ByApproach]


CASES = (
    PrintedCase(
        "nominal", "nominal", 0.0,
        {"simple": (0, 0, 0, 0), "multi": (0, 0, 0, 3.7)},
        {"simple": (None, None, None, None), "multi": (None, None, None, 44.9)},
    ),
    PrintedCase(
        "zero acceleration", "zero", 0.0,
        {"simple": (22.5, 35.5, 19.7, 22.4), "multi": (28.7, 49.4, 44.7, 35.6)},
        {"simple": (53.3, 11.3, 0.5, 1.0), "multi": (53.3, 10.6, 0.5, 0.7)},
    ),
    PrintedCase(
        "repeat 0.5 s", "repeat", 0.5,
        {"simple": (0, 0, 0, 0), "multi": (14.2, 50.3, 18.0, 24.4)},
        {"simple": (None, None, None, None), "multi": (32.3, 8.4, 12.5, 2.7)},
    ),
    PrintedCase(
        "extrapolate 0.5 s", "extrapolate", 0.5,
        {"simple": (0.9, 0, 0, 0), "multi": (99.7, 99.4, 99.5, 99.3)},
        {"simple": (48.8, None, None, None), "multi": (0.7, 0.7, 0.7, 0.9)},
    ),
    PrintedCase(
        "extrapolate & smooth 0.5 s", "extrapolate & smooth", 0.5,
        {"simple": (14.8, 17.9, 4.3, 13.3), "multi": (23.8, 49.1, 37.3, 27.8)},
        {"simple": (53.2, 14.6, 92.4, 55.3), "multi": (42.0, 10.7, 9.9, 12.9)},
    ),
    PrintedCase(
        "repeat 2 s", "repeat", 2.0,
        {"simple": (28.2, 41.2, 41.4, 33.4), "multi": (49.5, 84.3, 84.4, 68.4)},
        {"simple": (46.8, 11.2, 0.6, 3.6), "multi": (3.4, 1.0, 0.6, 2.6)},
    ),
    PrintedCase(
        "extrapolate 2 s", "extrapolate", 2.0,
        {"simple": (97.6, 99.7, 99.8, 98.5), "multi": (99.7, 99.7, 99.8, 99.5)},
        {"simple": (1.9, 0.4, 0.4, 1.9), "multi": (0.7, 0.4, 0.4, 0.7)},
    ),
    PrintedCase(
        "extrapolate & smooth 2 s", "extrapolate & smooth", 2.0,
        {"simple": (28.7, 40.9, 25.6, 30.8), "multi": (40.4, 70.6, 67.61, 64.2)},
        {"simple": (47.0, 11.2, 7.3, 6.3), "multi": (28.9, 9.5, 6.6, 6.3)},
    ),
)  # fmt: skip


MONITORS: tuple[Executive, ...] = ("simple", "multi")
STRIDES = (1, 2, 3, 4)
GATED = "nominal, lost epochs gated"


def convention(stride: int) -> str:
    """Which eight samples a test takes: ``consecutive``, or every second to fourth epoch,
    ``stride-2`` to ``stride-4``.
    """
    return "consecutive" if stride == 1 else f"stride-{stride}"


@dataclass(frozen=True, slots=True)
class CaseOutcome:
    """What one monitor made of one case in all runs of an approach; ``(runs,)`` each, inf for no
    detection.
    """

    case: str
    approach: int
    monitor: Executive
    convention: str
    duration_s: float
    detection_pct: Floats
    ttfd_s: Floats

    @property
    def detected_share(self) -> float:
        """Share of the runs with a detection."""
        return float(np.isfinite(self.ttfd_s).mean())

    @property
    def median_pct(self) -> float:
        """Median percentage over the runs."""
        return float(np.median(self.detection_pct))

    @property
    def median_s(self) -> float | None:
        """Median time over the runs, no detection counting as later than any; None where that is
        the median.
        """
        middle = float(np.median(self.ttfd_s))
        return middle if np.isfinite(middle) else None

    def limits(self) -> tuple[float, float, float, float]:
        """Within which 95 % of the runs lie: percentage from and to, time from and to, censored at
        the approach's length.
        """
        times = np.minimum(self.ttfd_s, self.duration_s)
        both = (
            np.percentile(values, (2.5, 97.5), method="closest_observation")
            for values in (self.detection_pct, times)
        )
        (low, high), (early, late) = both
        return float(low), float(high), float(early), float(late)


def outcomes(
    approach: Approach,
    flights: Flights,
    strides: Sequence[int],
    smoothing_s: float = CHOSEN.smoothing_s,
) -> Iterator[CaseOutcome]:
    """Table 2 of one approach, and the nominal case with lost epochs gated."""
    shown = {
        case.name: spoofed(flights.gnss_mps2, case.spoofer, case.delay_s, smoothing_s)
        for case in CASES
    } | {GATED: flights.gated_mps2}
    for stride in strides:
        for case, gnss in shown.items():
            flagged = flags(flights.phone_mps2 - gnss, flights.start, stride)
            for monitor in MONITORS:
                alerts: Bools = flagged.alerts(monitor)
                yield CaseOutcome(
                    case,
                    approach.number,
                    monitor,
                    convention(stride),
                    approach.duration_s,
                    percentage(alerts),
                    first_detection_s(alerts),
                )


def table2(found: Sequence[CaseOutcome]) -> dict[str, list[Any]]:
    """Columns of ``table2.parquet``: medians over the runs and what holds 95 % of them."""
    rows = []
    for outcome in found:
        low, high, _, _ = outcome.limits()
        rows.append({
            "case": outcome.case, "approach": outcome.approach, "monitor": outcome.monitor,
            "convention": outcome.convention,
            "detection_pct": outcome.median_pct, "detection_pct_lo": low, "detection_pct_hi": high,
            "ttfd_s": outcome.median_s, "detected_share": outcome.detected_share,
        })  # fmt: skip
    return {name: [row[name] for row in rows] for name in rows[0]}


def signatures(flights: Flights) -> dict[str, Floats]:
    """Table 1 of each run, ``(runs,)``: ``decorrelation_s mean_mps2 std_mps2 correlation``, lost
    epochs left out.
    """
    phone, gnss = flights.phone_mps2[flights.start :], flights.gated_mps2[flights.start :]
    known = ~np.isnan(gnss).any(axis=1)
    difference = (phone - gnss)[known]
    centred = [values[known] - values[known].mean(axis=0) for values in (phone, gnss)]
    correlation = (centred[0] * centred[1]).mean(axis=0) / (
        centred[0].std(axis=0) * centred[1].std(axis=0)
    )
    decorrelation = [np.argmax(autocorrelation(run) < np.exp(-1)) / RATE_HZ for run in phone.T]
    return {
        "decorrelation_s": np.array(decorrelation),
        "mean_mps2": difference.mean(axis=0),
        "std_mps2": difference.std(axis=0, ddof=1),
        "correlation": correlation,
    }


def table1(found: Sequence[dict[str, Floats]]) -> dict[str, list[Any]]:
    """Return the columns of ``table1.parquet``: per approach its length, and medians over the runs
    with what holds 95 % of them; ``found`` are the signatures of each approach, ``(runs,)``.
    """
    columns: dict[str, list[Any]] = {
        "approach": [approach.number for approach in APPROACHES],
        "duration_s": [approach.duration_s for approach in APPROACHES],
    }
    for name in found[0]:
        columns[name] = [float(np.median(run[name])) for run in found]
        for suffix, share in (("lo", 2.5), ("hi", 97.5)):
            columns[f"{name}_{suffix}"] = [float(np.percentile(run[name], share)) for run in found]
    return columns


def autocorrelation(values: Floats) -> Floats:
    """Normalised autocorrelation at lags from 0, ``(n,)``."""
    return crosscorrelation(values, values)[values.size - 1 :]


def crosscorrelation(values: Floats, others: Floats) -> Floats:
    """Return the cross-correlation of two series, ``(n,)`` each, over the autocorrelation's maximum
    of ``values``: at lags from ``-(n - 1)``, shape ``(2 n - 1,)``; Fig 10.
    """
    centred = values - values.mean()
    result: Floats = np.correlate(others - others.mean(), centred, "full") / (centred @ centred)
    return result
