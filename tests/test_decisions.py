"""Decisions are kept as they came, in one file per recording, and survive what may happen to a run:
an end at any byte, damage, another order.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spoofbench.decisions import SCHEMA, OutcomeLog, OutcomeReader, Outcomes
from spoofbench.detector import Decisions
from spoofbench.errors import ResultsError
from spoofbench.results import Status, TaskOutcome, write_parquet

S = 1_000_000_000
PLAN = {"drive": ["a", "b", "c"], "other": ["d"]}
NO_ROWS = Decisions([], [], [])


def ok(rows: int = 5, score: float = 0.5) -> TaskOutcome:
    decisions = Decisions(np.arange(rows) * S, np.full(rows, score), np.ones(rows, bool))
    return TaskOutcome("ok", None, decisions)


OUTCOMES = {
    "a": ok(5),
    "b": TaskOutcome("failed", "RuntimeError: it's “broken”", None),
    "c": TaskOutcome("ok", None, NO_ROWS),
    "d": ok(900, np.inf),
}


def same(one: TaskOutcome | None, other: TaskOutcome | None) -> bool:
    if one is None or other is None:
        return one is other
    if (one.status, one.reason) != (other.status, other.reason):
        return False
    if one.decisions is None or other.decisions is None:
        return one.decisions is other.decisions
    return all(
        np.array_equal(
            getattr(one.decisions, name), getattr(other.decisions, name), equal_nan=name == "score"
        )
        for name in ("time_ns", "score", "available")
    )


def written(
    folder: Path,
    outcomes: Mapping[str, TaskOutcome] = OUTCOMES,
    plan: Mapping[str, Sequence[str]] = PLAN,
) -> dict[str, bytes]:
    """The files of a run that came to these outcomes."""
    log = OutcomeLog(folder)
    for task_id, outcome in outcomes.items():
        log.add(task_id, outcome)
    log.sort(plan)
    return {path.name: path.read_bytes() for path in (folder / "decisions").iterdir()}


@settings(deadline=None)
@given(
    st.lists(st.integers(-(2**63), 2**63 - 1), unique=True, max_size=20).map(sorted),
    st.lists(st.floats(allow_nan=True), min_size=20, max_size=20),
)
def test_decisions_come_back_while_the_run_goes_on_and_after_it(
    tmp_path_factory: pytest.TempPathFactory, times: list[int], scores: list[float]
) -> None:
    folder = tmp_path_factory.mktemp("results")
    score = np.array(scores[: len(times)])
    outcome = TaskOutcome("ok", None, Decisions(times, score, ~np.isnan(score)))
    log = OutcomeLog(folder)
    log.add("t", outcome)
    assert same(log.get("t"), outcome)
    assert same(OutcomeLog(folder).get("t"), outcome), "a run that was killed had it already"
    log.sort({"drive": ["t"]})
    assert same(Outcomes(folder).of("drive").get("t"), outcome)
    assert same(OutcomeLog(folder).get("t"), outcome)


@pytest.mark.parametrize("status", [status for status in get_args(Status) if status != "ok"])
def test_reasons_come_back(tmp_path: Path, status: Status) -> None:
    outcome = TaskOutcome(status, "because", None)
    written(tmp_path, {"t": outcome}, {"drive": ["t"]})
    reader = OutcomeReader(tmp_path / "decisions" / "drive.parquet")
    assert reader.fate("t") == (status, "because")
    assert same(reader.get("t"), outcome)
    assert OutcomeLog(tmp_path).status("t") == status
    with pytest.raises(ResultsError, match="task 't' is ok but"):
        Outcomes(tmp_path).decisions("drive", "t")


def test_what_was_not_written_is_none(tmp_path: Path) -> None:
    log = OutcomeLog(tmp_path)
    assert (log.status("t"), log.get("t")) == (None, None)
    written(tmp_path, {"u": ok()}, {"drive": ["u"]})
    assert Outcomes(tmp_path).of("drive").get("t") is None
    with pytest.raises(ResultsError, match="damaged"):
        Outcomes(tmp_path).of("another")


def test_each_task_has_a_row_group_and_the_order_is_the_suite_s(tmp_path: Path) -> None:
    written(tmp_path)
    path = tmp_path / "decisions" / "drive.parquet"
    assert list(OutcomeReader(path)) == PLAN["drive"]
    assert pq.ParquetFile(path).num_row_groups == 1, "one of its tasks has rows"
    assert pq.read_table(path).schema.equals(SCHEMA)
    index = json.loads(pq.read_schema(path).metadata[b"outcomes"])
    assert [(task_id, status, rows) for task_id, status, _, rows in index] == [
        ("a", "ok", 5),
        ("b", "failed", 0),
        ("c", "ok", 0),
    ]


@pytest.mark.parametrize("order", ["abcd", "dcba", "bdac"])
def test_the_order_in_which_outcomes_come_leaves_no_trace(tmp_path: Path, order: str) -> None:
    expected = written(tmp_path / "expected")
    assert set(expected) == {"drive.parquet", "other.parquet"}
    assert written(tmp_path / "found", {name: OUTCOMES[name] for name in order}) == expected


def test_an_outcome_that_comes_again_replaces_the_one_before(tmp_path: Path) -> None:
    written(tmp_path)
    log = OutcomeLog(tmp_path)
    log.add("b", ok(3))
    log.sort(PLAN)
    assert same(Outcomes(tmp_path).of("drive").get("b"), ok(3))
    assert same(Outcomes(tmp_path).of("drive").get("a"), OUTCOMES["a"])


def test_what_the_suite_no_longer_asks_for_goes_and_the_rest_is_not_written_again(
    tmp_path: Path,
) -> None:
    written(tmp_path)
    before = {path.name: path.stat().st_ino for path in (tmp_path / "decisions").iterdir()}
    OutcomeLog(tmp_path).sort(PLAN)
    assert {path.name: path.stat().st_ino for path in (tmp_path / "decisions").iterdir()} == before
    OutcomeLog(tmp_path).sort({"drive": ["c", "a"]})
    assert [path.name for path in (tmp_path / "decisions").iterdir()] == ["drive.parquet"]
    assert list(Outcomes(tmp_path).of("drive")) == ["c", "a"]


@dataclass(frozen=True)
class Logged:
    """What a run that was killed has left, and where each outcome ends in it."""

    octets: bytes = field(repr=False)
    ends: tuple[int, ...]


@pytest.fixture(scope="module")
def logged(tmp_path_factory: pytest.TempPathFactory) -> Logged:
    folder = tmp_path_factory.mktemp("logged")
    path, ends = folder / "decisions" / "unsorted.arrows", []
    log = OutcomeLog(folder)
    for name in "abc":
        log.add(name, OUTCOMES[name])
        ends.append(path.stat().st_size)
    return Logged(path.read_bytes(), tuple(ends))


@settings(deadline=None)
@given(data=st.data())
def test_a_run_that_ended_at_any_byte_keeps_all_that_was_whole(
    tmp_path_factory: pytest.TempPathFactory,
    logged: Logged,
    data: st.DataObject,
) -> None:
    octets, ends = logged.octets, logged.ends
    near = [place for end in (0, *ends) for place in range(end - 9, end + 9)]
    kept = [place for place in near if 0 <= place <= len(octets)]
    end = data.draw(st.sampled_from(kept) | st.integers(0, len(octets)))
    folder = tmp_path_factory.mktemp("results")
    path = folder / "decisions" / "unsorted.arrows"
    path.parent.mkdir()
    path.write_bytes(octets[:end])
    log = OutcomeLog(folder)
    for name, outcome_end in zip("abc", ends, strict=True):
        assert same(log.get(name), OUTCOMES[name] if outcome_end <= end else None)
    for name in "abc":
        if log.status(name) is None:
            log.add(name, OUTCOMES[name])
    log.sort({"drive": PLAN["drive"]})
    for name in "abc":
        assert same(Outcomes(folder).of("drive").get(name), OUTCOMES[name])
    assert [each.name for each in path.parent.iterdir()] == ["drive.parquet"]


@settings(deadline=None)
@given(data=st.data())
def test_no_damage_is_more_than_a_loss(
    tmp_path_factory: pytest.TempPathFactory,
    logged: Logged,
    data: st.DataObject,
) -> None:
    octets, ends = logged.octets, logged.ends
    place = data.draw(st.integers(ends[0], len(octets) - 1))
    damaged = bytearray(octets)
    damaged[place] ^= data.draw(st.integers(1, 255))
    folder = tmp_path_factory.mktemp("results")
    path = folder / "decisions" / "unsorted.arrows"
    path.parent.mkdir()
    path.write_bytes(damaged)
    log = OutcomeLog(folder)
    assert same(log.get("a"), OUTCOMES["a"]), "what stands before the damage is kept"


def test_a_file_that_cannot_be_read_is_run_again_and_its_neighbours_are_kept(
    tmp_path: Path,
) -> None:
    written(tmp_path)
    path = tmp_path / "decisions" / "drive.parquet"
    path.write_bytes(path.read_bytes()[:100])
    log = OutcomeLog(tmp_path)
    assert [log.status(name) for name in "abcd"] == [None, None, None, "ok"]
    with pytest.raises(ResultsError, match="damaged"):
        Outcomes(tmp_path).of("drive")


@pytest.mark.parametrize(
    "outcomes",
    [
        None,
        "",
        "{",
        "3",
        "null",
        "[3]",
        '[["a"]]',
        '[["a", "well", null, 0]]',
        '[["a", "ok", null, "x"]]',
        '[["a", "ok", null, null]]',
        '[["a", "ok", null, 5], ["b", "ok", null, 5]]',
        '[["a", "failed", "because", 0]]',
        '[["a", "ok", null, 4]]',
        '[[["a"], "ok", null, 5]]',
        "[" * 100_000,
    ],
)
def test_an_index_that_no_run_writes_is_damage(tmp_path: Path, outcomes: str | None) -> None:
    written(tmp_path, {"a": ok()}, {"drive": ["a"]})
    path = tmp_path / "decisions" / "drive.parquet"
    table = pq.read_table(path)
    write_parquet(
        path, table.replace_schema_metadata(None if outcomes is None else {"outcomes": outcomes})
    )
    with pytest.raises(ResultsError, match=r"drive\.parquet is damaged"):
        OutcomeReader(path).get("a")
    assert OutcomeLog(tmp_path).get("a") is None


def _without_score(table: pa.Table) -> pa.Table:
    return table.drop_columns("score")


def _of_other_types(table: pa.Table) -> pa.Table:
    return table.set_column(1, "score", pa.array(["x"] * len(table)))


def _out_of_order(table: pa.Table) -> pa.Table:
    return table.take([1, 0, 2, 3, 4])


def _without_times(table: pa.Table) -> pa.Table:
    return table.set_column(0, "time_ns", pa.nulls(len(table), pa.int64()))


@pytest.mark.parametrize("change", [_without_score, _of_other_types, _out_of_order, _without_times])
def test_rows_that_are_no_decisions_are_damage(tmp_path: Path, change: Any) -> None:
    written(tmp_path, {"a": ok()}, {"drive": ["a"]})
    path = tmp_path / "decisions" / "drive.parquet"
    stored = pq.read_table(path)
    write_parquet(path, change(stored).replace_schema_metadata(stored.schema.metadata))
    with pytest.raises(ResultsError):
        OutcomeReader(path).get("a")
    assert OutcomeLog(tmp_path).get("a") is None
