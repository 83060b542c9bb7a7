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
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import asdict
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import spoofbench
from spoofbench import plugins
from spoofbench.errors import ResultsError
from spoofbench.results import write_run, write_tasks
from spoofbench.runner import identity
from spoofbench.runner.execution import RecordingRun, Run, describe, preload
from spoofbench.runner.plan import ConfiguredPlugin
from spoofbench.runner.store import ResultStore, check_folder
from spoofbench.sandbox import Sandbox, SandboxLost
from spoofbench.scoring.score import score_folder
from spoofbench.suite import AttackEntry, DetectorEntry, Suite

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
        SuiteError, PluginError: the suite asks for a plugin or parameter that does not exist.
        ResultsError: the folder has results of another run, or the server of the workers was
            killed.
    """
    asked: _Asked = ((plugins.ATTACKS, suite.attacks), (plugins.DETECTORS, suite.detectors))
    for group, entries in asked:
        for entry in entries:
            plugins.find(group, entry.plugin)
    check_folder(folder, suite.name, resume=resume)
    width = max(1, workers or os.cpu_count() or 1)
    total = len(suite.detectors) * sum(
        1 + len(suite.seeds) * len(suite.attacks_on(entry.id)) for entry in suite.recordings
    )
    try:
        with ThreadPoolExecutor(width) as pool, Sandbox(preload) as sandbox:
            attacks, detectors = (
                list(pool.map(partial(describe, sandbox, suite, group), entries))
                for group, entries in asked
            )
            store = ResultStore(
                folder, suite.name, total, retry_failed=retry_failed, progress=progress
            )
            recordings = [RecordingRun(sandbox, suite, entry, store) for entry in suite.recordings]
            _execute(pool, recordings, width, attacks, detectors)
    except SandboxLost as error:
        raise ResultsError(f"{error}; run again with --resume to do what is missing") from error
    tasks = [task for recording in recordings for task in recording.tasks]
    store.sweep(tasks)
    write_tasks(
        folder, [task.row(suite.target_far_per_hour, *store.found[task.id]) for task in tasks]
    )
    store.write_costs(task.id for task in tasks)
    inputs = {recording.recording.id: recording.info.digest for recording in recordings}
    write_run(folder, _about(suite, inputs, [*attacks, *detectors]))
    score_folder(folder)


def _execute(
    pool: ThreadPoolExecutor,
    recordings: Sequence[RecordingRun],
    width: int,
    attacks: Sequence[ConfiguredPlugin],
    detectors: Sequence[ConfiguredPlugin],
) -> None:
    """Prepare recordings and run detectors on them, as many at a time as there are workers;
    material goes with the last run on it.
    """
    waiting, futures = deque(recordings), dict[Future[list[Run]], RecordingRun]()
    while waiting or futures:
        while waiting and len(set(futures.values())) < width:
            recording = waiting.popleft()
            futures[pool.submit(recording.prepare, attacks, detectors)] = recording
        done, _ = wait(futures, return_when=FIRST_COMPLETED)
        for future in done:
            recording = futures.pop(future)
            futures |= {pool.submit(run): recording for run in future.result()}
            if Counter(futures.values())[recording] == 0:
                shutil.rmtree(recording.material, ignore_errors=True)


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
        "thresholds": "published",
    }
