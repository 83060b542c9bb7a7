"""The leaderboard of a results folder: a row per detector, a cell per detector and attack.

The tables of the folder are read as columns and grouped once by detector and once by cell; a figure
rests on its group's rows in the order of the table.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any, get_args

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from spoofbench.arrays import Bools, Floats, Indices, Ints
from spoofbench.errors import ResultsError
from spoofbench.results import (
    FAILURES,
    Status,
    has_truth,
    read_run,
    read_table,
    read_task_table,
    read_truth,
)
from spoofbench.scoring.metrics import false_alert_rate
from spoofbench.scoring.score import EVENT_SCHEMA, SCORE_SCHEMA
from spoofbench.scoring.statistics import (
    SurvivalCurve,
    proportion,
    session_interval,
    survival_curve,
)

_STATUSES: tuple[Status, ...] = get_args(Status)
_Columns = Mapping[str, NDArray[Any]]
"""Columns of a table by name, ``(n,)``: numbers as float64, NaN where unknown; names as codes."""


@dataclass(frozen=True, slots=True)
class LeaderboardRow:
    """One detector configuration over all tasks of a folder; unknown is None.

    Attributes:
        rank: 1 is best, equal where nothing tells two rows apart; None where no attacked task could
            be scored.
        detector: name in the suite.
        plugin, plugin_distribution, plugin_version, parameters: what it is; parameters as JSON
            text.
        baseline: whether the detector says that it is one that others must beat.
        keeps_target: whether the lower end of the false-alert interval is at most the target; None
            where the rate is unknown.
        detection_pct: mean over attacked tasks, failures as 0; ``lo`` and ``hi`` by bootstrap over
            sessions, None below 5.
        restricted_mean_ttfd_s: mean time to first detection, restricted to the folder's longest
            attack.
        ttfd_median_s, ttfd_p90_s: Kaplan-Meier over attack intervals; None where fewer than that
            share are ever detected.
        longest_attack_s: length of the longest attack that the detector faced.
        p_md: missed share of attack intervals, ``detected`` of ``events``; ``lo`` and ``hi`` by
            bootstrap over sessions, None below 5.
        far_per_hour: episodes per available clean hour over unattacked tasks pooled by time, with
            Garwood interval.
        far_floor_per_hour: the lowest rate that so many hours can resolve, 3/T.
        far_epoch, availability: shares of 1 over the same tasks, weighted by available clean hours
            and by epochs.
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
    longest_attack_s: float | None
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

    @property
    def exceeds_target(self) -> bool:
        """Whether the false-alert rate exceeds the target even at the lower end of its interval."""
        return self.keeps_target is False


@dataclass(frozen=True, slots=True)
class LeaderboardCell:
    """One detector configuration against one attack.

    Fields as in :class:`LeaderboardRow`, but P_MD with its Clopper-Pearson interval.
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
        recordings, sessions, attacked_variants: how many there are.
        clean_h: length of the unattacked recordings.
        target_far_per_hour: the false-alert rate that a detector is to keep.
        note: what every table must say about its thresholds; empty where there is nothing to say.
    """

    rows: tuple[LeaderboardRow, ...]
    cells: tuple[LeaderboardCell, ...]
    attacks: tuple[str, ...]
    recordings: int
    sessions: int
    attacked_variants: int
    clean_h: float
    target_far_per_hour: float
    note: str

    def cells_of(self, index: int) -> tuple[LeaderboardCell, ...]:
        """Return the cells of the row with this index, in the order of the attacks."""
        n = len(self.attacks)
        return self.cells[index * n : (index + 1) * n]


