"""A run that was killed goes on where it stood, and ends as if nothing had happened."""

import os
import pickle
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from spoofbench.decisions import OutcomeLog, OutcomeReader
from spoofbench.results import TaskOutcome, read_parquet, read_tasks
from spoofbench.runner import run
from spoofbench.suite import AttackEntry, DetectorEntry, Suite

MakeSuite = Callable[..., Suite]
Start = Callable[[Suite, Path], "subprocess.Popen[str]"]
PATIENCE_S = 60.0
END_OF_STREAM = b"\xff\xff\xff\xff\0\0\0\0"
needs_proc = pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs /proc")

SCRIPT = """
import pickle, signal, sys
from pathlib import Path
from spoofbench.errors import ResultsError
from spoofbench.runner import run
signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job ignores it
try:
    run(pickle.loads(Path(sys.argv[1]).read_bytes()), Path(sys.argv[2]), workers=2)
except ResultsError as error:
    sys.exit(str(error))
"""


def contents(folder: Path) -> dict[str, bytes]:
    """All files of a results folder but the costs."""
    paths = [
        path
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "costs.parquet"
    ]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, "it never happened"
        time.sleep(0.02)


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] not in "ZX"
    except OSError:
        return False


def children(pid: int) -> list[int]:
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((path / "stat").read_text().rsplit(")", 1)[1].split()[1])
        except OSError:
            continue
        found += [int(path.name)] if parent == pid else []
    return found


def descendants(pid: int) -> list[int]:
    return [pid for child in children(pid) for pid in (child, *descendants(child))]


@pytest.fixture(scope="module")
def slow(make_suite: MakeSuite) -> Suite:
    attacks = [
        AttackEntry(f"nudge-{shift}", "nudge", {"shift_deg": float(shift)}) for shift in (1, 2, 3)
    ]
    return make_suite(
        ["slow", "raises", DetectorEntry("slower", "slow", {"pause_s": 0.5})], attacks
    )


