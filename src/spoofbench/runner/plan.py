"""The plan of a run: what is fitted on what, and every recording, unattacked and under attack,
before every detector.

Each task has its id, in the order of the suite: it says all that decides the result. A detector
that learns is fitted for each set of sessions that its state must not have seen, and its thresholds
come from unattacked recordings that its state has not seen either.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from spoofbench.detector import input_class
from spoofbench.plugins import Plugin
from spoofbench.recording import Interval
from spoofbench.results import Provenance, Role, Status, Task
from spoofbench.runner import identity
from spoofbench.schema import KINDS
from spoofbench.suite import AttackEntry, Calibration, DetectorEntry, RecordingEntry, Suite

FOLDS = 5
"""In how many parts, by session, the calibration side is cut to find a fitted detector's factor."""

AS_RECORDED = "as recorded"
"""What the attack of a really attacked recording is called."""

Failure = tuple[Status, str]
"""Why there is nothing to be had: status and reason."""


@dataclass(frozen=True, slots=True)
class ConfiguredPlugin:
    """An attack or detector of the suite, with what its plugin says of itself.

    Attributes:
        given: the parameters to make it with.
        full: all its parameters.
        sources: where those come from that are not defaults, by name.
        code: digest of its code.
        requires, uses, memory_s, warm_up_s, baseline, is_fitted, learns_from_attacks: a detector's
            contract; ``is_fitted`` where it learns and the suite lets it.
        models, strength: an attack's.
        failure: set where the plugin cannot be loaded.
    """

    entry: AttackEntry | DetectorEntry
    plugin: Plugin
    given: Mapping[str, Any]
    full: Mapping[str, Any]
    code: str
    sources: Mapping[str, str] = field(default_factory=dict)
    requires: tuple[str, ...] = ()
    uses: tuple[str, ...] = ()
    memory_s: float = 0.0
    warm_up_s: float = 0.0
    baseline: bool = False
    is_fitted: bool = False
    learns_from_attacks: bool = False
    models: tuple[str, ...] = ()
    strength: float | None = None
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
        span: from the first row to the last.
        is_fused: whether the primary position is fused with inertial sensors.
        is_really_attacked: whether it carries the labels of a real attack.
        windows: of attack, disjoint; none where the recording has no room for one.
        unfit: attacks that cannot be made, by id.
    """

    digest: str | None
    donors: tuple[str, ...] = ()
    kinds: frozenset[str] = frozenset()
    span: Interval = field(default_factory=lambda: Interval(0, 1))
    is_fused: bool = False
    is_really_attacked: bool = False
    windows: tuple[Interval, ...] = ()
    unfit: Mapping[str, Failure] = field(default_factory=dict)
    failure: Failure | None = None


@dataclass(frozen=True, slots=True)
class PlannedVariant:
    """A recording under an attack, or as it is where ``attack`` is None; ``number`` is what
    detectors' workers know it by.
    """

    id: str
    number: str
    recording: RecordingEntry
    attack: ConfiguredPlugin | None
    window_number: int | None
    window: Interval | None
    failure: Failure | None

    @property
    def attack_group(self) -> str | None:
        """The attack of which this is one strength."""
        entry = self.attack.entry if self.attack else None
        return (entry.group or entry.id) if isinstance(entry, AttackEntry) else None


@dataclass(frozen=True, slots=True)
class FitMaterial:
    """A part of a variant that a detector is fitted on."""

    variant: PlannedVariant
    part: Interval


@dataclass(frozen=True, slots=True)
class PlannedFit:
    """A detector to fit; it has to do without the ``withheld`` kinds."""

    id: str
    detector: ConfiguredPlugin
    clean: tuple[FitMaterial, ...]
    attacked: tuple[FitMaterial, ...]
    withheld: frozenset[str]


@dataclass(frozen=True, slots=True)
class Unseen:
    """What a threshold, and a fitted state, must not have seen: sessions, and the attacks of a
    plugin.
    """

    sessions: frozenset[str] = frozenset()
    attack: str | None = None


@dataclass(frozen=True, slots=True)
class PlannedTask:
    """One detector on one variant.

    Attributes:
        id: says all that decides the result.
        calibration: the part of the variant that sets thresholds.
        judged_from_ns: from when on it is judged; None where it is not.
        fit: the state that it runs with, of a fitted detector.
        failure: why it cannot run.
        withheld: kinds that the detector has to do without.
    """

    id: str
    role: Role
    variant: PlannedVariant
    detector: ConfiguredPlugin
    unseen: Unseen
    calibration: Interval | None
    judged_from_ns: int | None
    fit: PlannedFit | None
    failure: Failure | None
    withheld: frozenset[str]

    def row(
        self, info: RecordingInfo, kinds: Iterable[str] | None, status: Status, reason: str | None
    ) -> Task:
        """Return its row of the table of tasks; ``kinds`` are those of the variant, where it is."""
        variant, attack, detector = self.variant, self.variant.attack, self.detector
        recording, entry = variant.recording, detector.entry
        return Task(
            task_id=self.id,
            variant_id=variant.id,
            role=self.role,
            recording=recording.id,
            session=recording.session,
            sensor_class=recording.sensor_class,
            provenance=_provenance(recording, info),
            is_fused=info.is_fused,
            kinds=None if kinds is None else identity.canonical(sorted(kinds)),
            attack=attack.entry.id
            if attack
            else (AS_RECORDED if info.is_really_attacked else None),
            attack_group=variant.attack_group or (AS_RECORDED if info.is_really_attacked else None),
            attack_plugin=attack.plugin.name if attack else None,
            attack_parameters=identity.canonical(attack.full) if attack else None,
            strength=attack.strength if attack else None,
            window=variant.window_number,
            window_start_ns=variant.window.start_ns if variant.window else None,
            window_end_ns=variant.window.end_ns if variant.window else None,
            calibration_start_ns=self.calibration.start_ns if self.calibration else None,
            calibration_end_ns=self.calibration.end_ns if self.calibration else None,
            judged_start_ns=self.judged_from_ns,
            held_out=identity.canonical(sorted(self.unseen.sessions)),
            left_out=self.unseen.attack,
            fit_id=self.fit.id if self.fit else None,
            detector=entry.id,
            plugin=detector.plugin.name,
            plugin_distribution=detector.plugin.distribution,
            plugin_version=detector.plugin.version,
            parameters=identity.canonical(detector.full),
            parameter_sources=identity.canonical(detector.sources),
            input_class=input_class({*detector.requires, *detector.uses}),
            requires=identity.canonical(sorted(detector.requires)),
            memory_s=detector.memory_s,
            warm_up_s=detector.warm_up_s,
            learns_from_attacks=bool(self.fit and self.fit.attacked),
            baseline=detector.baseline,
            hold_s=entry.hold_s if isinstance(entry, DetectorEntry) else None,
            status=status,
            reason=reason,
        )


def _provenance(recording: RecordingEntry, info: RecordingInfo) -> Provenance:
    if info.is_really_attacked:
        return "real attack"
    return "simulated" if recording.simulated else "injected"


def plan(
    suite: Suite,
    infos: Mapping[str, RecordingInfo],
    attacks: Sequence[ConfiguredPlugin],
    detectors: Sequence[ConfiguredPlugin],
) -> list[PlannedTask]:
    """Return all tasks: of each recording those of its variants, as it is and under attack, each
    before every detector; then those that only thresholds need.

    Args:
        suite: what to run.
        infos: what is known of each recording, by id.
        attacks, detectors: of the suite.
    """
    return list(_Planner(suite, infos, attacks, detectors).tasks())


class _Planner:
    def __init__(
        self,
        suite: Suite,
        infos: Mapping[str, RecordingInfo],
        attacks: Sequence[ConfiguredPlugin],
        detectors: Sequence[ConfiguredPlugin],
    ) -> None:
        self.suite, self.infos, self.attacks, self.detectors = suite, infos, attacks, detectors
        self.variants = {entry.id: self._variants_of(entry) for entry in suite.recordings}
        self.fits: dict[str, PlannedFit] = {}

    def tasks(self) -> Iterator[PlannedTask]:
        """Yield the tasks of all recordings, then those that set thresholds of fitted ones."""
        pairs: dict[tuple[str, Unseen], tuple[ConfiguredPlugin, str]] = {}
        for recording in self.suite.recordings:
            made_for = self.suite.detectors_for(recording)
            detectors = [each for each in self.detectors if each.entry in made_for]
            for variant in self.variants[recording.id]:
                for detector in detectors:
                    for task in self._of_variant(variant, detector):
                        yield task
                        if task.fit is not None:
                            key = f"{detector.entry.id}/{recording.sensor_class}", task.unseen
                            pairs.setdefault(key, (detector, recording.sensor_class))
        for (_, unseen), (detector, sensor_class) in pairs.items():
            yield from self._thresholds(detector, sensor_class, unseen)

    def _of_variant(
        self, variant: PlannedVariant, detector: ConfiguredPlugin
    ) -> Iterator[PlannedTask]:
        recording, info = variant.recording, self.infos[variant.recording.id]
        is_clean = variant.attack is None
        unseen = Unseen(self._held_out(recording, attacked=not is_clean))
        part = self._calibration_part(recording) if is_clean else None
        judged_from_ns = self._judged_from_ns(recording)
        if not (detector.is_fitted and self.suite.is_calibrated(recording)):
            if judged_from_ns is not None or part is not None:
                role: Role = "calibration" if judged_from_ns is None else "judged"
                yield self._task(role, variant, detector, unseen, part, judged_from_ns, None)
            return
        if judged_from_ns is None:
            return  # it serves the fits alone
        # but for first parts, its own folds set its thresholds
        part = self._threshold_part(recording) if is_clean and self._split.until_s else None
        fitted = self._fit(detector, recording.sensor_class, unseen)
        yield self._task("judged", variant, detector, unseen, part, judged_from_ns, fitted)
        if detector.learns_from_attacks and variant.attack and not info.failure:
            without = replace(unseen, attack=variant.attack.plugin.name)
            other = self._fit(detector, recording.sensor_class, without)
            if other is not fitted:  # else it has learned from no attack of that family
                yield self._task(
                    "family left out", variant, detector, without, None, judged_from_ns, other
                )

    def _thresholds(
        self, detector: ConfiguredPlugin, sensor_class: str, unseen: Unseen
    ) -> Iterator[PlannedTask]:
        """The tasks on unattacked recordings of the calibration side, each with a state that has
        not seen what sets the threshold.
        """
        sessions = self._calibration_sessions(sensor_class, unseen)
        if self._split.split == "first-part":
            # the state has seen the first half alone; where nothing is held out, the judged tasks
            # on unattacked recordings have it
            folds = [frozenset(sessions)] if unseen != Unseen() else []
        else:
            folds = _folds(sessions)
        for fold in folds:
            held_out = unseen.sessions if self._split.until_s else unseen.sessions | fold
            fitted = self._fit(detector, sensor_class, replace(unseen, sessions=held_out))
            for recording in self.suite.recordings:
                part = self._threshold_part(recording)
                if recording.session in fold and part is not None:
                    clean = self.variants[recording.id][0]
                    yield self._task("calibration", clean, detector, unseen, part, None, fitted)

    def _task(
        self,
        role: Role,
        variant: PlannedVariant,
        detector: ConfiguredPlugin,
        unseen: Unseen,
        part: Interval | None,
        judged_from_ns: int | None,
        fitted: PlannedFit | Failure | None,
    ) -> PlannedTask:
        withheld = self._withheld(detector, variant.recording)
        limits = self.suite.limits
        fit = fitted if isinstance(fitted, PlannedFit) else None
        failure = fitted if isinstance(fitted, tuple) else None
        name = identity.identify(
            versions=identity.versions(),
            variant=variant.id,
            detector=detector.inputs,
            withheld=sorted(withheld),
            limits={"time_s": limits.time_s, "memory_mb": limits.memory_mb},
            fit=fit.id if fit else failure,
            use=[role, sorted(unseen.sessions), unseen.attack] if detector.is_fitted else None,
        )
        return PlannedTask(
            name,
            role,
            variant,
            detector,
            unseen,
            part,
            judged_from_ns,
            fit,
            variant.failure or detector.failure or failure,
            withheld,
        )

    def _fit(
        self, detector: ConfiguredPlugin, sensor_class: str, unseen: Unseen
    ) -> PlannedFit | Failure:
        """Return the fit on all that may be seen, or why there is none."""
        clean, attacked = [], []
        for recording in self.suite.recordings:
            part = self._calibration_part(recording)
            if recording.sensor_class != sensor_class or part is None:
                continue
            if recording.session in unseen.sessions or self.infos[recording.id].failure:
                continue
            if self._split.until_s:
                part = Interval(part.start_ns, _middle_ns(part))
            unattacked, *variants = self.variants[recording.id]
            clean.append(FitMaterial(unattacked, part))
            attacked += [
                FitMaterial(variant, self.infos[recording.id].span)
                for variant in variants
                if self._may_teach(detector, variant, unseen)
            ]
        if not clean:
            return "skipped", "no session is left to fit the detector on"
        withheld = frozenset[str]().union(
            *(self._withheld(detector, material.variant.recording) for material in clean)
        )
        name = identity.identify(
            versions=identity.versions(),
            detector=detector.inputs,
            clean=[_named(material) for material in clean],
            attacked=[_named(material) for material in attacked],
            withheld=sorted(withheld),
        )
        fit = PlannedFit(name, detector, tuple(clean), tuple(attacked), withheld)
        return self.fits.setdefault(name, fit)

    def _may_teach(
        self, detector: ConfiguredPlugin, variant: PlannedVariant, unseen: Unseen
    ) -> bool:
        attack, donors = variant.attack, self._sessions(variant.recording.donors)
        judged = {each.session for each in self.suite.recordings if each.side == "judged"}
        return (
            detector.learns_from_attacks
            and not self._split.until_s  # its windows are judged
            and attack is not None
            and variant.failure is None
            and attack.plugin.name != unseen.attack
            and not donors & (unseen.sessions | judged)
        )

    @property
    def _split(self) -> Calibration:
        assert self.suite.calibration is not None, "only what is calibrated is fitted"
        return self.suite.calibration

    def _calibration_part(self, recording: RecordingEntry) -> Interval | None:
        """The unattacked part of a recording that may set thresholds."""
        info = self.infos[recording.id]
        if not self.suite.is_calibrated(recording) or info.failure or info.is_really_attacked:
            return None
        if self._split.until_s is not None:
            return Interval(info.span.start_ns, self._first_part_end_ns(info))
        whole = Interval(info.span.start_ns, info.span.end_ns + 1)
        return None if recording.side == "judged" else whole

    def _threshold_part(self, recording: RecordingEntry) -> Interval | None:
        """The part of it that may set the thresholds of a fitted detector."""
        part = self._calibration_part(recording)
        if part is None or not self._split.until_s:
            return part
        return Interval(_middle_ns(part), part.end_ns)

    def _judged_from_ns(self, recording: RecordingEntry) -> int | None:
        info = self.infos[recording.id]
        if recording.side == "calibration":
            return None
        has_first_part = self.suite.is_calibrated(recording) and self._split.until_s is not None
        if has_first_part and not info.is_really_attacked:
            return self._first_part_end_ns(info)
        return info.span.start_ns

    def _first_part_end_ns(self, info: RecordingInfo) -> int:
        return first_part_end_ns(info.span, self._split.until_s or 0.0)

    def _held_out(self, recording: RecordingEntry, *, attacked: bool) -> frozenset[str]:
        """The sessions that what judges a variant must not have seen."""
        if not self.suite.is_calibrated(recording):
            return frozenset()
        donors = self._sessions(recording.donors) if attacked else frozenset[str]()
        if self._split.split == "leave-one-session-out":
            return donors | {recording.session}
        return donors - {recording.session}

    def _sessions(self, recordings: Iterable[str]) -> frozenset[str]:
        names = set(recordings)
        return frozenset(each.session for each in self.suite.recordings if each.id in names)

    def _calibration_sessions(self, sensor_class: str, unseen: Unseen) -> list[str]:
        sessions = [
            recording.session
            for recording in self.suite.recordings
            if recording.sensor_class == sensor_class
            and self._calibration_part(recording) is not None
            and recording.session not in unseen.sessions
        ]
        return list(dict.fromkeys(sessions))

    def _variants_of(self, recording: RecordingEntry) -> list[PlannedVariant]:
        """The variants of a recording: as it is, then attacks x windows, in the suite's order."""
        info, on_this = self.infos[recording.id], self.suite.attacks_on(recording.id)
        attempts: list[tuple[ConfiguredPlugin | None, int | None]] = [(None, None)]
        teaches = any(each.learns_from_attacks and each.is_fitted for each in self.detectors)
        if not info.is_really_attacked and (recording.side != "calibration" or teaches):
            numbers = range(1, max(1, len(info.windows)) + 1)
            attempts += [
                (attack, number)
                for attack in self.attacks
                if attack.entry in on_this
                for number in numbers
            ]
        ids = [self._variant_id(recording, attack, number) for attack, number in attempts]
        known_as = {name: f"{number:05d}" for number, name in enumerate(sorted(ids))}
        return [
            PlannedVariant(
                name,
                known_as[name],
                recording,
                attack,
                number,
                _window(info, attack, number),
                _failure(info, attack),
            )
            for name, (attack, number) in zip(ids, attempts, strict=True)
        ]

    def _variant_id(
        self, recording: RecordingEntry, attack: ConfiguredPlugin | None, number: int | None
    ) -> str:
        info = self.infos[recording.id]
        window = _window(info, attack, number)
        return identity.identify(
            versions=identity.versions(),
            recording=recording.id,
            digest=info.digest,
            donors=info.donors if attack else None,
            attack=attack.inputs if attack else None,
            window=[window.start_ns, window.end_ns] if window else None,
            seed=self.suite.seed if attack else None,
            number=number if attack and window is None else None,
            failure=info.failure,
        )

    def _withheld(self, detector: ConfiguredPlugin, recording: RecordingEntry) -> frozenset[str]:
        """The kinds that a detector could use and that not every variant of the recording keeps.

        False alerts and detections are then those of the same detector, and a kind that is missing
        tells nothing.
        """
        info = self.infos[recording.id]
        kept = [
            set(variant.attack.models)
            for variant in self.variants[recording.id]
            if variant.attack and not variant.failure
        ]
        optional = (set(detector.uses) - set(detector.requires)) & info.kinds
        return frozenset(
            kind
            for kind in optional
            if KINDS[kind].is_gnss_derived and not all(kind in models for models in kept)
        )


def first_part_end_ns(span: Interval, until_s: float) -> int:
    """Return where the first part of a recording ends, which calibrates; what follows is judged."""
    return min(span.start_ns + round(until_s * 1e9), span.end_ns)


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


def _folds(sessions: Sequence[str]) -> list[frozenset[str]]:
    """Cut sessions into at most :data:`FOLDS` parts; one session cannot be cut."""
    count = min(FOLDS, len(sessions))
    return [frozenset(sessions[number::count]) for number in range(count)] if count > 1 else []


def _middle_ns(part: Interval) -> int:
    return part.start_ns + (part.end_ns - part.start_ns) // 2


def _named(material: FitMaterial) -> list[Any]:
    return [material.variant.id, material.part.start_ns, material.part.end_ns]


def _window(
    info: RecordingInfo, attack: ConfiguredPlugin | None, number: int | None
) -> Interval | None:
    if attack is None or number is None or attack.entry.id in info.unfit:
        return None
    return info.windows[number - 1] if number <= len(info.windows) else None


def _failure(info: RecordingInfo, attack: ConfiguredPlugin | None) -> Failure | None:
    if info.failure or attack is None:
        return info.failure
    return attack.failure or info.unfit.get(attack.entry.id)
