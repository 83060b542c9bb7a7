"""What every detector must keep, as checks that name the law that is broken."""

import dataclasses
import inspect
import math
import pickle
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from spoofbench.detector import Detector, Trainable, warm_up_s
from spoofbench.recording import Recording
from spoofbench.schema import SENSOR_KINDS, split_topic
from spoofbench.testing import fits
from spoofbench.testing.detector_cases import (
    DetectorUnderTest,
    cuts,
    decide,
    decide_if_possible,
    degraded_recordings,
    difference,
    examples,
    fingerprint,
    futures,
    private,
    process_state,
    quiet,
)
from spoofbench.testing.isolation import decide_alone
from spoofbench.testing.kit import (
    Check,
    CheckFailed,
    CheckResult,
    global_seed,
    parametrised,
    require,
)

if TYPE_CHECKING:
    import pytest


_STANDS_S = 60.0


def check_detector(detector: str | Detector, /, **parameters: Any) -> "pytest.MarkDecorator":
    """Parametrise a test's argument ``check`` with all checks of a detector.

    Args:
        detector: name of an entry point of ``spoofbench.detectors``, or an instance.
        parameters: of the entry point's dataclass.
    """
    return parametrised(LAWS, DetectorUnderTest(detector, MappingProxyType(parameters)))


def run_detector_checks(
    detector: str | Detector, parameters: Mapping[str, Any] = MappingProxyType({})
) -> list[CheckResult]:
    """Run all checks of a detector and return what each said.

    Raises:
        PluginError: there is no such detector, it cannot be loaded, or it refuses the parameters.
    """
    subject = DetectorUnderTest(detector, parameters)
    _ = subject.detector
    return [Check(law, subject).result() for law in LAWS]


def _require_same(reason: str | None, where: str) -> None:
    require(reason is None, f"{where}: {reason}")


def is_a_frozen_dataclass(subject: DetectorUnderTest) -> None:
    """Loaded by its entry point it is a frozen dataclass whose parameters are named."""
    detector: Any = subject.detector
    require(
        dataclasses.is_dataclass(detector) and not isinstance(detector, type),
        f"{detector!r} is not an instance of a dataclass",
    )
    require(
        detector.__dataclass_params__.frozen,
        f"{type(detector).__name__} is not frozen: write @dataclass(frozen=True)",
    )
    require(
        isinstance(detector, Detector),
        f"{type(detector).__name__} lacks one of requires, uses, memory_s, detect",
    )
    loose = (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL)
    for parameter in inspect.signature(type(detector)).parameters.values():
        require(
            parameter.kind not in loose,
            f"parameter {parameter} has no name: parameters must be fields",
        )


def declares_its_needs(subject: DetectorUnderTest) -> None:
    """``requires`` and ``uses`` are kinds of the schema, ``memory_s`` and ``warm_up_s`` are finite
    numbers of seconds.
    """
    detector = subject.detector
    for name, kinds in (("requires", detector.requires), ("uses", detector.uses)):
        require(isinstance(kinds, tuple), f"{name} must be a tuple of kinds, not {kinds!r}")
        for kind in kinds:
            require(
                kind in SENSOR_KINDS,
                f"{name} has {kind!r}, which is not one of {sorted(SENSOR_KINDS)}",
            )
    memory = detector.memory_s
    number = isinstance(memory, int | float) and not isinstance(memory, bool)
    require(
        number and math.isfinite(memory) and memory >= 0,
        f"memory_s must be a finite number of at least 0, not {memory!r}",
    )
    _ = warm_up_s(detector)


def decides(subject: DetectorUnderTest) -> None:
    """It gives decisions on ordinary drives, an available one at least, once it is fitted if it has
    to be; no score is -inf.
    """
    for name, decisions in subject.decided.items():
        lowest = decisions.score[decisions.available].min(initial=np.inf)
        require(lowest > -np.inf, f"on {name} a score is -inf: scores must be finite or +inf")
    available = any(decisions.available.any() for decisions in subject.decided.values())
    if not available and isinstance(subject.detector, Trainable):
        fitted = fits.fit(subject.detector)
        if fitted is not None:
            available = bool(decide(fitted, examples()[0].recording).available.any())
    require(
        available,
        (
            "no decision is available on any drive of up to 240 s, so no other check means "
            "anything: try shorter time spans"
        ),
    )


def warms_up_in_time(subject: DetectorUnderTest) -> None:
    """On a drive it decides within a minute after ``warm_up_s``: the drive stands still at first,
    and some epochs are missing.
    """
    example, declared_s = examples()[0], warm_up_s(subject.detector)
    decisions = subject.decided[example.name]
    if not decisions.available.any():
        return  # what it requires is not in this drive; ``decides`` has seen it decide on another
    start_ns = example.recording.span.start_ns
    needed_s = (int(decisions.time_ns[decisions.available][0]) - start_ns) / 1e9
    require(
        needed_s <= declared_s + _STANDS_S,
        f"on {example} the first decision is available after {needed_s:.0f} s, but warm_up_s is "
        f"{declared_s:g}",
    )


def keeps_causality(subject: DetectorUnderTest) -> None:
    """Decisions at or before t stay when the rows after t are cut off, scrambled or altered."""
    for index, example in enumerate(examples()):
        blind = example.recording.blind()
        expected = subject.decided[example.name]
        for time_ns in cuts(blind.primary("gnss/pvt").time_ns, thorough=index == 0):
            for change, other in futures(blind, time_ns):
                reason = difference(expected, decide_if_possible(subject.detector, other), time_ns)
                _require_same(
                    reason,
                    (
                        f"on {example}, with the rows after {time_ns} {change}, an earlier "
                        "decision changes"
                    ),
                )


