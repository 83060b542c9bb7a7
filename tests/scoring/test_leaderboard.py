"""The leaderboard: who stands above whom, and what is pooled how."""

from dataclasses import asdict
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from scipy import stats

from spoofbench.errors import ResultsError
from spoofbench.results import FAILURES, TASK_SCHEMA, write_parquet, write_run, write_tasks
from spoofbench.scoring.leaderboard import Leaderboard, leaderboard
from spoofbench.scoring.metrics import false_alert_rate
from spoofbench.scoring.score import EVENT_SCHEMA, SCORE_SCHEMA
from spoofbench.scoring.statistics import proportion, session_interval, survival_curve


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


def test_baselines_are_marked(bench: Any) -> None:
    add(bench, "never", [], [], baseline=True)
    add(bench, "mine", [], [110])
    assert {row.detector: row.baseline for row in ranked(bench).rows} == {
        "never": True,
        "mine": False,
    }


@pytest.mark.parametrize(
    ("thresholds", "noted"), [("published", True), ("calibrated", False), (None, False)]
)
def test_published_thresholds_are_noted(bench: Any, thresholds: str | None, noted: bool) -> None:
    bench.thresholds = thresholds
    bench.add("d")
    assert bool(ranked(bench).note) == noted


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


Rows = list[dict[str, Any]]


def random_tables(rng: np.random.Generator, *, ties: bool, gaps: bool) -> tuple[Rows, Rows, Rows]:
    """Rows of tasks, scores and events of several recordings and sessions, in the order of a run.

    With ``gaps`` tasks fail or are not tried, and figures are unknown here and there.
    """
    tasks: Rows = []
    scores: Rows = []
    events: Rows = []
    detectors, attacks, sessions = rng.integers(1, 6), rng.integers(0, 4), rng.integers(1, 8)
    quality = rng.choice([0.2, 0.8], detectors) if ties else rng.random(detectors)
    variants = [(None, None), *((f"attack {a}", s) for a in range(attacks) for s in range(2))]
    statuses = ["ok"] * 6 + ["skipped", "not_modelled", "failed", "timeout", "out_of_memory"]

    def known(value: Any) -> Any:
        return None if gaps and rng.random() < 0.1 else value

    for recording in range(rng.integers(1, 8)):
        for attack, seed in variants:
            length_s = float(rng.choice([60, 120]))
            for detector in range(detectors):
                status = str(rng.choice(statuses)) if gaps else "ok"
                name = {
                    "task_id": f"t{len(tasks)}",
                    "recording": f"r{recording}",
                    "session": f"s{recording % sessions}",
                    "attack": attack,
                    "seed": seed,
                    "detector": f"d{detector}",
                }
                tasks.append(
                    name
                    | dict.fromkeys(("plugin", "plugin_version", "parameters", "requires"), "p")
                    | {
                        "plugin_distribution": "x",
                        "baseline": False,
                        "variant_id": f"{recording} {attack} {seed}",
                    }
                    | {"memory_s": 0.0, "target_far_per_hour": 1.0, "status": status}
                )
                row = name | {"status": status}
                scores.append(row)
                if status in ("skipped", "not_modelled"):
                    continue
                row |= {"epochs": int(rng.integers(3000)), "availability": known(rng.random())}
                if attack is None:
                    hours = float(rng.choice([0.0, rng.random()]))
                    row |= {"available_clean_h": hours, "episodes": int(rng.poisson(2 * hours))}
                    row |= {"far_epoch": rng.random() if hours else None}
                    continue
                hit = status == "ok" and rng.random() < quality[detector]
                row |= {"detection_pct": known(100.0 * (hit if ties else rng.random()))}
                row |= {"partial_auc": known(rng.random())}
                for _ in range(rng.integers(3) if gaps else 1):
                    ttfd_s = 10.0 * rng.integers(5) if ties else length_s * rng.random()
                    events.append(
                        name
                        | {"start_ns": 0, "end_ns": 1, "length_s": length_s, "alert_before": False}
                        | {"detected": hit, "ttfd_s": ttfd_s if hit else None}
                        | {"position_error_at_detection_m": known(rng.random()) if hit else None}
                        | {"largest_undetected_position_error_m": known(rng.random())}
                    )
    return tasks, scores, events


