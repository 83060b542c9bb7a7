"""The runner: every recording of a suite, unattacked and under every attack, before every detector.

The main process never runs a plugin's code and never holds a recording. A server that has imported
everything heavy forks workers: one describes a plugin, one prepares a recording (and knows the
truth), one runs a detector on a group of variants (and has nothing but blind material). Decisions
come back through a pipe, and each task's outcome is a file named by the hash of all that decides
it: a run that was killed goes on where it stood.
"""

import os
import platform
import shutil
from collections import Counter, deque
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import spoofbench
from spoofbench import plugins
from spoofbench.results import write_run, write_tasks
from spoofbench.runner import identity
from spoofbench.runner.execution import Job, Preparation, describe
from spoofbench.runner.ledger import Ledger, check_folder
from spoofbench.runner.planning import Part
from spoofbench.runner.workers import Server
from spoofbench.scoring.score import score_folder
from spoofbench.suite import Suite


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
    for group, entries in ((plugins.ATTACKS, suite.attacks), (plugins.DETECTORS, suite.detectors)):
        for entry in entries:
            plugins.find(group, entry.plugin)
    check_folder(folder, suite.name, resume=resume)
    width = max(1, workers or os.cpu_count() or 1)
    total = len(suite.detectors) * sum(
        1 + len(suite.seeds) * len(suite.attacks_on(entry.id)) for entry in suite.recordings
    )
    with ThreadPoolExecutor(width) as pool, Server() as server:
        attacks = list(
            pool.map(lambda entry: describe(server, suite, plugins.ATTACKS, entry), suite.attacks)
        )
        detectors = list(
            pool.map(
                lambda entry: describe(server, suite, plugins.DETECTORS, entry), suite.detectors
            )
        )
        ledger = Ledger(folder, suite.name, total, retry_failed=retry_failed, progress=progress)
        preparations = [Preparation(server, suite, entry, ledger) for entry in suite.recordings]
        _execute(pool, preparations, width, attacks, detectors)
    tasks = [task for preparation in preparations for task in preparation.tasks]
    ledger.sweep(tasks)
    write_tasks(
        folder, [task.row(suite.target_far_per_hour, *ledger.found[task.id]) for task in tasks]
    )
    ledger.write_costs(task.id for task in tasks)
    inputs = {preparation.recording.id: preparation.survey.digest for preparation in preparations}
    write_run(folder, _about(suite, inputs, [*attacks, *detectors]))
    score_folder(folder)


def _execute(
    pool: ThreadPoolExecutor,
    preparations: Sequence[Preparation],
    width: int,
    attacks: Sequence[Part],
    detectors: Sequence[Part],
) -> None:
    """Prepare recordings and run their groups, as many at a time as there are workers; material
    goes with its last group.
    """
    waiting, futures = deque(preparations), dict[Future[list[Job]], Preparation]()
    while waiting or futures:
        while waiting and len(set(futures.values())) < width:
            preparation = waiting.popleft()
            futures[pool.submit(preparation.run, attacks, detectors)] = preparation
        done, _ = wait(futures, return_when=FIRST_COMPLETED)
        for future in done:
            preparation = futures.pop(future)
            futures |= {pool.submit(job): preparation for job in future.result()}
            if Counter(futures.values())[preparation] == 0:
                shutil.rmtree(preparation.material, ignore_errors=True)


def _about(suite: Suite, inputs: dict[str, str | None], parts: Sequence[Part]) -> dict[str, Any]:
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
        "plugins": {f"{part.plugin}": part.code for part in parts},
        "machine": {"platform": platform.platform(), "processors": os.cpu_count()},
        "thresholds": "published",
    }
