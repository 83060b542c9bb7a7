"""How the main process runs jobs in workers of a sandbox, and what becomes of those that fail.

Each function that runs in a worker stands before the one that hears it. The main process never runs
a plugin's code, never holds a recording, and checks anew what a detector's worker sends.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from spoofbench import plugins
from spoofbench.detector import Decisions
from spoofbench.errors import PluginError, SuiteError
from spoofbench.recording import Interval
from spoofbench.results import Status, TaskOutcome
from spoofbench.runner import identity, jobs
from spoofbench.runner.jobs import DescriptionJob, DetectorJob, RecordingJob, VariantJob
from spoofbench.runner.plan import (
    ConfiguredPlugin,
    Failure,
    PlannedTask,
    PlannedVariant,
    RecordingInfo,
    lacking,
    plan,
)
from spoofbench.runner.store import Cost, ResultStore
from spoofbench.sandbox import Sandbox, Worker, WorkerChannel, WorkerDied, WorkerTimedOut
from spoofbench.suite import RATE_PARAMETER, AttackEntry, DetectorEntry, RecordingEntry, Suite

_PREPARING = 10.0
"""Reading a recording, and making a variant of it, may take so many times a task's time: neither is
a detector's fault.
"""

_DECISION_BYTES = 17

Run = Callable[[], "list[Run]"]
"""Work for one thread, which may return further work."""


def preload() -> None:
    """Import what workers need: each would take a second for it."""
    import pandas  # noqa: F401 - pyarrow imports it in silence
    import pyarrow.parquet  # noqa: F401
    import scipy.linalg
    import scipy.signal
    import scipy.stats  # noqa: F401

    plugins.found(plugins.DETECTORS)


def _describe(channel: WorkerChannel, job: DescriptionJob) -> None:
    channel.send(**jobs.describe_plugin(job))


def describe(
    sandbox: Sandbox, suite: Suite, group: plugins.Group, entry: AttackEntry | DetectorEntry
) -> ConfiguredPlugin:
    """Load a plugin in a worker and return what it says of itself.

    Raises:
        PluginError: there is no such plugin.
        SuiteError: it does not take the suite's parameters.
    """
    plugin, given = plugins.find(group, entry.plugin), dict(entry.parameters)
    code = identity.code_of(plugin)
    target = suite.target_far_per_hour if group == plugins.DETECTORS else None
    with sandbox.start(_describe, DescriptionJob(group, entry.plugin, given, target)) as worker:
        try:
            about = worker.receive(suite.limits.time_s)
        except (WorkerDied, WorkerTimedOut) as error:
            about = {"status": "failed", "reason": f"loading the plugin: {error}"}
    if about["status"] == "refused":
        raise SuiteError(f"suite {suite.name!r}, {entry.id!r}: {about['reason']}")
    if about["status"] != "ok":
        failure: Failure = ("failed", about["reason"])
        return ConfiguredPlugin(entry, plugin, given, given, code, failure=failure)
    if target is not None and RATE_PARAMETER in about["parameters"]:
        given.setdefault(RATE_PARAMETER, target)
    kinds = {name: tuple(about.get(name, ())) for name in ("requires", "uses", "models")}
    return ConfiguredPlugin(
        entry,
        plugin,
        given,
        about["parameters"],
        code,
        memory_s=about.get("memory_s", 0.0),
        baseline=about.get("baseline", False),
        **kinds,
    )


def _prepare(channel: WorkerChannel, job: RecordingJob, results: Path, material: Path) -> None:
    for record in jobs.survey_recording(job):
        channel.send(**record)
    variants = [VariantJob(**variant) for variant in channel.receive()["variants"]]
    for record in jobs.make_variants(job, variants, results, material):
        channel.send(**record)


class RecordingRun:
    """One recording of a run; when it is prepared, :attr:`tasks` is its plan and :attr:`info` what
    was read.
    """

    def __init__(
        self, sandbox: Sandbox, suite: Suite, recording: RecordingEntry, store: ResultStore
    ) -> None:
        self.sandbox, self.suite, self.recording, self.store = sandbox, suite, recording, store
        self.material = sandbox.folder / str(suite.recordings.index(recording))
        self.info = RecordingInfo(None)
        self.tasks: list[PlannedTask] = []

    def prepare(
        self, attacks: Sequence[ConfiguredPlugin], detectors: Sequence[ConfiguredPlugin]
    ) -> list[Run]:
        """Plan the tasks, make the variants that missing ones need, and write the outcome of those
        that cannot run; return what runs the others: one detector on all its variants.
        """
        on_this = self.suite.attacks_on(self.recording.id)
        attacks = [attack for attack in attacks if attack.entry in on_this]
        worker, self.info = self._survey(attacks)
        with worker:
            self.tasks = plan(self.suite, self.recording, self.info, attacks, detectors)
            missing = self.store.missing(self.tasks)
            wanted = {task.variant.id: task.variant for task in missing if not task.variant.failure}
            made = self._make(worker, list(wanted.values()))
        while left := [variant for name, variant in wanted.items() if name not in made]:
            worker, again = self._survey(attacks)
            with worker:
                made |= (
                    {variant.id: again.failure for variant in left}
                    if again.failure
                    else self._make(worker, left)
                )
        runnable = self._settle(missing, made)
        runs: list[Run] = []
        for detector in detectors:
            own = [task for task in runnable if task.detector is detector]
            own.sort(key=lambda task: task.variant.number)
            if own:
                run = DetectorRun(self.sandbox, self.suite, detector, self.material, self.store)
                runs.append(partial(run.run, own))
        return runs

    def _survey(self, attacks: Sequence[ConfiguredPlugin]) -> tuple[Worker, RecordingInfo]:
        """Return a worker that has read the recording, and what it found; attacks that a worker
        does not survive are unfit.
        """
        fatal: dict[str, Failure] = {}
        while True:
            usable = [a for a in attacks if not a.failure and a.entry.id not in fatal]
            job, results = self._job(usable), self.store.folder.absolute()
            worker = self.sandbox.start(_prepare, job, results, self.material)
            asked = None
            try:
                while (read := self._next(worker))["status"] == "asking":
                    asked = read["attack"]
            except (WorkerDied, WorkerTimedOut) as error:
                worker.end()
                if asked is None:
                    failure: Failure = ("failed", f"reading the recording: {error}")
                    return worker, RecordingInfo(None, failure=failure)
                fatal[asked] = ("failed", f"asking what the attack can supply: {error}")
                continue
            if read["status"] != "ok":
                return worker, RecordingInfo(None, failure=("failed", read["reason"]))
            windows = {
                int(seed): window and Interval(*window) for seed, window in read["windows"].items()
            }
            unfit: dict[str, Failure] = {
                name: (status, reason) for name, (status, reason) in read["unfit"].items()
            }
            donors, kinds = tuple(read["donors"]), frozenset(read["kinds"])
            return worker, RecordingInfo(read["digest"], donors, kinds, windows, fatal | unfit)

    def _job(self, attacks: Sequence[ConfiguredPlugin]) -> RecordingJob:
        paths = {entry.id: str(entry.path.absolute()) for entry in self.suite.recordings}
        return RecordingJob(
            recording=self.recording.id,
            path=paths[self.recording.id],
            donors=[paths[donor] for donor in self.recording.donors],
            attacks=[
                {
                    "id": attack.entry.id,
                    "plugin": attack.plugin.name,
                    "parameters": dict(attack.given),
                }
                for attack in attacks
            ],
            seeds=self.suite.seeds,
            suite_seed=self.suite.seed,
            warm_up_s=self.suite.warm_up_s,
            duration_s=self.suite.duration_s,
            memory_mb=self.suite.limits.memory_mb,
        )

    def _next(self, worker: Worker) -> dict[str, Any]:
        return worker.receive(_PREPARING * self.suite.limits.time_s)

    def _make(
        self, worker: Worker, variants: Sequence[PlannedVariant]
    ) -> dict[str, frozenset[str] | Failure]:
        """Have variants made; return the kinds of each, or why there is none, up to one that the
        worker did not survive.
        """
        made: dict[str, frozenset[str] | Failure] = {}
        if not variants:
            return made
        worker.send(variants=[asdict(_variant_job(variant)) for variant in variants])
        for variant in variants:
            try:
                record = self._next(worker)
            except (WorkerDied, WorkerTimedOut) as error:
                made[variant.id] = ("failed", f"making the variant: {error}")
                break
            made[variant.id] = (
                frozenset(record["kinds"])
                if record["status"] == "ok"
                else (record["status"], record["reason"])
            )
            if record.get("id") != variant.id:
                break
        return made

    def _settle(
        self, missing: Iterable[PlannedTask], made: dict[str, frozenset[str] | Failure]
    ) -> list[PlannedTask]:
        """Write the outcome of tasks that cannot run; return the others."""
        runnable = []
        for task in missing:
            failure = task.variant.failure or task.detector.failure
            kinds = frozenset() if failure else made[task.variant.id]
            if failure is None:
                failure = (
                    lacking(task.detector, self.info, kinds)
                    if isinstance(kinds, frozenset)
                    else kinds
                )
            if failure is None:
                runnable.append(task)
            else:
                self.store.done(task, TaskOutcome(*failure, None))
        return runnable


def _variant_job(variant: PlannedVariant) -> VariantJob:
    attack, window = variant.attack, variant.window
    if attack is None:
        return VariantJob(variant.id, variant.number)
    within = (window.start_ns, window.end_ns) if window else ()
    return VariantJob(
        variant.id, variant.number, attack.entry.id, attack.plugin.name, within, variant.seed or 0
    )


def _detect(channel: WorkerChannel, job: DetectorJob, material: Path) -> None:
    for record, decisions in jobs.run_detector(job, material):
        if decisions is None:
            channel.send(**record)
        else:
            channel.send(**record, rows=decisions.time_ns.size)
            arrays = (decisions.time_ns, decisions.score, decisions.available)
            channel.send_bytes(b"".join(array.tobytes() for array in arrays))


class DetectorRun:
    """One detector on variants of one recording."""

    def __init__(
        self,
        sandbox: Sandbox,
        suite: Suite,
        detector: ConfiguredPlugin,
        material: Path,
        store: ResultStore,
    ) -> None:
        self.sandbox, self.limits, self.detector = sandbox, suite.limits, detector
        self.material, self.store = material, store

    def run(self, tasks: Sequence[PlannedTask]) -> list[Run]:
        """Run tasks in one worker; return what runs those again that had no result when it failed,
        each in a worker of its own.
        """
        left = self._attempt(tasks, alone=False)
        self.store.write_costs()
        return [partial(self._run_alone, task) for task in left]

    def _run_alone(self, task: PlannedTask) -> list[Run]:
        self._attempt([task], alone=True)
        self.store.write_costs()
        return []

    def _attempt(self, tasks: Sequence[PlannedTask], *, alone: bool) -> list[PlannedTask]:
        """Return the tasks without result; a task that is alone always gets one."""
        left = list(tasks)
        status: Status = "failed"
        job = DetectorJob(
            plugin=self.detector.plugin.name,
            parameters=dict(self.detector.given),
            variants=[task.variant.number for task in tasks],
            withheld=sorted(tasks[0].withheld),
            memory_mb=self.limits.memory_mb,
        )
        with self.sandbox.start(_detect, job, self.material) as worker:
            try:
                loaded = worker.receive(self.limits.time_s)
                if loaded.get("status") != "ok":
                    raise WorkerDied(str(loaded.get("reason")))
                while left:
                    outcome, cost = self._next(worker, left[0])
                    if outcome.status == "out_of_memory" and not alone:
                        return left  # tasks before it may have left something behind
                    self.store.done(left.pop(0), outcome, cost)
                return []
            except WorkerTimedOut as error:
                status, reason = "timeout", str(error)
            except WorkerDied as error:
                reason = str(error)
        if alone:
            self.store.done(left.pop(0), TaskOutcome(status, reason, None))
        return left

    def _next(self, worker: Worker, task: PlannedTask) -> tuple[TaskOutcome, Cost]:
        record = worker.receive(self.limits.time_s)
        status, reason = record.get("status"), record.get("reason")
        if record.get("variant") != task.variant.number or status not in (
            "ok",
            "failed",
            "out_of_memory",
        ):
            raise WorkerDied("it disturbed the connection of its process")
        cost = Cost(record.get("seconds"), record.get("growth_mb"))
        if status != "ok":
            return TaskOutcome(status, str(reason), None), cost
        try:
            decisions = _decisions(worker, record.get("rows"), self.limits.time_s)
        except PluginError as error:
            return TaskOutcome("failed", f"PluginError: {error}", None), cost
        return TaskOutcome("ok", None, decisions), cost


def _decisions(worker: Worker, rows: Any, within_s: float) -> Decisions:
    """Return decisions of a worker, checked anew.

    Raises:
        PluginError: they are no decisions.
        WorkerDied, WorkerTimedOut, SandboxLost: as :meth:`Worker.receive`.
    """
    if not isinstance(rows, int) or rows < 0:
        raise WorkerDied("it disturbed the connection of its process")
    data = worker.receive_bytes(rows * _DECISION_BYTES, within_s)
    time_ns = np.frombuffer(data, np.int64, rows)
    score = np.frombuffer(data, np.float64, rows, 8 * rows)
    return Decisions(time_ns, score, np.frombuffer(data, np.uint8, rows, 16 * rows) != 0)
