"""Jobs are functions of plain specifications and folders: what a run does, anybody can do with the
same specifications after a way through JSON.
"""

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pytest

from spoofbench import plugins
from spoofbench.decisions import Outcomes
from spoofbench.results import read_tasks
from spoofbench.runner import run
from spoofbench.runner.jobs import (
    DescriptionJob,
    DetectorJob,
    RecordingJob,
    VariantJob,
    describe_plugin,
    make_variants,
    run_detector,
    survey_recording,
)
from spoofbench.suite import Suite

MakeSuite = Callable[..., Suite]
_Job = TypeVar("_Job", DescriptionJob, RecordingJob, VariantJob, DetectorJob)


@pytest.fixture(autouse=True)
def _no_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """A job limits the memory of its process, which here is that of all tests."""
    monkeypatch.setattr("spoofbench.runner.jobs.limit_memory", lambda growth_bytes: None)


def through_json(job: _Job) -> _Job:
    return type(job)(**json.loads(json.dumps(asdict(job))))


def test_jobs_by_hand_give_what_a_run_gives(
    make_suite: MakeSuite, logs: Path, tmp_path: Path
) -> None:
    suite = make_suite(["steady"])
    run(suite, tmp_path / "results")
    tasks = {task.attack: task for task in read_tasks(tmp_path / "results")}

    said = describe_plugin(through_json(DescriptionJob(plugins.DETECTORS, "steady", {})))
    assert json.loads(json.dumps(said)) == {
        "status": "ok",
        "parameters": {"scale": 0.1},
        "changed": [],
        "requires": ["gnss/pvt"],
        "uses": [],
        "memory_s": 0.0,
        "warm_up_s": 0.0,
        "baseline": False,
        "is_trainable": False,
        "learns_from_attacks": False,
    }
    nudge = {"id": "nudge", "plugin": "nudge", "parameters": {}}
    recording = through_json(
        RecordingJob(
            recording="drive-1",
            path=str(logs / "drive-1.mcap"),
            donors=(),
            attacks=(nudge,),
            seed=suite.seed,
            first_s=10.0,
            duration_s=suite.duration_s,
            gap_s=suite.memory_cap_s,
            windows=1,
            memory_mb=2048,
        )
    )
    asking, info = survey_recording(recording)
    assert asking == {"status": "asking", "attack": "nudge"}
    assert info["windows"] == [(tasks["nudge"].window_start_ns, tasks["nudge"].window_end_ns)]
    variants = [
        through_json(VariantJob("clean", "1")),
        through_json(VariantJob("nudged", "0", "nudge", "nudge", info["windows"][0])),
    ]
    made = list(make_variants(recording, variants, tmp_path / "by-hand", tmp_path / "material"))
    assert [record["status"] for record in made] == ["ok", "ok"]
    for variant, attack in (("clean", None), ("nudged", "nudge")):
        theirs = tmp_path / "results" / "truth" / f"{tasks[attack].variant_id}.parquet"
        ours = tmp_path / "by-hand" / "truth" / f"{variant}.parquet"
        assert ours.read_bytes() == theirs.read_bytes()

    detector = through_json(DetectorJob("steady", {}, variants=("0", "1"), memory_mb=2048))
    loaded, *ran = run_detector(detector, tmp_path / "material")
    assert loaded == ({"status": "ok"}, None)
    for (record, decisions), attack in zip(ran, ("nudge", None), strict=True):
        outcome: Any = Outcomes(tmp_path / "results").of("drive-1").get(tasks[attack].task_id)
        assert record["status"] == outcome.status == "ok"
        assert decisions is not None
        np.testing.assert_array_equal(decisions.score, outcome.decisions.score)


def test_a_job_says_in_plain_records_what_went_wrong(
    make_suite: MakeSuite, logs: Path, tmp_path: Path
) -> None:
    suite = make_suite(["steady"])
    recording = RecordingJob(
        "drive-1", str(logs / "drive-1.mcap"), (), (), suite.seed, 10.0, 20.0, 130.0, 1, 2048
    )
    assert [record["status"] for record in survey_recording(recording)] == ["ok"]
    (made,) = make_variants(recording, [VariantJob("clean", "0")], tmp_path, tmp_path / "material")
    assert made["status"] == "ok"
    job = DetectorJob("raises", {}, variants=("0",), memory_mb=2048)
    _, (record, decisions) = run_detector(job, tmp_path / "material")
    assert (record["status"], decisions) == ("failed", None)
    assert json.loads(json.dumps(record))["reason"].startswith("RuntimeError: cannot open")
