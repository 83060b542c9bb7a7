"""The worked cases of the definitions, run-length coded, and in their original form where it stands
beside the project.
"""

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spoofbench.arrays import Times
from spoofbench.detector import Decisions
from spoofbench.recording import Interval
from spoofbench.results import Truth
from spoofbench.scoring.grid import default_hold_s, score_on_grid, within
from spoofbench.scoring.metrics import detection_pct, false_alerts, find_events, share

HERE = Path(__file__).parent
ORIGINAL = HERE.parents[2] / "shared" / "design" / "score_examples.json"
CASES = json.loads((HERE / "score_examples.json").read_text())
HOLDS = json.loads((HERE / "hold_examples.json").read_text())
ORIGINALS = json.loads(ORIGINAL.read_text()) if ORIGINAL.exists() else []


def unfolded(case: dict[str, Any]) -> dict[str, Any]:
    """A case with one value per epoch."""
    flags = {
        name: None
        if case[name] is None
        else [flag for flag, count in case[name] for _ in range(count)]
        for name in ("alert", "available", "spoofed")
    }
    return {**case, **flags, "t_s": [row * case["dt_s"] for row in range(case["epochs"])]}


def scored(case: dict[str, Any]) -> dict[str, Any]:
    """Everything that a case may expect."""
    time_ns = np.array([round(t * 1e9) for t in case["t_s"]], np.int64)
    alert, available = np.array(case["alert"], bool), np.array(case["available"], bool)
    epoch_ns = round(case["dt_s"] * 1e9)
    if case["spoofed"] is None:
        false = false_alerts(time_ns, alert, available, epoch_ns)
        return {
            "far_epoch": false.epoch,
            "far_per_hour": false.per_hour,
            "far_per_hour_lo": false.per_hour_lo,
            "far_per_hour_hi": false.per_hour_hi,
            "episodes": false.episodes,
            "availability": share(available, np.ones(alert.size, bool)),
        }
    spoofed = np.array(case["spoofed"], bool)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], spoofed, [False]])))
    intervals = [Interval(int(a) * epoch_ns, int(b) * epoch_ns) for a, b in edges.reshape(-1, 2)]
    np.testing.assert_array_equal(within(time_ns, intervals), spoofed)
    over_all, over_available = detection_pct(alert, available, spoofed)
    return {
        "detection_pct": over_all,
        "detection_pct_available": over_available,
        "events": [
            {
                "start_s": event.interval.start_ns / 1e9,
                "length_s": event.interval.duration_s,
                "alert_before": event.alert_before,
                "detected": event.detected,
                "ttfd_s": event.ttfd_s,
                "persisted_s": event.persisted_s,
                "retrust_s": event.retrust_s,
            }
            for event in find_events(
                time_ns,
                alert & available,
                intervals,
                hold_s=1.1 * case["dt_s"],
                end_ns=alert.size * epoch_ns,
                unreviewed_ns=time_ns[:0],
            )
        ],
    }


def check(case: dict[str, Any]) -> None:
    found = scored(case)
    assert found.keys() >= case["expected"].keys()
    for name, expected in case["expected"].items():
        if name == "events":
            assert len(found[name]) == len(expected)
            for event, wanted in zip(found[name], expected, strict=True):
                assert event.items() >= wanted.items()
            continue
        assert found[name] == (
            pytest.approx(expected, rel=1e-12) if isinstance(expected, float) else expected
        ), name


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["name"])
def test_worked_case(case: dict[str, Any]) -> None:
    check(unfolded(case))


@pytest.mark.skipif(not ORIGINALS, reason="the original cases are not beside the project")
def test_original_cases() -> None:
    for case in ORIGINALS:
        check(case)
    ours = [unfolded(case) for case in CASES[: len(ORIGINALS)]]
    for name in ("name", "t_s", "alert", "available", "spoofed", "expected"):
        assert [case[name] for case in ORIGINALS] == [case[name] for case in ours]


def grid(time_ns: Times, epoch_ns: int) -> Truth:
    """A truth without an attack."""
    nothing, flags = np.full(time_ns.size, np.nan), np.zeros(time_ns.size, bool)
    return Truth(time_ns, ~flags, flags, flags, ~flags, *itertools.repeat(nothing, 6), epoch_ns, ())


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["name"])
def test_decisions_at_epochs_come_through_the_grid(case: dict[str, Any]) -> None:
    full = unfolded(case)
    time_ns = np.array([round(t * 1e9) for t in full["t_s"]], np.int64)
    alert, available = np.array(full["alert"]), np.array(full["available"])
    score = np.where(alert, 1.5, 0.5)
    truth = grid(time_ns, round(full["dt_s"] * 1e9))
    np.testing.assert_array_equal(
        score_on_grid(
            Decisions(time_ns, score, available), truth, default_hold_s(truth.epoch_ns, time_ns)
        ),
        np.where(available, score, np.nan),
    )


@pytest.mark.parametrize("case", HOLDS, ids=lambda case: case["name"])
def test_worked_case_of_a_hold(case: dict[str, Any]) -> None:
    """A score of null is an unavailable decision, or an unavailable epoch."""
    epochs, times, clean = (
        np.array([round(t * 1e9) for t in case[name]], np.int64)
        for name in ("epoch_s", "decision_s", "clean_decision_s")
    )
    score = np.array(case["score"], np.float64)
    truth = grid(epochs, int(np.median(np.diff(epochs))))
    hold_s = default_hold_s(truth.epoch_ns, clean)
    assert hold_s == pytest.approx(case["expected"]["hold_s"])
    np.testing.assert_array_equal(
        score_on_grid(Decisions(times, score, ~np.isnan(score)), truth, hold_s),
        np.array(case["expected"]["score"], np.float64),
    )
