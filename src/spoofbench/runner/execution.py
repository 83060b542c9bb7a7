"""How the main process runs jobs in workers of a sandbox, and what becomes of those that fail.

Each function that runs in a worker stands before the one that hears it. The main process never runs
a plugin's code, never holds a recording, and checks anew what a detector's worker sends.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from spoofbench import plugins
from spoofbench.detector import Decisions
from spoofbench.errors import PluginError, SuiteError
from spoofbench.recording import Interval
from spoofbench.results import Status, TaskOutcome, has_truth, read_truth
from spoofbench.runner import identity, jobs
from spoofbench.runner.jobs import (
    DescriptionJob,
    DetectorJob,
    FitJob,
    RecordingJob,
    TeachingMaterial,
    VariantJob,
)
from spoofbench.runner.plan import (
    ConfiguredPlugin,
    Failure,
    FitMaterial,
    PlannedFit,
    PlannedTask,
    PlannedVariant,
    RecordingInfo,
    lacking,
)
from spoofbench.runner.store import Cost, FitOutcome, ResultStore
from spoofbench.sandbox import Sandbox, Worker, WorkerChannel, WorkerDied, WorkerTimedOut
from spoofbench.scoring.grid import GUARD_S
from spoofbench.suite import (
    RATE_PARAMETER,
    SUITES_TARGET,
    AttackEntry,
    DetectorEntry,
    RecordingEntry,
    Suite,
)

_PREPARING = 10.0
"""Reading a recording, and making a variant of it, may take so many times a task's time: neither is
a detector's fault.
"""

_FITTING = 60.0
"""Fitting a detector may take so many times a task's time: it sees all recordings but one."""

_MAX_STATE_BYTES = 1 << 30
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
    if isinstance(entry, AttackEntry):
        models, strength = tuple(about["models"]), about["strength"]
        return ConfiguredPlugin(
            entry, plugin, given, about["parameters"], code, models=models, strength=strength
        )
    return ConfiguredPlugin(
        entry,
        plugin,
        {RATE_PARAMETER: target, **given} if RATE_PARAMETER in about["parameters"] else given,
        about["parameters"],
        code,
        sources=_sources(suite, entry, about["changed"]),
        requires=tuple(about["requires"]),
        uses=tuple(about["uses"]),
        memory_s=about["memory_s"],
        warm_up_s=about["warm_up_s"],
        baseline=about["baseline"],
        is_fitted=entry.fit and about["is_trainable"],
        learns_from_attacks=about["learns_from_attacks"],
    )


def _sources(suite: Suite, entry: DetectorEntry, changed: Iterable[str]) -> dict[str, str]:
    """Return where the parameters come from that are not the plugin's defaults.

    Raises:
        SuiteError: the suite does not say.
    """
    sources = {}
    for name in changed:
        source = entry.source_of(name)
        if source is None and name in entry.parameters:
            raise SuiteError(
                f"suite {suite.name!r}, {entry.id!r}: {name} is not the plugin's default and the "
                "suite does not say where it comes from; add source = 'published', 'data sheet', "
                "'by hand' or 'session ID', or leave it out"
            )
        sources[name] = source or SUITES_TARGET
    return sources


def _survey(channel: WorkerChannel, job: RecordingJob) -> None:
    for record in jobs.survey_recording(job):
        channel.send(**record)


def _make(
    channel: WorkerChannel,
    job: RecordingJob,
    variants: Sequence[VariantJob],
    results: Path,
    material: Path,
) -> None:
    for record in jobs.make_variants(job, variants, results, material):
        channel.send(**record)