def by_loop(detector: str, attack: str | None, scores: Rows, events: Rows) -> dict[str, Any]:
    """Figures of a detector, or of its cell against one attack, by walking all rows."""

    def of(rows: Rows) -> Rows:
        rows = [row for row in rows if row["detector"] == detector]
        return rows if attack is None else [row for row in rows if row["attack"] == attack]

    def values(rows: Rows, name: str) -> list[Any]:
        return [row[name] for row in rows if row.get(name) is not None]

    def mean(rows: Rows, name: str, weight: str | None = None) -> float | None:
        rows = [row for row in rows if row.get(name) is not None]
        weights = [1.0 if weight is None else row[weight] for row in rows]
        products = [row[name] * w for row, w in zip(rows, weights, strict=True)]
        return sum(products) / sum(weights) if sum(weights) else None

    own, faced = of(scores), of(events)
    detected = [event["detected"] for event in faced]
    curve = survival_curve(
        [event["ttfd_s"] if event["detected"] else event["length_s"] for event in faced], detected
    )
    missed = proportion(len(faced) - sum(detected), len(faced))
    found = {
        "detection_pct": mean(own, "detection_pct"),
        "detected": sum(detected),
        "events": len(faced),
        "p_md": missed and missed.value,
        "ttfd_median_s": curve and curve.quantile_s(0.5),
        "failed": sum(row["status"] in FAILURES for row in own),
        **{
            status: sum(row["status"] == status for row in own)
            for status in ("ok", "skipped", "not_modelled")
        },
    }
    if attack is not None:
        return found | {"p_md_lo": missed and missed.lo, "p_md_hi": missed and missed.hi}
    clean = [row for row in own if row["attack"] is None and row.get("epochs") is not None]
    tried = [row for row in own if row.get("detection_pct") is not None]
    pct_lo, pct_hi = session_interval(values(tried, "detection_pct"), values(tried, "session")) or (
        None,
        None,
    )
    p_lo, p_hi = session_interval(
        [not event["detected"] for event in faced], values(faced, "session")
    ) or (None, None)
    false = false_alert_rate(
        sum(values(clean, "episodes")),
        sum(values(clean, "available_clean_h")),
        mean(clean, "far_epoch", "available_clean_h"),
    )
    longest_s = max(values(events, "length_s"), default=0.0)
    errors_m = values(faced, "position_error_at_detection_m")
    return found | {
        "detection_pct_lo": pct_lo,
        "detection_pct_hi": pct_hi,
        "p_md_lo": p_lo,
        "p_md_hi": p_hi,
        "far_per_hour": false.per_hour,
        "far_per_hour_lo": false.per_hour_lo,
        "far_per_hour_hi": false.per_hour_hi,
        "far_floor_per_hour": false.floor_per_hour,
        "far_epoch": false.epoch,
        "availability": mean(clean, "availability", "epochs"),
        "partial_auc": mean(own, "partial_auc"),
        "restricted_mean_ttfd_s": curve and curve.restricted_mean_s(longest_s),
        "ttfd_p90_s": curve and curve.quantile_s(0.9),
        "longest_attack_s": max(values(faced, "length_s"), default=None),
        "position_error_at_detection_m": median(errors_m) if errors_m else None,
        "largest_undetected_position_error_m": max(
            values(faced, "largest_undetected_position_error_m"), default=None
        ),
    }


@pytest.mark.parametrize("gaps", [False, True])
@pytest.mark.parametrize("ties", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_groups_agree_exactly_with_a_loop_over_all_rows(
    tmp_path: Path, seed: int, ties: bool, gaps: bool
) -> None:
    tasks, scores, events = random_tables(np.random.default_rng(seed), ties=ties, gaps=gaps)
    write_run(tmp_path, {})
    for name, rows, schema in (
        ("tasks", tasks, TASK_SCHEMA),
        ("scores", scores, SCORE_SCHEMA),
        ("events", events, EVENT_SCHEMA),
    ):
        write_parquet(tmp_path / f"{name}.parquet", pa.Table.from_pylist(rows, schema))
    board = leaderboard(tmp_path)
    for row in board.rows:
        expected = by_loop(row.detector, None, scores, events)
        assert {name: asdict(row)[name] for name in expected} == expected
    for cell in board.cells:
        expected = by_loop(cell.detector, cell.attack, scores, events)
        assert {name: asdict(cell)[name] for name in expected} == expected
    assert {row.detector for row in board.rows} == {task["detector"] for task in tasks}
    assert [(cell.detector, cell.attack) for cell in board.cells] == [
        (row.detector, attack) for row in board.rows for attack in board.attacks
    ]
