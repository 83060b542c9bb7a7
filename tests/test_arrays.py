"""Steps on arrays, each against the loop that says what it means."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from spoofbench.arrays import (
    forward_fill,
    last_index,
    ragged_arange,
    ragged_ranges,
    run_starts,
)

FLAGS = st.lists(st.booleans(), max_size=30)
GROUPS = st.lists(st.tuples(st.integers(-50, 50), st.integers(0, 6)), max_size=12)


@given(FLAGS)
def test_last_index_is_that_of_the_last_true_entry(flags: list[bool]) -> None:
    known = np.array(flags, bool)
    expected = [max((j for j in range(i + 1) if flags[j]), default=-1) for i in range(len(flags))]
    assert last_index(known).tolist() == expected


@given(FLAGS, st.integers(-9, 9))
def test_forward_fill_repeats_the_last_known_value(flags: list[bool], before: int) -> None:
    known, values = np.array(flags, bool), np.arange(100, 100 + len(flags))
    expected, held = [], before
    for value, flag in zip(values.tolist(), flags, strict=True):
        held = value if flag else held
        expected.append(held)
    filled = forward_fill(values, known, before)
    assert filled.tolist() == expected
    assert filled.dtype == values.dtype


@given(FLAGS)
def test_forward_fill_goes_along_the_last_axis(flags: list[bool]) -> None:
    known = np.array(flags, bool)
    values = np.random.default_rng(0).normal(size=(2, 3, known.size))
    filled = forward_fill(values, known, np.nan)
    for i, j in np.ndindex(2, 3):
        np.testing.assert_array_equal(filled[i, j], forward_fill(values[i, j], known, np.nan))


@given(FLAGS, FLAGS)
def test_forward_fill_knows_nothing_of_the_future(past: list[bool], future: list[bool]) -> None:
    known = np.array(past + future, bool)
    values = np.arange(known.size, dtype=float)
    whole, cut = (forward_fill(values[:n], known[:n], np.nan) for n in (known.size, len(past)))
    np.testing.assert_array_equal(whole[: len(past)], cut)


@given(st.lists(st.integers(0, 2), max_size=30))
def test_run_starts_lie_where_the_label_changes(labels: list[int]) -> None:
    expected: list[int] = []
    for index, label in enumerate(labels):
        same = index > 0 and labels[index - 1] == label
        expected.append(expected[-1] if same else index)
    assert run_starts(np.array(labels, int)).tolist() == expected


@given(GROUPS)
def test_ragged_ranges_are_pythons(groups: list[tuple[int, int]]) -> None:
    starts, counts = [start for start, _ in groups], [count for _, count in groups]
    assert ragged_arange(counts).tolist() == [i for count in counts for i in range(count)]
    assert ragged_ranges(starts, counts).tolist() == [
        i for start, count in groups for i in range(start, start + count)
    ]
