"""What the baselines promise: their rates, their repeatability, the receiver's word as it is."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from spoofbench_baselines import Always, Bursts, Never, Periodic, Random, ReceiverFlag

from spoofbench.detector import Detector, detect, is_baseline
from spoofbench.recording import Recording
from spoofbench.table import Column, Table
from spoofbench.testing import check_detector, drive

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND


def epochs(n: int, step_s: float = 1.0, start: int = START) -> Recording:
    time_ns = start + np.arange(n) * round(step_s * SECOND)
    return Recording({"/g/gnss/pvt": Table("gnss/pvt", time_ns, {})})


def starts(alert: np.ndarray) -> int:
    return int(np.count_nonzero(alert & ~np.append(False, alert[:-1])))


@check_detector("never")
def test_never_keeps_the_contract(check: Callable[[], None]) -> None:
    check()


@check_detector("always")
def test_always_keeps_the_contract(check: Callable[[], None]) -> None:
    check()


@check_detector("periodic", rate_per_hour=60)
def test_periodic_keeps_the_contract(check: Callable[[], None]) -> None:
    check()


@check_detector("random", rate_per_hour=60)
def test_random_keeps_the_contract(check: Callable[[], None]) -> None:
    check()


@check_detector("bursts", rate_per_hour=30)
def test_bursts_keeps_the_contract(check: Callable[[], None]) -> None:
    check()


@check_detector("receiver-flag")
def test_receiver_flag_keeps_the_contract(check: Callable[[], None]) -> None:
    check()


@pytest.mark.parametrize(
    "detector", [Never(), Always(), Periodic(), Random(), Bursts(), ReceiverFlag()]
)
def test_they_say_that_they_are_baselines(detector: Detector) -> None:
    assert is_baseline(detector)


@given(st.floats(1e-3, 1e3))
def test_no_scaling_makes_never_alert_or_always_stop(scale: float) -> None:
    recording = epochs(5)
    assert not (detect(Never(), recording).score * scale > 1).any()
    assert (detect(Always(), recording).score * scale > 1).all()


@given(st.integers(1, 100), st.integers(2, 30), st.sampled_from([0.1, 1.0, 5.0]))
def test_periodic_alerts_for_its_length_in_every_period(
    rate: int, alert_s: int, step_s: float
) -> None:
    hours = 2
    detector = Periodic(rate, alert_s)
    alert = detect(detector, epochs(round(hours * 3600 / step_s), step_s)).alert
    assert starts(alert) == pytest.approx(hours * rate, abs=1) or alert_s < step_s
    assert alert.mean() == pytest.approx(
        rate * alert_s / 3600, abs=hours * rate * step_s / (hours * 3600) + 1e-9
    )
    assert not alert[: math.floor((3600 / rate - alert_s) / step_s)].any()


def test_random_alarms_come_at_their_rate_as_a_poisson_process() -> None:
    days, rate = 60, 6.0
    onsets = [
        np.count_nonzero(
            detect(
                Random(rate, alert_s=1, seed=seed), epochs(3600 * 24, start=START + seed * 10**15)
            ).alert
        )
        for seed in range(days)
    ]
    expected = 24 * rate
    assert np.mean(onsets) == pytest.approx(expected, abs=5 * math.sqrt(expected / days))
    assert np.var(onsets) == pytest.approx(expected, rel=5 * math.sqrt(2 / days))


def test_random_alarms_crowd_as_those_of_a_poisson_process_do() -> None:
    """At nearly one per second, exp(-1) of the seconds see none."""
    alert = detect(Random(3599.0, alert_s=1), epochs(100_000)).alert
    assert 1 - alert.mean() == pytest.approx(math.exp(-1), abs=0.01)


def test_a_random_alarm_lasts_its_length() -> None:
    alert = detect(Random(2.0, alert_s=20), epochs(3600 * 24 * 5)).alert
    lengths = np.diff(np.flatnonzero(np.diff(np.concatenate(([0], alert, [0])))))[::2]
    assert lengths.min() >= 20 or alert[0] or alert[-1]
    assert np.median(lengths) == 20


def test_a_burst_is_many_alerts_and_one_episode() -> None:
    """Its alarms are less than 10 s apart, and all of them within 60 s."""
    alert = detect(Bursts(1.0), epochs(3600 * 24)).alert
    edges = np.flatnonzero(alert & ~np.append(False, alert[:-1]))
    first = np.append(True, np.diff(edges) >= 10)
    bursts = np.split(edges, np.flatnonzero(first)[1:])
    whole = [burst for burst in bursts if burst.size == 10]
    assert len(whole) >= 0.8 * len(bursts)
    assert all(np.diff(burst).max() == 6 and burst[-1] - burst[0] == 54 for burst in whole)
    assert len(bursts) == pytest.approx(24, abs=5 * math.sqrt(24))
    assert alert.sum() == edges.size


def test_bursts_come_at_their_rate() -> None:
    rate, days = 2.0, 60
    counts = [
        starts(detect(Bursts(rate, seed=seed), epochs(3600 * 24)).alert) / 10
        for seed in range(days)
    ]
    assert np.mean(counts) == pytest.approx(24 * rate, abs=5 * math.sqrt(24 * rate / days))


@given(
    st.sampled_from([Random, Bursts]),
    st.floats(0.5, 20),
    st.floats(0.01, 100),
    st.integers(-(2**70), 2**70),
)
def test_scaling_a_random_score_is_scaling_the_rate(
    kind: type[Random] | type[Bursts], rate: float, factor: float, seed: int
) -> None:
    if not 0 < rate * factor * 60 < 3600:
        return
    recording = epochs(500)
    scaled, other = (
        detect(kind(rate, seed=seed), recording).score * factor,
        detect(kind(rate * factor, seed=seed), recording).score,
    )
    np.testing.assert_allclose(scaled, other, rtol=1e-12)


@given(st.integers(0, 400), st.integers(0, 10**9 - 1))
def test_random_knows_the_clock_alone(kept: int, offset: int) -> None:
    """Other epochs in the same seconds, fewer of them, or more: each second keeps its score."""
    whole = detect(Random(20.0, seed=3), epochs(400))
    fewer = detect(
        Random(20.0, seed=3), epochs(400, start=START + offset).until(START + kept * SECOND)
    )
    np.testing.assert_array_equal(fewer.score, whole.score[: fewer.score.size])


def test_seeds_give_different_alarms() -> None:
    a, b = (detect(Random(30.0, seed=seed), epochs(20_000)).alert for seed in (1, 2))
    assert abs(np.corrcoef(a, b)[0, 1]) < 0.1


def test_the_hash_is_the_same_on_every_machine() -> None:
    """First outputs of splitmix64 from the states 0 and 1234567, as its authors' reference code
    prints them.
    """
    from spoofbench_baselines.detectors import _mixed

    assert _mixed(np.array([0, 1234567], np.uint64)).tolist() == [
        0xE220A8397B1DCDAF,
        6457827717110365317,
    ]


def test_the_receivers_word_is_taken_as_it_is() -> None:
    spoofing = Column(np.array([0, 1, 2, 3, 2, 1]), np.array([True, True, True, True, True, False]))
    time_ns = np.array([0, 1, 2, 3, 4, 5]) * SECOND
    recording = Recording(
        {"/g/gnss/integrity": Table("gnss/integrity", time_ns, {"spoofing": spoofing})}
    )
    decisions = detect(ReceiverFlag(), recording)
    assert decisions.time_ns.tolist() == time_ns.tolist()
    assert decisions.available.tolist() == [False, True, True, True, True, False]
    assert decisions.alert.tolist() == [False, False, True, True, True, False]


def test_of_two_words_at_one_time_the_last_counts() -> None:
    table = Table("gnss/integrity", np.array([0, 0, 1]), {"spoofing": [2, 1, 2]})
    assert detect(ReceiverFlag(), Recording({"/g/gnss/integrity": table})).alert.tolist() == [
        False,
        True,
    ]


def test_a_receiver_that_says_nothing_of_spoofing_is_unavailable() -> None:
    recording = drive(0, 60.0)
    table = recording["/gnss0/gnss/integrity"]
    silent = recording.replace({"/gnss0/gnss/integrity": table.replace(spoofing=None)})
    assert detect(ReceiverFlag(), recording).available.all()
    assert not detect(ReceiverFlag(), silent).available.any()


@pytest.mark.parametrize("detector", [Periodic, Random])
@pytest.mark.parametrize(
    "parameters",
    [
        {"rate_per_hour": 0.0},
        {"rate_per_hour": 120.0, "alert_s": 30.0},
        {"alert_s": 0.5},
        {"rate_per_hour": math.nan},
    ],
    ids=str,
)
def test_refuses_alarms_that_make_no_sense(detector: Any, parameters: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="must be"):
        detector(**parameters)


@pytest.mark.parametrize(
    "parameters",
    [
        {"rate_per_hour": 0.0},
        {"rate_per_hour": 60.0},
        {"alert_s": 0.5},
        {"alert_s": 6.0},
        {"every_s": 61.0},
        {"burst_s": math.nan},
    ],
    ids=str,
)
def test_refuses_bursts_that_make_no_sense(parameters: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="must be"):
        Bursts(**parameters)
