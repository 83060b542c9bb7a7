"""How much Table 2 of Lo et al. (2017) depends on what the paper leaves open and Table 1 does not
settle.
"""

from collections.abc import Callable, Sequence
from typing import Any

from spoofbench_papers.lo2017.approach import APPROACHES, Choices, fly
from spoofbench_papers.lo2017.cells import JUDGED, JUDGED_STRIDE, by_key
from spoofbench_papers.lo2017.checks import (
    WANTED_POINTS,
    mean_absolute_difference,
    simulated_checks,
)
from spoofbench_papers.lo2017.tables import outcomes
from spoofbench_papers.reproduction import Cell

VARIED = {
    "as chosen": Choices(),
    "motion 0.2 s": Choices(gust_s=0.2),
    "motion 0.3 s": Choices(gust_s=0.3),
    "motion 0.4 s": Choices(gust_s=0.4),
    "mismatch 3 s": Choices(mismatch_s=3.0),
    "mismatch 30 s": Choices(mismatch_s=30.0),
    "smoothing 3 s": Choices(smoothing_s=3.0),
    "smoothing 5 s": Choices(smoothing_s=5.0),
}


def sensitivity(
    names: Sequence[str], seeds: Sequence[int], done: Callable[[float], None]
) -> list[dict[str, Any]]:
    """Return a row per choice: the mean absolute difference in points, repeat 0.5 s by approach,
    and the checks that fail.
    """
    rows = []
    for place, name in enumerate(names):
        choices = VARIED[name]
        found = by_key([
            outcome
            for approach in APPROACHES
            for outcome in outcomes(approach, fly(approach, seeds, choices), (JUDGED_STRIDE,), choices.smoothing_s)
        ])  # fmt: skip
        repeat = [
            found["repeat 0.5 s", approach.number, "multi", JUDGED].median_pct
            for approach in APPROACHES
        ]
        rows.append({
            "choice": name,
            "difference_points": mean_absolute_difference(found, JUDGED),
            **{f"repeat_half_second_{approach.number}_pct": value for approach, value in zip(APPROACHES, repeat, strict=True)},
            "failing": "; ".join(check.item for check in simulated_checks(found, JUDGED) if not check.holds),
        })  # fmt: skip
        done((place + 1) / len(names))
    return rows


def sensitivity_cell(rows: Sequence[dict[str, Any]]) -> Cell:
    """A cell on the mean absolute difference over all choices."""
    points = [row["difference_points"] for row in rows]
    kept = [row["choice"] for row in rows if not row["failing"]]
    return Cell(
        (
            "Table 2 as a whole, mean absolute difference over choices of what the paper leaves "
            f"open, {JUDGED}, points"
        ),
        None, points[0], min(points), max(points),
        "not reproduced" if max(points) > WANTED_POINTS else "matches after calibration",
        (
            f"{len(rows)} choices; wanted: at most {WANTED_POINTS:g}; all checks hold for: "
            f"{', '.join(kept) or 'none'}; none was chosen by it"
        ),
    )  # fmt: skip
