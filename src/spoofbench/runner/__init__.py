"""The runner: every recording of a suite, unattacked and under every attack, before every detector.

:func:`run` tells the story. ``execution`` has each job done in a worker of a sandbox: describe a
plugin, prepare a recording (it knows the truth), run a detector on a group of variants (it has
nothing but blind material). ``jobs`` has what the workers do, as functions of plain specifications
and folders. ``plan`` crosses recordings, attacks and detectors; ``identity`` names each task by the
hash of all that decides it; ``store`` writes its outcome to a file of that name, so that a run that
was killed goes on where it stood.
"""

import os
import platform
import shutil
from collections import Counter, deque
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import asdict
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import spoofbench
from spoofbench import plugins
from spoofbench.errors import ResultsError, SuiteError
from spoofbench.results import TaskOutcome, write_run
from spoofbench.runner import identity
from spoofbench.runner.execution import RecordingRun, Run, describe, fit, preload
from spoofbench.runner.plan import (
    ConfiguredPlugin,
    Failure,
    PlannedFit,
    PlannedTask,
    PlannedVariant,
    RecordingInfo,
    plan,
)
from spoofbench.runner.store import ResultStore, check_folder
from spoofbench.sandbox import Sandbox, SandboxLost
from spoofbench.scoring.score import score_folder
from spoofbench.suite import AttackEntry, DetectorEntry, RecordingEntry, Suite

_Asked = tuple[tuple[plugins.Group, Sequence[AttackEntry | DetectorEntry]], ...]


