"""The results folder of a run as it grows: which tasks are done, what they came to and what they
cost.
"""

import contextlib
import re
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from spoofbench.errors import ResultsError
from spoofbench.results import (
    FAILURES,
    Status,
    TaskOutcome,
    has_truth,
    read_outcome,
    read_parquet,
    read_run,
    write_outcome,
    write_parquet,
    write_run,
)
from spoofbench.runner.plan import PlannedTask

_COST_SCHEMA = pa.schema(
    [("task_id", pa.string()), ("seconds", pa.float64()), ("memory_mb", pa.float64())]
)
_OURS = re.compile(r"\.?[0-9a-f]{64}\.parquet(\.part)?")


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


class ResultStore:
    """Writes outcomes as they come, from any thread."""

    def __init__(
        self,
        folder: Path,
        name: str,
        total: int,
        *,
        retry_failed: bool,
        progress: Callable[[float], None] | None,
    ) -> None:
        self.folder = folder
        self.found: dict[str, tuple[Status, str | None]] = {}
        self._costs: dict[str, Cost] = {}
        self._total, self._retry_failed, self._progress = total, retry_failed, progress
        self._lock = threading.Lock()
        if not (folder / "run.json").exists():
            write_run(folder, {"suite": {"name": name}})
        with contextlib.suppress(ResultsError):  # costs are the one thing that may be lost
            for row in read_parquet(folder / "costs.parquet").to_pylist():
                self._costs[row["task_id"]] = Cost(row["seconds"], row["memory_mb"])

    def missing(self, tasks: Iterable[PlannedTask]) -> list[PlannedTask]:
        """Return the tasks that are to be run; the others are done."""
        missing = []
        for task in tasks:
            outcome = self._old(task)
            if outcome is None or (self._retry_failed and outcome.status in FAILURES):
                missing.append(task)
            else:
                self._count(task, outcome)
        return missing

    def _old(self, task: PlannedTask) -> TaskOutcome | None:
        try:
            outcome = read_outcome(self.folder, task.id)
        except ResultsError:
            return None  # damaged: run it again
        return (
            None
            if outcome is not None
            and outcome.status == "ok"
            and not has_truth(self.folder, task.variant.id)
            else outcome
        )

    def done(self, task: PlannedTask, outcome: TaskOutcome, cost: Cost = Cost(None, None)) -> None:
        """Write what became of a task."""
        write_outcome(self.folder, task.id, outcome)
        with self._lock:
            self._costs[task.id] = cost
        self._count(task, outcome)

    def _count(self, task: PlannedTask, outcome: TaskOutcome) -> None:
        with self._lock:
            self.found[task.id] = (outcome.status, outcome.reason)
            if self._progress:
                self._progress(len(self.found) / self._total)

    def write_costs(self, order: Iterable[str] | None = None) -> None:
        """Write ``costs.parquet``: of these tasks, or of all that are known."""
        with self._lock:
            rows = [
                {"task_id": name, "seconds": cost.seconds, "memory_mb": cost.memory_mb}
                for name in (self._costs if order is None else order)
                for cost in [self._costs.get(name, Cost(None, None))]
            ]
            write_parquet(self.folder / "costs.parquet", pa.Table.from_pylist(rows, _COST_SCHEMA))

    def sweep(self, tasks: Iterable[PlannedTask]) -> None:
        """Remove the files of tasks and variants that the suite or its inputs no longer ask for,
        and of writes that were cut short.
        """
        tasks = list(tasks)
        keep = {
            "decisions": {f"{task.id}.parquet" for task in tasks},
            "truth": {f"{task.variant.id}.parquet" for task in tasks},
        }
        for part, names in keep.items():
            for path in (self.folder / part).glob("*"):
                if _OURS.fullmatch(path.name) and path.name not in names:
                    path.unlink()
        for path in self.folder.glob(".*.part"):
            path.unlink()
