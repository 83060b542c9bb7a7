"""The detector's contract: a recording in, decisions out, causally.

A detector is a frozen dataclass whose fields are its parameters, behind an entry point of the group
``spoofbench.detectors``. It gets the kinds that it declares of a blind recording (see
:meth:`spoofbench.recording.Recording.blind`) and returns one :class:`Decisions`. What it may do
besides is a protocol of its own: :class:`Trainable`, :class:`LearnsFromAttacks`, :class:`WarmsUp`,
:class:`Baseline`. Tools for the way there are in :mod:`spoofbench.navigation`; who thinks in steps
takes :func:`stepwise`.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence, Set
from dataclasses import dataclass
from functools import partial
from typing import Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from spoofbench.arrays import Bools, Floats, Times
from spoofbench.errors import PluginError, RecordingError
from spoofbench.recording import Interval, Recording
from spoofbench.schema import split_topic
from spoofbench.table import Table, frozen


@dataclass(frozen=True, slots=True, eq=False)
class Decisions:
    """What a detector decides over time, arrays of shape ``(n,)``.

    Attributes:
        time_ns: int64, strictly increasing; a decision at t rests on rows at or before t alone.
        score: float64, the test statistic over its threshold: above 1 is an alert. Finite or +inf
            where available.
        available: bool, whether the detector could decide; where not, the score is NaN.

    Raises:
        PluginError: shapes differ, time does not increase, or an available score is NaN.
    """

    time_ns: Times
    score: Floats
    available: Bools

    def __init__(self, time_ns: ArrayLike, score: ArrayLike, available: ArrayLike) -> None:
        times, scores, usable = (
            np.asarray(time_ns, np.int64),
            np.asarray(score, np.float64),
            np.asarray(available, bool),
        )
        if times.ndim != 1 or not times.shape == scores.shape == usable.shape:
            raise PluginError(
                f"decisions must be three arrays of one shape (n,), not {times.shape}, "
                f"{scores.shape}, {usable.shape}"
            )
        if np.any(times[1:] <= times[:-1]):
            raise PluginError(
                f"decision times must increase; row {int(np.argmax(times[1:] <= times[:-1])) + 1} "
                "does not"
            )
        if np.any(np.isnan(scores) & usable):
            raise PluginError(
                f"the score of row {int(np.argmax(np.isnan(scores) & usable))} is NaN though it "
                "is available"
            )
        object.__setattr__(self, "time_ns", frozen(times))
        object.__setattr__(self, "score", frozen(np.where(usable, scores, np.nan)))
        object.__setattr__(self, "available", frozen(usable))

    @property
    def alert(self) -> Bools:
        """Where it alerts: available and score above 1, bool ``(n,)``."""
        return self.available & (self.score > 1)


@runtime_checkable
class Detector(Protocol):
    """A spoofing detector; it refuses invalid parameters by ``ValueError``.

    Attributes:
        requires: kinds without which it cannot run.
        uses: kinds that it reads where they are there.
        memory_s: how long, in seconds, an alert may outlast its cause.
    """

    @property
    def requires(self) -> tuple[str, ...]: ...
    @property
    def uses(self) -> tuple[str, ...]: ...
    @property
    def memory_s(self) -> float: ...

    def detect(self, recording: Recording) -> Decisions:
        """Return decisions on a blind recording, each from rows at or before its time alone."""
        ...


@runtime_checkable
class Baseline(Detector, Protocol):
    """A detector that others must beat, such as chance or the receiver's own word.

    Attributes:
        baseline: whether it is one; leaderboards mark it.
    """

    @property
    def baseline(self) -> bool: ...


_INPUTS = {
    "gnss/pvt": "gnss",
    "gnss/timemark": "gnss",
    "gnss/signal": "signal",
    "gnss/rf": "signal",
    "gnss/clock": "clock",
    "gnss/observation": "observation",
    "gnss/navdata": "observation",
    "gnss/integrity": "receiver",
    "ins/pva": "ins",
}
"""What a kind is an input of; others are inputs of their own."""


def inputs_of(kinds: Iterable[str]) -> tuple[str, ...]:
    """Return what these kinds are inputs of, ``gnss`` first, each once."""
    named = {_INPUTS.get(kind, kind) for kind in kinds}
    order = list(dict.fromkeys(_INPUTS.values()))
    return tuple(
        sorted(
            named,
            key=lambda name: (name not in order, order.index(name) if name in order else 0, name),
        )
    )


def input_class(kinds: Iterable[str]) -> str:
    """Return the class of a detector that looks at these kinds, such as ``gnss+imu``: within it
    detectors are ranked.
    """
    return "+".join(inputs_of(kinds))


def is_baseline(detector: Detector) -> bool:
    """Return whether a detector says that it is a :class:`Baseline`."""
    return isinstance(detector, Baseline) and bool(detector.baseline)


@runtime_checkable
class WarmsUp(Detector, Protocol):
    """A detector that needs some input before its first decision.

    Attributes:
        warm_up_s: seconds of input, of a vehicle that drives, after which it decides.
    """

    @property
    def warm_up_s(self) -> float: ...


def warm_up_s(detector: Detector) -> float:
    """Return the seconds of input before a detector's first decision: 0 where it does not say.

    Raises:
        PluginError: it declares something else than a finite number of at least 0.
    """
    if not isinstance(detector, WarmsUp):
        return 0.0
    declared: object = detector.warm_up_s
    if not (isinstance(declared, int | float) and 0 <= declared < np.inf):
        raise PluginError(
            f"warm_up_s must be a finite number of at least 0, in seconds, not {declared!r}"
        )
    return float(declared)


@dataclass(frozen=True, slots=True)
class Labelled:
    """An attacked recording of the calibration split.

    Attributes:
        recording: blind.
        attacked: the intervals in which it is attacked.
    """

    recording: Recording
    attacked: tuple[Interval, ...]


@runtime_checkable
class Trainable(Detector, Protocol):
    """A detector that learns from the calibration split: lag, mounting, noise, or a model.

    Chance comes from a field ``seed``. What was learned is a field, too, and pickles.
    """

    def fit(self, clean: Sequence[Recording], attacked: Sequence[Labelled]) -> Self:
        """Return the same frozen dataclass with fields replaced; this one stays as it is.

        Fitting twice gives detectors of one pickle.

        Args:
            clean: blind recordings with the kinds that the detector declares, cut to the part that
                calibrates.
            attacked: the same with an attack; empty, unless :class:`LearnsFromAttacks`.

        Raises:
            NotApplicable: it cannot be fitted on these recordings; the text says why.
        """
        ...


@runtime_checkable
class LearnsFromAttacks(Trainable, Protocol):
    """A trainable detector that is shown attacked recordings, too; leaderboards mark it.

    Attributes:
        learns_from_attacks: whether it is.
    """

    @property
    def learns_from_attacks(self) -> bool: ...


def learns_from_attacks(detector: Detector) -> bool:
    """Return whether a detector asks for attacked recordings to learn from."""
    return isinstance(detector, LearnsFromAttacks) and bool(detector.learns_from_attacks)


def detect(
    detector: Detector, recording: Recording, withheld: frozenset[str] = frozenset()
) -> Decisions:
    """Run a detector on the kinds that it declares of the blind part of a recording.

    Args:
        detector: what decides.
        recording: blind or not.
        withheld: kinds that it uses, but is to do without. A variant lacks the kinds that its
            attack does not model; a detector that saw them in the clean recording alone would know
            the variant by that.

    Raises:
        RecordingError: the recording lacks a kind that the detector requires.
        PluginError: the detector returned something else than decisions.
    """
    blind = recording.blind()
    missing = [kind for kind in detector.requires if kind not in blind.kinds]
    if missing:
        raise RecordingError(f"the detector requires {missing[0]!r}, which the recording lacks")
    decisions = detector.detect(seen(blind, declared(detector) - withheld))
    if not isinstance(decisions, Decisions):
        raise PluginError(f"a detector must return Decisions, not {type(decisions).__name__}")
    return decisions


def declared(detector: Detector) -> frozenset[str]:
    """Return the kinds that a detector requires or uses."""
    return frozenset({*detector.requires, *detector.uses})


def seen(blind: Recording, kinds: Set[str]) -> Recording:
    """Return the tables of these kinds, and what the metadata say of them and their sources."""
    topics = [topic for topic in blind if split_topic(topic)[1] in kinds]
    present = {split_topic(topic)[1] for topic in topics}
    sources = {f"source/{split_topic(topic)[0]}" for topic in topics}
    metadata = {
        name: record
        for name, record in blind.metadata.items()
        if name in sources or not name.startswith("source/")
    }
    primary = {
        kind: source
        for kind, source in blind.metadata.get("primary", {}).items()
        if kind in present
    }
    return Recording(
        {topic: partial(blind.__getitem__, topic) for topic in topics},
        {**metadata, "primary": primary},
    )


Event = tuple[str, Table]
"""What a stepwise detector gets: the topic, and a table of one row."""


def stepwise(
    recording: Recording,
    clock: str,
    others: Sequence[str],
    score_events: Callable[[Iterator[Event]], Iterator[float | None]],
) -> Decisions:
    """Let a generator decide at each row of the primary ``clock`` kind: causal by construction.

    Args:
        recording: blind recording.
        clock: kind whose primary rows ask for a decision, such as ``gnss/pvt``.
        others: further kinds whose primary rows the generator gets; rows of all kinds come in the
            order of time, at equal times the clock's last.
        score_events: a generator that takes the events and yields, for each clock row before it
            takes the next event, a score or None (unavailable).

    Raises:
        RecordingError: the recording lacks the clock.
        PluginError: the generator does not yield a score for each clock row, or only after it has
            taken further events.
    """
    clock_topic = recording.topics(clock)[0] if recording.topics(clock) else None
    if clock_topic is None:
        raise RecordingError(f"the recording has no {clock!r}")
    topics = [recording.topics(kind)[0] for kind in others if recording.topics(kind)] + [
        clock_topic
    ]
    times = np.concatenate([recording[topic].time_ns for topic in topics])
    owner = np.repeat(np.arange(len(topics)), [len(recording[topic]) for topic in topics])
    row = np.concatenate([np.arange(len(recording[topic])) for topic in topics])
    order = np.lexsort((row, owner, times))

    taken = 0

    def events() -> Iterator[Event]:
        nonlocal taken
        for index in order.tolist():
            taken += 1
            topic = topics[owner[index]]
            yield topic, recording[topic].take(slice(int(row[index]), int(row[index]) + 1))

    clock_times = recording[clock_topic].time_ns
    due = (np.flatnonzero(owner[order] == len(topics) - 1) + 1).tolist()
    scores: list[float | None] = []
    for score_of_row in score_events(events()):
        if len(scores) < len(due) and taken > due[len(scores)]:
            raise PluginError(
                f"a stepwise detector took further events before its score for row {len(scores)} "
                f"of {clock!r}"
            )
        scores.append(score_of_row)
    if len(scores) != clock_times.size:
        raise PluginError(
            f"a stepwise detector yielded {len(scores)} scores for {clock_times.size} rows of "
            f"{clock!r}"
        )
    score = np.array([np.nan if value is None else value for value in scores], float)
    last = np.searchsorted(clock_times, np.unique(clock_times), "right") - 1  # row of each time
    return Decisions(clock_times[last], score[last], ~np.isnan(score[last]))
