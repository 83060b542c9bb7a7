"""One row whatever happens: what misbehaving plugins become, and that their neighbours do not
notice.
"""

import os
import re
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from spoofbench import cli, codec
from spoofbench.decisions import Outcomes
from spoofbench.detector import detect
from spoofbench.errors import PluginError, ResultsError, SuiteError
from spoofbench.recording import Recording
from spoofbench.results import Task, read_parquet, read_tasks, read_truth
from spoofbench.runner import run
from spoofbench.suite import AttackEntry, DetectorEntry, RecordingEntry, Suite, TaskLimits
from spoofbench.testing.recordings import drive, spoofed_drive

MakeSuite = Callable[..., Suite]
HOSTILE = ("raises", "sleeps", "eats", "exits", "segfaults", "garbage", "unimportable", "scribbles")


def by_detector(folder: Path) -> dict[str, list[Task]]:
    tasks: dict[str, list[Task]] = {}
    for task in read_tasks(folder):
        tasks.setdefault(task.detector, []).append(task)
    return tasks


def rows(folder: Path, detector: str) -> set[tuple[str, str | None]]:
    return {(task.status, task.reason) for task in by_detector(folder)[detector]}


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] not in "ZX"
    except OSError:
        return False


@pytest.fixture(scope="module")
def hostile(make_suite: MakeSuite, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of a suite in which steady detectors stand between hostile ones."""
    folder = tmp_path_factory.mktemp("hostile")
    strays = DetectorEntry("strays", "strays", {"note": str(folder / "strays.txt")})
    before, after = DetectorEntry("steady-first", "steady"), DetectorEntry("steady-last", "steady")
    suite = make_suite(
        [before, *HOSTILE, "prints", "hungry", strays, after],
        limits=TaskLimits(time_s=3.0, memory_mb=256),
    )
    run(suite, folder / "results", workers=2)
    return folder / "results"


def test_every_task_has_a_row_in_the_order_of_the_suite(hostile: Path) -> None:
    tasks = read_tasks(hostile)
    detectors = ["steady-first", *HOSTILE, "prints", "hungry", "strays", "steady-last"]
    assert [(task.attack, task.detector) for task in tasks] == [
        (attack, name) for attack in (None, "nudge") for name in detectors
    ]
    scores = read_parquet(hostile / "scores.parquet").to_pylist()
    assert [row["task_id"] for row in scores] == [task.task_id for task in tasks]
    for task in tasks:
        outcome = Outcomes(hostile).of(task.recording).get(task.task_id)
        assert outcome is not None
        assert (outcome.status, outcome.reason) == (task.status, task.reason)


def test_a_baseline_is_what_says_so_itself(hostile: Path) -> None:
    assert {task.detector for task in read_tasks(hostile) if task.baseline} == {"prints"}


@pytest.mark.parametrize(
    ("detector", "status", "reason"),
    [
        (
            "raises",
            "failed",
            r"RuntimeError: cannot open spoofbench_fakes\.py for topic '/gnss0/gnss/pvt'",
        ),
        ("sleeps", "timeout", r"it took longer than 3 s"),
        ("eats", "out_of_memory", r"it needs more than 256 MB"),
        ("exits", "failed", r"its process ended with exit status 3 before it had answered"),
        ("segfaults", "failed", r"its process was ended by SIGSEGV"),
        ("garbage", "failed", r"PluginError: a detector must return Decisions, not dict"),
        (
            "unimportable",
            "failed",
            (
                r"PluginError: detector 'unimportable' of spoofbench-fakes 0\.1 cannot be loaded "
                r".*ModuleNotFoundError.*"
            ),
        ),
        ("scribbles", "failed", r"it disturbed the connection of its process"),
    ],
)
def test_a_hostile_detector_becomes_rows(
    hostile: Path, detector: str, status: str, reason: str
) -> None:
    ((found, text),) = rows(hostile, detector)
    assert found == status
    assert re.fullmatch(reason, text or "")


def test_neighbours_of_hostile_detectors_are_intact(hostile: Path, logs: Path, fakes: Path) -> None:
    from spoofbench import plugins

    expected = detect(plugins.make(plugins.DETECTORS, "steady"), codec.read(logs / "drive-1.mcap"))
    for name in ("steady-first", "steady-last", "prints", "hungry", "strays"):
        assert rows(hostile, name) == {("ok", None)}
        outcome = Outcomes(hostile).of("drive-1").get(by_detector(hostile)[name][0].task_id)
        assert outcome is not None
        assert outcome.decisions is not None
        np.testing.assert_array_equal(outcome.decisions.time_ns, expected.time_ns)
        np.testing.assert_array_equal(outcome.decisions.score, expected.score)


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs /proc")
def test_what_a_detector_started_ends_with_it(hostile: Path) -> None:
    pids = [int(line) for line in (hostile.parent / "strays.txt").read_text().split()]
    assert pids
    assert not any(alive(pid) for pid in pids)


def test_costs_are_known_for_what_ran(hostile: Path) -> None:
    costs = read_parquet(hostile / "costs.parquet").to_pylist()
    tasks = read_tasks(hostile)
    assert [row["task_id"] for row in costs] == [task.task_id for task in tasks]
    assert all(
        row["seconds"] is not None
        for row, task in zip(costs, tasks, strict=True)
        if task.status == "ok"
    )
    if sys.platform == "linux":
        memory_mb = {
            task.detector: row["memory_mb"] for row, task in zip(costs, tasks, strict=True)
        }
        assert memory_mb["steady-last"] < 50
        assert 90 < memory_mb["hungry"] < 150, "it takes 100 MB, some of which may have been there"


def test_a_group_that_fails_loses_the_culprit_alone(make_suite: MakeSuite, tmp_path: Path) -> None:
    attacks = [
        AttackEntry(f"nudge-{shift}", "nudge", {"shift_deg": shift}) for shift in (0.5, 40.0, 1.0)
    ]
    run(make_suite(["picky"], attacks), tmp_path / "results", workers=1)
    found = {task.attack: task.status for task in read_tasks(tmp_path / "results")}
    assert found == {None: "ok", "nudge-0.5": "ok", "nudge-40.0": "failed", "nudge-1.0": "ok"}


def test_an_attack_that_fails_costs_its_own_tasks(make_suite: MakeSuite, tmp_path: Path) -> None:
    late = AttackEntry("late", "replay", {"delay_s": 1e4})
    suite = make_suite(
        ["steady"],
        [
            "fatal-supply",
            "nudge",
            "stumbles",
            "kills-itself",
            "inapplicable",
            late,
            AttackEntry("nudge-2", "nudge"),
        ],
    )
    run(suite, tmp_path / "results")
    found = {task.attack: (task.status, task.reason) for task in read_tasks(tmp_path / "results")}
    assert found[None] == found["nudge"] == found["nudge-2"] == ("ok", None)
    died = "its process ended with exit status 5 before it had answered"
    assert found["fatal-supply"] == ("failed", f"asking what the attack can supply: {died}")
    assert found["stumbles"][0] == "failed"
    assert "ValueError: stumbled" in (found["stumbles"][1] or "")
    assert found["kills-itself"] == (
        "failed",
        "making the variant: its process ended with exit status 4 before it had answered",
    )
    assert found["inapplicable"] == ("skipped", "there is nothing to replay")
    assert found["late"][0] == "skipped"
    scores = {
        row["attack"]: row
        for row in read_parquet(tmp_path / "results" / "scores.parquet").to_pylist()
    }
    assert scores["stumbles"]["detection_pct"] is None, "without truth there is nothing to measure"


@pytest.mark.parametrize("what", ["gone", "damaged", "attacked already", "with an attacked donor"])
def test_a_recording_that_cannot_be_read_stops_the_run_before_the_first_task(
    make_suite: MakeSuite, logs: Path, tmp_path: Path, what: str
) -> None:
    path = tmp_path / "log.mcap"
    if what == "damaged":
        path.write_bytes((logs / "drive-1.mcap").read_bytes()[:5000])
    elif what != "gone":
        codec.write(spoofed_drive(1), path)
    donors = ("bad",) if what == "with an attacked donor" else ()
    suite = make_suite(["steady"])
    entries = (
        RecordingEntry("whole", logs / "drive-2.mcap", "monday", donors=donors),
        RecordingEntry("bad", path, "tuesday"),
    )
    with pytest.raises(SuiteError) as failure:
        run(replace(suite, recordings=entries), tmp_path / "results")
    said = str(failure.value)
    assert "'bad'" in said or "'whole'" in said
    assert "\n" not in said
    assert not (tmp_path / "results" / "tasks.parquet").exists()
    assert not (tmp_path / "results" / "truth").exists()
    # nothing is there yet that would have to be resumed
    run(make_suite(["steady"]), tmp_path / "results")


def test_a_recording_that_takes_too_long_stops_the_run(
    make_suite: MakeSuite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    os.mkfifo(tmp_path / "endless.mcap")
    monkeypatch.setattr("spoofbench.runner.execution._PREPARING", 0.05)
    suite = make_suite(["steady"], recordings={"endless": tmp_path / "endless.mcap"})
    with pytest.raises(SuiteError, match="reading the recording: it took longer than 1 s"):
        run(suite, tmp_path / "results")


@pytest.mark.parametrize("memory_mb", [256, 1024, 2048])
def test_the_memory_limit_is_the_detector_s_own(
    make_suite: MakeSuite, tmp_path: Path, memory_mb: int
) -> None:
    fits, not_quite = (
        DetectorEntry(f"hungry-{mb}", "hungry", {"memory_mb": mb})
        for mb in (memory_mb - 64, memory_mb + 64)
    )
    run(make_suite([fits, not_quite], [], limits=TaskLimits(20.0, memory_mb)), tmp_path / "results")
    assert rows(tmp_path / "results", fits.id) == {("ok", None)}
    assert rows(tmp_path / "results", not_quite.id) == {
        ("out_of_memory", f"it needs more than {memory_mb} MB")
    }


def test_what_is_not_there_is_skipped_and_what_is_removed_is_not_modelled(
    make_suite: MakeSuite, logs: Path, tmp_path: Path
) -> None:
    whole = codec.read(logs / "drive-1.mcap")
    bare = Recording(
        {topic: table for topic, table in whole.items() if "integrity" not in topic}, whole.metadata
    )
    codec.write(bare, tmp_path / "bare.mcap")
    suite = make_suite(
        ["demanding"], recordings={"whole": logs / "drive-1.mcap", "bare": tmp_path / "bare.mcap"}
    )
    run(suite, tmp_path / "results")
    found = {
        (task.recording, task.attack): task.status for task in read_tasks(tmp_path / "results")
    }
    assert found == {
        ("whole", None): "ok",
        ("whole", "nudge"): "not_modelled",
        ("bare", None): "skipped",
        ("bare", "nudge"): "skipped",
    }


@pytest.mark.parametrize("asked", [None, 2, 99])
def test_windows_are_shared_disjoint_and_after_the_warm_up(
    make_suite: MakeSuite, tmp_path: Path, asked: int | None
) -> None:
    codec.write(drive(1, 300.0), tmp_path / "long.mcap")
    attacks = [
        AttackEntry("nudge", "nudge"),
        AttackEntry("replay", "replay", {"delay_s": 30.0}),
        AttackEntry("drag-off", "drag-off"),
    ]
    suite = make_suite(
        ["steady"],
        attacks,
        recordings={"long": tmp_path / "long.mcap"},
        windows=asked,
        warm_up_s=15.0,
        memory_cap_s=40.0,
    )
    run(suite, tmp_path / "results")
    span = codec.read(tmp_path / "long.mcap").span
    windows: dict[int, set[tuple[int, int]]] = {}
    for task in read_tasks(tmp_path / "results"):
        if task.window is not None:
            assert task.window_start_ns is not None
            assert task.window_end_ns is not None
            windows.setdefault(task.window, set()).add((task.window_start_ns, task.window_end_ns))
            (truth,) = read_truth(tmp_path / "results", task.variant_id).intervals
            assert task.window_start_ns <= truth.start_ns < truth.end_ns <= task.window_end_ns
    assert all(len(shared) == 1 for shared in windows.values()), "all attacks share a window"
    room_s = (span.end_ns - span.start_ns) / 1e9 - 30.0
    fit = int((room_s + 40.0) // (20.0 + 40.0))
    assert sorted(windows) == list(range(1, (2 if asked == 2 else fit) + 1))
    drawn = [next(iter(windows[number])) for number in sorted(windows)]
    assert drawn[0][0] >= span.start_ns + 30e9
    assert drawn[-1][1] <= span.end_ns
    assert all(end_ns - start_ns == 20e9 for start_ns, end_ns in drawn)
    assert all(after - end_ns >= 40e9 for (_, end_ns), (after, _) in pairwise(drawn))


def test_a_recording_without_room_has_its_attacks_skipped(
    make_suite: MakeSuite, logs: Path, tmp_path: Path
) -> None:
    suite = make_suite(["steady"], warm_up_s=1000.0)
    run(suite, tmp_path / "results")
    found = {task.attack: (task.status, task.reason) for task in read_tasks(tmp_path / "results")}
    assert found[None] == ("ok", None)
    assert found["nudge"][0] == "skipped"
    assert "too few for an attack of 20 s" in (found["nudge"][1] or "")


def test_where_parameters_come_from_must_be_said(make_suite: MakeSuite, tmp_path: Path) -> None:
    suite = make_suite(["steady"], [])
    bare = replace(suite, detectors=(DetectorEntry("mine", "steady", {"scale": 0.2}),))
    with pytest.raises(SuiteError, match=r"'mine': scale is not .* default .* add source ="):
        run(bare, tmp_path / "results")
    for entry in (
        DetectorEntry("default", "steady", {"scale": 0.1}),
        DetectorEntry("said", "steady", {"scale": 0.2}, "published"),
        DetectorEntry("said-each", "steady", {"scale": 0.2}, sources={"scale": "data sheet"}),
    ):
        run(replace(suite, detectors=(entry,)), tmp_path / entry.id)
    sources = {
        name: read_tasks(tmp_path / name)[0].parameter_sources
        for name in ("default", "said", "said-each")
    }
    assert sources == {
        "default": "{}",
        "said": '{"scale":"published"}',
        "said-each": '{"scale":"data sheet"}',
    }


def test_a_rate_that_the_suite_leaves_open_is_its_target(
    make_suite: MakeSuite, tmp_path: Path
) -> None:
    own = DetectorEntry("own", "rated", {"rate_per_hour": 9.0})
    run(make_suite(["rated", own, "steady"], []), tmp_path / "results")
    parameters = {task.detector: task.parameters for task in read_tasks(tmp_path / "results")}
    assert parameters == {
        "rated": '{"rate_per_hour":3.5,"scale":0.1}',
        "own": '{"rate_per_hour":9.0,"scale":0.1}',
        "steady": '{"scale":0.1}',
    }


@pytest.mark.parametrize(
    ("entry", "error", "words"),
    [
        (DetectorEntry("x", "staedy"), PluginError, "did you mean 'steady'"),
        (DetectorEntry("x", "steady", {"skale": 1.0}), SuiteError, "no parameter 'skale'"),
    ],
)
def test_a_mistake_in_the_suite_stops_the_run_at_once(
    make_suite: MakeSuite, tmp_path: Path, entry: DetectorEntry, error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words):
        run(make_suite(["steady", entry], []), tmp_path / "results")
    run(
        make_suite(["steady"], []), tmp_path / "results"
    )  # nothing is there yet that would have to be resumed


def test_results_are_not_overwritten(make_suite: MakeSuite, tmp_path: Path) -> None:
    run(make_suite(["steady"], []), tmp_path / "results")
    with pytest.raises(ResultsError, match="--resume"):
        run(make_suite(["steady"], []), tmp_path / "results")
    with pytest.raises(ResultsError, match="'fakes', not of 'others'"):
        run(make_suite(["steady"], [], name="others"), tmp_path / "results", resume=True)


def test_nothing_is_left_running_or_lying_about(
    make_suite: MakeSuite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    run(make_suite(["steady"], []), tmp_path / "results")
    assert [path.name for path in tmp_path.iterdir()] == ["results"]
    assert not [path for path in (tmp_path / "results").rglob("*") if path.name.startswith(".")]
    children = Path(f"/proc/self/task/{os.getpid()}/children")
    if children.exists():
        deadline = time.monotonic() + 10
        while children.read_text().split() and time.monotonic() < deadline:
            time.sleep(0.05)
        assert not children.read_text().split()


@pytest.mark.parametrize(("detector", "code"), [("steady", 0), ("raises", 3), ("demanding", 0)])
def test_the_exit_code_says_whether_tasks_failed(
    fakes: Path,
    logs: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    detector: str,
    code: int,
) -> None:
    """What was skipped or not modelled has not failed."""
    monkeypatch.setattr(cli, "_leaderboard", lambda folder: None)
    (tmp_path / "suite.toml").write_text(
        'name = "one"\nseed = 1\nduration_s = 20.0\nwarm_up_s = 10.0\ntarget_far_per_hour = 1.0\n'
        f'[[recordings]]\nid = "r"\npath = "{logs / "drive-1.mcap"}"\n'
        f'[[attacks]]\nname = "nudge"\n[[detectors]]\nname = "{detector}"\n'
    )
    words = ["run", str(tmp_path / "suite.toml"), "-o", str(tmp_path / "results")]
    try:
        ended = cli.app(words, standalone_mode=False)
    except SystemExit as end:
        ended = end.code
    assert (ended or 0) == code
    said = capsys.readouterr().err
    assert ("2 of 2 tasks failed, such as raises on r: RuntimeError" in said) == (code == 3)
