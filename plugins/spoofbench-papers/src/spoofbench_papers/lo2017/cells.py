"""What Lo et al. (2017) print beside what simulated approaches give, cell by cell.

The rule for Table 2: a printed value matches within what holds 95 % of the runs and within 10
points (times: a factor of 2) of their median; one of the two is a trend; neither is not reproduced.
Nothing simulated is ever said to match without calibration, since the approaches are set by Table
1.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from statistics import NormalDist
from typing import Any, cast, get_args

import numpy as np
from spoofbench_acceleration.statistics import Averaging, Executive

from spoofbench_papers.lo2017 import approach as simulated
from spoofbench_papers.lo2017.approach import APPROACHES, Flights
from spoofbench_papers.lo2017.ensemble import PAPER, Spoofer, flags, spoofed
from spoofbench_papers.lo2017.tables import (
    CASES,
    MONITORS,
    CaseOutcome,
    convention,
    crosscorrelation,
)
from spoofbench_papers.reproduction import Cell, Verdict

JUDGED_STRIDE = 3
JUDGED = convention(JUDGED_STRIDE)
LITERAL = convention(1)

_ROUNDING = 0.05
_NEAR_PCT = 10.0
_NEAR_FACTOR = 2.0

Outcomes = Mapping[tuple[str, int, Executive, str], CaseOutcome]


def by_key(found: Sequence[CaseOutcome]) -> Outcomes:
    """Index outcomes by case, approach, monitor and convention."""
    return {
        (outcome.case, outcome.approach, outcome.monitor, outcome.convention): outcome
        for outcome in found
    }


def table2_cells(found: Outcomes) -> Iterator[Cell]:
    """A cell for each of the 64 percentages and 64 times of Table 2."""
    for case in CASES:
        for monitor in MONITORS:
            for index, approach in enumerate(APPROACHES):
                keys = [(case.name, approach.number, monitor, way) for way in (JUDGED, LITERAL)]
                item = f"Table 2, {case.name}, {monitor}, approach {approach.number}"
                yield _percentage(
                    f"{item}: % detected",
                    case.detection_pct[monitor][index],
                    *(found[key] for key in keys),
                )
                yield _time(
                    f"{item}: time to first detection, s",
                    case.ttfd_s[monitor][index],
                    *(found[key] for key in keys),
                )


def _percentage(
    item: str, printed: float | None, judged: CaseOutcome, literal: CaseOutcome
) -> Cell:
    assert printed is not None
    low, high, _, _ = judged.limits()
    verdict = _verdict(
        low - _ROUNDING <= printed <= high + _ROUNDING,
        abs(judged.median_pct - printed) <= _NEAR_PCT,
    )
    reason = f"{JUDGED}; {LITERAL} samples give {literal.median_pct:.1f} %"
    return Cell(item, printed, judged.median_pct, low, high, verdict, reason)


def _time(item: str, printed: float | None, judged: CaseOutcome, literal: CaseOutcome) -> Cell:
    _, _, early, late = judged.limits()
    ours, other = judged.median_s, literal.median_s
    literally = "N/A" if other is None else f"{other:.1f} s"
    reason = (
        f"{JUDGED}, {100 * judged.detected_share:.0f} % of the runs detect; {LITERAL} samples give "
        f"{literally}"
    )
    if printed is None or ours is None:
        alike = printed is None and ours is None
        verdict = _verdict(alike or (printed is not None and early <= printed <= late), alike)
    else:
        verdict = _verdict(
            early - _ROUNDING <= printed <= late + _ROUNDING,
            1 / _NEAR_FACTOR <= ours / printed <= _NEAR_FACTOR,
        )
    return Cell(
        item,
        "N/A" if printed is None else printed,
        "N/A" if ours is None else ours,
        early,
        late,
        verdict,
        reason,
    )


def _verdict(inside: bool, near: bool) -> Verdict:
    return (
        "matches after calibration"
        if inside and near
        else "trend only"
        if inside or near
        else "not reproduced"
    )


def table1_cells(table: Mapping[str, Sequence[Any]]) -> Iterator[Cell]:
    """Decorrelation, mean and deviation of Table 1, and the correlations of Figs 7 and 8."""
    fields = (
        ("decorrelation_s", "the process's correlation time is chosen within the printed range"),
        ("mean_mps2", "an input"),
        ("std_mps2", "the slow mismatch is scaled to it; lost epochs are left out"),
        ("correlation", "the level of the motion is set by it"),
    )
    for index, approach in enumerate(APPROACHES):
        for name, basis in fields:
            printed = getattr(approach, name)
            if printed is not None:
                low, high = (table[f"{name}_{end}"][index] for end in ("lo", "hi"))
                where = f"Fig {6 + approach.number}" if name == "correlation" else "Table 1"
                verdict: Verdict = (
                    "matches after calibration" if low <= printed <= high else "not reproduced"
                )
                yield Cell(
                    f"{where}, approach {approach.number}: {name}",
                    printed,
                    table[name][index],
                    low,
                    high,
                    verdict,
                    basis,
                )


def crosscorrelation_cell(flights: Mapping[int, Flights]) -> Cell:
    """Largest cross-correlation of approach 2 with the others, Fig 10."""
    phones = {number: flight.phone_mps2[flight.start :].T for number, flight in flights.items()}
    largest = [
        max(float(np.max(crosscorrelation(second, phones[other][run]))) for other in (1, 3, 4))
        for run, second in enumerate(phones[2])
    ]
    low, middle, high = np.percentile(largest, (2.5, 50, 97.5)).tolist()
    verdict: Verdict = (
        "matches after calibration"
        if low <= 0.55 <= high
        else "trend only"
        if high < 0.55
        else "not reproduced"
    )
    reason = (
        "independent approaches of the calibrated process; a lower value shows no less that "
        "approaches do not resemble each other"
    )
    return Cell(
        "Fig 10: largest cross-correlation of approach 2 with the others",
        0.55,
        middle,
        low,
        high,
        verdict,
        reason,
    )


def static_cells(seconds: float) -> Iterator[Cell]:
    """Noise at rest, raw and averaged, and the thresholds; the averaged values decide what the 5 s
    may mean.
    """
    phone, gnss = simulated.stand_still(seconds, seed=0)
    rates = {
        "accelerometer": (phone, simulated.PHONE_HZ, 0.027, 0.003),
        "GNSS": (gnss, simulated.RATE_HZ, 1.198, 0.028),
    }
    for name, (values, rate_hz, raw, printed) in rates.items():
        settled = round(10 * simulated.AVERAGING_S * rate_hz)
        span, constant = (
            float(simulated.averaged(values, rate_hz, kind)[settled:].std())
            for kind in get_args(Averaging)
        )
        yield Cell(
            f"Fig 12: static noise of the {name}, m/s^2",
            raw,
            float(values.std()),
            None,
            None,
            "matches after calibration",
            "an input",
        )
        agrees = round(span, 3) == printed
        yield Cell(
            f"static noise of the {name} averaged over 5 s, m/s^2", printed, span, None, None,
            "matches after calibration" if agrees else "not reproduced",
            (
                "5 s taken as a span, chosen because GNSS comes out; as a time constant it is "
                f"{constant:.4f}"
            ),
        )  # fmt: skip
    sigma = 2 * math.hypot(0.003, simulated.GNSS_AVERAGED_MPS2)
    yield Cell(
        "Eq (7): sigma, m/s^2",
        0.06,
        sigma,
        None,
        None,
        "matches" if round(sigma, 2) == 0.06 else "not reproduced",
        "by arithmetic",
    )
    two_sided = -NormalDist().inv_cdf(1e-9 / 2)
    yield Cell(
        "z threshold at 1e-9", PAPER.z_threshold, two_sided, None, None,
        "matches" if round(two_sided, 1) == 6.1 else "not reproduced",
        (
            "two-sided, though Eq (5) has no absolute value; one-sided it is "
            f"{-NormalDist().inv_cdf(1e-9):.3f}"
        ),
    )  # fmt: skip
    risk = chi2_7_above(PAPER.chi2_threshold)
    yield Cell(
        "false-alert probability of chi-square above 55.87", 1e-9, risk, None, None,
        "matches" if abs(risk / 1e-9 - 1) < 0.01 else "not reproduced", "7 degrees of freedom",
    )  # fmt: skip


def flag_cells(flights: Mapping[int, Flights]) -> Iterator[Cell]:
    """What the text reads off Figs 16 to 22: the most flags of a test within 5 s."""
    for figure, number, spoofer, delay_s, test, printed in (
        ("Fig 16, approach 1, nominal", 1, "nominal", 0.0, "chi-square", 1),
        ("Fig 16, approach 1, nominal", 1, "nominal", 0.0, "mean difference", 0),
        ("Fig 18, approach 1, repeat 2 s", 1, "repeat", 2.0, "chi-square", 40),
        ("Fig 22, approach 2, nominal", 2, "nominal", 0.0, "chi-square", 5),
        ("Fig 22, approach 2, nominal", 2, "nominal", 0.0, "mean difference", 0),
        (
            "Fig 22, approach 2, extrapolate & smooth 0.5 s",
            2,
            "extrapolate & smooth",
            0.5,
            "chi-square",
            30,
        ),
    ):
        flight = flights[number]
        shown = spoofed(flight.gnss_mps2, cast(Spoofer, spoofer), delay_s)
        z, chi2 = flags(flight.phone_mps2 - shown, flight.start, JUDGED_STRIDE).counts()
        largest = (z if test == "mean difference" else chi2).max(axis=0)
        low, middle, high = np.percentile(largest, (2.5, 50, 97.5)).tolist()
        verdict: Verdict = (
            "matches after calibration" if low <= printed <= high else "not reproduced"
        )
        reason = (
            f"{JUDGED}; the simulated difference makes no jumps of its own"
            if spoofer == "nominal"
            else JUDGED
        )
        yield Cell(
            f"{figure}: most flags in 5 s, {test} test", printed, middle, low, high, verdict, reason
        )


def chi2_7_above(x: float) -> float:
    """Probability that chi-square of 7 degrees of freedom lies above x (Abramowitz and Stegun
    26.4.4).
    """
    return math.erfc(math.sqrt(x / 2)) + math.sqrt(2 * x / math.pi) * math.exp(-x / 2) * (
        1 + x / 3 + x**2 / 15
    )
