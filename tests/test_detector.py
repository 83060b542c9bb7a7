"""Decisions, the blind run and the stepwise helper."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spoofbench.detector import (
    Decisions,
    Detector,
    Event,
    Labelled,
    Trainable,
    detect,
    is_baseline,
    learns_from_attacks,
    stepwise,
    warm_up_s,
)
from spoofbench.errors import PluginError, RecordingError
from spoofbench.recording import Recording
from spoofbench.table import Table
from spoofbench.testing import drive


@given(st.lists(st.tuples(st.floats(0, 3), st.booleans()), max_size=20))
def test_an_alert_is_available_and_above_one(rows: list[tuple[float, bool]]) -> None:
    scores, available = [score for score, _ in rows], [known for _, known in rows]
    decisions = Decisions(np.arange(len(rows)), scores, available)
    assert decisions.alert.tolist() == [known and score > 1 for score, known in rows]
    assert np.isnan(decisions.score).tolist() == [not known for known in available]


def test_decisions_are_frozen() -> None:
    decisions = Decisions([1, 2], [0.5, np.inf], [True, True])
    for array in (decisions.time_ns, decisions.score, decisions.available):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    with pytest.raises(AttributeError):
        decisions.score = np.zeros(2)  # type: ignore[misc]


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (([1, 2], [0.0], [True, True]), r"of one shape \(n,\)"),
        (([[1, 2]], [[0.0, 1.0]], [[True, True]]), r"of one shape \(n,\)"),
        (([1, 1], [0.0, 0.0], [True, True]), "row 1 does not"),
        (([1, 3, 2], [0.0, 0.0, 0.0], [True] * 3), "row 2 does not"),
        (([1, 2], [0.0, np.nan], [True, True]), "row 1 is NaN though it is available"),
    ],
)
def test_decisions_that_break_the_contract(arguments: Any, reason: str) -> None:
    with pytest.raises(PluginError, match=reason):
        Decisions(*arguments)


@dataclass(frozen=True)
class Watcher:
    """Keeps what it was shown."""

    answer: Any
    requires: ClassVar[tuple[str, ...]] = ("gnss/pvt", "imu")
    uses: ClassVar[tuple[str, ...]] = ()
    memory_s: ClassVar[float] = 0.0
    shown: ClassVar[list[Recording]] = []

    def detect(self, recording: Recording) -> Decisions:
        self.shown.append(recording)
        answer: Decisions = self.answer
        return answer


NOTHING = Decisions([], [], [])


def test_a_detector_sees_the_blind_recording_only() -> None:
    recording = drive(0, 60.0)
    assert {"reference/pva"} < recording.kinds
    detect(Watcher(NOTHING), recording)
    seen = Watcher.shown[-1]
    assert "reference/pva" not in seen.kinds
    assert "origin" in recording.metadata
    assert "origin" not in seen.metadata


def test_a_detector_cannot_see_which_kinds_a_variant_lacks() -> None:
    clean = drive(0, 60.0)
    declared = {*Watcher.requires, *Watcher.uses}
    lacking = clean.replace(
        {topic: None for kind in clean.kinds - declared for topic in clean.topics(kind)}
    )
    for recording in (clean, lacking):
        detect(Watcher(NOTHING), recording)
    whole, less = Watcher.shown[-2:]
    assert whole.kinds == less.kinds == declared
    assert whole.metadata == less.metadata
    assert set(whole.metadata["primary"]) == declared
    assert all(whole[topic] is clean[topic] for topic in whole)


def test_metadata_do_not_tell_of_a_source_that_is_gone() -> None:
    clean = drive(0, 60.0)
    second = clean.replace({"/gnss1/gnss/pvt": clean.primary("gnss/pvt")}).with_metadata(
        {"source/gnss1": {"solution": "gnss"}}
    )
    for recording, names in (
        (second, {"source/gnss1"}),
        (second.replace({"/gnss1/gnss/pvt": None}), set()),
    ):
        detect(Watcher(NOTHING), recording)
        assert {name for name in Watcher.shown[-1].metadata if name == "source/gnss1"} == names


def test_a_missing_kind_is_named() -> None:
    recording = drive(0, 60.0)
    with pytest.raises(RecordingError, match="requires 'imu', which the recording lacks"):
        detect(Watcher(NOTHING), recording.replace({"/imu0/imu": None}))


def test_something_else_than_decisions_is_blamed_on_the_plugin() -> None:
    with pytest.raises(PluginError, match="must return Decisions, not list"):
        detect(Watcher([1.0]), drive(0, 60.0))


def test_the_protocols_tell_detectors_from_trainable_ones() -> None:
    watcher = Watcher(NOTHING)
    assert isinstance(watcher, Detector)
    assert not isinstance(watcher, Trainable)
    assert not isinstance(object(), Detector)


def test_what_is_not_declared_is_no_warm_up_and_no_wish_for_attacks() -> None:
    @dataclass(frozen=True)
    class Warm(Watcher):
        warm_up_s: Any = 12

        def fit(self, clean: Sequence[Recording], attacked: Sequence[Labelled]) -> Self:
            return self

    @dataclass(frozen=True)
    class Learns(Warm):
        learns_from_attacks: bool = True

    assert [warm_up_s(one) for one in (Watcher(NOTHING), Warm(NOTHING))] == [0.0, 12.0]
    assert isinstance(Warm(NOTHING), Trainable)
    learners = [Watcher(NOTHING), Warm(NOTHING), Learns(NOTHING), Learns(NOTHING, 0, False)]
    assert [learns_from_attacks(one) for one in learners] == [False, False, True, False]


@pytest.mark.parametrize("declared", [-1.0, np.inf, np.nan, "long", None])
def test_a_warm_up_is_a_number_of_seconds(declared: Any) -> None:
    @dataclass(frozen=True)
    class Warm(Watcher):
        warm_up_s: Any = 12

    with pytest.raises(PluginError, match="warm_up_s must be a finite number"):
        warm_up_s(Warm(NOTHING, declared))


def test_a_baseline_says_so_itself() -> None:
    @dataclass(frozen=True)
    class Chance(Watcher):
        baseline: bool = True

    assert is_baseline(Chance(NOTHING))
    assert not is_baseline(Chance(NOTHING, baseline=False))
    assert not is_baseline(Watcher(NOTHING))


def recording_of(clock: list[int], other: list[int]) -> Recording:
    pvt = Table(
        "gnss/pvt", np.array(clock, np.int64), {"height_m": np.arange(len(clock), dtype=float)}
    )
    imu = Table(
        "imu", np.array(other, np.int64), {"accel_x_mps2": np.arange(len(other), dtype=float)}
    )
    return Recording({"/gnss0/gnss/pvt": pvt, "/imu0/imu": imu})


times = st.lists(st.integers(0, 20), max_size=15).map(sorted)


@given(times, times)
def test_stepwise_gives_the_events_in_the_order_of_time(clock: list[int], other: list[int]) -> None:
    seen: list[tuple[int, str, float]] = []

    def score_events(events: Iterator[Event]) -> Iterator[float | None]:
        for topic, row in events:
            assert len(row) == 1
            is_clock = topic == "/gnss0/gnss/pvt"
            value = float(row["height_m" if is_clock else "accel_x_mps2"][0])
            seen.append((int(row.time_ns[0]), topic, value))
            if is_clock:
                others = sum(topic == "/imu0/imu" for _, topic, _ in seen)
                yield float(others) if len(seen) % 3 else None

    decisions = stepwise(recording_of(clock, other), "gnss/pvt", ["imu"], score_events)
    expected = [(t, 1, "/gnss0/gnss/pvt", float(i)) for i, t in enumerate(clock)]
    expected += [(t, 0, "/imu0/imu", float(i)) for i, t in enumerate(other)]
    assert seen == [
        (t, topic, value)
        for t, _, topic, value in sorted(expected, key=lambda e: (e[0], e[1], e[3]))
    ]
    assert decisions.time_ns.tolist() == sorted(set(clock))
    for time_ns, score in zip(
        decisions.time_ns[decisions.available], decisions.score[decisions.available], strict=True
    ):
        assert score == sum(t <= time_ns for t in other)


@pytest.mark.parametrize("yielded", [0, 2])
def test_stepwise_wants_one_score_per_row(yielded: int) -> None:
    def score_events(events: Iterator[Event]) -> Iterator[float | None]:
        for _ in events:
            yield from [0.0] * yielded

    with pytest.raises(PluginError, match=f"yielded {3 * yielded} scores for 3 rows of 'gnss/pvt'"):
        stepwise(recording_of([1, 2, 3], []), "gnss/pvt", [], score_events)


@pytest.mark.parametrize("ahead", [1, 2])
def test_stepwise_refuses_a_look_ahead(ahead: int) -> None:
    def score_events(events: Iterator[Event]) -> Iterator[float | None]:
        for topic, _ in events:
            if topic == "/gnss0/gnss/pvt":
                for _ in range(ahead):
                    next(events, None)
                yield 0.0

    with pytest.raises(
        PluginError, match="took further events before its score for row 0 of 'gnss/pvt'"
    ):
        stepwise(
            recording_of([1, 10, 20], [2, 3, 4, 12, 13, 14]), "gnss/pvt", ["imu"], score_events
        )


def test_stepwise_needs_its_clock() -> None:
    with pytest.raises(RecordingError, match="has no 'gnss/clock'"):
        stepwise(
            recording_of([1], [1]), "gnss/clock", [], lambda events: iter([0.0 for _ in events])
        )
