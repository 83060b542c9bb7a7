"""Detectors that learn: states are stored, their thresholds come from what they have not seen, and
memorising is of no avail.
"""

import json
import pickle
import shutil
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from spoofbench import codec
from spoofbench.decisions import OutcomeLog
from spoofbench.detector import detect
from spoofbench.results import read_tasks
from spoofbench.runner import run
from spoofbench.runner.jobs import DetectorJob, run_detector
from spoofbench.scoring.leaderboard import leaderboard
from spoofbench.scoring.score import score_folder
from spoofbench.suite import DetectorEntry, Suite
from spoofbench.testing import drive
from tests.runner.sessions import (
    TARGET_PER_HOUR,
    factors,
    judged,
    noise,
    session_recording,
    session_suite,
    write_sessions,
)

pytestmark = pytest.mark.usefixtures("fakes")

STEADY = DetectorEntry("steady", "steady", {"scale": 1.0}, "by hand")
DERIVED = ("scores", "events", "calibration", "curves", "transfer")


def contents(folder: Path, pattern: str) -> Mapping[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.glob(pattern))}


@pytest.fixture(scope="module")
def suite(fakes: Path, tmp_path_factory: pytest.TempPathFactory) -> Suite:
    """Two sessions calibrate, one is judged and borrows."""
    folder = tmp_path_factory.mktemp("sessions")
    write_sessions(folder, {number: noise(number) for number in (1, 2, 3)})
    detectors = [STEADY, "attack-pupil", DetectorEntry("as-is", "pupil", fit=False), "unteachable"]
    return session_suite(
        folder, "sides", detectors, ["boost", "borrow"], donors={3: [1]}, calibrating=(1, 2)
    )


