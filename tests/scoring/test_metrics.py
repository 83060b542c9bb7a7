"""Measures: laws that they obey, and agreement with loops that spell the definitions out."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from spoofbench.arrays import Bools, Times
from spoofbench.recording import Interval
from spoofbench.scoring import metrics

S = 1_000_000_000
NONE = np.empty(0, np.int64)


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


def episodes_by_loop(run: Run, step_s: int = 1) -> int:
    """Walk the epochs, ``step_s`` apart, with a watch in hand."""
    first, last, count = 0.0, -np.inf, 0
    for row, (on, usable) in enumerate(zip(run.alert, run.available, strict=True)):
        now = row * step_s
        if not (on and usable):
            continue
        if now - last >= max(10, 1.5 * step_s):
            first, count = now, count + 1
        else:
            count += int((now - first) // 60 - (last - first) // 60)
        last = now
    return count


@given(runs(), st.sampled_from([1, 3, 9, 10, 30, 90]))
def test_episodes_agree_with_a_loop(run: Run, step_s: int) -> None:
    assert metrics.count_episodes(
        step_s * run.time_ns, run.alert, run.available, step_s * S
    ) == episodes_by_loop(run, step_s)


@given(st.integers(1, 200), st.integers(1, 100))
def test_an_alarm_that_never_stops_counts_its_minutes_at_any_rate(epochs: int, step_s: int) -> None:
    always = np.ones(epochs, bool)
    counted = metrics.count_episodes(np.arange(epochs) * step_s * S, always, always, step_s * S)
    assert counted == 1 + (epochs - 1) * step_s // 60


@given(runs(), st.data())
def test_a_further_false_episode_never_improves(run: Run, data: st.DataObject) -> None:
    """One at least 10 s from any other; a nearer one may join two."""
    alert = run.alert & run.available
    far = np.array([not alert[max(0, row - 9) : row + 10].any() for row in range(alert.size)])
    rows = np.flatnonzero(far & run.available)
    assume(rows.size)
    more = alert.copy()
    more[data.draw(st.sampled_from(rows.tolist()))] = True
    before, after = (
        metrics.false_alerts(run.time_ns, flags, run.available, S) for flags in (alert, more)
    )
    assert after.episodes == before.episodes + 1
    assert after.hours == before.hours
    assert before.per_hour is not None
    assert after.per_hour is not None
    assert after.per_hour > before.per_hour


@pytest.mark.parametrize(
    ("alerts", "unavailable", "episodes"),
    [
        ([5, 14], [], 1),
        ([5, 15], [], 2),
        (range(60), [], 1),
        (range(61), [], 2),
        ([5, 14], range(6, 14), 1),
        ([5, 15], range(6, 15), 2),
        ([5, 30], range(6, 30), 2),
        (range(0, 180, 9), sorted({*range(180)} - {*range(0, 180, 9)}), 3),
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


def alarm_by_loop(run: Run, hold: int) -> Bools:
    """Whether an alarm is on in each second: raised by an alert, ended by anything else or when
    the last alert is older than the hold. Decisions come where ``alert`` was drawn, see below.
    """
    on, last, state = np.zeros(run.alert.size + 400, bool), -1, False
    decided = dict(zip((run.time_ns // S).tolist(), run.alert & run.available, strict=False))
    for second in range(on.size):
        if second in decided:
            state, last = bool(decided[second]), second
        on[second] = state and second < last + hold
    return on


@given(runs(), attacks(), st.sampled_from([1, 2, 4, 100]), st.data())
def test_events_agree_with_a_loop(
    run: Run, intervals: list[Interval], hold: int, data: st.DataObject
) -> None:
    kept = np.array(
        data.draw(st.lists(st.booleans(), min_size=run.alert.size, max_size=run.alert.size))
    )
    run = Run(*(values[kept] for values in run))
    alert, end = run.alert & run.available, int(kept.size)
    found = metrics.find_events(
        run.time_ns, alert, intervals, hold_s=hold, end_ns=end * S, unreviewed_ns=NONE
    )
    assert len(found) == len(intervals)
    alarm = alarm_by_loop(run, hold)
    for number, (interval, event) in enumerate(zip(intervals, found, strict=True)):
        on, before, detection = False, False, None
        for time, alerts in zip(run.time_ns.tolist(), alert.tolist(), strict=True):
            if time < interval.start_ns:
                before = alerts
            elif time < interval.end_ns and alerts and not on and detection is None:
                detection = time
            on = alerts
        assert event.interval == interval
        assert event.alert_before == before
        assert event.detection_ns == detection
        assert event.ttfd_s is None or 0 <= event.ttfd_s < interval.duration_s
        assert event.detected == (event.ttfd_s is not None)
        if detection is None:
            assert event.persisted_s is None
        else:
            stays = alarm[detection // S : interval.end_ns // S]
            assert event.persisted_s == (stays.size if stays.all() else np.argmin(stays))
        release = interval.end_ns // S
        following = intervals[number + 1 : number + 2]
        stop = min([end, *(other.start_ns // S for other in following)])
        stays = alarm[release:]
        was_on = release > 0 and alarm[release - 1] and state_before(run, release, hold)
        length = int(np.argmin(stays)) if was_on else 0
        censored = length > 0 and release + length >= stop
        assert event.retrust_censored == censored
        assert event.retrust_s == (None if censored else length)


def state_before(run: Run, release: int, hold: int) -> bool:
    """Whether the alarm of the decisions before the release still stands at it."""
    alert = run.alert & run.available
    earlier = np.flatnonzero(run.time_ns < release * S)
    if not (earlier.size and alert[earlier[-1]]):
        return False
    last = int(run.time_ns[earlier[-1]]) // S
    return release < last + hold or (release == last + hold and release * S in run.time_ns)


@given(runs(), attacks(), st.data())
def test_detecting_earlier_never_worsens(
    run: Run, intervals: list[Interval], data: st.DataObject
) -> None:
    """A rising edge more, in an attack and before its detection: sooner, and with less error.

    An alert that only goes on with one from before the attack is none: it says nothing new.
    """
    assume(intervals)
    alert = run.alert & run.available
    number = data.draw(st.integers(0, len(intervals) - 1))
    (before,) = events_of(run.time_ns, alert, [intervals[number]])
    until_ns = before.interval.end_ns if before.detection_ns is None else before.detection_ns
    sooner = (run.time_ns >= before.interval.start_ns) & (run.time_ns < until_ns)
    rows = np.flatnonzero(sooner & ~alert & ~np.append(False, alert[:-1]))
    assume(rows.size)
    more = alert.copy()
    more[data.draw(st.sampled_from(rows.tolist()))] = True
    (after,) = events_of(run.time_ns, more, [intervals[number]])
    assert after.detection_ns is not None
    assert after.detection_ns < until_ns
    error_m = np.random.default_rng(0).random(alert.size)
    worse, better = (
        metrics.harm(event, run.time_ns, error_m, flags, alert_limit_m=0.9, time_to_alert_s=6)
        for event, flags in ((before, alert), (after, more))
    )
    assert better.largest_error_before_alert_m is not None
    assert worse.largest_error_before_alert_m is not None
    assert better.largest_error_before_alert_m <= worse.largest_error_before_alert_m
    assert better.alerted_share is not None
    assert worse.alerted_share is not None
    assert better.alerted_share > worse.alerted_share
    assert better.hazard_ns == worse.hazard_ns
    assert bool(better.warned) >= bool(worse.warned)


def events_of(time_ns: Times, alert: Bools, intervals: list[Interval]) -> list[metrics.Event]:
    return metrics.find_events(
        time_ns, alert, intervals, hold_s=1.1, end_ns=time_ns.size * S, unreviewed_ns=NONE
    )


def test_time_to_detection_uses_the_times_of_the_decisions() -> None:
    times = np.array([0, 900_000_000, 2_250_000_000], np.int64)
    (event,) = events_of(times, np.array([False, False, True]), [Interval(S, 3 * S)])
    assert event.ttfd_s == 1.25
    assert event.persisted_s == 0.75


def test_what_comes_after_the_release_may_hide_the_end_of_the_alarm() -> None:
    alert = np.zeros(100, bool)
    alert[15:40] = True
    attack, times = Interval(10 * S, 20 * S), np.arange(100) * S

    def retrust(*others: Interval, end: int = 100, unreviewed: Sequence[int] = ()) -> object:
        event = metrics.find_events(
            times,
            alert,
            [attack, *others],
            hold_s=1.1,
            end_ns=end * S,
            unreviewed_ns=np.array(unreviewed, np.int64) * S,
        )[0]
        assert event.retrust_censored == (event.retrust_s is None)
        return event.retrust_s

    assert retrust() == 20
    assert retrust(unreviewed=[*range(20), 41, 42]) == 20
    assert retrust(unreviewed=[39, 40]) is None
    assert retrust(unreviewed=range(22)) is None
    assert retrust(Interval(30 * S, 31 * S)) is None
    assert retrust(Interval(15 * S, 21 * S)) is None
    assert retrust(end=40) is None
    alert[19] = False
    assert retrust(Interval(20 * S, 31 * S)) == 0


def test_what_an_attack_did() -> None:
    """Error of 10 m per epoch from 2 s on, alerts at 4 s and at 7 s; the limit is 25 m."""
    time_ns, attack = np.arange(10) * S, Interval(2 * S, 8 * S)
    error_m = np.array([0, 0, 10, 20, np.nan, 40, 50, 60, 900, 0])
    alert = np.isin(np.arange(10), [4, 7])

    def done(at: float | None, wait_s: float, limit_m: float = 25.0) -> metrics.Harm:
        at_ns = None if at is None else round(at * S)
        event = metrics.Event(attack, False, at_ns, None, 0.0, False)
        return metrics.harm(
            event, time_ns, error_m, alert, alert_limit_m=limit_m, time_to_alert_s=wait_s
        )

    assert done(4, 0) == metrics.Harm(2 / 6, None, 20.0, 50.0, 5 * S, True, True)
    assert done(None, 9) == metrics.Harm(2 / 6, None, 60.0, 50.0, 5 * S, True, False)
    assert done(7.5, 2.5).warned is True
    assert done(7.5, 2.4).warned is False
    assert (done(7.5, 0).error_at_detection_m, done(7.5, 0).largest_error_before_alert_m) == (
        60,
        60,
    )
    assert (done(None, 0, 60).hazardous, done(None, 0, 60).warned) == (False, None)
    error_m[2:8] = np.nan
    assert done(None, 0) == metrics.Harm(2 / 6, None, None, None, None, None, None)


def test_a_detection_before_the_first_epoch_of_the_attack_has_the_error_until_then() -> None:
    event = metrics.Event(Interval(S // 2, 9 * S), False, 3 * S // 4, None, 0.0, False)
    done = metrics.harm(
        event,
        np.arange(9) * S,
        np.arange(9.0),
        np.zeros(9, bool),
        alert_limit_m=1.0,
        time_to_alert_s=0.0,
    )
    assert (done.error_at_detection_m, done.largest_error_before_alert_m) == (0, 0)


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
    alert[[99, 200]] = True
    assert metrics.count_episodes(time_ns, alert, counted, S) == 2


@given(
    st.lists(
        st.tuples(st.integers(0, 50), st.floats(-3, 3) | st.sampled_from([np.nan, np.inf])),
        max_size=20,
        unique_by=lambda row: row[0],
    ),
    st.lists(st.floats(-3, 3) | st.just(np.nan), min_size=4, max_size=4),
    st.sampled_from([0.0, 0.5, 1.0]),
)
def test_an_epoch_has_a_false_alert_where_it_or_a_decision_since_the_one_before_has(
    decisions: list[tuple[int, float]], held: list[float], factor: float
) -> None:
    decisions.sort()
    at = np.array([time for time, _ in decisions], np.int64)
    decided = np.array([score for _, score in decisions], np.float64)
    epochs, score = np.array([5, 15, 16, 40]), np.array(held)
    level = metrics.alarm_level(epochs, score, at, decided)
    for row, (before, now) in enumerate(zip([5, 5, 15, 16], epochs, strict=True)):
        mine = [score[row], *(s for t, s in decisions if before < t <= now)]
        assert (level[row] > factor) == any(some > factor for some in mine)
        assert np.isnan(level[row]) == np.isnan(mine).all()
    assert score.tolist() == pytest.approx(held, nan_ok=True)
