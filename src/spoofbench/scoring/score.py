"""Scores of a results folder, from its raw decisions and truth alone.

Every task that is judged is scored at its operating points: ``published``, the threshold of the
detector itself, and ``calibrated``, a factor on it that :mod:`.operating` finds on the calibration
side. ``scores.parquet`` has one row per task and point, ``events.parquet`` one per task, point and
attack interval, both in the order of ``tasks.parquet``, the ranked point first.

A task that failed scores as a detector that was never available: its attacks are missed and its
clean hours are none. Tasks that were skipped or not modelled have nulls, and so have failed ones
whose variant could not be made: there is no truth to score against.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, zip_longest
from math import inf
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa

from spoofbench.arrays import Bools
from spoofbench.decisions import Outcomes
from spoofbench.detector import Decisions
from spoofbench.results import (
    FAILURES,
    Task,
    Truth,
    has_truth,
    read_run,
    read_tasks,
    read_truth,
    write_parquet,
)
from spoofbench.scoring.grid import default_hold_s
from spoofbench.scoring.metrics import (
    Event,
    detection_pct,
    false_alerts,
    harm,
    largest_error,
    share,
)
from spoofbench.scoring.operating import Curves, Thresholds
from spoofbench.scoring.statistics import partial_auc, roc_curve
from spoofbench.scoring.trace import Trace, Twin, trace

P_FA_LIMIT = 0.01
"""Largest P_FA per epoch that the partial area under the ROC curve looks at."""

Point = Literal["calibrated", "published"]

_NAMES: tuple[tuple[str, pa.DataType], ...] = (
    ("task_id", pa.string()),
    ("point", pa.string()),
    ("factor", pa.float64()),
    ("role", pa.string()),
    ("recording", pa.string()),
    ("session", pa.string()),
    ("sensor_class", pa.string()),
    ("provenance", pa.string()),
    ("attack", pa.string()),
    ("attack_group", pa.string()),
    ("strength", pa.float64()),
    ("window", pa.int64()),
    ("detector", pa.string()),
)

SCORE_SCHEMA = pa.schema(
    [
        *_NAMES,
        ("status", pa.string()),
        ("reason", pa.string()),
        ("epochs", pa.int64()),
        ("availability", pa.float64()),
        ("alert_fraction", pa.float64()),
        ("episodes", pa.int64()),
        ("available_clean_h", pa.float64()),
        ("far_per_hour", pa.float64()),
        ("far_per_hour_lo", pa.float64()),
        ("far_per_hour_hi", pa.float64()),
        ("far_floor_per_hour", pa.float64()),
        ("far_epoch", pa.float64()),
        ("detection_pct", pa.float64()),
        ("detection_pct_available", pa.float64()),
        ("placebo_pct", pa.float64()),
        ("detected", pa.bool_()),
        ("placebo_detected", pa.bool_()),
        ("ttfd_s", pa.float64()),
        ("partial_auc", pa.float64()),
    ]
)

EVENT_SCHEMA = pa.schema(
    [
        *_NAMES,
        ("start_ns", pa.int64()),
        ("end_ns", pa.int64()),
        ("length_s", pa.float64()),
        ("alert_before", pa.bool_()),
        ("detected", pa.bool_()),
        ("placebo_detected", pa.bool_()),
        ("ttfd_s", pa.float64()),
        ("alerted_share", pa.float64()),
        ("placebo_share", pa.float64()),
        ("persisted_s", pa.float64()),
        ("retrust_s", pa.float64()),
        ("retrust_censored", pa.bool_()),
        ("position_error_at_detection_m", pa.float64()),
        ("largest_error_m", pa.float64()),
        ("largest_error_before_alert_m", pa.float64()),
        ("largest_error_while_silent_m", pa.float64()),
        ("hazardous", pa.bool_()),
        ("warned", pa.bool_()),
    ]
)

_NEVER_AVAILABLE = Decisions([], [], [])
_NO_TIMES = _NEVER_AVAILABLE.time_ns
_ROWS_AT_ONCE = 1000
_Cells = dict[str, Any]
"""What a row has, by column; the rest is null."""


@dataclass(frozen=True, slots=True)
class Rules:
    """What a suite says about scoring.

    Attributes:
        target_far_per_hour: false-alert rate at which detectors are ranked.
        memory_cap_s: how long after an attack nothing is scored, the same for all detectors.
        alert_limit_m, time_to_alert_s: errors above it are hazardous unless an alert comes in time;
            None where the suite sets no limit.
    """

    target_far_per_hour: float
    memory_cap_s: float
    alert_limit_m: float | None
    time_to_alert_s: float


def score_folder(folder: Path) -> None:
    """Write ``scores.parquet``, ``events.parquet``, ``calibration.parquet`` and ``curves.parquet``:
    same folder, same bytes.

    ``detected``, ``placebo_detected`` and ``ttfd_s`` of a task are those of its first attack
    interval; the events have them all.

    Raises:
        ResultsError: a file of the folder is missing or damaged.
    """
    tasks, suite = read_tasks(folder), read_run(folder)["suite"]
    rules = Rules(
        suite["target_far_per_hour"],
        suite["memory_cap_s"],
        suite["alert_limit_m"],
        suite["time_to_alert_s"],
    )
    reading = _Reading(folder, tasks)
    thresholds = Thresholds(rules.target_far_per_hour)
    for task, seen in reading.calibrating():
        thresholds.add(seen, task)
    classes = sorted({task.sensor_class for task in tasks if task.calibrates})
    curves = Curves(
        thresholds,
        {name: {task.session for task in tasks if task.sensor_class == name} for name in classes},
        rules.memory_cap_s,
    )
    scores, events = _Rows(SCORE_SCHEMA), _Rows(EVENT_SCHEMA)
    unscored = {index for index, task in enumerate(tasks) if task.is_judged}
    for index, seen, twin in reading.judged():
        task = tasks[index]
        unscored.remove(index)
        auc = _partial_auc(seen, twin)
        for point, factor in _points(thresholds, task):
            found, row = _scored(task, seen.at(factor), twin, rules)
            named = _identity(task) | {"point": point, "factor": factor}
            scores.add(index, named | row | auc)
            for event in found:
                events.add(index, named | event)
        curves.add(task, seen, twin)
    for index in unscored:
        task = tasks[index]
        for point, factor in _points(thresholds, task):
            named = _identity(task) | {"point": point, "factor": factor}
            scores.add(index, named | _fate(task))
    write_parquet(folder / "scores.parquet", scores.table())
    write_parquet(folder / "events.parquet", events.table())
    thresholds.write(folder)
    curves.write(folder)


def score_decisions(
    decisions: Decisions, truth: Truth, *, memory_s: float, hold_s: float | None = None
) -> dict[str, Any]:
    """Return what ``scores.parquet`` says of one task's decisions, at their own threshold; unknown
    is None.

    Where the truth has no attack, the false alerts are given, else what was detected, and what
    ``events.parquet`` says of the first attack interval.

    Args:
        decisions: of one detector on one recording.
        truth: of that recording.
        memory_s: how long an alert of the detector may outlast its cause.
        hold_s: how long a decision stands; None for by their own rate.
    """
    if hold_s is None:
        hold_s = default_hold_s(truth.epoch_ns, decisions.time_ns)
    seen = trace(decisions, truth, hold_s)
    row = _alerts(seen, np.ones(truth.time_ns.size, bool))
    if not truth.intervals:
        return row | _false_alerts(seen, seen.clean(memory_s))
    found = seen.events(truth.intervals)
    first = _event(seen, found[0], Rules(0.0, memory_s, None, 0.0))
    return row | first | _detection(seen, None, found, []) | {"partial_auc": None}


def _points(thresholds: Thresholds, task: Task) -> Iterator[tuple[Point, float]]:
    factor = thresholds.factor(task)
    if factor is not None:
        yield "calibrated", factor
    yield "published", 1.0


class _Rows:
    """Rows of a table as they come, by the number of their task; a thousand at a time become
    columns, which take a tenth of the memory.
    """

    def __init__(self, schema: pa.Schema) -> None:
        self._schema = schema
        self._parts: list[pa.Table] = []
        self._rows: list[_Cells] = []
        self._tasks: list[int] = []

    def add(self, task: int, row: _Cells) -> None:
        self._tasks.append(task)
        self._rows.append(row)
        if len(self._rows) == _ROWS_AT_ONCE:
            self._make_columns()

    def _make_columns(self) -> None:
        self._parts.append(pa.Table.from_pylist(self._rows, self._schema))
        self._rows.clear()

    def table(self) -> pa.Table:
        """Return the rows in the order of their tasks."""
        self._make_columns()
        order = np.argsort(np.array(self._tasks, np.int64), kind="stable")
        return pa.concat_tables(self._parts).take(pa.array(order)).combine_chunks()


class _Reading:
    """Reads decisions and truth of a folder, a recording at a time."""

    def __init__(self, folder: Path, tasks: Sequence[Task]) -> None:
        self.folder, self.tasks, self.outcomes = folder, tasks, Outcomes(folder)
        self.hold_s: dict[tuple[str, str], float] = {}

    def calibrating(self) -> Iterator[tuple[Task, Trace]]:
        """Yield the tasks that set thresholds, and what their detectors decided."""
        unattacked = [task for task in self.tasks if task.calibrates]
        unattacked.sort(key=lambda task: (task.recording, task.variant_id))
        for variant_id, group in groupby(unattacked, lambda task: task.variant_id):
            some = [task for task in group if task.status in ("ok", *FAILURES)]
            truth = self._truth(variant_id, some)
            if truth is not None:
                yield from ((task, self._trace(task, truth)) for task in some)

    def judged(self) -> Iterator[tuple[int, Trace, Twin | None]]:
        """Yield the index of each judged task that can be scored, what its detector decided, and
        what it decided on the unattacked recording.
        """
        judged = [
            index
            for index, task in enumerate(self.tasks)
            if task.is_judged and task.status in ("ok", *FAILURES)
        ]

        def place(index: int) -> tuple[str, bool, str]:
            task = self.tasks[index]
            return task.recording, task.attack is not None, task.variant_id

        twins: dict[str, Twin] = {}
        recording = ""
        for (name, is_attacked, variant_id), group in groupby(sorted(judged, key=place), place):
            if name != recording:
                recording, twins = name, {}
            own = list(group)
            truth = self._truth(variant_id, [self.tasks[index] for index in own])
            if truth is None:
                continue
            for index in own:
                task = self.tasks[index]
                seen = self._trace(task, truth)
                if not is_attacked:
                    twins[task.detector] = Twin(seen)
                yield index, seen, twins.get(task.detector) if is_attacked else None

    def _truth(self, variant_id: str, tasks: Sequence[Task]) -> Truth | None:
        """Return the truth of a variant; None where it could not be made, and no task on it is ok.

        Raises:
            ResultsError: its file is damaged, or is missing although a task on it is ok.
        """
        if has_truth(self.folder, variant_id) or any(task.status == "ok" for task in tasks):
            return read_truth(self.folder, variant_id)
        return None

    def _trace(self, task: Task, truth: Truth) -> Trace:
        decisions = _NEVER_AVAILABLE
        if task.status not in FAILURES:
            decisions = self.outcomes.decisions(task.recording, task.task_id)
        return trace(decisions, truth, self._hold_s(task, truth, decisions))

    def _hold_s(self, task: Task, truth: Truth, decisions: Decisions) -> float:
        """How long a decision stands, by the first decisions that come of a recording: those on it
        as it is.
        """
        if task.hold_s is not None:
            return task.hold_s
        key = task.recording, task.detector
        if key not in self.hold_s:
            hold_s = default_hold_s(truth.epoch_ns, decisions.time_ns)
            if not decisions.time_ns.size:
                return hold_s  # says nothing of the detector's own rate
            self.hold_s[key] = hold_s
        return self.hold_s[key]


def _scored(
    task: Task, seen: Trace, twin: Twin | None, rules: Rules
) -> tuple[list[_Cells], _Cells]:
    """Return the events and the row of one task at one operating point."""
    truth = seen.truth
    found = seen.events(truth.intervals)
    placebo = twin.events(truth.intervals, seen.factor) if twin else []
    events = [
        _event(seen, event, rules) | _placebo(event, other, twin, seen.factor)
        for event, other in zip_longest(found, placebo)
    ]
    judged = truth.time_ns >= (task.judged_start_ns or 0)
    row = _fate(task) | _alerts(seen, judged) | _detection(seen, twin, found, placebo)
    if task.attack is None or task.provenance == "real attack":
        row |= _false_alerts(seen, seen.clean(rules.memory_cap_s) & judged)
    return events, row


def _identity(task: Task) -> _Cells:
    names = [name for name, _ in _NAMES if name not in ("point", "factor")]
    return {name: getattr(task, name) for name in names}


def _fate(task: Task) -> _Cells:
    return {"status": task.status, "reason": task.reason}


def _alerts(seen: Trace, epochs: Bools) -> _Cells:
    """Availability and alerts over these epochs."""
    return {
        "epochs": int(epochs.sum()),
        "availability": share(~np.isnan(seen.score), epochs),
        "alert_fraction": share(seen.alert, epochs),
    }


def _false_alerts(seen: Trace, clean: Bools) -> _Cells:
    """False alerts over the available clean epochs."""
    truth, level = seen.truth, seen.level
    counted = ~np.isnan(level) & clean
    false = false_alerts(truth.time_ns, seen.alert, counted, truth.epoch_ns, level > seen.factor)
    return {
        "far_per_hour": false.per_hour,
        "far_per_hour_lo": false.per_hour_lo,
        "far_per_hour_hi": false.per_hour_hi,
        "far_floor_per_hour": false.floor_per_hour,
        "far_epoch": false.epoch,
        "episodes": false.episodes,
        "available_clean_h": false.hours,
    }


def _detection(
    seen: Trace, twin: Twin | None, found: Sequence[Event], placebo: Sequence[Event]
) -> _Cells:
    truth = seen.truth
    if not truth.intervals:
        return {}
    over_all, over_available = detection_pct(seen.alert, ~np.isnan(seen.score), truth.spoofed)
    alerted = None if twin is None else twin.alerted_share(truth.intervals, seen.factor)
    return {
        "detection_pct": over_all,
        "detection_pct_available": over_available,
        "placebo_pct": None if alerted is None else 100 * alerted,
        "detected": found[0].detected,
        "placebo_detected": placebo[0].detected if placebo else None,
        "ttfd_s": found[0].ttfd_s,
    }


def _event(seen: Trace, event: Event, rules: Rules) -> _Cells:
    truth, interval = seen.truth, event.interval
    limit_m = rules.alert_limit_m
    done = harm(
        event,
        truth.time_ns,
        truth.position_error_m,
        seen.alert,
        alert_limit_m=inf if limit_m is None else limit_m,
        time_to_alert_s=rules.time_to_alert_s,
    )
    return {
        "start_ns": interval.start_ns,
        "end_ns": interval.end_ns,
        "length_s": interval.duration_s,
        "alert_before": event.alert_before,
        "detected": event.detected,
        "ttfd_s": event.ttfd_s,
        "alerted_share": done.alerted_share,
        "persisted_s": event.persisted_s,
        "retrust_s": event.retrust_s,
        "retrust_censored": event.retrust_censored,
        "position_error_at_detection_m": done.error_at_detection_m,
        "largest_error_m": largest_error(truth.position_error_m, interval.covers(truth.time_ns)),
        "largest_error_before_alert_m": done.largest_error_before_alert_m,
        "largest_error_while_silent_m": done.largest_error_while_silent_m,
        "hazardous": None if limit_m is None else done.hazardous,
        "warned": None if limit_m is None else done.warned,
    }


def _placebo(event: Event, other: Event | None, twin: Twin | None, factor: float) -> _Cells:
    """The same interval of the unattacked recording."""
    return {
        "placebo_detected": other and other.detected,
        "placebo_share": twin and twin.alerted_share((event.interval,), factor),
    }


def _partial_auc(seen: Trace, twin: Twin | None) -> _Cells:
    if twin is None or not seen.truth.intervals:
        return {}
    curve = roc_curve(twin.clean_score, seen.score[seen.truth.spoofed])
    return {"partial_auc": None if curve is None else partial_auc(*curve, P_FA_LIMIT)}
