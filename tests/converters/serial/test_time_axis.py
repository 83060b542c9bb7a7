"""The time axis: dates carried, clocks followed or not, whatever the log is cut into."""

import itertools
import random
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spoofbench_converters.serial import time_axis
from spoofbench_converters.serial.contract import ABSENT_NS, Epochs, SerialOptions
from spoofbench_converters.serial.time_axis import (
    BACKWARDS,
    HORIZON,
    NO_DATE,
    NO_TIME_YET,
    TIMED,
    TimeAxis,
)

from spoofbench.errors import ConversionError
from spoofbench.gnss_time import DAY_NS, WEEK_NS

S = 1_000_000_000
START = int(datetime(2024, 2, 29, 23, 59, 30, tzinfo=UTC).timestamp()) * S
GPS_EPOCH = int(datetime(1980, 1, 6, tzinfo=UTC).timestamp()) * S
ABSENT = None
Claim = tuple[int, int | None, int, int | None]
"""Protocol, claimed time, its period, receive time."""


def of_day(time: int) -> tuple[int, int]:
    return time % DAY_NS, DAY_NS


def of_week(time: int) -> tuple[int, int]:
    return GPS_EPOCH + (time - GPS_EPOCH) % WEEK_NS, WEEK_NS


def axis_of(
    claims: list[Claim], cuts: tuple[int, ...] = (), spacing: int = 100, **options: Any
) -> tuple[list[int], list[int], dict[str, str]]:
    """Return times, verdicts (both in the order of the claims) and metadata, of epochs that come in
    the given groups.
    """
    under_test = TimeAxis(SerialOptions(**options), ("UBX", "NMEA"))
    times: list[list[int]] = [[], []]
    verdicts: list[list[int]] = [[], []]
    borders = [0, *sorted(cut for cut in cuts if 0 < cut < len(claims)), len(claims)]
    for first, end in itertools.pairwise(borders):
        for protocol in (0, 1):
            mine = [
                (number * spacing, *claim[1:])
                for number, claim in enumerate(claims)
                if first <= number < end and claim[0] == protocol
            ]
            if mine:
                columns = [
                    np.array([ABSENT_NS if value is None else value for value in column])
                    for column in zip(*mine, strict=True)
                ]
                under_test.push(protocol, Epochs(*columns, np.zeros(len(mine), np.int64), ()))
        for protocol, (given_times, given_verdicts) in under_test.advance(
            end * spacing - HORIZON, last=end == len(claims)
        ).items():
            times[protocol] += given_times.tolist()
            verdicts[protocol] += given_verdicts.tolist()
    queues = [iter(zip(*each, strict=True)) for each in zip(times, verdicts, strict=True)]
    in_order = [next(queues[claim[0]]) for claim in claims]
    return [time for time, _ in in_order], [verdict for _, verdict in in_order], under_test.about()


def whole(*seconds: float | None) -> list[Claim]:
    """Epochs of one protocol with complete times, in seconds after the start."""
    return [(0, None if s is None else START + round(s * S), 0, None) for s in seconds]


def after_start(times: list[int]) -> list[float]:
    return [(time - START) / S for time in times]


@given(
    st.lists(st.integers(0, 3599), min_size=1, max_size=30),
    st.sampled_from([of_day, of_week]),
    st.integers(0, 29),
)
def test_dates_are_carried_forward(steps: list[int], shortened: Any, dated: int) -> None:
    """Across midnight of a leap day and the end of the week; epochs before the first date have
    none.
    """
    truth = list(itertools.accumulate(steps, lambda time, step: time + step * S, initial=START))
    dated = min(dated, len(truth) - 1)
    claims: list[Claim] = [
        (0, *((time, 0) if number == dated else shortened(time)), None)
        for number, time in enumerate(truth)
    ]
    times, verdicts, _ = axis_of(claims)
    assert times[dated:] == truth[dated:]
    assert verdicts == [NO_DATE] * dated + [TIMED] * (len(truth) - dated)
    assert axis_of(claims, date_backward=True)[0] == truth


