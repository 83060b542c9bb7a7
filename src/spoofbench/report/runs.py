"""What the page carries of each run: its labels, figures, decisions and the track it was on."""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from spoofbench.formatting import NONE, between, date_time, percent, rate, seconds, share_percent
from spoofbench.report.traces import (
    STEPS,
    Plane,
    Pool,
    interval_s,
    milliseconds,
    pack_scores,
    thinned,
)
from spoofbench.results import (
    Task,
    Truth,
    has_truth,
    read_outcome,
    read_rows,
    read_tasks,
    read_truth,
)
from spoofbench.scoring.grid import GUARD_S
from spoofbench.scoring.score import SCORE_SCHEMA

CLEAN = "none (clean)"
"""What the page calls the attack of an unattacked task."""

_DECISION_BYTES = 6_000_000
"""What the decisions of all runs may take, each an equal part; a run that needs more is thinned."""

_TIMED_BYTES, _UNTIMED_BYTES = 8, 8 / 3
"""A decision in base64, with a time of its own (4 + 2 bytes) and at the variant's epochs (2 bytes).
"""


def payload(folder: Path, best: str) -> dict[str, Any]:
    """Return the page's data for the whole folder, ready for JSON; the page opens with the ``best``
    detector under attack.

    Raises:
        ResultsError: the folder lacks a file or a file is damaged.
    """
    tasks = read_tasks(folder)
    scores = {row["task_id"]: row for row in read_rows(folder / "scores.parquet", SCORE_SCHEMA)}
    truths = {
        task.variant_id: read_truth(folder, task.variant_id)
        for task in tasks
        if has_truth(folder, task.variant_id)
    }
    pool = Pool()
    planes = _planes(tasks, truths)
    of_variant: dict[str, Task] = {}
    for task in tasks:
        of_variant.setdefault(task.variant_id, task)
    place = {name: i for i, name in enumerate(of_variant)}
    room = _DECISION_BYTES / max(len(tasks), 1)
    return {
        "steps": STEPS,
        "variants": [
            _variant(task, truths.get(name), planes.get(task.recording), pool)
            for name, task in of_variant.items()
        ],
        "runs": [
            _run(
                task,
                place[task.variant_id],
                scores.get(task.task_id, {}),
                _trace(folder, task, truths, pool, room),
            )
            for task in tasks
        ],
        "first": next(
            (i for i, task in enumerate(tasks) if task.attack and task.detector == best), 0
        ),
        "arrays": pool.items,
    }


def labels(task: Task) -> dict[str, str]:
    """Return the labels by which the page finds a run."""
    return {
        "detector": task.detector,
        "recording": task.recording,
        "attack": task.attack or CLEAN,
        "seed": NONE if task.seed is None else str(task.seed),
    }


def _planes(tasks: Iterable[Task], truths: Mapping[str, Truth]) -> dict[str, Plane]:
    """One plane for all variants of a recording, so that they share the clean track."""
    planes: dict[str, Plane] = {}
    for task in tasks:
        if task.recording not in planes and task.variant_id in truths:
            plane = Plane.at_start(truths[task.variant_id])
            planes |= {task.recording: plane} if plane else {}
    return planes


def _variant(task: Task, truth: Truth | None, plane: Plane | None, pool: Pool) -> dict[str, Any]:
    name = {key: text for key, text in labels(task).items() if key != "detector"}
    if truth is None or not truth.time_ns.size:
        return name | {
            "epochs": pool.add([], "<i4"),
            "clean": pool.add([], "<i4"),
            "attacked": [],
            "intervals": [],
        }
    start_ns = int(truth.time_ns[0])
    plane = plane or Plane(0.0, 0.0)
    attacked = []
    for interval in truth.intervals:
        rows = np.flatnonzero(interval.covers(truth.time_ns))
        if rows.size:
            moved = plane.east_north_dm(truth.lat_deg[rows], truth.lon_deg[rows])
            attacked.append({"first": int(rows[0]), "track": pool.add(moved, "<i4")})
    return name | {
        "epochs": pool.add(milliseconds(truth.time_ns, start_ns), "<i4"),
        "clean": pool.add(plane.east_north_dm(truth.clean_lat_deg, truth.clean_lon_deg), "<i4"),
        "attacked": attacked,
        "intervals": [interval_s(interval, start_ns) for interval in truth.intervals],
        "start": date_time(start_ns),
    }


def _trace(
    folder: Path, task: Task, truths: Mapping[str, Truth], pool: Pool, room: float
) -> dict[str, int] | None:
    outcome = read_outcome(folder, task.task_id)
    truth = truths.get(task.variant_id)
    if outcome is None or outcome.decisions is None or truth is None or not truth.time_ns.size:
        return None
    decisions = outcome.decisions
    shared = np.array_equal(decisions.time_ns, truth.time_ns)
    n = decisions.time_ns.size
    rows = (
        np.arange(n)
        if shared and n * _UNTIMED_BYTES <= room
        else thinned(decisions, max(200, int(room / _TIMED_BYTES)))
    )
    return {
        "time": pool.add(milliseconds(decisions.time_ns[rows], int(truth.time_ns[0])), "<i4"),
        "score": pool.add(pack_scores(decisions.score[rows], decisions.available[rows]), "<i2"),
        "rows": n,
    }


def _run(
    task: Task, variant: int, scores: Mapping[str, Any], trace: dict[str, int] | None
) -> dict[str, Any]:
    return {
        "variant": variant,
        "detector": task.detector,
        "status": task.status,
        "reason": task.reason,
        "guard_s": max(GUARD_S, task.memory_s),
        "facts": _facts(task, scores),
        "summary": f"Score over time of {task.detector} on {task.attack or CLEAN}",
        "trace": trace,
    }


def _facts(task: Task, scores: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Name and text of what is to be said beside a run's plots; a clean run has no detection, an
    attacked no false alerts.
    """
    if task.attack is None:
        low, high = rate(scores.get("far_per_hour_lo")), rate(scores.get("far_per_hour_hi"))
        figures = [
            (
                "False alerts",
                _unit(rate(scores.get("far_per_hour")), f"per hour (95 %: {between(low, high)})"),
            ),
            (
                "Alerted share of available clean epochs",
                _unit(share_percent(scores.get("far_epoch")), "%"),
            ),
        ]
    else:
        figures = [
            ("Detection", _unit(percent(scores.get("detection_pct")), "%")),
            (
                "Detection where available",
                _unit(percent(scores.get("detection_pct_available")), "%"),
            ),
            ("Time to first detection", _unit(seconds(scores.get("ttfd_s")), "s")),
            (
                "Position error at detection",
                _unit(rate(scores.get("position_error_at_detection_m")), "m"),
            ),
            ("Attack parameters", _parameters(task.attack_parameters)),
        ]
    return [
        *figures,
        ("Availability", _unit(share_percent(scores.get("availability")), "%")),
        ("Detector parameters", _parameters(task.parameters)),
        ("Plugin", f"{task.plugin} from {task.plugin_distribution} {task.plugin_version}"),
        ("Task", task.task_id),
    ]


def _parameters(text: str | None) -> str:
    """Return ``delay_s = 60.0, ...`` of a JSON object, other text as it is."""
    if text is None:
        return NONE
    try:
        values = json.loads(text)
    except ValueError:
        return text
    if not isinstance(values, dict):
        return text
    return ", ".join(f"{name} = {json.dumps(value)}" for name, value in values.items()) or NONE


def _unit(text: str, unit: str) -> str:
    return text if text == NONE else f"{text} {unit}"
