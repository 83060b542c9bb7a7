"""What code in a process of its own has, what becomes of it, and that it ends."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import sandboxed

from spoofbench.sandbox import Sandbox, SandboxLost, WorkerDied, WorkerTimedOut

PATIENCE_S = 60.0
needs_proc = pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs /proc")
needs_linux = pytest.mark.skipif(sys.platform != "linux", reason="needs Linux")


@pytest.fixture(scope="module")
def sandbox() -> Iterator[Sandbox]:
    with Sandbox(sandboxed.preload) as sandbox:
        yield sandbox


def ask(sandbox: Sandbox, function: Callable[..., None], *arguments: Any) -> dict[str, Any]:
    with sandbox.start(function, *arguments) as worker:
        return worker.receive(PATIENCE_S)


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] not in "ZX"
    except OSError:
        return False


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, "it never happened"
        time.sleep(0.02)


def test_a_function_answers_by_records_and_bytes(sandbox: Sandbox) -> None:
    assert ask(sandbox, sandboxed.double, 21) == {"result": 42}
    with sandbox.start(sandboxed.echo) as worker:
        for data in (b"", b"abc", bytes(range(256)) * 1000):
            worker.send(size=len(data))
            worker._channel.send_bytes(data)
            assert worker.receive_bytes(len(data), PATIENCE_S) == data[::-1]


@pytest.mark.parametrize(
    ("function", "how"),
    [
        (sandboxed.exit_with_three, "its process ended with exit status 3 before it had answered"),
        (sandboxed.read_where_nothing_is, "its process was ended by SIGSEGV"),
        (sandboxed.scribble, "it disturbed the connection of its process"),
    ],
)
def test_one_that_dies_says_how(sandbox: Sandbox, function: Callable[..., None], how: str) -> None:
    with pytest.raises(WorkerDied) as death:
        ask(sandbox, function)
    assert str(death.value) == how
    assert ask(sandbox, sandboxed.double, 1) == {"result": 2}, "its neighbours do not notice"


def test_an_error_is_one_line_without_folders(sandbox: Sandbox) -> None:
    assert ask(sandbox, sandboxed.raise_error) == {
        "status": "failed",
        "reason": "ValueError: no such file: sandboxed.py in two lines",
    }


def test_a_record_that_is_no_record_is_not_taken_for_one(sandbox: Sandbox) -> None:
    with sandbox.start(sandboxed.say_yes_for_ever) as worker:
        assert worker.receive(PATIENCE_S) == {"yes": True}
        with pytest.raises(WorkerDied, match="disturbed"):
            worker.receive_bytes(3, PATIENCE_S)


@needs_proc
def test_one_that_does_not_answer_ends_with_all_that_it_started(sandbox: Sandbox) -> None:
    with sandbox.start(sandboxed.sleep_in_company) as worker:
        pids = worker.receive(PATIENCE_S)["pids"]
        with pytest.raises(WorkerTimedOut, match=r"it took longer than 0\.2 s"):
            worker.receive(0.2)
        assert all(alive(pid) for pid in pids)
    until(lambda: not any(alive(pid) for pid in pids))
    pid = ask(sandbox, sandboxed.leave_somebody)["pid"]
    until(lambda: not alive(pid))


def test_a_worker_has_nothing_of_the_main_process(
    sandbox: Sandbox, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SPOOFBENCH_HINT", "a hint")
    monkeypatch.setattr(sys, "argv", ["a", "telling", "argument"])
    with Sandbox(environment={"GIVEN": "yes", "MALLOC_ARENA_MAX": None}) as other:
        said = ask(other, sandboxed.say_where)
    assert said["folder"] == os.path.realpath(other.folder)
    assert said["arguments"] == ["-c"]
    assert said["main"] is None
    assert len(said["descriptors"]) == 4, "standard ones and its connection"
    assert said["environment"]["GIVEN"] == "yes"
    assert not {"SPOOFBENCH_HINT", "MALLOC_ARENA_MAX"} & said["environment"].keys()
    assert not other.folder.exists()


def test_the_server_preloads_once(sandbox: Sandbox) -> None:
    for _ in range(2):
        assert ask(sandbox, sandboxed.say_what_is_loaded) == {"loaded": ["once"], "numpy": True}
    assert sandboxed.loaded == [], "not in the main process"


@needs_linux
def test_memory_is_limited_as_growth_and_measured(sandbox: Sandbox) -> None:
    assert ask(sandbox, sandboxed.allocate, 256, 400) == {"fits": False}
    said = ask(sandbox, sandboxed.allocate, 256, 128)
    assert said["fits"]
    assert 120 < said["growth_mb"] < 140


def test_starting_is_cheap(sandbox: Sandbox) -> None:
    ask(sandbox, sandboxed.double, 1)
    start = time.perf_counter()
    for number in range(20):
        ask(sandbox, sandboxed.double, number)
    assert time.perf_counter() - start < 20 * 0.25, "a process that imports numpy takes longer"


@needs_proc
def test_a_sandbox_ends_its_workers_and_leaves_nothing(tmp_path: Path) -> None:
    with Sandbox() as sandbox:
        worker = sandbox.start(sandboxed.sleep_in_company)
        pids = worker.receive(PATIENCE_S)["pids"]
    until(lambda: not any(alive(pid) for pid in pids))
    assert not sandbox.folder.exists()
    with pytest.raises(SandboxLost):
        sandbox.start(sandboxed.double, 1)
    with pytest.raises((SandboxLost, WorkerDied)):
        worker.receive(PATIENCE_S)
    worker.end()


SCRIPT = """
import sys, time
from pathlib import Path
import sandboxed
from spoofbench.sandbox import Sandbox

with Sandbox() as sandbox, sandbox.start(sandboxed.sleep_in_company) as worker:
    pids = [*worker.receive(60.0)["pids"], sandbox._server.pid]
    print(*pids, sandbox.folder, flush=True)
    worker.receive(None)
"""


@needs_proc
@pytest.mark.parametrize("victim", ["main process", "server"])
def test_workers_end_with_whoever_is_killed(victim: str) -> None:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(
        [sys.executable, "-c", SCRIPT],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    ) as process:
        assert process.stdout is not None
        *numbers, folder = process.stdout.readline().split()
        pids = [int(number) for number in numbers]
        os.kill(process.pid if victim == "main process" else pids[-1], signal.SIGKILL)
        _, complaint = process.communicate(timeout=PATIENCE_S)
        until(lambda: not any(alive(pid) for pid in pids))
        until(lambda: not Path(folder).exists())
    if victim == "server":
        assert complaint.strip().endswith("the server of the worker processes has ended")


def test_a_script_needs_no_guard(tmp_path: Path) -> None:
    """Workers do not import the main module."""
    script = tmp_path / "script.py"
    script.write_text(
        "import sandboxed\n"
        "from spoofbench.sandbox import Sandbox\n"
        "with Sandbox() as sandbox, sandbox.start(sandboxed.double, 4) as worker:\n"
        "    print(worker.receive(60.0)['result'])\n"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, env=environment, check=True
    )
    assert done.stdout == "8\n"
