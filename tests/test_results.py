"""The results folder: what is written comes back, whole, and damage is reported in one sentence."""

from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import get_args

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spoofbench.detector import Decisions
from spoofbench.errors import ResultsError
from spoofbench.recording import Interval
from spoofbench.results import (
    TASK_SCHEMA,
    Status,
    Task,
    TaskOutcome,
    Truth,
    read_outcome,
    read_parquet,
    read_run,
    read_tasks,
    read_truth,
    write_outcome,
    write_parquet,
    write_run,
    write_tasks,
    write_truth,
)

TASK = Task(
    task_id="0f",
    variant_id="1e",
    recording="drive",
    session="monday",
    attack="replay",
    attack_parameters="{}",
    window_start_ns=2**62,
    window_end_ns=2**62 + 1,
    seed=7,
    detector="d",
    plugin="p",
    plugin_distribution="a-distribution",
    plugin_version="1.0",
    parameters="{}",
    requires='["imu"]',
    memory_s=5.0,
    baseline=False,
    hold_s=None,
    target_far_per_hour=1.0,
    status="ok",
    reason=None,
)
UNATTACKED = replace(
    TASK,
    task_id="2d",
    attack=None,
    attack_parameters=None,
    window_start_ns=None,
    window_end_ns=None,
    seed=None,
)


def truth(n: int = 3) -> Truth:
    values = np.append(np.arange(n - 1.0), np.nan)
    flags = np.arange(n) % 2 == 0
    return Truth(
        np.arange(n),
        flags,
        ~flags,
        flags,
        ~flags,
        *(values + k for k in range(6)),
        epoch_ns=200_000_000,
        intervals=(Interval(1, 2),),
    )


def test_tasks_come_back(tmp_path: Path) -> None:
    failed = replace(TASK, status="failed", reason="ValueError: 'x' is not a number", hold_s=2.5)
    write_tasks(tmp_path, [TASK, UNATTACKED, failed])
    assert read_tasks(tmp_path) == [TASK, UNATTACKED, failed]
    write_tasks(tmp_path, [])
    assert read_tasks(tmp_path) == []


@given(
    st.lists(st.integers(-(2**63), 2**63 - 1), unique=True, max_size=20).map(sorted),
    st.lists(st.floats(allow_nan=True), min_size=20, max_size=20),
)
def test_decisions_come_back(
    tmp_path_factory: pytest.TempPathFactory, times: list[int], scores: list[float]
) -> None:
    folder = tmp_path_factory.mktemp("results")
    score = np.array(scores[: len(times)])
    decisions = Decisions(times, score, ~np.isnan(score))
    write_outcome(folder, "t", TaskOutcome("ok", None, decisions))
    back = read_outcome(folder, "t")
    assert back is not None
    assert back.decisions is not None
    assert (back.status, back.reason) == ("ok", None)
    for name in ("time_ns", "score", "available"):
        np.testing.assert_array_equal(getattr(back.decisions, name), getattr(decisions, name))


@pytest.mark.parametrize("status", [status for status in get_args(Status) if status != "ok"])
def test_reasons_come_back(tmp_path: Path, status: Status) -> None:
    write_outcome(tmp_path, "t", TaskOutcome(status, "because", None))
    back = read_outcome(tmp_path, "t")
    assert back is not None
    assert (back.status, back.reason, back.decisions) == (status, "because", None)


def test_what_was_not_written_is_none(tmp_path: Path) -> None:
    assert read_outcome(tmp_path, "t") is None


def test_truth_comes_back(tmp_path: Path) -> None:
    written = truth()
    write_truth(tmp_path, "v", written)
    back = read_truth(tmp_path, "v")
    for field in fields(Truth):
        np.testing.assert_array_equal(getattr(back, field.name), getattr(written, field.name))


def test_run_comes_back(tmp_path: Path) -> None:
    write_run(tmp_path, {"versions": {"numpy": "2"}, "thresholds": "published"})
    assert read_run(tmp_path) == {"versions": {"numpy": "2"}, "thresholds": "published"}