def test_one_protocol_dates_the_other() -> None:
    claims: list[Claim] = [(0, *of_week(START), None), (1, START + S, 0, None)]
    claims += [(0, *of_week(START + n * S), None) for n in range(2, 100)]
    times, verdicts, _ = axis_of(claims)
    assert verdicts == [NO_DATE] + [TIMED] * 99
    assert after_start(times[1:]) == list(range(1, 100))


@pytest.mark.parametrize("shortened", [of_day, of_week])
def test_a_reference_date_dates_the_first_time(shortened: Any) -> None:
    claims: list[Claim] = [(0, *shortened(START + n * 10 * S), None) for n in range(10)]
    assert axis_of(claims)[1] == [NO_DATE] * 10
    times, _, about = axis_of(claims, date="2024-02-29")
    assert after_start(times) == [n * 10.0 for n in range(10)]
    assert about["reference_date"] == "2024-02-29"


def test_lost_periods_of_1024_weeks_are_added_when_asked() -> None:
    claims = [
        (protocol, time - 1024 * WEEK_NS if time else time, *rest)
        for protocol, time, *rest in whole(0, 1, 2)
    ]
    times, _, about = axis_of(claims, week_rollover=1)  # type: ignore[arg-type]
    assert (after_start(times), about["week_rollover"]) == ([0, 1, 2], "1")


@pytest.mark.parametrize(
    ("claimed", "expected", "steps"),
    [
        ((0, 1, 2, 3, 10, 11), (0, 1, 2, 3, 10, 11), 0),
        ((0, 0, 0, 10, 10, 10), (0, 0, 0, 10, 10, 10), 0),
        ((0, 1, 2, -500, 4, 5), (0, 1, 2, 3, 4, 5), 1),
        ((0, 1, 2, 9000, 4, 5), (0, 1, 2, 3, 4, 5), 1),
        ((0, 1, 2, 9000, 2.5, 3), (0, 1, 2, 2.5, 2.5, 3), 1),
        ((0, 1, 2, -500, -499, -498), (0, 1, 2, 3, 4, 5), 1),
        ((0, 1, 2, 9000, 9001, 9002), (0, 1, 2, 3, 4, 5), 1),
        ((0, 1, 2, None, 4, 5), (0, 1, 2, 3, 4, 5), 0),
        ((0, 1, 2, None, None, None), (0, 1, 2, 3, 4, 5), 0),
        ((0, 0.1, 0.2, None, None, 0.3), (0, 0.1, 0.2, 0.3, 0.4, 0.4), 0),
        ((0, 1, 2, -500, None, -498), (0, 1, 2, 3, 4, 5), 1),
    ],
)
def test_what_the_axis_does_with_a_clock(
    claimed: tuple[float | None, ...], expected: tuple[float, ...], steps: int
) -> None:
    times, verdicts, about = axis_of(whole(*claimed))
    assert after_start(times) == pytest.approx(expected, abs=1e-6)
    assert verdicts == [TIMED] * len(claimed)
    assert int(about.get("clock_step_count", 0)) == steps


def test_a_longer_gap_can_be_allowed() -> None:
    assert after_start(axis_of(whole(0, 1, 9000, 9001), gap_s=10_000.0)[0]) == [0, 1, 9000, 9001]


def test_the_axis_starts_with_the_first_time_that_others_follow() -> None:
    times, verdicts, _ = axis_of(whole(None, None, -1e6, 5, 6, 7))
    assert verdicts == [NO_TIME_YET] * 3 + [TIMED] * 3
    assert after_start(times[3:]) == [5, 6, 7]


def test_protocols_of_one_receiver_step_together() -> None:
    seconds = [0, 1, 2, 9000, 9001, 9002]
    claims: list[Claim] = [
        (protocol, START + s * S, 0, None) for s in seconds for protocol in (0, 1)
    ]
    times, _, about = axis_of(claims)
    assert after_start(times) == [n for n in range(6) for _ in (0, 1)]
    assert about["clock_step_count"] == "1"


def test_protocols_that_lag_keep_their_own_times() -> None:
    claims: list[Claim] = [
        claim
        for n in range(40)
        for claim in ((0, START + (n + 1) * S, 0, None), (1, START + n * S, 0, None))
    ]
    times, _, about = axis_of(claims)
    assert times == [claim[1] for claim in claims]
    assert "clock_step_count" not in about


