"""Scores of a results folder, from its raw decisions and truth alone.

``scores.parquet`` has one row per task, ``events.parquet`` one per task and attack interval, both
in the order of ``tasks.parquet``. A task that failed scores as a detector that was never available:
its attacks are missed and its clean hours are none. Tasks that were skipped or not modelled have
nulls, and so have failed ones whose variant could not be made: there is no truth to score against.
"""

import math
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from spoofbench.arrays import Bools, Floats
from spoofbench.detector import Decisions
from spoofbench.errors import ResultsError
from spoofbench.results import (
    FAILURES,
    Task,
    Truth,
    has_truth,
    read_outcome,
    read_tasks,
    read_truth,
    write_parquet,
)
from spoofbench.scoring.grid import default_hold_s, release_guard, score_on_grid, within
from spoofbench.scoring.metrics import (
    alarm_level,
    detection_pct,
    false_alerts,
    find_events,
    harm,
    largest_error,
    share,
)
from spoofbench.scoring.statistics import partial_auc, roc_curve

P_FA_LIMIT = 0.01
"""Largest P_FA per epoch that the partial area under the ROC curve looks at."""

# spoofbench.scoring.metrics says what the figures are
SCORE_SCHEMA = pa.schema(
    [
        ("recording", pa.string()),
        ("attack", pa.string()),
        ("seed", pa.int64()),
        ("detector", pa.string()),
        ("status", pa.string()),
        ("reason", pa.string()),
        ("far_per_hour", pa.float64()),
        ("far_per_hour_lo", pa.float64()),
        ("far_per_hour_hi", pa.float64()),
        ("far_epoch", pa.float64()),
        ("alert_fraction", pa.float64()),
        ("detection_pct", pa.float64()),
        ("detection_pct_available", pa.float64()),
        ("ttfd_s", pa.float64()),
        ("detected", pa.bool_()),
        ("availability", pa.float64()),
        ("position_error_at_detection_m", pa.float64()),
        ("largest_undetected_position_error_m", pa.float64()),
        ("partial_auc", pa.float64()),
        ("far_floor_per_hour", pa.float64()),
        ("episodes", pa.int64()),
        ("available_clean_h", pa.float64()),
        ("epochs", pa.int64()),
        ("task_id", pa.string()),
        ("session", pa.string()),
    ]
)

EVENT_SCHEMA = pa.schema(
    [
        ("recording", pa.string()),
        ("attack", pa.string()),
        ("seed", pa.int64()),
        ("detector", pa.string()),
        ("start_ns", pa.int64()),
        ("end_ns", pa.int64()),
        ("length_s", pa.float64()),
        ("alert_before", pa.bool_()),
        ("detected", pa.bool_()),
        ("ttfd_s", pa.float64()),
        ("position_error_at_detection_m", pa.float64()),
        ("largest_undetected_position_error_m", pa.float64()),
        ("task_id", pa.string()),
        ("session", pa.string()),
    ]
)

_NEVER_AVAILABLE = Decisions([], [], [])
_NO_TIMES = _NEVER_AVAILABLE.time_ns
_Cells = dict[str, Any]
"""What a row has, by column; the rest is null."""


def score_folder(folder: Path) -> None:
    """Write ``scores.parquet`` and ``events.parquet``: same folder, same bytes.

    The truth of a variant is read once, unattacked variants first: the ROC curve of an attacked
    task needs the scores of its detector on the clean recording. ``detected``, ``ttfd_s`` and
    ``position_error_at_detection_m`` of a task are those of its first attack interval; the events
    have them all.

    Raises:
        ResultsError: a file of the folder is missing or damaged.
    """
    tasks = read_tasks(folder)
    rows: list[_Cells] = [
        _identity(task) | {"status": task.status, "reason": task.reason} for task in tasks
    ]
    events: list[list[_Cells]] = [[] for _ in tasks]
    clean_scores: dict[tuple[str, str], Floats] = {}
    default_holds_s: dict[tuple[str, str], float] = {}

    def by_variant(index: int) -> tuple[bool, str]:
        return tasks[index].attack is not None, tasks[index].variant_id

    scored = [index for index, task in enumerate(tasks) if _can_be_scored(folder, task)]
    for (_, variant_id), group in groupby(sorted(scored, key=by_variant), by_variant):
        truth = read_truth(folder, variant_id)
        for index in group:
            task = tasks[index]
            decisions = _decisions(folder, task)
            key = (task.recording, task.detector)
            if task.attack is None:
                default_holds_s[key] = default_hold_s(truth.epoch_ns, decisions.time_ns)
            hold_s = task.hold_s
            if hold_s is None:
                hold_s = default_holds_s.get(key, default_hold_s(truth.epoch_ns, _NO_TIMES))
            score = score_on_grid(decisions, truth, hold_s)
            if task.attack is None:
                clean_scores[key] = score[_clean(truth, task.memory_s)]
            found = _events(truth, decisions, score > 1, hold_s)
            events[index] = [_identity(task) | event for event in found]
            rows[index] |= _scores(
                truth, decisions, score, found, task.memory_s, unattacked=task.attack is None
            )
            rows[index]["partial_auc"] = _partial_auc(clean_scores.get(key), score[truth.spoofed])
    write_parquet(folder / "scores.parquet", pa.Table.from_pylist(rows, SCORE_SCHEMA))
    write_parquet(
        folder / "events.parquet",
        pa.Table.from_pylist([event for some in events for event in some], EVENT_SCHEMA),
    )


