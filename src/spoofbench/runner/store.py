"""The results folder of a run as it grows: which tasks are done, what they came to and what they
cost.
"""

import contextlib
import hashlib
import json
import re
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa

from spoofbench.decisions import OutcomeLog, Outcomes
from spoofbench.errors import ResultsError
from spoofbench.results import (
    FAILURES,
    Status,
    TaskOutcome,
    has_truth,
    read_kinds,
    read_parquet,
    read_run,
    write_parquet,
    write_run,
    write_tasks,
    write_whole,
)
from spoofbench.runner.plan import PlannedFit, PlannedTask, RecordingInfo

_COST_SCHEMA = pa.schema(
    [("task_id", pa.string()), ("seconds", pa.float64()), ("memory_mb", pa.float64())]
)
_OURS = re.compile(r"\.?[0-9a-f]{64}\.(parquet|pickle|json)(\.part)?")


@dataclass(frozen=True, slots=True)
class Cost:
    """Wall-clock time of a task, and the peak of memory over its start where the system can
    tell.
    """

    seconds: float | None
    memory_mb: float | None


def check_folder(folder: Path, name: str, *, resume: bool) -> None:
    """Make a folder for results, or see that those of an old one may be resumed.

    Raises:
        ResultsError: there are results and ``resume`` is not set, or they are another suite's.
    """
    if not (folder / "run.json").exists():
        if folder.is_dir() and any(
            (folder / part).exists() for part in ("decisions", "truth", "tasks.parquet")
        ):
            raise ResultsError(
                f"{str(folder)!r} has results but no run.json that says whose; choose another "
                "folder"
            )
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ResultsError(
                f"{str(folder)!r} cannot be made a results folder: {error.strerror}"
            ) from error
        return
    if not resume:
        raise ResultsError(
            f"{str(folder)!r} has results already; resume them with --resume or choose another "
            "folder"
        )
    other = read_run(folder).get("suite", {}).get("name")
    if other != name:
        raise ResultsError(
            f"{str(folder)!r} has results of the suite {other!r}, not of {name!r}; choose another "
            "folder"
        )


@dataclass(frozen=True, slots=True)
class FitOutcome:
    """What became of a fit: the pickle of a detector and its fitted parameters where it is ``ok``,
    else the reason why there is none.
    """

    status: Status
    reason: str | None
    state: bytes
    learned: Mapping[str, Any]