def stamped(*seconds: float) -> list[Claim]:
    return [(0, *of_day(START + n * S), START + round(s * S)) for n, s in enumerate(seconds)]


def test_the_recorders_clock_is_taken_where_nearly_all_have_it() -> None:
    times, verdicts, about = axis_of(stamped(0.2, 1.3, 2.2, 90_000.2, 90_001.2))
    assert after_start(times) == pytest.approx([0.2, 1.3, 2.2, 90_000.2, 90_001.2])
    assert (set(verdicts), about) == ({TIMED}, {"clock": "recorder"})


def test_a_recorders_clock_that_runs_backwards_rejects_or_goes_on() -> None:
    claims = stamped(0, 1, 2, 3, -9, -8, -7, 4, 5)
    times, verdicts, _ = axis_of(claims)
    assert verdicts == [TIMED] * 4 + [BACKWARDS] * 3 + [TIMED] * 2
    assert after_start(times[7:]) == [4, 5]
    times, verdicts, about = axis_of(claims[:7], append_clock=True)
    assert (after_start(times), set(verdicts)) == ([0, 1, 2, 3, 4, 5, 6], {TIMED})
    assert about["clock_step_count"] == "1"


@pytest.mark.parametrize("count", [15, 400])
def test_two_interleaved_receivers_are_refused(count: int) -> None:
    seconds = [s for n in range(count) for s in (n, n + 500)]
    with pytest.raises(ConversionError, match="two receivers seem to be interleaved"):
        axis_of(whole(*seconds))


def claims_at_random(seed: int, by_recorder: bool) -> list[Claim]:
    """Two protocols' epochs whose clock stands still, leaps, steps and is absent now and then."""
    chance = random.Random(seed)
    steps, forms = (
        [0] + [1] * chance.choice([8, 60]) + [10, 600, 4000, 50_000, -3, -9000],
        ["whole"] * 6 + ["day", "week", "none", "false"],
    )
    clock, claims = START, []
    for number in range(chance.randint(2, 80)):
        clock += chance.choice(steps) * S
        form = {
            "whole": (clock, 0),
            "day": of_day(clock),
            "week": of_week(clock),
            "none": (None, 0),
            "false": (clock + 10**6 * S, 0),
        }
        received = (
            START + number * S + chance.choice([0, 0, 0, 0, -5, 5000]) * S if by_recorder else None
        )
        claims.append((chance.randint(0, 1), *form[chance.choice(forms)], received))
    return claims


@given(
    seed=st.integers(0, 2**32),
    cuts=st.lists(st.integers(1, 80), min_size=1, max_size=6),
    recorder=st.sampled_from(["", "rejects", "appends"]),
    spacing=st.sampled_from([100, 40_000, 400_000]),
)
@settings(max_examples=400, deadline=None)
def test_nothing_depends_on_the_groups_that_epochs_come_in(
    seed: int, cuts: list[int], recorder: str, spacing: int
) -> None:
    claims, options = (
        claims_at_random(seed, bool(recorder)),
        {"append_clock": recorder == "appends", "date": "2024-02-29"},
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(time_axis, "_FIRST_EPOCHS", 3)
        try:
            at_once = axis_of(claims, spacing=spacing, **options)
        except ConversionError as refusal:
            with pytest.raises(ConversionError, match=str(refusal)[:40]):
                axis_of(claims, tuple(cuts), spacing, **options)
            return
        assert axis_of(claims, tuple(cuts), spacing, **options) == at_once
    for protocol in (0, 1):
        given_times = [
            time
            for claim, time, verdict in zip(claims, *at_once[:2], strict=True)
            if claim[0] == protocol and verdict == TIMED
        ]
        assert given_times == sorted(given_times)


@given(st.lists(st.integers(1, 3599), min_size=2, max_size=60))
def test_a_clock_that_goes_forward_is_the_axis(steps: list[int]) -> None:
    seconds = list(itertools.accumulate(steps))
    times, _, about = axis_of(whole(*seconds))
    assert (after_start(times), about) == (seconds, {"clock": "gnss"})
