"""What the main process has its workers do: describe plugins, prepare a recording, run groups of
tasks.
"""

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from spoofbench import plugins
from spoofbench.errors import PluginError, SuiteError
from spoofbench.recording import Interval
from spoofbench.results import Outcome, Status
from spoofbench.runner import identity
from spoofbench.runner.ledger import Cost, Ledger
from spoofbench.runner.planning import Part, PlannedTask, Problem, Survey, Variant, lacking, plan
from spoofbench.runner.workers import Died, Server, TimedOut, Worker
from spoofbench.suite import RATE_PARAMETER, AttackEntry, DetectorEntry, RecordingEntry, Suite

_PREPARING = 10.0
"""Reading a recording, and making a variant of it, may take so many times a task's time: neither is
a detector's fault.
"""

Job = Callable[[], "list[Job]"]
"""Work for one thread, which may return further jobs."""


def describe(
    server: Server, suite: Suite, group: plugins.Group, entry: AttackEntry | DetectorEntry
) -> Part:
    """Load a plugin in a worker and return what it says of itself.

    Raises:
        PluginError: there is no such plugin.
        SuiteError: it does not take the suite's parameters.
    """
    plugin, given = plugins.find(group, entry.plugin), dict(entry.parameters)
    code = identity.code_of(plugin)
    target = suite.target_far_per_hour if group == plugins.DETECTORS else None
    with server.fork() as worker:
        worker.say(
            work="describe", group=group, name=entry.plugin, parameters=given, rate_per_hour=target
        )
        try:
            about = worker.hear(suite.limits.time_s)
        except (Died, TimedOut) as error:
            about = {"status": "failed", "reason": f"loading the plugin: {error}"}
    if about["status"] == "refused":
        raise SuiteError(f"suite {suite.name!r}, {entry.id!r}: {about['reason']}")
    if about["status"] != "ok":
        return Part(entry, plugin, given, given, code, problem=("failed", about["reason"]))
    if target is not None and RATE_PARAMETER in about["parameters"]:
        given.setdefault(RATE_PARAMETER, target)
    kinds = {name: tuple(about.get(name, ())) for name in ("requires", "uses", "models")}
    return Part(
        entry,
        plugin,
        given,
        about["parameters"],
        code,
        memory_s=about.get("memory_s", 0.0),
        **kinds,
    )


class Preparation:
    """Prepares one recording; then :attr:`tasks` is its plan and :attr:`survey` what was read."""

    def __init__(
        self, server: Server, suite: Suite, recording: RecordingEntry, ledger: Ledger
    ) -> None:
        self.server, self.suite, self.recording, self.ledger = server, suite, recording, ledger
        self.material = server.folder / str(suite.recordings.index(recording))
        self.survey = Survey(None)
        self.tasks: list[PlannedTask] = []

    def run(self, attacks: Sequence[Part], detectors: Sequence[Part]) -> list[Job]:
        """Prepare what missing tasks need; settle those that cannot run; return the groups of the
        others.
        """
        on_this = self.suite.attacks_on(self.recording.id)
        attacks = [attack for attack in attacks if attack.entry in on_this]
        worker, self.survey = self._surveyed(attacks)
        with worker:
            self.tasks = plan(self.suite, self.recording, self.survey, attacks, detectors)
            missing = self.ledger.missing(self.tasks)
            wanted = {task.variant.id: task.variant for task in missing if not task.variant.problem}
            made = self._make(worker, list(wanted.values()))
        while len(made) < len(wanted):
            left = [variant for variant in wanted.values() if variant.id not in made]
            worker, again = self._surveyed(
                [attack for attack in attacks if attack.entry.id not in self.survey.unfit]
            )
            with worker:
                made |= (
                    {variant.id: again.problem for variant in left}
                    if again.problem
                    else self._make(worker, left)
                )
        return self._groups(self._settle(missing, made), detectors)

    def _surveyed(self, attacks: Sequence[Part]) -> tuple[Worker, Survey]:
        """Return a worker that has read the recording, and what it found; attacks that a worker
        does not survive are unfit.
        """
        fatal: dict[str, Problem] = {}
        while True:
            worker = self.server.fork()
            asked: list[str] = []
            try:
                read = self._survey(
                    worker,
                    [
                        attack
                        for attack in attacks
                        if not attack.problem and attack.entry.id not in fatal
                    ],
                    asked,
                )
            except (Died, TimedOut) as error:
                worker.end()
                if not asked:
                    return worker, Survey(
                        None, problem=("failed", f"reading the recording: {error}")
                    )
                fatal[asked[-1]] = ("failed", f"asking what the attack can supply: {error}")
                continue
            if read["status"] != "ok":
                return worker, Survey(None, problem=("failed", read["reason"]))
            windows = {
                int(seed): window and Interval(*window) for seed, window in read["windows"].items()
            }
            unfit: dict[str, Problem] = {
                name: (status, reason) for name, (status, reason) in read["unfit"].items()
            }
            return worker, Survey(
                read["digest"],
                tuple(read["donors"]),
                frozenset(read["kinds"]),
                windows,
                fatal | unfit,
            )

    def _survey(self, worker: Worker, attacks: Sequence[Part], asked: list[str]) -> dict[str, Any]:
        """Return the worker's survey; ``asked`` gets the attacks whose code has run."""
        paths = {entry.id: str(entry.path.absolute()) for entry in self.suite.recordings}
        order = {
            "path": paths[self.recording.id],
            "donors": [paths[donor] for donor in self.recording.donors],
            "recording": self.recording.id,
            "attacks": [
                {
                    "id": attack.entry.id,
                    "plugin": attack.plugin.name,
                    "parameters": dict(attack.given),
                }
                for attack in attacks
            ],
            "seeds": list(self.suite.seeds),
            "suite_seed": self.suite.seed,
            "warm_up_s": self.suite.warm_up_s,
            "duration_s": self.suite.duration_s,
        }
        memory_mb = self.suite.limits.memory_mb
        worker.say(
            work="prepare",
            order=order,
            results=str(self.ledger.folder.absolute()),
            material=str(self.material),
            memory_mb=memory_mb,
        )
        while (read := worker.hear(_PREPARING * self.suite.limits.time_s))["status"] == "asking":
            asked.append(read["attack"])
        return read

    def _make(
        self, worker: Worker, variants: Sequence[Variant]
    ) -> dict[str, frozenset[str] | Problem]:
        """Have variants made; return the kinds of each, or why there is none, up to one that the
        worker did not survive.
        """
        made: dict[str, frozenset[str] | Problem] = {}
        if not variants:
            return made
        worker.say(variants=[_wanted(variant) for variant in variants])
        for variant in variants:
            try:
                record = worker.hear(_PREPARING * self.suite.limits.time_s)
            except (Died, TimedOut) as error:
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
        self, missing: Iterable[PlannedTask], made: dict[str, frozenset[str] | Problem]
    ) -> list[PlannedTask]:
        """Write the outcome of tasks that cannot run; return the others."""
        runnable = []
        for task in missing:
            problem = task.variant.problem or task.detector.problem
            kinds = frozenset() if problem else made[task.variant.id]
            if problem is None:
                problem = (
                    lacking(task.detector, self.survey, kinds)
                    if isinstance(kinds, frozenset)
                    else kinds
                )
            if problem is None:
                runnable.append(task)
            else:
                self.ledger.done(task, Outcome(*problem, None))
        return runnable

    def _groups(self, tasks: Sequence[PlannedTask], detectors: Sequence[Part]) -> list[Job]:
        jobs: list[Job] = []
        for detector in detectors:
            group = sorted(
                (task for task in tasks if task.detector is detector),
                key=lambda task: task.variant.number,
            )
            if group:
                jobs.append(
                    partial(
                        Group(self.server, self.suite, detector, self.material, self.ledger).run,
                        group,
                    )
                )
        return jobs


