"""A leaderboard ranked and a page written, from made-up results folders.

``rank-and-report-table`` ranks 160,000 tasks. The peer computes the same means, rates and shares by
pandas groupby, as one would in a notebook; ours adds exact and bootstrap intervals, Kaplan-Meier
quantiles and ranks, and refuses damaged files. ``rank-and-report-page`` ranks a folder of 2,000
runs and writes its page; nothing else does that, so its time stands alone.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from benchmarks.speed.frame import Job
from spoofbench.detector import Decisions
from spoofbench.recording import Interval
from spoofbench.report import write_site
from spoofbench.results import (
    TASK_SCHEMA,
    Task,
    TaskOutcome,
    Truth,
    write_outcome,
    write_parquet,
    write_run,
    write_tasks,
    write_truth,
)
from spoofbench.scoring.leaderboard import Leaderboard, leaderboard
from spoofbench.scoring.score import EVENT_SCHEMA, SCORE_SCHEMA, score_folder

SECOND_NS = 1_000_000_000
EPOCHS, ATTACK_S = 2602, 120


@dataclass(frozen=True, slots=True)
class Crossing:
    """How many of what a suite crosses; the attacked variants are ``attacks * seeds``."""

    detectors: int
    recordings: int
    attacks: int
    seeds: int

    def tasks(self) -> list[Task]:
        """The tasks in the order of a run: by recording, variant, detector."""
        variants: list[tuple[int | None, int | None]] = [
            (None, None),
            *product(range(self.attacks), range(self.seeds)),
        ]
        return [
            _task(number, recording, attack, seed, detector)
            for number, (recording, (attack, seed), detector) in enumerate(
                product(range(self.recordings), variants, range(self.detectors))
            )
        ]


def jobs(folder: Path) -> Iterator[Job]:
    """Yield the jobs; their results folders are in the folder."""
    tables, results = folder / "tables", folder / "results"
    tasks = Crossing(detectors=40, recordings=40, attacks=33, seeds=3).tasks()
    write_tables(tables, tasks, np.random.default_rng(0))
    yield Job(
        "rank-and-report-table",
        f"{len(tasks):,} tasks ranked, 40 detectors against 33 attacks",
        partial(leaderboard, tables),
        {"pandas": partial(_pandas, tables)},
        check=_same,
    )
    runs = Crossing(detectors=20, recordings=2, attacks=7, seeds=7).tasks()
    write_results(results, runs, np.random.default_rng(0))
    yield Job(
        "rank-and-report-page",
        f"{len(runs):,} runs of {EPOCHS} epochs ranked and reported in one page",
        lambda: write_site(results, leaderboard(results), folder / "site"),
        {},
    )


def write_tables(folder: Path, tasks: Sequence[Task], rng: np.random.Generator) -> None:
    """Write the tables of a scored folder without decisions and truth; figures are drawn."""
    rows = [asdict(task) for task in tasks]
    n = len(tasks)
    is_attacked = np.array([task.attack is not None for task in tasks])
    hit = is_attacked & (rng.random(n) < 0.7)
    figures = {
        "epochs": np.full(n, EPOCHS),
        "availability": rng.random(n),
        "detection_pct": 100 * rng.random(n),
        "partial_auc": rng.random(n),
        "episodes": rng.poisson(1, n),
        "available_clean_h": rng.random(n),
        "far_epoch": rng.random(n),
        "length_s": rng.choice([60.0, 120.0], n),
        "detected": hit,
        "ttfd_s": 60 * rng.random(n),
        "position_error_at_detection_m": 100 * rng.random(n),
        "largest_undetected_position_error_m": 100 * rng.random(n),
    }
    unknown = {
        "detection_pct": ~is_attacked,
        "partial_auc": ~is_attacked,
        "episodes": is_attacked,
        "available_clean_h": is_attacked,
        "far_epoch": is_attacked,
        "ttfd_s": ~hit,
        "position_error_at_detection_m": ~hit,
    }
    columns: dict[str, Any] = {
        name: pa.array([row[name] for row in rows], TASK_SCHEMA.field(name).type)
        for name in TASK_SCHEMA.names
    }
    columns |= {name: pa.array(values, mask=unknown.get(name)) for name, values in figures.items()}
    write_parquet(folder / "tasks.parquet", pa.table(columns).select(TASK_SCHEMA.names))
    for name, schema, chosen in (
        ("scores", SCORE_SCHEMA, np.ones(n, bool)),
        ("events", EVENT_SCHEMA, is_attacked),
    ):
        table = pa.table({key: columns.get(key, pa.nulls(n)) for key in schema.names}).filter(
            pa.array(chosen)
        )
        write_parquet(folder / f"{name}.parquet", table.cast(schema))
    write_run(folder, {"thresholds": "published"})


def write_results(folder: Path, tasks: Sequence[Task], rng: np.random.Generator) -> None:
    """Write a whole folder, every decision of its own, and score it."""
    time_ns = 1_700_000_000 * SECOND_NS + np.arange(EPOCHS) * SECOND_NS
    angle, zeros = np.arange(EPOCHS) / 90, np.zeros(EPOCHS)
    lat, lon = 39.7 + 0.01 * np.sin(angle), -84.2 + 0.02 * np.cos(0.7 * angle)
    start_ns = int(time_ns[EPOCHS // 2])
    window = Interval(start_ns, start_ns + ATTACK_S * SECOND_NS)
    for task in tasks:
        spoofed = window.covers(time_ns) & (task.attack is not None)
        if task.detector == "detector-0":
            moved = np.where(spoofed, 1e-5 * np.arange(EPOCHS), 0.0)
            truth = Truth(
                time_ns=time_ns,
                observed=np.ones(EPOCHS, bool),
                spoofed=spoofed,
                guard=np.zeros(EPOCHS, bool),
                reviewed=np.ones(EPOCHS, bool),
                lat_deg=lat + moved,
                lon_deg=lon,
                clean_lat_deg=lat,
                clean_lon_deg=lon,
                position_error_m=111_000 * moved,
                velocity_error_mps=zeros,
                epoch_ns=SECOND_NS,
                intervals=(window,) if task.attack is not None else (),
            )
            write_truth(folder, task.variant_id, truth)
        score = np.abs(rng.normal(0, 0.3, EPOCHS)) + spoofed * rng.gamma(2, 1, EPOCHS)
        decisions = Decisions(time_ns, score, np.arange(EPOCHS) >= 30)
        write_outcome(folder, task.task_id, TaskOutcome("ok", None, decisions))
    write_tasks(folder, tasks)
    write_run(folder, {"suite": "made up", "thresholds": "published"})
    score_folder(folder)


def _task(number: int, recording: int, attack: int | None, seed: int | None, detector: int) -> Task:
    return Task(
        task_id=f"{number:064x}",
        variant_id=f"{recording}-{attack}-{seed}",
        recording=f"recording-{recording}",
        session=f"session-{recording % 10}",
        attack=None if attack is None else f"attack-{attack}",
        attack_parameters=None if attack is None else '{"delay_s": 60.0}',
        window_start_ns=None,
        window_end_ns=None,
        seed=seed,
        detector=f"detector-{detector}",
        plugin="plugin",
        plugin_distribution="distribution",
        plugin_version="1.0",
        parameters='{"threshold": 1.0}',
        requires='["gnss/pvt"]',
        memory_s=20.0,
        baseline=False,
        hold_s=None,
        target_far_per_hour=1.0,
        status="ok",
        reason=None,
    )


def _pandas(folder: Path) -> pd.DataFrame:
    """Means, rates and shares by detector, and detection by cell, as a notebook would."""
    scores, events = (pd.read_parquet(folder / f"{name}.parquet") for name in ("scores", "events"))
    clean = scores[scores["attack"].isna()]
    by_detector, hours = scores.groupby("detector"), clean.groupby("detector")
    table = pd.DataFrame(
        {
            "detection_pct": by_detector["detection_pct"].mean(),
            "partial_auc": by_detector["partial_auc"].mean(),
            "far_per_hour": hours["episodes"].sum() / hours["available_clean_h"].sum(),
            "p_md": 1 - events.groupby("detector")["detected"].mean(),
            "largest_undetected_position_error_m": events.groupby("detector")[
                "largest_undetected_position_error_m"
            ].max(),
        }
    )
    cells = scores.pivot_table("detection_pct", "detector", "attack")
    missed = 1 - events.astype({"detected": float}).pivot_table("detected", "detector", "attack")
    return table.join(cells).join(missed, rsuffix=" missed")


def _same(ours: Leaderboard, theirs: pd.DataFrame) -> None:
    """The figures agree to 1e-9."""
    for index, row in enumerate(ours.rows):
        peer = theirs.loc[row.detector]
        for name in ("detection_pct", "partial_auc", "far_per_hour", "p_md"):
            np.testing.assert_allclose(getattr(row, name), peer[name], rtol=1e-9)
        cells = ours.cells_of(index)
        np.testing.assert_allclose(
            np.array([(cell.detection_pct, cell.p_md) for cell in cells], float),
            [(peer[cell.attack], peer[f"{cell.attack} missed"]) for cell in cells],
            rtol=1e-9,
        )