def leaderboard(folder: Path) -> Leaderboard:
    """Return the leaderboard of a scored results folder.

    Rows that keep the target false-alert rate come before those that do not, and those before rows
    whose rate is unknown; within each by detection percentage, then by restricted mean time to
    first detection.

    Raises:
        ResultsError: a file of the folder is missing or damaged, or the folder has no tasks.
    """
    tasks = read_task_table(folder)
    if not len(tasks):
        raise ResultsError(f"{folder} has no tasks to rank; run a suite into it")
    score_table = read_table(folder / "scores.parquet", SCORE_SCHEMA)
    event_table = read_table(folder / "events.parquet", EVENT_SCHEMA)
    if not score_table["task_id"].equals(tasks["task_id"]):
        raise ResultsError(f"the scores in {folder} are not those of its tasks; score it again")
    names = {
        "detector": tasks["detector"].unique(),
        "attack": tasks["attack"].unique().drop_null(),
        "session": tasks["session"].unique().sort(),
    }
    scores = _columns(score_table, names | {"status": pa.array(_STATUSES)})
    events = _columns(event_table, names)
    horizon_s = float(events["length_s"].max(initial=0.0))
    detectors, attacks = names["detector"].to_pylist(), names["attack"].to_pylist()
    n = len(detectors)
    first = [rows[0] for rows in _groups(_codes(tasks["detector"], names["detector"]), n)]
    rows = _ranked(
        [
            _row(task, _taken(scores, own), _taken(events, faced), horizon_s)
            for task, own, faced in zip(
                tasks.take(first).to_pylist(),
                _groups(scores["detector"], n),
                _groups(events["detector"], n),
                strict=True,
            )
        ]
    )
    cells = _cells(scores, events, detectors, attacks)
    clean = tasks.filter(pc.is_null(tasks["attack"]))["variant_id"].unique().to_pylist()
    attacked = tasks.filter(pc.is_valid(tasks["attack"]))["variant_id"].unique().to_pylist()
    truths = [read_truth(folder, variant) for variant in clean if has_truth(folder, variant)]
    return Leaderboard(
        rows=rows,
        cells=tuple(cells[row.detector, attack] for row in rows for attack in attacks),
        attacks=tuple(attacks),
        recordings=len(tasks["recording"].unique()),
        sessions=len(names["session"]),
        attacked_variants=sum(has_truth(folder, variant) for variant in attacked),
        clean_h=sum(truth.time_ns.size * truth.epoch_ns for truth in truths) / 3.6e12,
        target_far_per_hour=tasks["target_far_per_hour"][0].as_py(),
        note="Thresholds are the published ones: the suite has no calibration side."
        if read_run(folder).get("thresholds") == "published"
        else "",
    )


def _columns(table: pa.Table, names: Mapping[str, pa.Array]) -> _Columns:
    """Numbers of a table, and names as codes: their index among these, -1 for others and null."""
    return {
        column.name: _codes(table[column.name], names[column.name])
        if column.name in names
        else table[column.name].cast(pa.float64(), safe=False).to_numpy()
        for column in table.schema
        if column.name in names or column.type != pa.string()
    }


def _codes(column: pa.ChunkedArray, names: pa.Array) -> Ints:
    codes: Ints = pc.index_in(column, value_set=names).fill_null(-1).to_numpy()
    return codes


def _groups(codes: Ints, count: int) -> list[Indices]:
    """Rows of each code from 0 to ``count - 1``, ``(k,)`` each, in the order of the table."""
    order = np.argsort(codes, kind="stable")
    bounds = np.searchsorted(codes[order], np.arange(count + 1))
    return [order[start:end] for start, end in pairwise(bounds)]


def _taken(columns: _Columns, rows: Indices) -> _Columns:
    return {name: values[rows] for name, values in columns.items()}


def _row(
    task: Mapping[str, Any], scores: _Columns, events: _Columns, horizon_s: float
) -> LeaderboardRow:
    """The row of a task's detector, whose scores and events these are; not ranked yet."""
    clean = _taken(scores, np.flatnonzero((scores["attack"] < 0) & ~np.isnan(scores["epochs"])))
    known = ~np.isnan(scores["detection_pct"])
    interval = session_interval(scores["detection_pct"][known], scores["session"][known])
    false = false_alert_rate(
        int(clean["episodes"].sum()),
        sum(clean["available_clean_h"].tolist()),
        _mean(clean["far_epoch"], clean["available_clean_h"]),
    )
    curve = _survival(events["detected"] == 1, events["ttfd_s"], events["length_s"])
    return LeaderboardRow(
        rank=None,
        detector=task["detector"],
        plugin=task["plugin"],
        plugin_distribution=task["plugin_distribution"],
        plugin_version=task["plugin_version"],
        parameters=task["parameters"],
        baseline=task["baseline"],
        keeps_target=None
        if false.per_hour_lo is None
        else false.per_hour_lo <= task["target_far_per_hour"],
        detection_pct=_mean(scores["detection_pct"]),
        detection_pct_lo=None if interval is None else interval[0],
        detection_pct_hi=None if interval is None else interval[1],
        restricted_mean_ttfd_s=None if curve is None else curve.restricted_mean_s(horizon_s),
        ttfd_median_s=None if curve is None else curve.quantile_s(0.5),
        ttfd_p90_s=None if curve is None else curve.quantile_s(0.9),
        longest_attack_s=_over(max, events["length_s"]),
        **_missed_over_attacks(events),
        far_per_hour=false.per_hour,
        far_per_hour_lo=false.per_hour_lo,
        far_per_hour_hi=false.per_hour_hi,
        far_floor_per_hour=false.floor_per_hour,
        far_epoch=false.epoch,
        availability=_mean(clean["availability"], clean["epochs"]),
        position_error_at_detection_m=_over(median, events["position_error_at_detection_m"]),
        largest_undetected_position_error_m=_over(
            max, events["largest_undetected_position_error_m"]
        ),
        partial_auc=_mean(scores["partial_auc"]),
        **_counts(scores["status"]),
    )


