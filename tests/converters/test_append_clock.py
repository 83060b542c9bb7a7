"""A clock that jumps back goes on at its interval; a lone wrong time moves no other row."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from spoofbench_converters.append_clock import MAX_STEPS, ClockAppender

WINDOW_NS = 100


def appended(times: list[int], cuts: list[int]) -> tuple[list[int], ClockAppender]:
    """Return the times of rows that come cut into pieces."""
    appender, found = ClockAppender(WINDOW_NS), []
    own, offset = np.array(times, np.int64), 10 * np.arange(len(times))
    for a, b in pairwise(sorted({0, len(times), *cuts})):
        following = times[b] if b < len(times) else None
        added = appender.push(offset[a:b], own[a:b], following)
        np.testing.assert_array_equal(added, appender.added_at(offset[a:b]))
        found += (own[a:b] + added).tolist()
    return found, appender


@given(st.data())
def test_pieces_make_no_difference(data: st.DataObject) -> None:
    steps = st.sampled_from([1, 5, 10, 90, 150, 1000, -5, -90, -150, -1000])
    times = np.cumsum([1000, *data.draw(st.lists(steps, min_size=1, max_size=40))]).tolist()
    cuts = data.draw(st.lists(st.integers(1, len(times) - 1)))
    whole, cut = appended(times, []), appended(times, cuts)
    assert cut[0] == whole[0]
    assert cut[1].steps == whole[1].steps
    assert cut[1].step_count == whole[1].step_count


def test_a_jump_back_goes_on_at_the_median_interval() -> None:
    times, appender = appended([1000, 1010, 1020, 1090, 1100, 100, 110, 120, -80, -70], [])
    assert times == [1000, 1010, 1020, 1090, 1100, 1110, 1120, 1130, 1140, 1150]
    assert appender.steps == [
        {"offset": 50, "from_ns": 1100, "to_ns": 100},
        {"offset": 80, "from_ns": 120, "to_ns": -80},
    ]


@pytest.mark.parametrize("wrong", [5000, -5000, 10])
def test_a_lone_wrong_time_moves_no_other(wrong: int) -> None:
    times = [1000, 1010, 1020, wrong, 1040, 1050]
    assert appended(times, [])[0] == times


def test_steps_are_counted_beyond_those_that_are_listed() -> None:
    times = np.tile([1000, 1010, 0, 10], MAX_STEPS + 5).tolist()
    appender = appended(times, [])[1]
    assert len(appender.steps) == MAX_STEPS
    assert appender.step_count == MAX_STEPS + 5


def test_nothing_is_added_without_rows() -> None:
    appender = ClockAppender()
    none = np.empty(0, np.int64)
    assert not appender.push(none, none).size
    assert appender.added_at(np.array([5])).tolist() == [0]