def leaves_the_recording(subject: DetectorUnderTest) -> None:
    """The recording is the same after the call."""
    for example in examples():
        blind = private(example.recording.blind())
        before = fingerprint(blind)
        with quiet():
            subject.detector.detect(blind)
        require(fingerprint(blind) == before, f"detect() alters the recording of {example}")


def keeps_no_state(subject: DetectorUnderTest) -> None:
    """A recording's decisions do not depend on what was seen before it."""
    fresh: Detector = pickle.loads(pickle.dumps(subject.detector))
    for example in reversed(examples()):
        for who, detector in (("the same", subject.detector), ("another", fresh)):
            reason = difference(subject.decided[example.name], decide(detector, example.recording))
            _require_same(
                reason, f"on {example}, {who} instance decides otherwise after other recordings"
            )


def leaves_the_process(subject: DetectorUnderTest) -> None:
    """The global random generators, numpy's error state, the folder and the environment stay as
    they are.
    """
    with global_seed(11):
        before = process_state()
        decide(subject.detector, examples()[0].recording)
        for name, value in process_state().items():
            require(value == before[name], f"detect() changes {name} of the process")


def is_deterministic(subject: DetectorUnderTest) -> None:
    """The same twice, whatever the state of the global random generators."""
    for example in examples():
        for seed in (1, 2):
            with global_seed(seed):
                reason = difference(
                    subject.decided[example.name], decide(subject.detector, example.recording)
                )
            _require_same(reason, f"on {example}, a second run decides otherwise")


def needs_nothing_but_the_blind_recording(subject: DetectorUnderTest) -> None:
    """Alone with blind recordings in another process it decides the same and reaches for no file or
    network.
    """
    backwards = tuple(reversed(examples()))
    answer = decide_alone(subject.detector, [example.recording for example in backwards])
    for example, decisions in zip(backwards, answer.decisions, strict=True):
        reason = difference(subject.decided[example.name], decisions)
        _require_same(
            reason,
            f"on {example}, it decides otherwise in a process that has the blind recording alone",
        )
    require(answer.reached is None, f"detect() reaches beyond the recording: {answer.reached}")


def pickles(subject: DetectorUnderTest) -> None:
    """It can go to another process and is equal there."""
    copied = pickle.loads(pickle.dumps(subject.detector))
    require(
        copied == subject.detector, f"{subject.detector!r} comes back from pickle as {copied!r}"
    )


def does_without_what_it_does_not_require(subject: DetectorUnderTest) -> None:
    """Kinds beyond ``requires``, second sources and metadata may be missing."""
    recording = examples()[0].recording.blind()
    needed = Recording(
        {
            topic: table
            for topic, table in recording.items()
            if split_topic(topic)[1] in subject.detector.requires
        }
    )
    decide(subject.detector, needed)


def says_what_is_missing(subject: DetectorUnderTest) -> None:
    """Without a required kind it raises nothing but a clear error, even when the harness does not
    ask first.
    """
    blind = examples()[0].recording.blind()
    for kind in subject.detector.requires:
        without = blind.replace(dict.fromkeys(blind.topics(kind)))
        decide_if_possible(_Unasked(subject.detector), without)


@dataclass(frozen=True)
class _Unasked:
    """A detector that claims to require nothing and to use what it requires."""

    detector: Detector
    requires: tuple[str, ...] = ()
    memory_s: float = 0.0

    @property
    def uses(self) -> tuple[str, ...]:
        return (*self.detector.requires, *self.detector.uses)

    def detect(self, recording: Recording) -> Any:
        return self.detector.detect(recording)


def survives_degraded_recordings(subject: DetectorUnderTest) -> None:
    """Degraded recordings give decisions, unavailable ones, or one clear error, nothing else."""
    for name, recording in degraded_recordings(examples()[1].recording.blind()):
        try:
            decisions = decide_if_possible(subject.detector, recording)
        except Exception as error:
            raise CheckFailed(f"on {name} it raises {type(error).__name__}: {error}") from error
        if decisions is not None:
            lowest = decisions.score[decisions.available].min(initial=np.inf)
            require(lowest > -np.inf, f"on {name} a score is -inf: scores must be finite or +inf")


def keeps_the_laws_when_fitted(subject: DetectorUnderTest) -> None:
    """Fitted, it is causal, keeps no state, and survives degraded recordings, as before."""
    fitted = fits.fit(subject.detector) if isinstance(subject.detector, Trainable) else None
    if fitted is not None:
        learned = DetectorUnderTest(fitted, MappingProxyType({}))
        for law in (keeps_causality, keeps_no_state, survives_degraded_recordings):
            law(learned)


LAWS: tuple[Callable[[DetectorUnderTest], None], ...] = (
    is_a_frozen_dataclass,
    declares_its_needs,
    decides,
    warms_up_in_time,
    keeps_causality,
    leaves_the_recording,
    keeps_no_state,
    leaves_the_process,
    is_deterministic,
    needs_nothing_but_the_blind_recording,
    pickles,
    does_without_what_it_does_not_require,
    says_what_is_missing,
    survives_degraded_recordings,
    fits.fits_a_copy,
    fits.fits_alike_twice,
    fits.learns_only_what_it_declares,
    keeps_the_laws_when_fitted,
)