@pytest.fixture(scope="module")
def results(suite: Suite, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("results")
    run(suite, folder / "results")
    return folder / "results"


@pytest.mark.slow
def test_fitting_twice_gives_the_same_states(suite: Suite, results: Path, tmp_path: Path) -> None:
    run(suite, tmp_path / "again", workers=1)
    states = contents(results / "states", "*")
    assert states
    assert contents(tmp_path / "again" / "states", "*") == states
    used = {task.fit_id for task in read_tasks(results) if task.status == "ok"}
    assert {Path(name).stem for name in states} == used - {None}, (
        "every state that a task ran with is there"
    )


def test_a_suite_may_take_a_detector_that_learns_as_it_is(results: Path) -> None:
    own = [task for task in read_tasks(results) if task.detector == "as-is"]
    assert {task.fit_id for task in own} == {None}
    assert {task.recording for task in own if task.calibrates} == {"r1", "r2"}


def test_who_cannot_be_fitted_is_skipped_and_says_why(results: Path) -> None:
    assert {(task.status, task.reason) for task in judged(results, "unteachable")} == {
        ("skipped", "it cannot be fitted: NotApplicable: it takes a hundred recordings")
    }


def changed_state(folder: Path) -> Path:
    """Exchange a state for another that pickles as well; return its file."""
    task = next(t for t in judged(folder, "attack-pupil") if t.fit_id and t.attack is None)
    path = folder / "states" / f"{task.fit_id}.pickle"
    state = pickle.loads(path.read_bytes())
    path.write_bytes(pickle.dumps(type(state)(taught="[]")))
    return path


@pytest.mark.slow
def test_a_changed_state_is_not_used_when_a_run_goes_on(
    suite: Suite, results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is fitted anew, and the run ends as if nothing had happened."""
    folder = tmp_path / "results"
    shutil.copytree(results, folder)
    whole = contents(folder / "states", "*")
    changed = changed_state(folder)
    assert contents(folder / "states", "*") != whole
    missing = {t.task_id for t in judged(folder, "attack-pupil") if t.fit_id == changed.stem}
    known = OutcomeLog.status
    monkeypatch.setattr(
        OutcomeLog,
        "status",
        lambda log, task_id: None if task_id in missing else known(log, task_id),
    )
    run(suite, folder, resume=True)
    assert contents(folder / "states", "*") == whole
    assert contents(folder / "decisions", "*") == contents(results / "decisions", "*")


def test_a_worker_refuses_a_changed_state(
    results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("spoofbench.runner.jobs.limit_memory", lambda growth_bytes: None)
    folder = tmp_path / "results"
    shutil.copytree(results, folder)
    path = changed_state(folder)
    digest = json.loads(path.with_suffix(".json").read_text())["sha256"]
    (tmp_path / "material").mkdir()
    job = DetectorJob("attack-pupil", {}, ("0",), state=str(path), state_sha256=digest)
    monkeypatch.setattr("spoofbench.runner.jobs.BlindReader", _NothingToRead)
    ((record, _),) = run_detector(job, tmp_path / "material")
    assert record["status"] == "failed"
    assert "has been changed since" in record["reason"]


class _NothingToRead:
    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def size(self, variant: str) -> int:
        return 0


def test_a_copied_folder_alone_gives_every_number_again(results: Path, tmp_path: Path) -> None:
    copy = tmp_path / "elsewhere"
    shutil.copytree(results, copy)
    for name in DERIVED:
        (copy / f"{name}.parquet").unlink()
    score_folder(copy)
    for name in DERIVED:
        ours, theirs = (folder / f"{name}.parquet" for folder in (copy, results))
        assert ours.read_bytes() == theirs.read_bytes(), name
    assert leaderboard(copy) == leaderboard(results)
    assert (copy / "calibration.parquet").stat().st_size > 0
    points = {row.threshold for table in leaderboard(copy).tables for row in table.rows}
    assert "calibrated" in points, "there is something to get again"


@pytest.mark.slow
def test_an_in_sample_threshold_is_caught(fakes: Path, tmp_path: Path) -> None:
    """A detector that scores 0 wherever it was taught has no false alert there at any factor, so
    that an in-sample threshold would be its own. By sessions that it has not seen, its rate is
    that of one that never learned.
    """
    numbers, calibrating = range(1, 25), range(1, 13)
    write_sessions(tmp_path / "sessions", {n: noise(n) for n in numbers})
    suite = session_suite(
        tmp_path / "sessions",
        "sides",
        [STEADY, "memoriser", DetectorEntry("twin", "steady", {"scale": 1.0}, "by hand")],
        calibrating=calibrating,
    )
    run(suite, tmp_path / "results")
    task = next(t for t in judged(tmp_path / "results", "memoriser") if t.attack is None)
    state = pickle.loads((tmp_path / "results" / "states" / f"{task.fit_id}.pickle").read_bytes())
    for number in calibrating:
        seen = session_recording(number, noise(number))
        assert detect(state, seen).score.max() == 0, "in sample every factor is as good"
    (table,) = leaderboard(tmp_path / "results").tables
    (row,) = (row for row in table.rows if row.detector == "memoriser")
    in_sample, cross_fitted = row.published, row.ranked
    assert cross_fitted is not None
    assert in_sample.far_per_hour_lo is not None
    assert in_sample.far_per_hour_lo > TARGET_PER_HOUR
    assert cross_fitted.far_per_hour_lo is not None
    assert cross_fitted.far_per_hour_hi is not None
    assert cross_fitted.far_per_hour_lo <= TARGET_PER_HOUR <= cross_fitted.far_per_hour_hi
    found = factors(tmp_path / "results")
    assert found["memoriser", "[]"] == found["steady", "[]"]
    assert (row.threshold, row.is_fitted, row.learns_from_attacks) == ("calibrated", True, False)


@pytest.mark.slow
def test_learners_of_scikit_learn_run_whole(fakes: Path, tmp_path: Path) -> None:
    """Both learn, one from attacks too; a forest that memorises gets a threshold from sessions
    that it has not seen, and is also judged without the attack's family.
    """
    pytest.importorskip("sklearn", reason="scikit-learn is not installed")
    for number in (1, 2, 3):
        codec.write(drive(number, 240.0).replace({"/imu0/imu": None}), tmp_path / f"{number}.mcap")
    trees = [
        DetectorEntry(name, name, {"trees": 5}, "by hand")
        for name in ("isolation-trees", "attack-trees")
    ]
    suite = session_suite(
        tmp_path,
        "sides",
        trees,
        ["drag-off", "nudge"],
        calibrating=(1, 2),
        duration_s=90.0,
        target_far_per_hour=60.0,
    )
    run(suite, tmp_path / "results")
    tasks = read_tasks(tmp_path / "results")
    assert {task.status for task in tasks} == {"ok"}
    (table,) = leaderboard(tmp_path / "results").tables
    rows = {row.detector: row for row in table.rows}
    assert {name: row.learns_from_attacks for name, row in rows.items()} == {
        "isolation-trees": False,
        "attack-trees": True,
    }
    assert rows["isolation-trees"].family_left_out is None
    assert rows["attack-trees"].family_left_out is not None
    assert rows["attack-trees"].family_left_out[1] == rows["attack-trees"].shown.attacks == 2
    for row in rows.values():
        assert row.is_fitted
        assert row.ranked is not None
        assert row.factor_lo is not None
        assert np.isfinite(row.factor_lo)
