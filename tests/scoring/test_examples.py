"""The worked cases of the definitions, run-length coded, and in their original form where it stands
beside the project.
"""

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spoofbench.detector import Decisions
from spoofbench.recording import Interval
from spoofbench.results import Truth
from spoofbench.scoring.grid import score_on_grid, within
from spoofbench.scoring.metrics import detection_pct, false_alerts, find_events, share

HERE = Path(__file__).parent
ORIGINAL = HERE.parents[2] / "shared" / "design" / "score_examples.json"
CASES = json.loads((HERE / "score_examples.json").read_text())
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
            }
            for event in find_events(time_ns, alert, available, intervals)
        ],
    }


def check(case: dict[str, Any]) -> None:
    found = scored(case)
    assert found.keys() >= case["expected"].keys()
    for name, expected in case["expected"].items():
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
    assert [case["name"] for case in ORIGINALS] == [case["name"] for case in CASES]
    for name in ("t_s", "alert", "available", "spoofed", "expected"):
        assert [case[name] for case in ORIGINALS] == [unfolded(case)[name] for case in CASES]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["name"])
def test_decisions_at_epochs_come_through_the_grid(case: dict[str, Any]) -> None:
    full = unfolded(case)
    time_ns = np.array([round(t * 1e9) for t in full["t_s"]], np.int64)
    alert, available = np.array(full["alert"]), np.array(full["available"])
    nothing = np.full(time_ns.size, np.nan)
    flags = np.zeros(time_ns.size, bool)
    truth = Truth(
        time_ns,
        *(~flags, flags, flags, ~flags),
        *itertools.repeat(nothing, 6),
        round(full["dt_s"] * 1e9),
        (),
    )
    score = np.where(alert, 1.5, 0.5)
    np.testing.assert_array_equal(
        score_on_grid(Decisions(time_ns, score, available), truth, None),
        np.where(available, score, np.nan),
    )
