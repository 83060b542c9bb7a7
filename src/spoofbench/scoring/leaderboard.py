"""The leaderboard of a results folder: one row per detector configuration, one cell per detector
and attack.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

from spoofbench.errors import ResultsError
from spoofbench.results import FAILURES, Task, read_rows, read_run, read_tasks
from spoofbench.scoring.metrics import false_alert_rate
from spoofbench.scoring.score import EVENT_SCHEMA, SCORE_SCHEMA
from spoofbench.scoring.statistics import Survival, proportion, session_interval, survival

BASELINES = "spoofbench-baselines"
"""The distribution whose detectors are rows of chance."""

_Cells = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Row:
    """One detector configuration over all tasks of a folder; null is None throughout.

    Attributes:
        rank: 1 is best, equal where nothing tells two rows apart; None where no attacked task could
            be scored.
        detector: name in the suite.
        plugin, plugin_distribution, plugin_version, parameters: what it is; parameters as JSON
            text.
        baseline: a row of chance, for comparison.
        keeps_target: whether the lower end of the false-alert interval is at most the target; None
            where the rate is unknown.
        detection_pct: mean over attacked tasks, failures as 0; ``lo`` and ``hi`` by bootstrap over
            sessions, None below 5.
        restricted_mean_ttfd_s: mean time to first detection, restricted to the folder's longest
            attack.
        ttfd_median_s, ttfd_p90_s: Kaplan-Meier over attack intervals; None where fewer than that
            share are ever detected.
        p_md: missed share of attack intervals, ``detected`` of ``events``; ``lo`` and ``hi`` by
            bootstrap over sessions, None below 5.
        far_per_hour: episodes per available clean hour over unattacked tasks pooled by time, with
            Garwood interval.
        far_floor_per_hour: the lowest rate that so many hours can resolve, 3/T.
        far_epoch, availability: over the same tasks, pooled by epochs.
        position_error_at_detection_m: median over detected attack intervals.
        largest_undetected_position_error_m: over all spoofed epochs without alert.
        partial_auc: mean over attacked tasks of the area under the ROC curve at low P_FA, as a
            share of the largest possible.
        ok, failed, skipped, not_modelled: numbers of tasks; ``failed`` holds timeouts and memory as
            well.
    """

    rank: int | None
    detector: str
    plugin: str
    plugin_distribution: str
    plugin_version: str
    parameters: str
    baseline: bool
    keeps_target: bool | None
    detection_pct: float | None
    detection_pct_lo: float | None
    detection_pct_hi: float | None
    restricted_mean_ttfd_s: float | None
    ttfd_median_s: float | None
    ttfd_p90_s: float | None
    p_md: float | None
    p_md_lo: float | None
    p_md_hi: float | None
    detected: int
    events: int
    far_per_hour: float | None
    far_per_hour_lo: float | None
    far_per_hour_hi: float | None
    far_floor_per_hour: float | None
    far_epoch: float | None
    availability: float | None
    position_error_at_detection_m: float | None
    largest_undetected_position_error_m: float | None
    partial_auc: float | None
    ok: int
    failed: int
    skipped: int
    not_modelled: int


@dataclass(frozen=True, slots=True)
class Cell:
    """One detector configuration against one attack; fields as in :class:`Row`, but P_MD with
    Clopper-Pearson interval.
    """

    detector: str
    attack: str
    detection_pct: float | None
    p_md: float | None
    p_md_lo: float | None
    p_md_hi: float | None
    ttfd_median_s: float | None
    detected: int
    events: int
    ok: int
    failed: int
    skipped: int
    not_modelled: int


@dataclass(frozen=True, slots=True)
class Leaderboard:
    """What a results folder says.

    Attributes:
        rows: best first.
        cells: by detector in the order of the rows, then attack in the order of the suite.
        attacks: in the order of the suite.
        recordings, sessions: how many there are.
        target_far_per_hour: the false-alert rate that a detector is to keep.
        note: what every table must say about its thresholds; empty where there is nothing to say.
    """

    rows: tuple[Row, ...]
    cells: tuple[Cell, ...]
    attacks: tuple[str, ...]
    recordings: int
    sessions: int
    target_far_per_hour: float
    note: str


def leaderboard(folder: Path) -> Leaderboard:
    """Return the leaderboard of a scored results folder.

    Rows that keep the target false-alert rate come before those that do not, and those before rows
    whose rate is unknown; within each by detection percentage, then by restricted mean time to
    first detection.

    Raises:
        ResultsError: a file of the folder is missing or damaged, or the folder has no tasks.
    """
    tasks = read_tasks(folder)
    if not tasks:
        raise ResultsError(f"{folder} has no tasks to rank; run a suite into it")
    scores = read_rows(folder / "scores.parquet", SCORE_SCHEMA)
    events = read_rows(folder / "events.parquet", EVENT_SCHEMA)
    if [row["task_id"] for row in scores] != [task.task_id for task in tasks]:
        raise ResultsError(f"the scores in {folder} are not those of its tasks; score it again")
    horizon_s = max((event["length_s"] for event in events), default=0.0)
    detectors = list(dict.fromkeys(task.detector for task in tasks))
    attacks = tuple(dict.fromkeys(task.attack for task in tasks if task.attack is not None))
    rows = _ranked(
        [
            _row(next(task for task in tasks if task.detector == name), scores, events, horizon_s)
            for name in detectors
        ]
    )
    return Leaderboard(
        rows=rows,
        cells=tuple(
            _cell(row.detector, attack, scores, events) for row in rows for attack in attacks
        ),
        attacks=attacks,
        recordings=len({task.recording for task in tasks}),
        sessions=len({task.session for task in tasks}),
        target_far_per_hour=tasks[0].target_far_per_hour,
        note="Thresholds are the published ones: the suite has no calibration side."
        if read_run(folder).get("thresholds") == "published"
        else "",
    )


def _row(
    task: Task, all_scores: Sequence[_Cells], all_events: Sequence[_Cells], horizon_s: float
) -> Row:
    """The row of a task's detector, not ranked yet."""
    scores, events = (
        _of(all_scores, detector=task.detector),
        _of(all_events, detector=task.detector),
    )
    clean = [row for row in _of(scores, attack=None) if row["epochs"] is not None]
    detected = [row for row in scores if row["detection_pct"] is not None]
    interval = session_interval(
        [row["detection_pct"] for row in detected], [row["session"] for row in detected]
    )
    hours = sum(row["available_clean_h"] for row in clean)
    false = false_alert_rate(
        sum(row["episodes"] for row in clean),
        hours,
        _mean(clean, "far_epoch", weight="available_clean_h"),
    )
    curve = _survival(events)
    return Row(
        rank=None,
        detector=task.detector,
        plugin=task.plugin,
        plugin_distribution=task.plugin_distribution,
        plugin_version=task.plugin_version,
        parameters=task.parameters,
        baseline=task.plugin_distribution == BASELINES,
        keeps_target=None
        if false.per_hour_lo is None
        else false.per_hour_lo <= task.target_far_per_hour,
        detection_pct=_mean(detected, "detection_pct"),
        detection_pct_lo=None if interval is None else interval[0],
        detection_pct_hi=None if interval is None else interval[1],
        restricted_mean_ttfd_s=None if curve is None else curve.restricted_mean_s(horizon_s),
        ttfd_median_s=None if curve is None else curve.quantile_s(0.5),
        ttfd_p90_s=None if curve is None else curve.quantile_s(0.9),
        **_missed_over_attacks(events),
        far_per_hour=false.per_hour,
        far_per_hour_lo=false.per_hour_lo,
        far_per_hour_hi=false.per_hour_hi,
        far_floor_per_hour=false.floor_per_hour,
        far_epoch=false.epoch,
        availability=_mean(clean, "availability", weight="epochs"),
        position_error_at_detection_m=_over(median, events, "position_error_at_detection_m"),
        largest_undetected_position_error_m=_over(
            max, events, "largest_undetected_position_error_m"
        ),
        partial_auc=_mean(scores, "partial_auc"),
        **_counts(scores),
    )


