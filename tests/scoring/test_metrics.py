"""Measures: laws that they obey, and agreement with loops that spell the definitions out."""

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spoofbench.arrays import Bools, Times
from spoofbench.recording import Interval
from spoofbench.scoring import metrics

S = 1_000_000_000


class Run(NamedTuple):
    time_ns: Times
    alert: Bools
    available: Bools


@st.composite
def runs(draw: st.DrawFn, most: int = 8) -> Run:
    """Stretches of alert, silence and unavailability at 1 Hz, from one epoch to beyond a minute
    long.
    """
    pieces = draw(
        st.lists(
            st.tuples(st.integers(1, 70) | st.integers(1, 12), st.booleans(), st.booleans()),
            min_size=1,
            max_size=most,
        )
    )
    alert = np.array([on for length, on, _ in pieces for _ in range(length)])
    available = np.array([usable for length, _, usable in pieces for _ in range(length)])
    return Run(np.arange(alert.size) * S, alert, available)


@st.composite
def attacks(draw: st.DrawFn, end: int = 300) -> list[Interval]:
    bounds = sorted(draw(st.lists(st.integers(0, end), max_size=6, unique=True)))
    return [Interval(a * S, b * S) for a, b in zip(bounds[::2], bounds[1::2], strict=False)]


def episodes_by_loop(run: Run) -> int:
    """Walk the epochs with a clock that ticks at available ones only."""
    clock, first, last, count = 0, None, None, 0
    for on, usable in zip(run.alert, run.available, strict=True):
        if not usable:
            continue
        clock += 1
        if not on:
            continue
        if first is None or last is None or clock - last >= 10:
            first, count = clock, count + 1
        elif (clock - first) // 60 > (last - first) // 60:
            count += 1
        last = clock
    return count


@given(runs())
def test_episodes_agree_with_a_loop(run: Run) -> None:
    assert metrics.count_episodes(run.time_ns, run.alert, run.available, S) == episodes_by_loop(run)


@pytest.mark.parametrize(
    ("alerts", "unavailable", "episodes"),
    [
        ([5, 14], [], 1),
        ([5, 15], [], 2),
        (range(60), [], 1),
        (range(61), [], 2),
        ([5, 30], range(6, 30), 1),
        ([5, 30], range(6, 21), 2),
        ([5, 100], range(6, 100), 1),
        ([], [], 0),
    ],
)
def test_where_episodes_begin_and_count_again(
    alerts: list[int], unavailable: list[int], episodes: int
) -> None:
    alert, available = np.zeros(200, bool), np.ones(200, bool)
    alert[list(alerts)], available[list(unavailable)] = True, False
    assert metrics.count_episodes(np.arange(200) * S, alert, available, S) == episodes


@given(runs(), st.integers(1, 4))
def test_copies_have_as_many_times_the_episodes_at_the_same_rate(run: Run, copies: int) -> None:
    quiet = np.zeros(10, bool)
    alert, available = (
        np.tile(np.append(flags, ends), copies)
        for flags, ends in ((run.alert, quiet), (run.available, ~quiet))
    )
    one = metrics.false_alerts(
        np.arange(run.alert.size + 10) * S,
        *(flags[: run.alert.size + 10] for flags in (alert, available)),
        S,
    )
    many = metrics.false_alerts(np.arange(alert.size) * S, alert, available, S)
    assert many.episodes == copies * one.episodes
    assert many.hours == pytest.approx(copies * one.hours)
    assert many.per_hour == pytest.approx(one.per_hour)
    assert many.epoch == pytest.approx(one.epoch)
    assert many.per_hour_hi is not None
    assert one.per_hour_hi is not None
    assert many.per_hour_hi <= one.per_hour_hi * (1 + 1e-12)


@given(runs())
def test_a_rate_lies_within_its_interval_and_says_what_it_can_resolve(run: Run) -> None:
    false = metrics.false_alerts(run.time_ns, run.alert, run.available, S)
    if false.per_hour is None:
        assert not run.available.any()
        assert (
            false.per_hour_lo,
            false.per_hour_hi,
            false.floor_per_hour,
            false.epoch,
            false.episodes,
        ) == (None, None, None, None, 0)
        return
    assert false.per_hour_lo is not None
    assert false.per_hour_hi is not None
    assert false.per_hour_lo <= false.per_hour <= false.per_hour_hi
    assert false.floor_per_hour == pytest.approx(3 / false.hours)