def run(
    suite: Suite,
    folder: Path,
    *,
    workers: int | None = None,
    resume: bool = False,
    retry_failed: bool = False,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Run a suite into a results folder, and score it.

    Args:
        suite: what to run.
        folder: results; must not hold any unless ``resume``.
        workers: processes at a time; one per processor where None.
        resume: run only what is missing; what the suite no longer asks for goes.
        retry_failed: with ``resume``, run tasks again that failed, timed out or ran out of memory.
        progress: gets the share of tasks that are done, from several threads, one at a time.

    Raises:
        SuiteError, PluginError: the suite asks for a plugin or parameter that does not exist, or
            for a recording that cannot be read.
        ResultsError: the folder has results of another run, or the server of the workers was
            killed.
    """
    asked: _Asked = ((plugins.ATTACKS, suite.attacks), (plugins.DETECTORS, suite.detectors))
    for group, entries in asked:
        for entry in entries:
            plugins.find(group, entry.plugin)
    for recording in suite.recordings:
        if not recording.path.exists() and recording.recipe:
            raise SuiteError(
                f"suite {suite.name!r}: the recording {recording.id!r} is not in the cache; fetch "
                f"it with: spoofbench fetch {recording.recipe}"
            )
        if not recording.path.exists():
            raise SuiteError(
                f"suite {suite.name!r}: there is no file {str(recording.path)!r} for the recording "
                f"{recording.id!r}"
            )
    check_folder(folder, suite.name, resume=resume)
    try:
        width = workers or os.cpu_count() or 1
        with ThreadPoolExecutor(width) as pool, Sandbox(preload) as sandbox:
            attacks, detectors = (
                list(pool.map(partial(describe, sandbox, suite, group), entries))
                for group, entries in asked
            )
            under_way = _Run(pool, width, sandbox, suite, attacks, detectors)
            infos = under_way.survey()
            store = ResultStore(folder, suite.name, retry_failed=retry_failed, progress=progress)
            under_way.run(infos, store)
    except SandboxLost as error:
        raise ResultsError(f"{error}; run again with --resume to do what is missing") from error
    score_folder(folder)


class _Run:
    """A run under way: recordings are surveyed, tasks planned, variants made and run; detectors
    that learn are fitted and run when all material is there.
    """

    def __init__(
        self,
        pool: ThreadPoolExecutor,
        width: int,
        sandbox: Sandbox,
        suite: Suite,
        attacks: Sequence[ConfiguredPlugin],
        detectors: Sequence[ConfiguredPlugin],
    ) -> None:
        self.pool, self.width, self.sandbox, self.suite = pool, width, sandbox, suite
        self.attacks, self.detectors = attacks, detectors
        self.store: ResultStore
        self.recordings = {
            entry.id: RecordingRun(sandbox, suite, entry, attacks) for entry in suite.recordings
        }

    def run(self, infos: dict[str, RecordingInfo], store: ResultStore) -> None:
        self.store = store
        tasks = plan(self.suite, infos, self.attacks, self.detectors)
        missing = self.store.missing(tasks)
        fits = {task.fit.id: task.fit for task in missing if task.fit}
        teaching = {
            each.variant.id: each.variant
            for fit in fits.values()
            for each in (*fit.clean, *fit.attacked)
        }
        waiting = self._prepare_and_run(missing, list(teaching.values()))
        failed = self._fit(fits.values())
        ready: dict[str, list[PlannedTask]] = {}
        for task in waiting:
            failure = failed.get(task.fit.id) if task.fit else None
            if failure:
                self.store.done(task, TaskOutcome(*failure, None))
            else:
                ready.setdefault(task.variant.recording.id, []).append(task)
        self._drain(
            {
                self.pool.submit(run)
                for name, own in ready.items()
                for run in self.recordings[name].runs(own, self.store)
            }
        )
        self.store.finish(tasks, infos)
        inputs = {name: info.digest for name, info in infos.items()}
        write_run(self.store.folder, _about(self.suite, inputs, [*self.attacks, *self.detectors]))

    def survey(self) -> dict[str, RecordingInfo]:
        """Return what is in each recording.

        Raises:
            SuiteError: one cannot be read.
        """
        suite = self.suite

        def survey(recording: RecordingRun) -> None:
            warm_up_s = self._warm_up_s(recording.recording)
            until_s = suite.calibration.until_s if suite.calibration else None
            is_cut = until_s is not None and suite.is_calibrated(recording.recording)
            recording.survey(max(warm_up_s, until_s or 0.0) if is_cut else warm_up_s)

        list(self.pool.map(survey, self.recordings.values()))
        for name, recording in self.recordings.items():
            if recording.info.failure:
                reason = recording.info.failure[1]
                raise SuiteError(
                    f"suite {suite.name!r}, recording {name!r} cannot be read: {reason}"
                )
        return {name: recording.info for name, recording in self.recordings.items()}

    def _warm_up_s(self, recording: RecordingEntry) -> float:
        """Return how long before the first window: as the suite says, or the longest that a
        detector for the recording's class declares.
        """
        if self.suite.warm_up_s is not None:
            return self.suite.warm_up_s
        made_for = self.suite.detectors_for(recording)
        return max((each.warm_up_s for each in self.detectors if each.entry in made_for), default=0)

    def _prepare_and_run(
        self, tasks: Sequence[PlannedTask], teaching: Sequence[PlannedVariant]
    ) -> list[PlannedTask]:
        """Prepare recordings, as many at a time as there are workers, and run what needs no fit;
        return the tasks that wait for one. Material that nothing waits for goes with the last run.
        """
        own: dict[str, list[PlannedTask]] = {name: [] for name in self.recordings}
        for task in tasks:
            own[task.variant.recording.id].append(task)
        waiting: list[PlannedTask] = []
        queue = deque(name for name, missing in own.items() if missing or teaching)
        futures = dict[Future[list[Run]], str]()

        def prepare(name: str) -> list[Run]:
            recording = self.recordings[name]
            variants = [variant for variant in teaching if variant.recording.id == name]
            runnable = recording.prepare(own[name], variants, self.store)
            waiting.extend(task for task in runnable if task.fit)
            return recording.runs([task for task in runnable if not task.fit], self.store)

        while queue or futures:
            while queue and len(set(futures.values())) < self.width:
                name = queue.popleft()
                futures[self.pool.submit(prepare, name)] = name
            done, _ = wait(futures, return_when=FIRST_COMPLETED)
            for future in done:
                name = futures.pop(future)
                futures |= {self.pool.submit(run): name for run in future.result()}
                if not teaching and Counter(futures.values())[name] == 0:
                    shutil.rmtree(self.recordings[name].material, ignore_errors=True)
        order = {task.id: number for number, task in enumerate(tasks)}
        return sorted(waiting, key=lambda task: order[task.id])

    def _fit(self, fits: Iterable[PlannedFit]) -> dict[str, Failure]:
        """Fit detectors; return why there is no state, by fit."""
        material = {name: recording.material for name, recording in self.recordings.items()}
        missing = [each for each in fits if not self.store.has_state(each.id)]

        def do(planned: PlannedFit) -> Failure | None:
            outcome = fit(self.sandbox, self.suite, planned, material, self.store.folder)
            self.store.fitted(planned, outcome)
            return None if outcome.status == "ok" else (outcome.status, outcome.reason or "")

        results = self.pool.map(do, missing)
        return {
            planned.id: failure
            for planned, failure in zip(missing, results, strict=True)
            if failure is not None
        }

    def _drain(self, futures: set[Future[list[Run]]]) -> None:
        """Wait for runs, and for those that they return."""
        while futures:
            done, futures = wait(futures, return_when=FIRST_COMPLETED)
            futures |= {self.pool.submit(run) for future in done for run in future.result()}


def _about(
    suite: Suite, inputs: dict[str, str | None], used: Sequence[ConfiguredPlugin]
) -> dict[str, Any]:
    """What ``run.json`` says: nothing that differs between equal runs on one machine."""
    entries = asdict(suite)
    for entry in entries["recordings"]:
        entry["path"] = entry["path"].name
    return {
        "suite": entries,
        "inputs": inputs,
        "versions": {
            "spoofbench": spoofbench.__version__,
            "code": identity.core(),
            "python": platform.python_version(),
            **{name: version(name) for name in ("numpy", "scipy", "pyarrow", "pandas")},
        },
        "plugins": {str(entry.plugin): entry.code for entry in used},
        "machine": {"platform": platform.platform(), "processors": os.cpu_count()},
    }
