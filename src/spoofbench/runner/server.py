"""The server: a process that has imported everything heavy and forks workers on demand.

It never learns what its workers are to do: each worker reads its job from a connection of its own,
so what one worker knows (the truth) is not in the memory that another one (a detector's) inherits.
Its folder is private to one run; it removes it at the end.

A request is one byte with two file descriptors: the worker's connection and the write end of a
pipe, which gets the worker's process id and, when it has ended, its wait status (both int32).
"""

import contextlib
import gc
import importlib
import os
import selectors
import shutil
import signal
import socket
import struct
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NoReturn

from spoofbench import plugins
from spoofbench.runner import confine
from spoofbench.runner.talk import Talk, one_line

NUMBER = struct.Struct("<i")

_PRELOADED = (
    "numpy",
    "pyarrow.parquet",
    "pandas",
    "scipy.linalg",
    "scipy.signal",
    "scipy.stats",
    "spoofbench.scoring.grid",
    "spoofbench.codec",
)
_WORK: Mapping[str, str] = {
    "describe": "spoofbench.runner.describing",
    "prepare": "spoofbench.runner.preparing",
    "detect": "spoofbench.runner.grouping",
}


def main(control_fd: int, parent: int) -> None:
    """Serve until the other end of the control socket closes, then end all workers and remove the
    folder.
    """
    folder = Path.cwd()
    children: dict[int, int] = {}
    woken, wake = os.pipe()
    os.set_blocking(wake, False)
    signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
    for number in (
        signal.SIGTERM,
        signal.SIGCHLD,
    ):  # noted in the pipe: an exception could come in the middle of the tidying up
        signal.signal(number, lambda *_: None)
    try:
        confine.die_with(parent, signal.SIGTERM)
        for module in (*_PRELOADED, *_WORK.values()):
            importlib.import_module(module)
        plugins.found(plugins.DETECTORS)
        gc.freeze()
        _serve(socket.socket(fileno=control_fd), children, woken, wake)
    finally:
        for pid in children:
            _kill_group(pid)
        shutil.rmtree(folder, ignore_errors=True)


def _serve(control: socket.socket, children: dict[int, int], woken: int, wake: int) -> None:
    with selectors.DefaultSelector() as selector:
        selector.register(control, selectors.EVENT_READ)
        selector.register(woken, selectors.EVENT_READ)
        while True:
            ready = {key.fd for key, _ in selector.select()}
            if woken in ready:
                if signal.SIGTERM in os.read(woken, 4096):
                    return
                _reap(children)
            if control.fileno() in ready:
                request, handed, _, _ = socket.recv_fds(control, 1, 2)
                if not request:
                    return
                _fork(handed[0], handed[1], children, (control.fileno(), woken, wake, selector))


def _fork(connection: int, status: int, children: dict[int, int], own: tuple[Any, ...]) -> None:
    server = os.getpid()
    pid = os.fork()
    if pid == 0:
        *descriptors, selector = own
        selector.close()
        for descriptor in (*descriptors, status, *children.values()):
            os.close(descriptor)
        children.clear()
        _work(connection, server)
    _own_group(pid)
    os.close(connection)
    children[pid] = status
    os.write(status, NUMBER.pack(pid))


def _work(connection: int, server: int) -> NoReturn:
    """Be a worker: read the job, do it, end."""
    try:
        signal.set_wakeup_fd(-1)
        for number in (signal.SIGCHLD, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
        _own_group(0)
        confine.die_with(server, signal.SIGKILL)
        confine.silence()
        talk = Talk.of(connection)
        job = talk.receive()
        work: Callable[..., None] = importlib.import_module(_WORK[job.pop("work")]).work
        try:
            work(talk, **job)
        except Exception as error:  # noqa: BLE001, it may come from a plugin's code
            talk.send(status="failed", reason=one_line(error))
        os._exit(0)
    finally:
        os._exit(1)


def _own_group(pid: int) -> None:
    """Give a worker a process group of its own, so that what it starts can be ended with it."""
    with contextlib.suppress(
        PermissionError, ProcessLookupError
    ):  # it has done so itself, or has ended
        os.setpgid(pid, pid)


def _reap(children: dict[int, int]) -> None:
    """Report the workers that have ended, and end what they left running."""
    for pid, status in list(children.items()):
        ended, wait_status = os.waitpid(pid, os.WNOHANG)
        if not ended:
            continue
        _kill_group(pid)
        with contextlib.suppress(BrokenPipeError):  # nobody waits for this worker any more
            os.write(status, NUMBER.pack(wait_status))
        os.close(status)
        del children[pid]


def _kill_group(pid: int) -> None:
    with contextlib.suppress(
        PermissionError, ProcessLookupError
    ):  # macOS says EPERM for a group of ended processes
        os.killpg(pid, signal.SIGKILL)