@given(runs(), attacks(), st.data())
def test_one_more_alert_never_lowers_detection(
    run: Run, intervals: list[Interval], data: st.DataObject
) -> None:
    spoofed = np.zeros(run.alert.size, bool)
    for interval in intervals:
        spoofed |= interval.covers(run.time_ns)
    more = run.alert.copy()
    more[data.draw(st.integers(0, more.size - 1))] = True
    for before, after in zip(
        metrics.detection_pct(run.alert, run.available, spoofed),
        metrics.detection_pct(more, run.available, spoofed),
        strict=True,
    ):
        assert (before is None and after is None) or (
            before is not None and after is not None and after >= before
        )


@given(runs(), attacks())
def test_detection_counts_epochs(run: Run, intervals: list[Interval]) -> None:
    spoofed = [any(i.start_ns <= t < i.end_ns for i in intervals) for t in run.time_ns.tolist()]
    hits = sum(s and a and u for s, a, u in zip(spoofed, run.alert, run.available, strict=True))
    usable = sum(s and u for s, u in zip(spoofed, run.available, strict=True))
    over_all, over_available = metrics.detection_pct(run.alert, run.available, np.array(spoofed))
    assert over_all == (100 * hits / sum(spoofed) if any(spoofed) else None)
    assert over_available == (100 * hits / usable if usable else None)


@given(runs(), attacks())
def test_events_agree_with_a_loop(run: Run, intervals: list[Interval]) -> None:
    found = metrics.find_events(run.time_ns, run.alert, run.available, intervals)
    assert len(found) == len(intervals)
    for interval, event in zip(intervals, found, strict=True):
        on, before, detection = False, False, None
        for time, alert, usable in zip(run.time_ns.tolist(), run.alert, run.available, strict=True):
            if not usable:
                continue
            if time < interval.start_ns:
                before = alert
            elif time < interval.end_ns and alert and not on and detection is None:
                detection = time
            on = alert
        assert event == metrics.Event(interval, bool(before), detection)
        assert event.ttfd_s is None or 0 <= event.ttfd_s < interval.duration_s
        assert event.detected == (event.ttfd_s is not None)


def test_time_to_detection_uses_the_times_of_the_decisions() -> None:
    times = np.array([0, 900_000_000, 2_250_000_000], np.int64)
    (event,) = metrics.find_events(
        times, np.array([False, False, True]), np.ones(3, bool), [Interval(S, 3 * S)]
    )
    assert event.ttfd_s == 1.25


def test_position_errors() -> None:
    time_ns, error_m = np.arange(5) * S, np.array([0.0, 10.0, np.nan, 40.0, 20.0])
    assert metrics.error_at(time_ns, error_m, S + 999) == 10.0
    assert metrics.error_at(time_ns, error_m, 2 * S) is None
    assert metrics.error_at(time_ns, error_m, -1) is None
    assert metrics.largest_error(error_m, np.array([True, True, True, False, True])) == 20.0
    assert metrics.largest_error(error_m, np.array([False, False, True, False, False])) is None


@given(
    rates=st.lists(
        st.tuples(st.integers(1, 60), st.sampled_from([S // 10, S // 5, S])), min_size=1, max_size=6
    ),
    seed=st.integers(0, 99),
)
def test_hours_are_those_of_the_clock_at_any_rate(rates: list[tuple[int, int]], seed: int) -> None:
    time_ns = np.cumsum([step for seconds, step in rates for _ in range(seconds * S // step)])
    counted = np.random.default_rng(seed).random(time_ns.size) < 0.5
    spent_ns = sum(
        step
        for step, known in zip(np.diff(time_ns, prepend=time_ns[:1] - S), counted, strict=True)
        if known
    )
    false = metrics.false_alerts(time_ns, np.zeros(time_ns.size, bool), counted, S)
    assert false.hours == pytest.approx(spent_ns / 3.6e12)


def test_a_denser_stretch_without_detector_does_not_join_episodes() -> None:
    time_ns = np.concatenate(
        [np.arange(100) * S, 100 * S + np.arange(100) * S // 10, (110 + np.arange(100)) * S]
    )
    alert, counted = np.zeros(300, bool), np.ones(300, bool)
    counted[100:200] = False
    alert[[80, 210]] = True
    assert metrics.count_episodes(time_ns, alert, counted, S) == 2


@given(
    st.lists(
        st.tuples(st.integers(0, 50), st.booleans()), max_size=20, unique_by=lambda row: row[0]
    )
)
def test_what_was_raised_since_the_epoch_before(decisions: list[tuple[int, bool]]) -> None:
    decisions.sort()
    at, alert = (
        np.array([t for t, _ in decisions], np.int64),
        np.array([on for _, on in decisions], bool),
    )
    epochs = np.array([5, 15, 16, 40])
    expected = [
        any(on and before < t <= now for t, on in decisions)
        for before, now in zip([5, 5, 15, 16], epochs, strict=True)
    ]
    assert metrics.raised_since(epochs, at, alert).tolist() == expected
