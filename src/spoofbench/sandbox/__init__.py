"""The one way to run code in a process of its own.

A sandbox starts the standard library's fork server in a clean environment and a private folder. The
server imports what workers need, once, and forks a worker in some 10 ms. A worker is given a
function and its arguments; it answers by records and raw bytes (see
:class:`~spoofbench.sandbox.channel.WorkerChannel`)::

    def double(channel, number):
        channel.send(status="ok", result=2 * number)

    with Sandbox() as sandbox, sandbox.start(double, 21) as worker:
        print(worker.receive(within_s=10.0)["result"])

A worker ends with its block, together with all that it started, and with the main process, however
that ends. What becomes of it, besides its answer: :class:`WorkerTimedOut`, :class:`WorkerDied` with
the exit status or signal, or ``MemoryError`` in its own code, beyond what
:func:`~spoofbench.sandbox.inside.limit_memory` has set.
"""

import contextlib
import os
import pickle
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Mapping
from multiprocessing import forkserver, reduction
from multiprocessing.connection import Connection, wait
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any, Concatenate, ParamSpec, Self, TypeVar

from spoofbench.errors import SpoofbenchError
from spoofbench.sandbox.channel import WorkerChannel, one_line
from spoofbench.sandbox.inside import MemoryMeter, Order, kill_group, limit_memory, peak_bytes

__all__ = [
    "MemoryMeter",
    "Sandbox",
    "SandboxLost",
    "Worker",
    "WorkerChannel",
    "WorkerDied",
    "WorkerTimedOut",
    "limit_memory",
    "one_line",
    "peak_bytes",
]

_KEPT_ENVIRONMENT = (
    "PATH", "HOME", "LANG", "LC_ALL", "LC_CTYPE", "TZ", "TMPDIR", "LD_LIBRARY_PATH",
    "DYLD_LIBRARY_PATH", "VIRTUAL_ENV"
)  # fmt: skip
_SETTINGS = {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMEXPR_NUM_THREADS": "1",
    # its own pool reserves a gigabyte of address space, and that is what is limited
    "ARROW_DEFAULT_MEMORY_POOL": "system",
    "MALLOC_ARENA_MAX": "2",  # so does every thread's arena, in parts of 64 MB
    "PYTHONHASHSEED": "0",
}
_SERVE = "from spoofbench.sandbox.inside import serve; serve({}, {}, {!r}, {!r})"
_GRACE_S = 10.0
_T = TypeVar("_T")
_P = ParamSpec("_P")


class WorkerDied(Exception):
    """A worker ended before it had answered; the text says how."""


class WorkerTimedOut(Exception):
    """A worker did not answer in time."""


class SandboxLost(SpoofbenchError):
    """The server of the worker processes has ended."""

    def __init__(self) -> None:
        super().__init__("the server of the worker processes has ended")


def no_preload() -> None:
    """Leave all imports to the workers."""


