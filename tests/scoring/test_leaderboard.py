"""The leaderboard: who stands above whom, and what is pooled how."""

from pathlib import Path
from typing import Any

import pytest
from scipy import stats

from spoofbench.errors import ResultsError
from spoofbench.results import write_run, write_tasks
from spoofbench.scoring.leaderboard import Leaderboard, leaderboard


def ranked(bench: Any) -> Leaderboard:
    bench.score()
    return leaderboard(bench.path)


def add(
    bench: Any, detector: str, false: range | list[int], hits: range | list[int], **about: Any
) -> None:
    bench.add(detector, alerts=false, **about)
    bench.add(detector, "replay", alerts=hits, **about)


def test_rows_that_keep_the_target_come_first_then_detection_then_time(bench: Any) -> None:
    everywhere = range(200)
    add(bench, "always", everywhere, everywhere)
    add(bench, "late", [], range(130, 160))
    add(bench, "early", [], range(100, 130))
    add(bench, "better", [], range(125, 160))
    add(bench, "never", [], [])
    bench.add("crashes", status="failed")
    bench.add("crashes", "replay", alerts=everywhere)
    bench.add("blind", status="skipped")
    board = ranked(bench)
    assert [row.detector for row in board.rows] == [
        "better",
        "early",
        "late",
        "never",
        "always",
        "crashes",
        "blind",
    ]
    assert [row.rank for row in board.rows] == [1, 2, 3, 4, 5, 6, None]
    assert [row.keeps_target for row in board.rows] == [True, True, True, True, False, None, None]
    assert board.target_far_per_hour == 1


def test_one_false_alert_in_a_short_recording_does_not_prove_that_the_target_is_exceeded(
    bench: Any,
) -> None:
    add(bench, "once", [50], range(100, 160), target_far_per_hour=1.0)
    (row,) = ranked(bench).rows
    assert row.far_per_hour == pytest.approx(18)
    assert row.far_per_hour_lo == pytest.approx(stats.chi2.ppf(0.025, 2) / 2 * 18)
    assert row.keeps_target is True


def test_equals_share_a_rank(bench: Any) -> None:
    for detector in ("a", "b", "c"):
        add(bench, detector, [], range(110, 160) if detector != "c" else [])
    assert [(row.detector, row.rank) for row in ranked(bench).rows] == [
        ("a", 1),
        ("b", 1),
        ("c", 3),
    ]


def test_false_alerts_are_pooled_by_time(bench: Any) -> None:
    bench.add("d", alerts=[10, 50], recording="one", session="one")
    bench.add(
        "d",
        alerts=range(150),
        unavailable=range(100, 400),
        recording="two",
        session="two",
        epochs=400,
    )
    (row,) = ranked(bench).rows
    assert row.far_per_hour == pytest.approx((2 + 2) / (300 / 3600))
    assert row.far_floor_per_hour == pytest.approx(3 / (300 / 3600))
    assert row.far_epoch == pytest.approx((2 + 100) / 300)
    assert row.availability == 0.5


def test_misses_times_and_failures(bench: Any) -> None:
    for seed, hits in enumerate([range(102, 160), range(130, 160), [], range(110, 160)]):
        bench.add("d", "replay", alerts=hits, seed=seed)
    bench.add("d", "replay", status="timeout", seed=4)
    bench.add("d", "drag-off", status="not_modelled")
    bench.add("d", "meacon", status="skipped")
    board = ranked(bench)
    (row,) = board.rows
    assert (row.ok, row.failed, row.not_modelled, row.skipped) == (4, 1, 1, 1)
    assert row.detection_pct == pytest.approx(100 * (58 + 30 + 0 + 50 + 0) / 60 / 5)
    assert (row.detected, row.events, row.p_md) == (3, 5, 0.4)
    assert (row.p_md_lo, row.p_md_hi) == (None, None), (
        "windows on one recording are not independent"
    )
    interval = stats.binomtest(2, 5).proportion_ci(0.95, "exact")
    (cell,) = (cell for cell in board.cells if cell.attack == "replay")
    assert (cell.p_md_lo, cell.p_md_hi) == pytest.approx((interval.low, interval.high))
    assert (row.ttfd_median_s, row.ttfd_p90_s) == (30, None)
    assert row.restricted_mean_ttfd_s == pytest.approx((2 + 30 + 60 + 10 + 60) / 5)
    assert row.position_error_at_detection_m == 11
    assert row.largest_undetected_position_error_m == 60
    assert (row.far_per_hour, row.far_epoch, row.availability, row.partial_auc) == (
        None,
        None,
        None,
        None,
    )
    assert [(cell.attack, cell.detection_pct, cell.p_md, cell.events) for cell in board.cells] == [
        ("replay", row.detection_pct, 0.4, 5),
        ("drag-off", None, None, 0),
        ("meacon", None, None, 0),
    ]
    assert (board.cells[1].not_modelled, board.cells[2].skipped) == (1, 1)


@pytest.mark.parametrize(("sessions", "known"), [(4, False), (5, True)])
def test_detection_has_an_interval_from_five_sessions_on(
    bench: Any, sessions: int, known: bool
) -> None:
    for number in range(sessions):
        bench.add(
            "d",
            "replay",
            alerts=range(100 + number, 160),
            recording=f"r{number}",
            session=f"s{number}",
        )
    board = ranked(bench)
    (row,) = board.rows
    assert board.sessions == board.recordings == sessions
    assert row.detection_pct is not None
    if not known:
        assert (row.detection_pct_lo, row.detection_pct_hi) == (None, None)
    else:
        assert row.detection_pct_lo is not None
        assert row.detection_pct_hi is not None
        assert row.detection_pct_lo < row.detection_pct < row.detection_pct_hi


def test_rows_of_chance_are_marked(bench: Any) -> None:
    add(bench, "never", [], [], plugin_distribution="spoofbench-baselines")
    add(bench, "mine", [], [110])
    assert {row.detector: row.baseline for row in ranked(bench).rows} == {
        "never": True,
        "mine": False,
    }


@pytest.mark.parametrize(
    ("thresholds", "said"), [("published", True), ("calibrated", False), (None, False)]
)
def test_published_thresholds_are_said(bench: Any, thresholds: str | None, said: bool) -> None:
    bench.thresholds = thresholds
    bench.add("d")
    assert bool(ranked(bench).note) == said


def test_scores_of_other_tasks_are_refused(bench: Any, tmp_path: Path) -> None:
    bench.add("d")
    bench.score()
    bench.add("e")
    write_tasks(bench.path, bench.tasks)
    with pytest.raises(ResultsError, match="score it again"):
        leaderboard(bench.path)
    write_tasks(tmp_path / "empty", [])
    write_run(tmp_path / "empty", {})
    with pytest.raises(ResultsError, match="no tasks"):
        leaderboard(tmp_path / "empty")
