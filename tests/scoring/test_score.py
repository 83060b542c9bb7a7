"""A results folder is scored from its files alone, row by row, failures included."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spoofbench.detector import Decisions
from spoofbench.errors import ResultsError
from spoofbench.results import read_truth, write_truth
from spoofbench.scoring.score import score_folder

S = 1_000_000_000


def test_an_unattacked_task_has_false_alerts_and_no_detection(bench: Any) -> None:
    bench.add("d", alerts=[20, 25, 80], unavailable=range(150, 200))
    (row,) = bench.score()
    assert row["episodes"] == 2
    assert row["far_per_hour"] == pytest.approx(2 / (150 / 3600))
    assert row["far_epoch"] == 3 / 150
    assert row["available_clean_h"] == pytest.approx(150 / 3600)
    assert row["availability"] == 0.75
    assert row["alert_fraction"] == 3 / 200
    for name in (
        "detection_pct",
        "detection_pct_available",
        "ttfd_s",
        "detected",
        "partial_auc",
    ):
        assert row[name] is None, name
    assert bench.rows("events") == []


def test_alerts_between_epochs_are_false_alerts_too(bench: Any) -> None:
    between = Decisions(
        np.arange(0, 400) * 500_000_000,
        np.where(np.isin(np.arange(400), [41, 201]), 2.0, 0.5),
        np.ones(400, bool),
    )
    bench.add("d", decisions=between)
    (row,) = bench.score()
    assert (row["episodes"], row["far_epoch"], row["availability"]) == (2, 0.0, 1.0)


def test_what_was_not_reviewed_is_neither_clean_nor_attacked(bench: Any) -> None:
    bench.add("d", alerts=[20, 120, 180])
    truth = read_truth(bench.path, bench.tasks[0].variant_id)
    write_truth(
        bench.path, bench.tasks[0].variant_id, replace(truth, reviewed=truth.time_ns < 100 * S)
    )
    (row,) = bench.score()
    assert (row["episodes"], row["available_clean_h"]) == (1, pytest.approx(100 / 3600))


def test_an_attacked_task_has_detection_and_no_false_alerts(bench: Any) -> None:
    bench.add("d")
    bench.add("d", "replay", alerts=[5, *range(110, 150)], unavailable=range(150, 160))
    row = bench.score()[1]
    assert row["detection_pct"] == pytest.approx(100 * 40 / 60)
    assert row["detection_pct_available"] == 80
    assert (row["detected"], row["ttfd_s"]) == (True, 10)
    assert (row["placebo_pct"], row["placebo_detected"]) == (0, False)
    assert row["partial_auc"] == pytest.approx(40 / 60, abs=0.01)
    for name in (
        "far_per_hour",
        "far_per_hour_lo",
        "far_per_hour_hi",
        "far_epoch",
        "far_floor_per_hour",
        "episodes",
    ):
        assert row[name] is None, name
    (event,) = bench.rows("events")
    assert (event["start_ns"], event["length_s"], event["ttfd_s"]) == (100_000_000_000, 60, 10)
    assert event["position_error_at_detection_m"] == event["largest_error_before_alert_m"] == 11
    assert event["largest_error_while_silent_m"] == 60
    assert (event["persisted_s"], event["alerted_share"]) == (40, pytest.approx(40 / 60))


@pytest.mark.parametrize("status", ["failed", "timeout", "out_of_memory"])
def test_a_failure_is_a_miss(bench: Any, status: str) -> None:
    bench.add("d", status=status)
    bench.add("d", "replay", status=status)
    clean, attacked = bench.score()
    assert (clean["status"], clean["reason"]) == (status, f"it is {status}")
    assert (
        clean["far_per_hour"],
        clean["far_epoch"],
        clean["available_clean_h"],
        clean["availability"],
    ) == (None, None, 0, 0)
    assert (
        attacked["detection_pct"],
        attacked["detection_pct_available"],
        attacked["detected"],
    ) == (0, None, False)
    assert attacked["ttfd_s"] is None
    (event,) = bench.rows("events")
    assert (event["detected"], event["ttfd_s"], event["length_s"]) == (False, None, 60)


@pytest.mark.parametrize("status", ["skipped", "not_modelled"])
def test_what_could_not_be_tried_is_null(bench: Any, status: str) -> None:
    bench.add("d", "replay", status=status)
    (row,) = bench.score()
    known = {"task_id", "point", "factor", "role", "recording", "session", "sensor_class"}
    known |= {"provenance", "attack", "attack_group", "window", "detector", "status", "reason"}
    assert {name for name, value in row.items() if value is not None} == known
    assert bench.rows("events") == []


def test_a_variant_that_could_not_be_made_is_nobodys_miss(bench: Any) -> None:
    bench.add("d", "replay", status="failed")
    next((bench.path / "truth").iterdir()).unlink()
    (row,) = bench.score()
    assert (row["status"], row["detection_pct"], row["detected"], row["epochs"]) == (
        "failed",
        None,
        None,
        None,
    )
    assert bench.rows("events") == []


def test_an_attack_in_the_unattacked_recording_is_neither_clean_nor_within_the_guard(
    bench: Any,
) -> None:
    """A field recording may itself hold an attack: here at 100-160 s, with a guard of 20 s after
    it, however long the detector says that it remembers.
    """
    bench.suite["memory_cap_s"] = 20.0
    bench.add("d", "real", alerts=[50, 120, 175], memory_s=1e6)
    bench.tasks[0] = replace(bench.tasks[0], attack=None)
    (row,) = bench.score()
    assert (row["episodes"], row["available_clean_h"]) == (1, 120 / 3600)
    assert row["detection_pct"] == pytest.approx(100 / 60)


@pytest.mark.parametrize(
    ("hold_s", "pct", "available_pct"),
    [(1.1, 20, 100), (4.0, 50, 100), (20.0, 100, 100), (None, 100, 100)],
)
def test_a_hold_keeps_a_slow_detector_available(
    bench: Any, hold_s: float | None, pct: float, available_pct: float
) -> None:
    slow = Decisions(np.arange(0, 200, 10) * 1_000_000_000, np.full(20, 2.0), np.ones(20, bool))
    bench.add("d", "replay", hold_s=hold_s, decisions=slow)
    (row,) = bench.score()
    assert row["detection_pct"] == pytest.approx(pct)
    assert row["detection_pct_available"] == pytest.approx(available_pct)
    assert row["availability"] == pytest.approx(pct / 100)


def test_a_copied_folder_gives_the_same_bytes(
    bench: Any, tmp_path_factory: pytest.TempPathFactory
) -> None:
    tmp_path = tmp_path_factory.mktemp("elsewhere")
    bench.add("d", "replay", alerts=[110])
    bench.add("d")
    bench.score()
    made = ("scores", "events", "calibration", "curves", "transfer")
    before = {name: (bench.path / f"{name}.parquet").read_bytes() for name in made}
    copy = tmp_path / "copy"
    shutil.copytree(bench.path, copy)
    for name in made:
        (copy / f"{name}.parquet").unlink()
    for folder in (bench.path, copy):
        score_folder(folder)
        assert {name: (folder / f"{name}.parquet").read_bytes() for name in made} == before


def test_rows_keep_the_order_of_the_tasks(bench: Any) -> None:
    for detector in ("b", "a"):
        bench.add(detector, "replay", alerts=[110])
        bench.add(detector)
    rows = bench.score()
    assert [row["task_id"] for row in rows] == ["t0", "t1", "t2", "t3"]
    assert [row["partial_auc"] is None for row in rows] == [False, True, False, True]


def test_a_damaged_folder_is_said_in_one_sentence(bench: Any, tmp_path: Path) -> None:
    with pytest.raises(ResultsError, match="cannot be read"):
        score_folder(tmp_path / "nowhere")
    bench.add("d")
    bench.score()
    (bench.path / "decisions" / "drive.parquet").unlink()
    with pytest.raises(ResultsError, match=r"drive\.parquet is damaged"):
        score_folder(bench.path)
    next((bench.path / "truth").iterdir()).unlink()
    with pytest.raises(ResultsError, match="cannot be read"):
        score_folder(bench.path)
