"""Rows of a stream come out in the order of time, whatever the cuts; none is lost."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from spoofbench.conversion import Block, RowBatch, RowBuffer, TimeSorter
from spoofbench.conversion.rows import join
from spoofbench.table import Column, Table

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


TOPIC = "/gnss0/gnss/signal"
BATCHES = st.lists(
    st.lists(
        st.tuples(
            st.integers(0, 200),
            st.one_of(st.none(), st.integers(1, 40)),
            st.one_of(st.none(), st.floats(0, 60, width=32)),
            st.one_of(st.none(), st.sampled_from(["1C", "5Q", "2L"])),
        ),
        max_size=8,
    ),
    max_size=5,
)


def batch(rows: list[tuple[Any, ...]], first: int, without: set[str]) -> RowBatch:
    """Rows of signals; fields of ``without`` are left out and so absent."""
    times, numbers, strengths, signals = zip(*rows, strict=True) if rows else ((), (), (), ())
    columns: dict[str, Any] = {
        "svid": Column(
            np.array([number or 0 for number in numbers], np.uint32),
            np.array([number is not None for number in numbers], bool),
        ),
        "cn0_dbhz": np.array([np.nan if x is None else x for x in strengths], float),
        "signal": list(signals),
    }
    kept = {name: column for name, column in columns.items() if name not in without}
    count = len(rows)
    return RowBatch.of(
        "gnss/signal",
        np.array(times, np.int64),
        kept,
        np.arange(first, first + count),
        np.ones(count, np.int64),
    )


def seen(table: Table) -> list[tuple[Any, ...]]:
    """The rows of a table, None where absent."""
    numbers = [
        number if there else None
        for number, there in zip(table["svid"].tolist(), table.valid("svid").tolist(), strict=True)
    ]
    strengths = [None if x != x else x for x in table["cn0_dbhz"].tolist()]
    return list(zip(table.time_ns.tolist(), numbers, strengths, table.texts("signal"), strict=True))


@given(BATCHES, st.sets(st.sampled_from(["svid", "cn0_dbhz", "signal"])), st.data())
def test_a_buffer_gives_every_row_once_with_its_values(
    batches: list[list[tuple[Any, ...]]], without: set[str], data: st.DataObject
) -> None:
    buffer = RowBuffer(TOPIC, WINDOW_NS)
    given_rows, items = [], []
    for rows in batches:
        left_out = without if data.draw(st.booleans()) else set()
        items += buffer.push(batch(rows, len(given_rows), left_out))
        blanks = [None if name in left_out else ... for name in ("svid", "cn0_dbhz", "signal")]
        given_rows += [
            (
                row[0],
                *(v if blank is ... else None for v, blank in zip(row[1:], blanks, strict=True)),
            )
            for row in rows
        ]
    items += buffer.flush()
    tables = [item.table for item in items if isinstance(item, Block)]
    rejected = [o for item in items if not isinstance(item, Block) for o in item.offsets.tolist()]
    whole = seen(Table.concat(tables)) if tables else []
    assert sum(item.used for item in items if isinstance(item, Block)) == len(whole)
    assert [row[0] for row in whole] == sorted(row[0] for row in whole)
    kept = [row for number, row in enumerate(given_rows) if number not in rejected]
    assert sorted(whole, key=str) == sorted(kept, key=str)
    assert len(whole) + len(rejected) == len(given_rows)


def test_texts_that_are_gone_are_forgotten() -> None:
    buffer = RowBuffer(TOPIC, WINDOW_NS)
    for number in range(3000):
        rows = batch([(100 * number, 1, 1.0, None)], number, {"signal"})
        columns = {**rows.columns, "signal": Column(np.zeros(1, np.int32), None, (f"{number}",))}
        named = RowBatch(rows.kind, rows.time_ns, columns, rows.offset, rows.units)
        (*_,) = buffer.push(named)
    held = buffer.sort(batch([], 3000, set()))[0]
    assert len(held.columns["signal"].categories or ()) < 2000


def test_rows_that_come_too_late_are_not_held() -> None:
    buffer = RowBuffer(TOPIC, WINDOW_NS)
    buffer.sort(batch([(1000, 1, 1.0, None), (1001, 1, 1.0, None)], 0, set()))
    refused = 0
    for number in range(2, 102):
        refused += len(buffer.sort(batch([(1, 1, 1.0, None)], number, set()))[1])
        assert len(buffer._held) <= 3
    ready, last = buffer.rest()
    assert (len(ready), refused + len(last)) == (2, 100)


def test_numbers_of_no_field_stay_with_the_rows_but_not_in_the_block() -> None:
    rows = batch([(1, 1, 1.0, None), (2, 1, 2.0, None)], 0, {"signal"})
    beside = {**rows.columns, "beside": Column(np.array([5, 6]))}
    both = RowBatch.concat([rows, replace(rows, columns=beside)])
    np.testing.assert_array_equal(both.columns["beside"].values, [0, 0, 5, 6])
    assert "beside" not in both.take(slice(0, 2)).block(TOPIC).table