def _cell(
    detector: str, attack: str, all_scores: Sequence[_Cells], all_events: Sequence[_Cells]
) -> Cell:
    scores, events = (
        _of(rows, detector=detector, attack=attack) for rows in (all_scores, all_events)
    )
    curve = _survival(events)
    return Cell(
        detector=detector,
        attack=attack,
        detection_pct=_mean(scores, "detection_pct"),
        **_missed(events),
        ttfd_median_s=None if curve is None else curve.quantile_s(0.5),
        **_counts(scores),
    )


def _ranked(rows: Sequence[Row]) -> tuple[Row, ...]:
    """Put the best first and number them, equals equally; rows without a detection percentage come
    last, without number.
    """

    def key(row: Row) -> tuple[int, float, float]:
        mean_s = float("inf") if row.restricted_mean_ttfd_s is None else row.restricted_mean_ttfd_s
        return {True: 0, False: 1, None: 2}[row.keeps_target], -(row.detection_pct or 0.0), mean_s

    able = sorted((row for row in rows if row.detection_pct is not None), key=key)
    keys = [key(row) for row in able]
    return (
        *(replace(row, rank=keys.index(key(row)) + 1) for row in able),
        *(row for row in rows if row.detection_pct is None),
    )


def _of(rows: Sequence[_Cells], **wanted: str | None) -> list[_Cells]:
    return [row for row in rows if all(row[name] == value for name, value in wanted.items())]