class ResultStore:
    """Writes outcomes as they come, from any thread."""

    def __init__(
        self,
        folder: Path,
        name: str,
        *,
        retry_failed: bool,
        progress: Callable[[float], None] | None,
    ) -> None:
        self.folder = folder
        self._costs: dict[str, Cost] = {}
        self._states: dict[str, str] = {}
        self._retry_failed, self._progress = retry_failed, progress
        self._total, self._done = 1, 0
        self._lock = threading.Lock()
        if not (folder / "run.json").exists():
            write_run(folder, {"suite": {"name": name}})
        self._log = OutcomeLog(folder)
        with contextlib.suppress(ResultsError):  # costs are the one thing that may be lost
            for row in read_parquet(folder / "costs.parquet").to_pylist():
                self._costs[row["task_id"]] = Cost(row["seconds"], row["memory_mb"])

    def missing(self, tasks: Sequence[PlannedTask]) -> list[PlannedTask]:
        """Return the tasks that are to be run; the others are done."""
        self._total = max(1, len(tasks))
        missing = [task for task in tasks if not self._is_done(task)]
        self._count(len(tasks) - len(missing))
        return missing

    def _is_done(self, task: PlannedTask) -> bool:
        status = self._log.status(task.id)
        if status is None or (self._retry_failed and status in FAILURES):
            return False
        if status != "ok":
            return True
        outcome = self._log.get(task.id)
        return outcome is not None and has_truth(self.folder, task.variant.id)

    def done(self, task: PlannedTask, outcome: TaskOutcome, cost: Cost = Cost(None, None)) -> None:
        """Write what became of a task."""
        self._log.add(task.id, outcome)
        with self._lock:
            self._costs[task.id] = cost
        self._count(1)

    def _count(self, done: int) -> None:
        with self._lock:
            self._done += done
            if self._progress:
                self._progress(self._done / self._total)

    def state_file(self, fit_id: str) -> Path:
        """Return the file of what a detector has learned."""
        return self.folder / "states" / f"{fit_id}.pickle"

    def has_state(self, fit_id: str) -> bool:
        """Whether what a detector has learned is there as it was written."""
        path = self.state_file(fit_id)
        try:
            written: object = json.loads(path.with_suffix(".json").read_text())["sha256"]
            digest = hashlib.sha256(path.read_bytes()).hexdigest()
        except (OSError, ValueError, KeyError, TypeError):
            return False
        self._states[fit_id] = digest
        return digest == written

    def state_digest(self, fit_id: str) -> str:
        """Return the SHA-256 of a state that is there, as this process has seen it."""
        return self._states[fit_id]

    def fitted(self, planned: PlannedFit, outcome: FitOutcome) -> None:
        """Write what became of a fit, and what it has learned."""
        if outcome.status == "ok":
            path = self.state_file(planned.id)
            digest = self._states[planned.id] = hashlib.sha256(outcome.state).hexdigest()
            write_whole(path, lambda temporary: temporary.write_bytes(outcome.state))
            about = {
                "detector": planned.detector.entry.id,
                "sessions": sorted({each.variant.recording.session for each in planned.clean}),
                "attacks": sorted({each.variant.attack_group or "" for each in planned.attacked}),
                "learned": dict(outcome.learned),
                "sha256": digest,
            }
            text = json.dumps(about, indent=1, sort_keys=True) + "\n"
            write_whole(path.with_suffix(".json"), lambda temporary: temporary.write_text(text))

    def finish(self, tasks: Sequence[PlannedTask], infos: Mapping[str, RecordingInfo]) -> None:
        """Write the table of tasks and sort their decisions; remove the files of variants and fits
        that the suite or its inputs no longer ask for, and of writes that were cut short.
        """
        by_recording: dict[str, list[str]] = {}
        for task in tasks:
            by_recording.setdefault(task.variant.recording.id, []).append(task.id)
        self._log.sort(by_recording)
        kinds = {
            name: read_kinds(self.folder, name) for name in {task.variant.id for task in tasks}
        }
        outcomes = Outcomes(self.folder)
        rows = {}
        for task in sorted(tasks, key=lambda task: task.variant.recording.id):
            recording = task.variant.recording.id
            status, reason = outcomes.of(recording).fate(task.id)
            rows[task.id] = task.row(infos[recording], kinds[task.variant.id], status, reason)
        write_tasks(self.folder, [rows[task.id] for task in tasks])
        self._write_costs(task.id for task in tasks)
        fits = {task.fit.id for task in tasks if task.fit}
        keep = {
            "truth": {f"{task.variant.id}.parquet" for task in tasks},
            "states": {f"{name}{suffix}" for name in fits for suffix in (".pickle", ".json")},
        }
        for part, names in keep.items():
            for path in (self.folder / part).glob("*"):
                if _OURS.fullmatch(path.name) and path.name not in names:
                    path.unlink()
        for path in self.folder.glob(".*.part"):
            path.unlink()

    def save_costs(self) -> None:
        """Write what is known of all costs so far."""
        with self._lock:
            self._write_costs(self._costs)

    def _write_costs(self, order: Iterable[str]) -> None:
        rows = [
            {"task_id": name, "seconds": cost.seconds, "memory_mb": cost.memory_mb}
            for name in order
            for cost in [self._costs.get(name, Cost(None, None))]
        ]
        write_parquet(self.folder / "costs.parquet", pa.Table.from_pylist(rows, _COST_SCHEMA))