def _wanted(variant: Variant) -> dict[str, Any]:
    attack, window = variant.attack, variant.window
    return {
        "id": variant.id,
        "number": variant.number,
        "attack": attack.entry.id if attack else None,
        "plugin": attack.plugin.name if attack else None,
        "window": [window.start_ns, window.end_ns] if window else None,
        "seed": variant.seed,
    }


class Group:
    """One detector on variants of one recording."""

    def __init__(
        self, server: Server, suite: Suite, detector: Part, material: Path, ledger: Ledger
    ) -> None:
        self.server, self.limits, self.detector, self.material, self.ledger = (
            server,
            suite.limits,
            detector,
            material,
            ledger,
        )

    def run(self, tasks: Sequence[PlannedTask]) -> list[Job]:
        """Run tasks in one process; return jobs that run those again that had no result when it
        failed, each in a process of its own.
        """
        left = self._attempt(tasks, alone=False)
        self.ledger.write_costs()
        return [partial(self._run_alone, task) for task in left]

    def _run_alone(self, task: PlannedTask) -> list[Job]:
        self._attempt([task], alone=True)
        self.ledger.write_costs()
        return []

    def _attempt(self, tasks: Sequence[PlannedTask], *, alone: bool) -> list[PlannedTask]:
        """Return the tasks without result; a task that is alone always gets one."""
        left = list(tasks)
        failure: Status = "failed"
        with self.server.fork() as worker:
            worker.say(
                work="detect",
                name=self.detector.plugin.name,
                parameters=dict(self.detector.given),
                material=str(self.material),
                variants=[task.variant.number for task in tasks],
                withheld=sorted(tasks[0].withheld),
                memory_mb=self.limits.memory_mb,
            )
            try:
                loaded = worker.hear(self.limits.time_s)
                if loaded.get("status") != "ok":
                    raise Died(str(loaded.get("reason")))
                while left:
                    outcome, cost = self._next(worker, left[0])
                    if outcome.status == "out_of_memory" and not alone:
                        return left  # tasks before it may have left something behind
                    self.ledger.done(left.pop(0), outcome, cost)
                return []
            except TimedOut as error:
                failure, reason = "timeout", str(error)
            except Died as error:
                reason = str(error)
        if alone:
            self.ledger.done(left.pop(0), Outcome(failure, reason, None))
        return left

    def _next(self, worker: Worker, task: PlannedTask) -> tuple[Outcome, Cost]:
        record = worker.hear(self.limits.time_s)
        status, reason = record.get("status"), record.get("reason")
        if record.get("variant") != task.variant.number or status not in (
            "ok",
            "failed",
            "out_of_memory",
        ):
            raise Died("it disturbed the connection of its process")
        cost = Cost(record.get("seconds"), record.get("growth_mb"))
        if status != "ok":
            return Outcome(status, str(reason), None), cost
        try:
            return Outcome(
                "ok", None, worker.hear_decisions(record.get("rows"), self.limits.time_s)
            ), cost
        except PluginError as error:
            return Outcome("failed", f"PluginError: {error}", None), cost
