"""Results folders made by hand: known truth, known decisions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from spoofbench.decisions import OutcomeLog
from spoofbench.detector import Decisions
from spoofbench.recording import Interval
from spoofbench.results import (
    Status,
    Task,
    TaskOutcome,
    Truth,
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
    role="judged",
    recording="drive",
    session="drive",
    sensor_class="car",
    provenance="injected",
    is_fused=False,
    kinds='["gnss/pvt","imu"]',
    attack=None,
    attack_group=None,
    attack_plugin=None,
    attack_parameters=None,
    strength=None,
    window=None,
    window_start_ns=None,
    window_end_ns=None,
    calibration_start_ns=None,
    calibration_end_ns=None,
    judged_start_ns=0,
    held_out="[]",
    left_out=None,
    fit_id=None,
    detector="",
    plugin="plugin",
    plugin_distribution="a-distribution",
    plugin_version="1",
    parameters="{}",
    parameter_sources="{}",
    input_class="gnss",
    requires="[]",
    memory_s=0.0,
    warm_up_s=0.0,
    learns_from_attacks=False,
    baseline=False,
    hold_s=None,
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
    suite: dict[str, Any] = field(
        default_factory=lambda: {
            "name": "bench",
            "target_far_per_hour": 1.0,
            "memory_cap_s": 0.0,
            "alert_limit_m": None,
            "time_to_alert_s": 0.0,
            "warm_up_s": None,
            "ranks_fused": [],
            "calibration": None,
        }
    )
    tasks: list[Task] = field(default_factory=list)
    outcomes: dict[str, TaskOutcome] = field(default_factory=dict)

    def add(
        self,
        detector: str,
        attack: str | None = None,
        window: tuple[int, int] = (100, 160),
        *,
        alerts: Sequence[int] | range = (),
        unavailable: Sequence[int] | range = (),
        decisions: Decisions | None = None,
        level: float = 2.0,
        status: Status = "ok",
        epochs: int = EPOCHS,
        **about: Any,
    ) -> None:
        """Add one task; an alert's score is the level, silence's 0.5."""
        windows = [] if attack is None else [window]
        task_id = f"t{len(self.tasks)}"
        variant_id = f"{about.get('recording', 'drive')}-{attack}-{window[0]}-{window[1]}"
        if variant_id not in {task.variant_id for task in self.tasks}:
            write_truth(self.path, variant_id, truth_of(windows, epochs), ["gnss/pvt", "imu"])
        score, available = np.full(epochs, 0.5), np.ones(epochs, bool)
        score[list(alerts)], available[list(unavailable)] = level, False
        reason = None if status == "ok" else f"it is {status}"
        made = decisions or Decisions(np.arange(epochs) * S, score, available)
        self.outcomes[task_id] = TaskOutcome(status, reason, made if status == "ok" else None)
        known: Mapping[str, Any] = about
        if attack is not None:
            known = {
                "attack_group": attack,
                "attack_plugin": attack,
                "attack_parameters": "{}",
                "window": 1,
                "window_start_ns": window[0] * S,
                "window_end_ns": window[1] * S,
                **about,
            }
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

    def write(self) -> None:
        """Write all but the scores."""
        log, by_recording = OutcomeLog(self.path), dict[str, list[str]]()
        for task in self.tasks:
            log.add(task.task_id, self.outcomes[task.task_id])
            by_recording.setdefault(task.recording, []).append(task.task_id)
        log.sort(by_recording)
        write_tasks(self.path, self.tasks)
        write_run(self.path, {"suite": self.suite})

    def score(self) -> list[dict[str, Any]]:
        """Score the folder and return the rows of scores.parquet."""
        self.write()
        score_folder(self.path)
        return self.rows("scores")

    def rows(self, name: str) -> list[dict[str, Any]]:
        rows: list[dict[str, Any]] = pq.read_table(self.path / f"{name}.parquet").to_pylist()
        return rows


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)
