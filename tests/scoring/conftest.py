"""Results folders made by hand: known truth, known decisions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from spoofbench.detector import Decisions
from spoofbench.recording import Interval
from spoofbench.results import (
    Status,
    Task,
    TaskOutcome,
    Truth,
    write_outcome,
    write_run,
    write_tasks,
    write_truth,
)
from spoofbench.scoring.grid import release_guard, within
from spoofbench.scoring.score import score_folder

S = 1_000_000_000
EPOCHS = 200

TASK = Task(
    task_id="",
    variant_id="",
    recording="drive",
    session="drive",
    attack=None,
    attack_parameters=None,
    window_start_ns=None,
    window_end_ns=None,
    seed=None,
    detector="",
    plugin="plugin",
    plugin_distribution="a-distribution",
    plugin_version="1",
    parameters="{}",
    requires="[]",
    memory_s=0.0,
    baseline=False,
    hold_s=None,
    target_far_per_hour=1.0,
    status="ok",
    reason=None,
)


def truth_of(windows: Sequence[tuple[int, int]], epochs: int = EPOCHS) -> Truth:
    """A grid at 1 Hz whose position error grows by 1 m per spoofed second."""
    time_ns = np.arange(epochs) * S
    intervals = tuple(Interval(start * S, end * S) for start, end in windows)
    spoofed = within(time_ns, intervals)
    error_m = np.zeros(epochs)
    for start, end in windows:
        error_m[start:end] = np.arange(1, end - start + 1)
    zeros = np.zeros(epochs)
    return Truth(
        time_ns=time_ns,
        observed=np.ones(epochs, bool),
        spoofed=spoofed,
        guard=release_guard(time_ns, intervals, 0.0) & ~spoofed,
        reviewed=np.ones(epochs, bool),
        lat_deg=zeros,
        lon_deg=zeros,
        clean_lat_deg=zeros,
        clean_lon_deg=zeros,
        position_error_m=error_m,
        velocity_error_mps=zeros,
        epoch_ns=S,
        intervals=intervals,
    )


@dataclass
class Bench:
    """A results folder in the making; seconds on its axis are epochs."""

    path: Path
    thresholds: str | None = "published"
    tasks: list[Task] = field(default_factory=list)

    def add(
        self,
        detector: str,
        attack: str | None = None,
        window: tuple[int, int] = (100, 160),
        *,
        alerts: Sequence[int] | range = (),
        unavailable: Sequence[int] | range = (),
        status: Status = "ok",
        epochs: int = EPOCHS,
        **about: Any,
    ) -> None:
        """Add one task; an alert's score is 2, silence's 0.5."""
        windows = [] if attack is None else [window]
        task_id = f"t{len(self.tasks)}"
        variant_id = f"{about.get('recording', 'drive')}-{attack}-{window[0]}-{window[1]}"
        write_truth(self.path, variant_id, truth_of(windows, epochs))
        score, available = np.full(epochs, 0.5), np.ones(epochs, bool)
        score[list(alerts)], available[list(unavailable)] = 2.0, False
        reason = None if status == "ok" else f"it is {status}"
        decisions = Decisions(np.arange(epochs) * S, score, available) if status == "ok" else None
        write_outcome(self.path, task_id, TaskOutcome(status, reason, decisions))
        known: Mapping[str, Any] = {"seed": None if attack is None else 0, **about}
        task = replace(
            TASK,
            task_id=task_id,
            variant_id=variant_id,
            attack=attack,
            detector=detector,
            status=status,
            reason=reason,
        )
        self.tasks.append(replace(task, **known))

    def score(self) -> list[dict[str, Any]]:
        """Score the folder and return the rows of scores.parquet."""
        write_tasks(self.path, self.tasks)
        write_run(self.path, {} if self.thresholds is None else {"thresholds": self.thresholds})
        score_folder(self.path)
        return self.rows("scores")

    def rows(self, name: str) -> list[dict[str, Any]]:
        rows: list[dict[str, Any]] = pq.read_table(self.path / f"{name}.parquet").to_pylist()
        return rows


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)