def _mean(rows: Sequence[_Cells], name: str, weight: str | None = None) -> float | None:
    """Mean of the known values, None where there are none or they weigh nothing."""
    known = [
        (row[name], 1.0 if weight is None else row[weight]) for row in rows if row[name] is not None
    ]
    total = sum(w for _, w in known)
    return sum(value * w for value, w in known) / total if total else None


def _over(
    function: Callable[[list[float]], float], rows: Sequence[_Cells], name: str
) -> float | None:
    known = [row[name] for row in rows if row[name] is not None]
    return function(known) if known else None


def _survival(events: Sequence[_Cells]) -> Survival | None:
    observed_s = [event["ttfd_s"] if event["detected"] else event["length_s"] for event in events]
    return survival(observed_s, [event["detected"] for event in events])


def _missed(events: Sequence[_Cells]) -> dict[str, Any]:
    """P_MD over the intervals of one attack with its exact interval, and what it is made of."""
    detected = sum(event["detected"] for event in events)
    p_md = proportion(len(events) - detected, len(events))
    value, lo, hi = (None, None, None) if p_md is None else (p_md.value, p_md.lo, p_md.hi)
    return {
        "p_md": value,
        "p_md_lo": lo,
        "p_md_hi": hi,
        "detected": detected,
        "events": len(events),
    }


def _missed_over_attacks(events: Sequence[_Cells]) -> dict[str, Any]:
    """The same over several attacks, whose windows on one recording are not independent: its
    interval goes by sessions.
    """
    interval = session_interval(
        [float(not event["detected"]) for event in events], [event["session"] for event in events]
    )
    lo, hi = (None, None) if interval is None else interval
    return _missed(events) | {"p_md_lo": lo, "p_md_hi": hi}


def _counts(scores: Sequence[_Cells]) -> dict[str, int]:
    statuses = [row["status"] for row in scores]
    counts = {status: statuses.count(status) for status in ("ok", "skipped", "not_modelled")}
    return counts | {"failed": sum(status in FAILURES for status in statuses)}