def _cells(
    scores: _Columns, events: _Columns, detectors: Sequence[str], attacks: Sequence[str]
) -> dict[tuple[str, str], LeaderboardCell]:
    """The cells of these detectors and attacks by both names."""
    names = [(detector, attack) for detector in detectors for attack in attacks]
    own, faced = (
        _groups(
            np.where(
                (columns["detector"] < 0) | (columns["attack"] < 0),
                -1,
                columns["detector"].astype(np.int64) * len(attacks) + columns["attack"],
            ),
            len(names),
        )
        for columns in (scores, events)
    )
    detected, ttfd_s, length_s = events["detected"] == 1, events["ttfd_s"], events["length_s"]
    cells = {}
    for (detector, attack), rows, event_rows in zip(names, own, faced, strict=True):
        hits = detected[event_rows]
        curve = _survival(hits, ttfd_s[event_rows], length_s[event_rows])
        cells[detector, attack] = LeaderboardCell(
            detector=detector,
            attack=attack,
            detection_pct=_mean(scores["detection_pct"][rows]),
            **_missed(hits),
            ttfd_median_s=None if curve is None else curve.quantile_s(0.5),
            **_counts(scores["status"][rows]),
        )
    return cells


def _ranked(rows: Sequence[LeaderboardRow]) -> tuple[LeaderboardRow, ...]:
    """Put the best first and number them, equals equally; rows without a detection percentage come
    last, without number.
    """

    def key(row: LeaderboardRow) -> tuple[int, float, float]:
        mean_s = float("inf") if row.restricted_mean_ttfd_s is None else row.restricted_mean_ttfd_s
        return {True: 0, False: 1, None: 2}[row.keeps_target], -(row.detection_pct or 0.0), mean_s

    able = sorted((row for row in rows if row.detection_pct is not None), key=key)
    rank: dict[tuple[int, float, float], int] = {}
    for index, row in enumerate(able):
        rank.setdefault(key(row), index + 1)
    return (
        *(replace(row, rank=rank[key(row)]) for row in able),
        *(row for row in rows if row.detection_pct is None),
    )


def _mean(values: Floats, weights: Floats | None = None) -> float | None:
    """Mean of the known values, None where there are none or they weigh nothing."""
    known = ~np.isnan(values)
    weight = np.ones(values.size) if weights is None else weights
    total = sum(weight[known].tolist())
    return sum((values[known] * weight[known]).tolist()) / total if total else None


def _over(function: Callable[[list[float]], float], values: Floats) -> float | None:
    known = values[~np.isnan(values)].tolist()
    return function(known) if known else None


def _survival(detected: Bools, ttfd_s: Floats, length_s: Floats) -> SurvivalCurve | None:
    return survival_curve(np.where(detected, ttfd_s, length_s), detected)


def _missed(detected: Bools) -> dict[str, Any]:
    """P_MD over the intervals of one attack with its exact interval, and what it is made of."""
    hits = int(detected.sum())
    p_md = proportion(detected.size - hits, detected.size)
    value, lo, hi = (None, None, None) if p_md is None else (p_md.value, p_md.lo, p_md.hi)
    return {
        "p_md": value,
        "p_md_lo": lo,
        "p_md_hi": hi,
        "detected": hits,
        "events": detected.size,
    }


def _missed_over_attacks(events: _Columns) -> dict[str, Any]:
    """The same over several attacks, whose windows on one recording are not independent: its
    interval goes by sessions.
    """
    detected = events["detected"] == 1
    lo, hi = session_interval(~detected, events["session"]) or (None, None)
    return _missed(detected) | {"p_md_lo": lo, "p_md_hi": hi}


def _counts(status: Ints) -> dict[str, int]:
    """Numbers of tasks; statuses are codes."""
    counts = dict(zip(_STATUSES, np.bincount(status, minlength=6).tolist(), strict=True))
    return {
        "ok": counts["ok"],
        "failed": sum(counts[name] for name in FAILURES),
        "skipped": counts["skipped"],
        "not_modelled": counts["not_modelled"],
    }
