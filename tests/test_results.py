"""The results folder: what is written comes back, whole, and damage is reported in one sentence."""

from dataclasses import asdict, fields, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from spoofbench.errors import ResultsError
from spoofbench.recording import Interval
from spoofbench.results import (
    TASK_SCHEMA,
    Task,
    Truth,
    has_truth,
    read_kinds,
    read_parquet,
    read_run,
    read_tasks,
    read_truth,
    write_parquet,
    write_run,
    write_tasks,
    write_truth,
)

TASK = Task(
    task_id="0f",
    variant_id="1e",
    role="judged",
    recording="drive",
    session="monday",
    sensor_class="car-mems",
    provenance="injected",
    is_fused=False,
    kinds='["gnss/pvt"]',
    attack="replay",
    attack_group="replay",
    attack_plugin="replay",
    attack_parameters="{}",
    strength=2.5,
    window=7,
    window_start_ns=2**62,
    window_end_ns=2**62 + 1,
    calibration_start_ns=None,
    calibration_end_ns=None,
    judged_start_ns=2**60,
    held_out='["monday"]',
    left_out=None,
    fit_id=None,
    detector="d",
    plugin="p",
    plugin_distribution="a-distribution",
    plugin_version="1.0",
    parameters="{}",
    parameter_sources="{}",
    input_class="gnss+imu",
    requires='["imu"]',
    memory_s=5.0,
    warm_up_s=0.0,
    learns_from_attacks=False,
    baseline=False,
    hold_s=None,
    status="ok",
    reason=None,
)
UNATTACKED = replace(
    TASK,
    task_id="2d",
    attack=None,
    attack_group=None,
    attack_plugin=None,
    attack_parameters=None,
    strength=None,
    window=None,
    window_start_ns=None,
    window_end_ns=None,
    calibration_start_ns=1,
    calibration_end_ns=2**62,
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


def test_a_task_says_whether_it_is_judged_and_whether_it_calibrates() -> None:
    only = replace(UNATTACKED, role="calibration")
    first_part = replace(only, judged_start_ns=None)
    assert [(task.is_judged, task.calibrates) for task in (TASK, UNATTACKED, only, first_part)] == [
        (True, False),
        (True, True),
        (False, True),
        (False, True),
    ]


def test_truth_comes_back(tmp_path: Path) -> None:
    written = truth()
    assert not has_truth(tmp_path, "v")
    assert read_kinds(tmp_path, "v") is None
    write_truth(tmp_path, "v", written, ["gnss/pvt", "imu"])
    assert has_truth(tmp_path, "v")
    assert read_kinds(tmp_path, "v") == ["gnss/pvt", "imu"]
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
    files = sorted(
        path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*") if path.is_file()
    )
    assert [str(file) for file in files] == ["tasks.parquet", "truth/v.parquet"]
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
    write_truth(tmp_path, "v", truth())
    write_tasks(tmp_path, [TASK])
    grid, tasks = tmp_path / "truth" / "v.parquet", tmp_path / "tasks.parquet"

    stored = read_parquet(grid)
    write_parquet(grid, stored.replace_schema_metadata(None))
    with pytest.raises(ResultsError, match="epoch and intervals"):
        read_truth(tmp_path, "v")
    with pytest.raises(ResultsError, match="cannot be read"):
        read_kinds(tmp_path, "v")
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
        {"role": None},
        {"held_out": None},
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
    write_truth(tmp_path, "v", truth())
    for part, read in (
        ("tasks", lambda: read_tasks(tmp_path)),
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