class RecordingRun:
    """One recording of a run; :attr:`info` is what was read of it."""

    def __init__(
        self,
        sandbox: Sandbox,
        suite: Suite,
        recording: RecordingEntry,
        attacks: Sequence[ConfiguredPlugin],
    ) -> None:
        self.sandbox, self.suite, self.recording = sandbox, suite, recording
        self.material = sandbox.folder / str(suite.recordings.index(recording))
        on_this = suite.attacks_on(recording.id)
        self.attacks = [attack for attack in attacks if attack.entry in on_this]
        self.info = RecordingInfo(None)

    def survey(self, first_s: float) -> None:
        """Find out what is in the recording; attacks that a worker does not survive are unfit.

        Args:
            first_s: how long after its first row windows may begin.
        """
        fatal: dict[str, Failure] = {}
        while True:
            usable = [a for a in self.attacks if not a.failure and a.entry.id not in fatal]
            asked = None
            with self.sandbox.start(_survey, self._job(usable, first_s)) as worker:
                try:
                    while (read := self._next(worker))["status"] == "asking":
                        asked = read["attack"]
                except (WorkerDied, WorkerTimedOut) as error:
                    if asked is None:
                        reason = f"reading the recording: {error}"
                        self.info = RecordingInfo(None, failure=("failed", reason))
                        return
                    fatal[asked] = ("failed", f"asking what the attack can supply: {error}")
                    continue
            if read["status"] != "ok":
                self.info = RecordingInfo(None, failure=("failed", read["reason"]))
                return
            unfit: dict[str, Failure] = {
                name: (status, reason) for name, (status, reason) in read["unfit"].items()
            }
            self.info = RecordingInfo(
                digest=read["digest"],
                donors=tuple(read["donors"]),
                kinds=frozenset(read["kinds"]),
                span=Interval(*read["span"]),
                is_fused=read["is_fused"],
                is_really_attacked=read["is_really_attacked"],
                windows=tuple(Interval(*window) for window in read["windows"]),
                unfit=fatal | unfit,
            )
            return

    def prepare(
        self,
        tasks: Sequence[PlannedTask],
        variants: Iterable[PlannedVariant],
        store: ResultStore,
    ) -> list[PlannedTask]:
        """Make the variants that tasks need, and further ones; write the outcome of tasks that
        cannot run, and return the others.
        """
        wanted = {task.variant.id: task.variant for task in tasks if not task.failure}
        wanted |= {variant.id: variant for variant in variants if not variant.failure}
        made: dict[str, frozenset[str] | Failure] = {}
        while left := [variant for name, variant in wanted.items() if name not in made]:
            made |= self._made(left, store.folder.absolute())
        runnable = []
        for task in tasks:
            failure = task.failure
            if failure is None:
                kinds = made[task.variant.id]
                failure = (
                    lacking(task.detector, self.info, kinds)
                    if isinstance(kinds, frozenset)
                    else kinds
                )
            if failure is None:
                runnable.append(task)
            else:
                store.done(task, TaskOutcome(*failure, None))
        return runnable

    def runs(self, tasks: Sequence[PlannedTask], store: ResultStore) -> list[Run]:
        """Return what runs tasks: one detector, as it was fitted, on all its variants."""
        groups: dict[tuple[str, str], list[PlannedTask]] = {}
        for task in tasks:
            key = task.detector.entry.id, task.fit.id if task.fit else ""
            groups.setdefault(key, []).append(task)
        return [
            partial(
                DetectorRun(self.sandbox, self.suite, self.material, store).run,
                sorted(group, key=lambda task: task.variant.number),
            )
            for group in groups.values()
        ]

    def _job(self, attacks: Sequence[ConfiguredPlugin], first_s: float = 0.0) -> RecordingJob:
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
            seed=self.suite.seed,
            first_s=first_s,
            duration_s=self.suite.duration_s,
            gap_s=max(GUARD_S, self.suite.memory_cap_s),
            windows=self.suite.windows,
            memory_mb=self.suite.limits.memory_mb,
        )

    def _next(self, worker: Worker) -> dict[str, Any]:
        return worker.receive(_PREPARING * self.suite.limits.time_s)

    def _made(
        self, variants: Sequence[PlannedVariant], results: Path
    ) -> dict[str, frozenset[str] | Failure]:
        """Have variants made; return the kinds of each, or why there is none, up to one that the
        worker did not survive.
        """
        made: dict[str, frozenset[str] | Failure] = {}
        attacks = [attack for attack in self.attacks if not attack.failure]
        arguments = self._job(attacks), [_variant_job(variant) for variant in variants]
        with self.sandbox.start(_make, *arguments, results, self.material) as worker:
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


