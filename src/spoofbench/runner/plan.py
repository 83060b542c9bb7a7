"""The plan of a recording: its variants and tasks, each with its id, in the order of the suite."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from spoofbench.plugins import Plugin
from spoofbench.recording import Interval
from spoofbench.results import Status, Task
from spoofbench.runner import identity
from spoofbench.schema import KINDS
from spoofbench.suite import AttackEntry, DetectorEntry, RecordingEntry, Suite

Failure = tuple[Status, str]
"""Why there is nothing to be had: status and reason."""


@dataclass(frozen=True, slots=True)
class ConfiguredPlugin:
    """An attack or detector of the suite, with what its plugin says of itself.

    Attributes:
        given: the parameters to make it with.
        full: all its parameters.
        code: digest of its code.
        requires, uses, memory_s, baseline: a detector's contract.
        models: kinds whose change an attack models.
        failure: set where the plugin cannot be loaded.
    """

    entry: AttackEntry | DetectorEntry
    plugin: Plugin
    given: Mapping[str, Any]
    full: Mapping[str, Any]
    code: str
    requires: tuple[str, ...] = ()
    uses: tuple[str, ...] = ()
    memory_s: float = 0.0
    baseline: bool = False
    models: tuple[str, ...] = ()
    failure: Failure | None = None

    @property
    def inputs(self) -> dict[str, Any]:
        """What of it decides a result."""
        return {
            "id": self.entry.id,
            "plugin": self.plugin.name,
            "distribution": self.plugin.distribution,
            "version": self.plugin.version,
            "code": self.code,
            "parameters": dict(self.full),
        }


@dataclass(frozen=True, slots=True)
class RecordingInfo:
    """What reading a recording tells.

    Attributes:
        digest: of the decoded rows; None where it could not be read, and then ``failure`` says why.
        donors: digests of the donors.
        kinds: what a detector can see.
        windows: by seed; None where the recording has no room for an attack.
        unfit: attacks that cannot be made, by id.
    """

    digest: str | None
    donors: tuple[str, ...] = ()
    kinds: frozenset[str] = frozenset()
    windows: Mapping[int, Interval | None] = field(default_factory=dict)
    unfit: Mapping[str, Failure] = field(default_factory=dict)
    failure: Failure | None = None


@dataclass(frozen=True, slots=True)
class PlannedVariant:
    """A recording under an attack, or unattacked where ``attack`` is None; ``number`` is what
    detectors' workers know it by.
    """

    id: str
    number: str
    recording: RecordingEntry
    attack: ConfiguredPlugin | None
    window: Interval | None
    seed: int | None
    failure: Failure | None


@dataclass(frozen=True, slots=True)
class PlannedTask:
    """One detector on one variant; it has to do without the ``withheld`` kinds."""

    id: str
    variant: PlannedVariant
    detector: ConfiguredPlugin
    withheld: frozenset[str] = frozenset()

    def row(self, target_far_per_hour: float, status: Status, reason: str | None) -> Task:
        """Return its row of the table of tasks."""
        variant, attack, detector = self.variant, self.variant.attack, self.detector
        entry = detector.entry
        return Task(
            task_id=self.id,
            variant_id=variant.id,
            recording=variant.recording.id,
            session=variant.recording.session,
            attack=attack.entry.id if attack else None,
            attack_parameters=identity.canonical(attack.full) if attack else None,
            window_start_ns=variant.window.start_ns if variant.window else None,
            window_end_ns=variant.window.end_ns if variant.window else None,
            seed=variant.seed,
            detector=entry.id,
            plugin=detector.plugin.name,
            plugin_distribution=detector.plugin.distribution,
            plugin_version=detector.plugin.version,
            parameters=identity.canonical(detector.full),
            requires=", ".join(detector.requires),
            memory_s=detector.memory_s,
            baseline=detector.baseline,
            hold_s=entry.hold_s if isinstance(entry, DetectorEntry) else None,
            target_far_per_hour=target_far_per_hour,
            status=status,
            reason=reason,
        )


def plan(
    suite: Suite,
    recording: RecordingEntry,
    info: RecordingInfo,
    attacks: Sequence[ConfiguredPlugin],
    detectors: Sequence[ConfiguredPlugin],
) -> list[PlannedTask]:
    """Return the tasks of a recording: unattacked, then attacks x seeds; each before every
    detector.
    """
    attempts: list[tuple[ConfiguredPlugin | None, int | None]] = [
        (None, None),
        *((attack, seed) for attack in attacks for seed in suite.seeds),
    ]
    ids = [_variant_id(recording, info, attack, seed) for attack, seed in attempts]
    numbers = {name: f"{number:05d}" for number, name in enumerate(sorted(ids))}
    tasks = []
    for name, (attack, seed) in zip(ids, attempts, strict=True):
        variant = PlannedVariant(
            name,
            numbers[name],
            recording,
            attack,
            _window(info, attack, seed),
            seed,
            _failure(info, attack),
        )
        for detector in detectors:
            withheld = _withheld(detector, info, attacks)
            tasks.append(
                PlannedTask(
                    _task_id(suite, variant, detector, withheld), variant, detector, withheld
                )
            )
    return tasks


def _withheld(
    detector: ConfiguredPlugin, info: RecordingInfo, attacks: Sequence[ConfiguredPlugin]
) -> frozenset[str]:
    """The kinds that a detector could use and that not every variant of the recording keeps.

    False alerts and detections are then those of the same detector, and a kind that is missing
    tells nothing.
    """
    kept = [
        set(attack.models)
        for attack in attacks
        if not attack.failure and attack.entry.id not in info.unfit
    ]
    optional = (set(detector.uses) - set(detector.requires)) & info.kinds
    return frozenset(
        kind
        for kind in optional
        if KINDS[kind].is_gnss_derived and not all(kind in models for models in kept)
    )


def lacking(
    detector: ConfiguredPlugin, info: RecordingInfo, kinds: frozenset[str]
) -> Failure | None:
    """Return why a detector cannot run on a variant with these kinds, None where it can."""
    missing = [kind for kind in detector.requires if kind not in kinds]
    for kind in missing:
        if kind not in info.kinds:
            return "skipped", f"the recording has no {kind!r}, which the detector requires"
    for kind in missing:
        if KINDS[kind].is_gnss_derived:
            return (
                "not_modelled",
                f"the attack does not model {kind!r}, which the detector requires",
            )
    return None


def _variant_id(
    recording: RecordingEntry,
    info: RecordingInfo,
    attack: ConfiguredPlugin | None,
    seed: int | None,
) -> str:
    window = _window(info, attack, seed)
    return identity.identify(
        versions=identity.versions(),
        recording=recording.id,
        digest=info.digest,
        donors=info.donors if attack else None,
        attack=attack.inputs if attack else None,
        window=[window.start_ns, window.end_ns] if window else None,
        seed=seed,
        failure=info.failure,
    )


def _task_id(
    suite: Suite, variant: PlannedVariant, detector: ConfiguredPlugin, withheld: frozenset[str]
) -> str:
    limits = {"time_s": suite.limits.time_s, "memory_mb": suite.limits.memory_mb}
    inputs = {"detector": detector.inputs, "withheld": sorted(withheld), "limits": limits}
    return identity.identify(versions=identity.versions(), variant=variant.id, **inputs)


def _window(
    info: RecordingInfo, attack: ConfiguredPlugin | None, seed: int | None
) -> Interval | None:
    if attack is None or seed is None or attack.entry.id in info.unfit:
        return None
    return info.windows.get(seed)


def _failure(info: RecordingInfo, attack: ConfiguredPlugin | None) -> Failure | None:
    if info.failure or attack is None:
        return info.failure
    return attack.failure or info.unfit.get(attack.entry.id)