def score_decisions(
    decisions: Decisions, truth: Truth, *, memory_s: float, hold_s: float | None = None
) -> dict[str, Any]:
    """Return what ``scores.parquet`` says of one task's decisions; unknown is None.

    Where the truth has no attack, the false alerts are given, else what was detected.

    Args:
        decisions: of one detector on one recording.
        truth: of that recording.
        memory_s: how long an alert of the detector may outlast its cause.
        hold_s: how long a decision stands; None is the default of these decisions, see
            :func:`spoofbench.scoring.grid.default_hold_s`.
    """
    if hold_s is None:
        hold_s = default_hold_s(truth.epoch_ns, decisions.time_ns)
    score = score_on_grid(decisions, truth, hold_s)
    events = _events(truth, decisions, score > 1, hold_s)
    return _scores(truth, decisions, score, events, memory_s, unattacked=not truth.intervals)


def _scores(
    truth: Truth,
    decisions: Decisions,
    score: Floats,
    events: list[_Cells],
    memory_s: float,
    *,
    unattacked: bool,
) -> _Cells:
    """Return availability, alerts and detections and, where there is no attack, false alerts."""
    cells = _alerts(score) | _detection(truth, score, events)
    return cells | _false_alerts(truth, decisions, score, memory_s) if unattacked else cells


def _can_be_scored(folder: Path, task: Task) -> bool:
    return task.status == "ok" or (task.status in FAILURES and has_truth(folder, task.variant_id))


def _identity(task: Task) -> _Cells:
    return {
        name: getattr(task, name)
        for name in ("recording", "attack", "seed", "detector", "task_id", "session")
    }


def _decisions(folder: Path, task: Task) -> Decisions:
    if task.status in FAILURES:
        return _NEVER_AVAILABLE
    outcome = read_outcome(folder, task.task_id)
    if outcome is None or outcome.decisions is None:
        raise ResultsError(
            f"task {task.task_id!r} is ok but {folder} has no decisions of it; resume the run"
        )
    return outcome.decisions


def _clean(truth: Truth, memory_s: float) -> Bools:
    """Epochs known to be neither spoofed nor within the release guard, ``(n,)``."""
    guard = release_guard(truth.time_ns, truth.intervals, memory_s)
    return truth.reviewed & ~(within(truth.time_ns, truth.intervals) | guard)


def _alerts(score: Floats) -> _Cells:
    """Availability and alerts over all epochs."""
    every = np.ones(score.size, bool)
    return {
        "epochs": score.size,
        "availability": share(~np.isnan(score), every),
        "alert_fraction": share(score > 1, every),
    }


def _false_alerts(truth: Truth, decisions: Decisions, score: Floats, memory_s: float) -> _Cells:
    """False alerts over the available clean epochs."""
    level = alarm_level(truth.time_ns, score, decisions.time_ns, decisions.score)
    counted = ~np.isnan(level) & _clean(truth, memory_s)
    false = false_alerts(truth.time_ns, score > 1, counted, truth.epoch_ns, level > 1)
    return {
        "far_per_hour": false.per_hour,
        "far_per_hour_lo": false.per_hour_lo,
        "far_per_hour_hi": false.per_hour_hi,
        "far_floor_per_hour": false.floor_per_hour,
        "far_epoch": false.epoch,
        "episodes": false.episodes,
        "available_clean_h": false.hours,
    }


def _detection(truth: Truth, score: Floats, events: list[_Cells]) -> _Cells:
    alert = score > 1
    over_all, over_available = detection_pct(alert, ~np.isnan(score), truth.spoofed)
    first = events[0] if events else {}
    return {
        "detection_pct": over_all,
        "detection_pct_available": over_available,
        "largest_undetected_position_error_m": largest_error(
            truth.position_error_m, truth.spoofed & ~alert
        ),
        **{
            name: first.get(name)
            for name in ("detected", "ttfd_s", "position_error_at_detection_m")
        },
    }


def _events(truth: Truth, decisions: Decisions, alert: Bools, hold_s: float) -> list[_Cells]:
    """Return what came of each attack interval."""
    found = find_events(
        decisions.time_ns,
        decisions.alert,
        truth.intervals,
        hold_s=hold_s,
        end_ns=int(truth.time_ns[-1]) + truth.epoch_ns,
        unreviewed_ns=truth.time_ns[~truth.reviewed],
    )
    cells = []
    for event in found:
        done = harm(
            event,
            truth.time_ns,
            truth.position_error_m,
            alert,
            alert_limit_m=math.inf,
            time_to_alert_s=0.0,
        )
        cells.append(
            {
                "start_ns": event.interval.start_ns,
                "end_ns": event.interval.end_ns,
                "length_s": event.interval.duration_s,
                "alert_before": event.alert_before,
                "detected": event.detected,
                "ttfd_s": event.ttfd_s,
                "position_error_at_detection_m": done.error_at_detection_m,
                "largest_undetected_position_error_m": done.largest_error_while_silent_m,
            }
        )
    return cells


def _partial_auc(clean_score: Floats | None, spoofed_score: Floats) -> float | None:
    curve = None if clean_score is None else roc_curve(clean_score, spoofed_score)
    return None if curve is None else partial_auc(*curve, P_FA_LIMIT)