def _fit(channel: WorkerChannel, job: FitJob) -> None:
    record, state = jobs.fit_detector(job)
    channel.send(**record, size=len(state))
    channel.send_bytes(state)


def fit(
    sandbox: Sandbox, suite: Suite, planned: PlannedFit, material: Mapping[str, Path], folder: Path
) -> FitOutcome:
    """Fit a detector in a worker.

    Args:
        sandbox, suite: of the run.
        planned: what to fit on what.
        material: folder of each recording's blind material, by id.
        folder: the results, which know when variants are attacked.
    """

    def teaching(each: FitMaterial, *, is_attacked: bool) -> TeachingMaterial:
        variant = each.variant
        intervals = read_truth(folder, variant.id).intervals if is_attacked else ()
        return TeachingMaterial(
            str(material[variant.recording.id]),
            variant.number,
            each.part.start_ns,
            each.part.end_ns,
            [(interval.start_ns, interval.end_ns) for interval in intervals],
        )

    job = FitJob(
        plugin=planned.detector.plugin.name,
        parameters=dict(planned.detector.given),
        clean=[teaching(each, is_attacked=False) for each in planned.clean],
        attacked=[
            teaching(each, is_attacked=True)
            for each in planned.attacked
            if has_truth(folder, each.variant.id)
        ],
        withheld=sorted(planned.withheld),
        memory_mb=suite.limits.memory_mb,
    )
    within_s = _FITTING * suite.limits.time_s
    with sandbox.start(_fit, job) as worker:
        try:
            record = worker.receive(within_s)
            state = worker.receive_bytes(_size(record.get("size")), within_s)
        except WorkerTimedOut as error:
            return FitOutcome("timeout", f"fitting it: {error}", b"", {})
        except WorkerDied as error:
            return FitOutcome("failed", f"fitting it: {error}", b"", {})
    status, reason = record.get("status"), record.get("reason")
    if status not in ("ok", "skipped", "failed", "out_of_memory"):
        return FitOutcome("failed", "fitting it: it disturbed its connection", b"", {})
    return FitOutcome(status, reason and str(reason), state, dict(record.get("learned") or {}))


def _size(size: Any) -> int:
    if not isinstance(size, int) or not 0 <= size <= _MAX_STATE_BYTES:
        raise WorkerDied("what it has learned is too large")
    return size


def _variant_job(variant: PlannedVariant) -> VariantJob:
    attack, window = variant.attack, variant.window
    if attack is None:
        return VariantJob(variant.id, variant.number)
    within = (window.start_ns, window.end_ns) if window else ()
    return VariantJob(variant.id, variant.number, attack.entry.id, attack.plugin.name, within)


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
        material: Path,
        store: ResultStore,
    ) -> None:
        self.sandbox, self.limits = sandbox, suite.limits
        self.material, self.store = material, store

    def run(self, tasks: Sequence[PlannedTask]) -> list[Run]:
        """Run tasks in one worker; return what runs those again that had no result when it failed,
        each in a worker of its own.
        """
        left = self._attempt(tasks, alone=False)
        self.store.save_costs()
        return [partial(self._run_alone, task) for task in left]

    def _run_alone(self, task: PlannedTask) -> list[Run]:
        self._attempt([task], alone=True)
        self.store.save_costs()
        return []

    def _attempt(self, tasks: Sequence[PlannedTask], *, alone: bool) -> list[PlannedTask]:
        """Return the tasks without result; a task that is alone always gets one.

        The tasks have one detector, fitted on the same.
        """
        left, fitted = list(tasks), tasks[0].fit
        status: Status = "failed"
        job = DetectorJob(
            plugin=tasks[0].detector.plugin.name,
            parameters=dict(tasks[0].detector.given),
            variants=[task.variant.number for task in tasks],
            withheld=sorted(tasks[0].withheld),
            memory_mb=self.limits.memory_mb,
            state=str(self.store.state_file(fitted.id).absolute()) if fitted else "",
            state_sha256=self.store.state_digest(fitted.id) if fitted else "",
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
