"""Rows of a stream come out in the order of time, whatever the cuts; none is lost."""

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from spoofbench.conversion import TimeSorter
from spoofbench.conversion.rows import join

WINDOW_NS = 10


def run(times: list[int], cuts: list[int]) -> tuple[list[tuple[int, int]], list[int]]:
    """Return ``(time, place)`` of the rows that come out, and the places of those refused."""
    order = TimeSorter(WINDOW_NS)
    ready, refused = [], []
    columns = {"time_ns": np.array(times, np.int64), "place": np.arange(len(times))}
    bounds = sorted({0, len(times), *(cut for cut in cuts if cut <= len(times))})
    outcomes = [
        order.push({name: values[a:b] for name, values in columns.items()})
        for a, b in pairwise(bounds)
    ]
    for good, bad in [*outcomes, order.flush()]:
        ready += (
            list(zip(good["time_ns"].tolist(), good["place"].tolist(), strict=True)) if good else []
        )
        refused += bad["place"].tolist() if bad else []
    return ready, refused


STREAMS = st.lists(st.one_of(st.integers(-30, 30), st.integers(-(10**6), 10**6)), max_size=40).map(
    lambda steps: (1000 * np.arange(len(steps)) // 100 + np.array(steps, np.int64)).tolist()
)


@given(STREAMS, st.lists(st.integers(0, 40), max_size=6))
def test_cuts_do_not_matter_and_no_row_is_lost(times: list[int], cuts: list[int]) -> None:
    ready, refused = run(times, cuts)
    assert (ready, sorted(refused)) == (run(times, [])[0], sorted(run(times, [])[1]))
    assert sorted([place for _, place in ready] + refused) == list(range(len(times)))
    assert ready == sorted(ready)


@given(st.lists(st.integers(0, WINDOW_NS), min_size=1, max_size=40))
def test_jitter_within_the_window_is_sorted_in(jitter: list[int]) -> None:
    times = [5 * i - late for i, late in enumerate(jitter)]
    ready, refused = run(times, [])
    assert not refused
    assert [time for time, _ in ready] == sorted(times)


def test_a_step_back_is_refused_until_time_has_caught_up() -> None:
    ready, refused = run([0, 8, 16, 24, 2, 9, 25], [])
    assert refused == [4, 5]
    assert [time for time, _ in ready] == [0, 8, 16, 24, 25]


def test_a_lone_leap_ahead_costs_itself_alone() -> None:
    for times in ([0, 20, 10**9, 40, 60], [10**9, 0, 20, 40, 60]):
        ready, refused = run(times, [])
        assert refused == [times.index(10**9)]
        assert [time for time, _ in ready] == [0, 20, 40, 60]


def test_join_takes_either_side_as_empty() -> None:
    rows = {"time_ns": np.array([1])}
    assert join({}, rows) is rows
    assert join(rows, {}) is rows
    assert join(rows, rows)["time_ns"].tolist() == [1, 1]