class Sandbox:
    """The server of worker processes, and its private folder; a context manager.

    It runs :func:`multiprocessing.forkserver.main` and asks it for workers itself. A
    :class:`multiprocessing.Process` would take the arguments, folder and main module of this
    program along, share one server in this program's environment with all others, and leave it and
    a resource tracker running.

    Args:
        preload: a function of a module, which imports what workers need; the server calls it once.
        environment: variables beyond the few that workers keep; None leaves one out.

    Attributes:
        folder: private to this sandbox; removed with it, even if the main process is killed.
    """

    def __init__(
        self,
        preload: Callable[[], object] = no_preload,
        environment: Mapping[str, str | None] = MappingProxyType({}),
    ) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="spoofbench-"))
        self._folder_fd = os.open(self.folder, os.O_RDONLY)
        self._null_fd = os.open(os.devnull, os.O_RDWR)
        self._lock, self._ended = threading.Lock(), False
        alive, self._alive_fd = os.pipe()
        with socket.socket(socket.AF_UNIX) as listener:
            listener.bind(self._address)
            listener.listen()
            serve = _SERVE.format(
                listener.fileno(), alive, preload.__module__, preload.__qualname__
            )
            self._server = subprocess.Popen(
                [sys.executable, "-P", "-c", serve],
                pass_fds=[listener.fileno(), alive],
                cwd=self.folder,
                env=_clean_environment(environment),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                start_new_session=True,
            )
        os.close(alive)

    @property
    def _address(self) -> str:
        """Path of the server's socket; a system allows some 100 characters, so it is short."""
        short = Path(f"/proc/self/fd/{self._folder_fd}")
        return str((short if short.exists() else self.folder) / "server")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        with self._lock:
            self._ended = True
            os.close(self._alive_fd)  # the server sees it, ends its workers, and ends
        try:
            self._server.wait(_GRACE_S)
        except subprocess.TimeoutExpired:
            self._server.kill()
            self._server.wait()
        os.close(self._null_fd)
        os.close(self._folder_fd)
        shutil.rmtree(self.folder, ignore_errors=True)

    def start(
        self,
        function: Callable[Concatenate[WorkerChannel, _P], None],
        *arguments: _P.args,
        **keywords: _P.kwargs,
    ) -> "Worker":
        """Call a function in a new process.

        It must be of a module that can be imported there, and its arguments such as can be pickled.

        Raises:
            SandboxLost: the server is gone.
        """
        order = Order(self._server.pid, pickle.dumps((function, arguments, keywords)))
        ours, theirs = socket.socketpair()
        (status, report), (orders, write_end) = os.pipe(), os.pipe()
        try:
            with self._lock, socket.socket(socket.AF_UNIX) as client:
                if self._ended:
                    raise ConnectionRefusedError
                client.connect(self._address)
                handed = [orders, report, self._alive_fd, self._null_fd, theirs.fileno()]
                reduction.sendfds(client, handed)
        except OSError as error:
            ours.close()
            for descriptor in (status, write_end):
                os.close(descriptor)
            raise SandboxLost from error
        finally:
            theirs.close()
            for descriptor in (orders, report):
                os.close(descriptor)
        with contextlib.suppress(BrokenPipeError), os.fdopen(write_end, "wb") as pipe:
            # what to prepare, which is nothing, and what to run
            pipe.write(pickle.dumps({}) + pickle.dumps(order))
        return Worker(ours.detach(), Connection(status, writable=False))


class Worker:
    """A process that was started; a context manager that ends it, and all that it started."""

    def __init__(self, connection: int, status: Connection) -> None:
        self._channel = WorkerChannel(connection)
        self._status = status
        self._ended = False
        try:
            self.pid = self._number()
        except SandboxLost:
            self._close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.end()

    def send(self, **record: Any) -> None:
        """Send a record; whether the worker gets it shows when it answers."""
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            self._channel.send(**record)

    def receive(self, within_s: float | None) -> dict[str, Any]:
        """Return the worker's next record; None waits for ever.

        Raises:
            WorkerDied: it ended, or sent something that is no record.
            WorkerTimedOut: it sent nothing in time.
            SandboxLost: the server is gone.
        """
        return self._receive(self._channel.receive, within_s)

    def receive_bytes(self, size: int, within_s: float | None) -> bytes:
        """Return a message of that many bytes.

        Raises:
            WorkerDied, WorkerTimedOut, SandboxLost: as :meth:`receive`.
        """
        return self._receive(lambda: self._channel.receive_bytes(size), within_s)

    def _receive(self, receive: Callable[[], _T], within_s: float | None) -> _T:
        if not wait([self._channel.connection, self._status], within_s):
            raise WorkerTimedOut(f"it took longer than {within_s:g} s")
        try:
            if self._channel.connection.poll():
                return receive()
        except (EOFError, ConnectionResetError):
            pass  # it has closed its end: how it ended follows
        except (OSError, ValueError) as error:
            raise WorkerDied("it disturbed the connection of its process") from error
        raise WorkerDied(self._ending())

    def _ending(self) -> str:
        if not wait([self._status], _GRACE_S):
            return "it closed the connection of its process"
        code = self._number()
        self._ended = True
        if code < 0:
            return f"its process was ended by {signal.Signals(-code).name}"
        return f"its process ended with exit status {code} before it had answered"

    def end(self) -> None:
        """End the process and its group, and wait until it is gone."""
        if self._status.closed:
            return
        kill_group(self.pid)
        if not self._ended:
            wait([self._status], _GRACE_S)
        self._close()

    def _close(self) -> None:
        self._channel.close()
        self._status.close()

    def _number(self) -> int:
        """Read the next number of the server: the process id, and later the exit status."""
        try:
            return int(forkserver.read_signed(self._status.fileno()))
        except EOFError:
            raise SandboxLost from None


def _clean_environment(further: Mapping[str, str | None]) -> dict[str, str]:
    """The few variables that workers keep, calm threads, and the way to all modules."""
    kept = {name: os.environ.get(name) for name in _KEPT_ENVIRONMENT}
    search = os.pathsep.join(str(Path(entry).absolute()) for entry in sys.path)
    environment = {**kept, **_SETTINGS, "PYTHONPATH": search, **further}
    return {name: value for name, value in environment.items() if value is not None}