@pytest.fixture(scope="module")
def unbroken(slow: Suite, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("unbroken")
    run(slow, folder, workers=2)
    return folder


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Start a run in a process of its own."""
    started = []

    def start(suite: Suite, folder: Path) -> "subprocess.Popen[str]":
        (tmp_path / "suite.pickle").write_bytes(pickle.dumps(suite))
        (tmp_path / "temporary").mkdir(exist_ok=True)
        environment = os.environ | {
            "PYTHONPATH": os.pathsep.join(sys.path),
            "TMPDIR": str(tmp_path / "temporary"),
        }
        command = [sys.executable, "-c", SCRIPT, str(tmp_path / "suite.pickle"), str(folder)]
        started.append(
            subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)
        )
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.wait()
        if process.stderr:
            process.stderr.close()


def decided(folder: Path) -> int:
    """How many tasks have an outcome while a run is under way."""
    log = folder / "decisions" / "unsorted.arrows"
    return log.read_bytes().count(END_OF_STREAM) if log.exists() else 0


def log_of(folder: Path) -> bytes:
    return (folder / "decisions" / "unsorted.arrows").read_bytes()


def counted(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The tasks that get an outcome from now on."""
    ids: list[str] = []
    add = OutcomeLog.add

    def counting(log: OutcomeLog, task_id: str, outcome: TaskOutcome) -> None:
        ids.append(task_id)
        add(log, task_id, outcome)

    monkeypatch.setattr(OutcomeLog, "add", counting)
    return ids


@needs_proc
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_a_killed_and_resumed_run_equals_an_unbroken_one(
    slow: Suite,
    unbroken: Path,
    start: Start,
    tmp_path: Path,
    number: signal.Signals,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    broken = tmp_path / "broken"
    process = start(slow, broken)
    until(lambda: decided(broken) >= 3)
    family = descendants(process.pid)
    process.send_signal(number)
    process.communicate()
    assert family
    until(lambda: not any(alive(pid) for pid in family))
    until(lambda: not list((tmp_path / "temporary").iterdir()))
    done = {
        task.task_id
        for task in read_tasks(unbroken)
        if OutcomeLog(broken).status(task.task_id) is not None
    }
    assert 3 <= len(done) < len(read_tasks(unbroken))
    with (broken / "decisions" / "unsorted.arrows").open("ab") as log:
        log.write(log_of(broken)[:200])
    (broken / "decisions" / ".drive-1.parquet.part").write_bytes(b"cut short")
    again = counted(monkeypatch)
    run(slow, broken, workers=1, resume=True)
    assert not done & set(again), "what was done is not done again"
    assert contents(broken) == contents(unbroken)
    assert len(read_parquet(broken / "costs.parquet")) == len(read_tasks(broken))


@needs_proc
@pytest.mark.parametrize("victim", ["main process", "server"])
def test_workers_that_never_answer_die_with_whoever_is_killed(
    make_suite: MakeSuite, start: Start, tmp_path: Path, victim: str
) -> None:
    process = start(make_suite(["sleeps", "steady"]), tmp_path / "results")
    until(lambda: decided(tmp_path / "results") == 2)  # steady is done, so the other worker sleeps
    (server,) = children(process.pid)
    until(lambda: len(children(server)) == 1 and bool(descendants(children(server)[0])))
    family = descendants(process.pid)
    os.kill(process.pid if victim == "main process" else server, signal.SIGKILL)
    _, complaint = process.communicate(timeout=PATIENCE_S)
    if victim == "server":
        assert process.returncode == 1
        assert complaint.strip() == (
            "the server of the worker processes has ended; run again with --resume to do what is "
            "missing"
        )
    until(lambda: not any(alive(pid) for pid in family))
    until(lambda: not list((tmp_path / "temporary").iterdir()))
    assert decided(tmp_path / "results") == 2, "a task that was under way has no outcome"


def test_resuming_a_finished_run_changes_nothing(make_suite: MakeSuite, tmp_path: Path) -> None:
    suite = make_suite(["steady", "raises"])
    run(suite, tmp_path / "results")
    before = {
        path: (path.stat().st_ino, path.read_bytes())
        for path in (tmp_path / "results" / "decisions").iterdir()
    }
    costs, rest = (
        (tmp_path / "results" / "costs.parquet").read_bytes(),
        contents(tmp_path / "results"),
    )
    run(suite, tmp_path / "results", resume=True)
    assert {path: (path.stat().st_ino, path.read_bytes()) for path in before} == before
    assert contents(tmp_path / "results") == rest
    assert (tmp_path / "results" / "costs.parquet").read_bytes() == costs


def test_a_suite_that_grew_runs_what_is_new_and_one_that_shrank_drops_what_is_old(
    make_suite: MakeSuite, tmp_path: Path
) -> None:
    small, large = (
        make_suite(["steady"]),
        make_suite(["steady", "rated"], ["nudge", AttackEntry("far", "nudge", {"shift_deg": 9.0})]),
    )
    run(large, tmp_path / "large")
    run(small, tmp_path / "results")
    run(large, tmp_path / "results", resume=True)
    assert contents(tmp_path / "results") == contents(tmp_path / "large")
    run(small, tmp_path / "large", resume=True)
    run(small, tmp_path / "small")
    assert contents(tmp_path / "large") == contents(tmp_path / "small")


def test_failures_are_kept_until_they_are_to_be_tried_again(
    make_suite: MakeSuite, tmp_path: Path
) -> None:
    hindrance = tmp_path / "hindrance"
    hindrance.touch()
    suite = make_suite([DetectorEntry("flaky", "flaky", {"hindrance": str(hindrance)})], [])

    def status() -> list[tuple[str, str | None]]:
        return [(task.status, task.reason) for task in read_tasks(tmp_path / "results")]

    run(suite, tmp_path / "results")
    assert status() == [("failed", "RuntimeError: hindered")]
    hindrance.unlink()
    run(suite, tmp_path / "results", resume=True)
    assert status() == [("failed", "RuntimeError: hindered")]
    run(suite, tmp_path / "results", resume=True, retry_failed=True)
    assert status() == [("ok", None)]


@pytest.mark.parametrize("part", ["decisions", "truth"])
def test_a_damaged_file_is_made_again(make_suite: MakeSuite, tmp_path: Path, part: str) -> None:
    suite = make_suite(["steady"])
    run(suite, tmp_path / "results")
    before = contents(tmp_path / "results")
    victim = next((tmp_path / "results" / part).iterdir())
    if part == "decisions":
        victim.write_bytes(victim.read_bytes()[:100])
    else:
        victim.unlink()
    run(suite, tmp_path / "results", resume=True)
    assert contents(tmp_path / "results") == before


def test_a_changed_recording_is_run_anew(make_suite: MakeSuite, logs: Path, tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    path.write_bytes((logs / "drive-1.mcap").read_bytes())
    suite = make_suite(["steady"], recordings={"log": path})
    run(suite, tmp_path / "results")
    first = {task.task_id for task in read_tasks(tmp_path / "results")}
    path.write_bytes((logs / "drive-2.mcap").read_bytes())
    run(suite, tmp_path / "results", resume=True)
    second = {task.task_id for task in read_tasks(tmp_path / "results")}
    assert not first & second
    assert set(OutcomeReader(tmp_path / "results" / "decisions" / "log.parquet")) == second