def test_same_content_same_bytes_and_nothing_beside(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_truth(tmp_path / name, "v", truth())
        write_tasks(tmp_path / name, [TASK])
        write_outcome(tmp_path / name, "t", TaskOutcome("failed", "because", None))
    files = sorted(
        path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*") if path.is_file()
    )
    assert [str(file) for file in files] == [
        "decisions/t.parquet",
        "tasks.parquet",
        "truth/v.parquet",
    ]
    for file in files:
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


def test_a_write_that_fails_leaves_the_file_that_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_tasks(tmp_path, [TASK])

    def half(table: pa.Table, where: Path, **_: object) -> None:
        where.write_bytes(b"PAR1")
        raise OSError("no space left")

    monkeypatch.setattr("spoofbench.results.pq.write_table", half)
    with pytest.raises(ResultsError, match=r"tasks\.parquet' cannot be written: no space"):
        write_tasks(tmp_path, [])
    assert [path.name for path in tmp_path.iterdir()] == ["tasks.parquet"]
    assert read_tasks(tmp_path) == [TASK]


def test_damage_is_said(tmp_path: Path) -> None:
    write_outcome(tmp_path, "t", TaskOutcome("ok", None, Decisions([1], [2.0], [True])))
    write_truth(tmp_path, "v", truth())
    write_tasks(tmp_path, [TASK])
    decisions, grid, tasks = (
        tmp_path / "decisions" / "t.parquet",
        tmp_path / "truth" / "v.parquet",
        tmp_path / "tasks.parquet",
    )

    stored = read_parquet(decisions)
    write_parquet(decisions, stored.replace_schema_metadata(None))
    with pytest.raises(ResultsError, match="no status"):
        read_outcome(tmp_path, "t")
    write_parquet(decisions, stored.drop_columns("score"))
    with pytest.raises(ResultsError, match="lacks values of 'score'"):
        read_outcome(tmp_path, "t")
    decisions.write_bytes(b"PAR1 and no more")
    with pytest.raises(ResultsError, match="cannot be read"):
        read_outcome(tmp_path, "t")

    stored = read_parquet(grid)
    write_parquet(grid, stored.replace_schema_metadata(None))
    with pytest.raises(ResultsError, match="epoch and intervals"):
        read_truth(tmp_path, "v")
    write_parquet(grid, stored.set_column(0, "time_ns", pa.nulls(3, pa.int64())))
    with pytest.raises(ResultsError, match="lacks values of 'time_ns'"):
        read_truth(tmp_path, "v")
    with pytest.raises(ResultsError, match="cannot be read"):
        read_truth(tmp_path, "another")

    write_parquet(tasks, pa.Table.from_pylist([{**asdict(TASK), "colour": "red"}]))
    with pytest.raises(ResultsError, match="another version"):
        read_tasks(tmp_path)
    for text in ("", "{", "[1]", "3", "[" * 100_000):
        (tmp_path / "run.json").write_text(text)
        with pytest.raises(ResultsError, match="not a results folder"):
            read_run(tmp_path)


@pytest.mark.parametrize(
    "change",
    [
        {"detector": None},
        {"status": "well"},
        {"memory_s": np.inf},
        {"hold_s": np.nan},
        {"target_far_per_hour": None},
        {"variant_id": None},
    ],
)
def test_tasks_that_no_run_writes_are_damage(tmp_path: Path, change: dict[str, object]) -> None:
    write_tasks(tmp_path, [TASK])
    write_parquet(
        tmp_path / "tasks.parquet", pa.Table.from_pylist([asdict(TASK) | change], TASK_SCHEMA)
    )
    with pytest.raises(ResultsError, match=f"damaged.*{next(iter(change))}"):
        read_tasks(tmp_path)


def test_columns_of_other_types_are_damage(tmp_path: Path) -> None:
    write_tasks(tmp_path, [TASK])
    write_outcome(
        tmp_path, "t", TaskOutcome("ok", None, Decisions([1, 2], [2.0, 0.5], [True, True]))
    )
    write_truth(tmp_path, "v", truth())
    for part, read in (
        ("tasks", lambda: read_tasks(tmp_path)),
        ("decisions/t", lambda: read_outcome(tmp_path, "t")),
        ("truth/v", lambda: read_truth(tmp_path, "v")),
    ):
        path = tmp_path / f"{part}.parquet"
        good = read_parquet(path)
        for index, name in enumerate(good.column_names):
            other = (
                pa.nulls(len(good), pa.string()).fill_null("x")
                if good[name].type != pa.string()
                else pa.array([1] * len(good))
            )
            write_parquet(path, good.set_column(index, name, other))
            with pytest.raises(ResultsError):
                read()
        write_parquet(path, good)
        read()


def test_decisions_out_of_order_are_damage(tmp_path: Path) -> None:
    write_outcome(
        tmp_path, "t", TaskOutcome("ok", None, Decisions([1, 2], [2.0, 0.5], [True, True]))
    )
    path = tmp_path / "decisions" / "t.parquet"
    write_parquet(path, read_parquet(path).take([1, 0]))
    with pytest.raises(ResultsError, match="decision times must increase"):
        read_outcome(tmp_path, "t")


@pytest.mark.parametrize(
    "metadata",
    [
        {"intervals": '[["a", "b"]]'},
        {"intervals": "[[1.5, NaN]]"},
        {"intervals": f"[[0, {10**40}]]"},
        {"intervals": '{"ab": 1}'},
        {"intervals": "[" * 100_000},
        {"intervals": "[[5, 1]]"},
        {"epoch_ns": "9" * 30},
        {"epoch_ns": "0"},
    ],
)
def test_intervals_that_are_not_whole_nanoseconds_are_damage(
    tmp_path: Path, metadata: dict[str, str]
) -> None:
    write_truth(tmp_path, "v", truth())
    path = tmp_path / "truth" / "v.parquet"
    table = read_parquet(path)
    write_parquet(
        path,
        table.replace_schema_metadata(
            {**table.schema.metadata, **{key.encode(): value for key, value in metadata.items()}}
        ),
    )
    with pytest.raises(ResultsError, match="epoch and intervals"):
        read_truth(tmp_path, "v")
