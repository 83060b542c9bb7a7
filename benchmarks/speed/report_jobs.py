"""A results folder scored, ranked and reported, from made-up decisions.

``score-folder`` and ``report-page`` are done by nothing else, so that their times stand alone. The
peer of ``rank-folder`` computes the same means, rates and shares by pandas groupby, as one would in
a notebook; ours adds exact intervals, Kaplan-Meier quantiles, comparisons and ranks, and refuses
damaged files. ``python -m benchmarks.scale`` has the times and the memory of 50,000 tasks.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.speed.frame import Job
from benchmarks.speed.results_folders import Crossing
from spoofbench.report import write_site
from spoofbench.scoring.leaderboard import Leaderboard, leaderboard
from spoofbench.scoring.score import score_folder


def jobs(folder: Path) -> Iterator[Job]:
    """Yield the jobs; their results folder is in the folder."""
    crossing = Crossing(detectors=20, sessions=6, attacks=9, windows=4)
    results = folder / "results"
    crossing.write(results)
    score_folder(results)
    size = f"{crossing.tasks:,} tasks of 20 detectors against 9 attacks"
    yield Job("score-folder", f"{size} scored", partial(score_folder, results), {})
    yield Job(
        "rank-folder",
        f"{size} ranked",
        partial(leaderboard, results),
        {"pandas": partial(_pandas, results)},
        check=_same,
    )
    board = leaderboard(results)
    yield Job(
        "report-page",
        f"{size} in one page",
        lambda: write_site(results, board, folder / "site"),
        {},
    )


def _pandas(folder: Path) -> pd.DataFrame:
    """Rates and shares by detector, and detections by attack, as a notebook would."""
    scores, events = (
        pd.read_parquet(folder / f"{name}.parquet").query("point == 'calibrated'")
        for name in ("scores", "events")
    )
    hours = scores[scores["attack"].isna()].groupby("detector")
    detected = events.astype({"detected": float})
    by_session = detected.groupby(["detector", "session"])
    table = pd.DataFrame(
        {
            "far_per_hour": hours["episodes"].sum() / hours["available_clean_h"].sum(),
            "alerted": events.groupby("detector")["alerted_share"].mean(),
            "detected_share": by_session["detected"].mean().groupby("detector").mean(),
            "largest_error_m": events.groupby("detector")["largest_error_before_alert_m"].max(),
        }
    )
    return table.join(detected.pivot_table("detected", "detector", "attack"))


def _same(ours: Leaderboard, theirs: pd.DataFrame) -> None:
    """The figures agree to 1e-9."""
    for table in ours.tables:
        for index, row in enumerate(table.rows):
            peer, own = theirs.loc[row.detector], row.shown
            found = [own.far_per_hour, own.detected_share, own.error_before_alert_largest_m]
            found += [
                cell.figures.detected / cell.figures.attacks for cell in table.cells_of(index)
            ]
            names = ["far_per_hour", "detected_share", "largest_error_m", *table.attacks]
            np.testing.assert_allclose(np.array(found, float), peer[names], rtol=1e-9)
