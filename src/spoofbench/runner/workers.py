"""The main process's side of its workers: start the server, fork a worker, hear what it says or how
it ended.
"""

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection, wait
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

from spoofbench.detector import Decisions
from spoofbench.errors import ResultsError
from spoofbench.runner.server import NUMBER
from spoofbench.runner.talk import Talk

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
_GRACE_S = 10.0
_T = TypeVar("_T")


class Died(Exception):
    """A worker ended before it had said all; the text says how."""


class TimedOut(Exception):
    """A worker was ended because it said nothing for too long."""


class Server:
    """The forking server and its private folder; a context manager."""

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="spoofbench-"))
        self._control, theirs = socket.socketpair()
        self._lock = threading.Lock()
        search = [str(Path(entry).absolute()) for entry in sys.path]
        environment = {name: os.environ[name] for name in _KEPT_ENVIRONMENT if name in os.environ}
        environment |= _SETTINGS | {"PYTHONPATH": os.pathsep.join(search)}
        with theirs:
            self._process = subprocess.Popen(
                [
                    sys.executable,
                    "-P",
                    "-m",
                    "spoofbench.runner",
                    str(theirs.fileno()),
                    str(os.getpid()),
                ],
                pass_fds=[theirs.fileno()],
                cwd=self.folder,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                start_new_session=True,
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._control.close()
        try:
            self._process.wait(_GRACE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        shutil.rmtree(self.folder, ignore_errors=True)

    def fork(self) -> "Worker":
        """Return a new worker.

        Raises:
            ResultsError: the server is gone.
        """
        ours, theirs = socket.socketpair()
        status, report = os.pipe()
        try:
            with self._lock:
                socket.send_fds(self._control, [b"f"], [theirs.fileno(), report])
        except OSError as error:
            raise lost() from error
        finally:
            theirs.close()
            os.close(report)
        return Worker(Talk.of(ours.detach()), Connection(status, writable=False))


def lost() -> ResultsError:
    return ResultsError(
        "the server of the worker processes has ended; run again with --resume to do what is "
        "missing"
    )


class Worker:
    """A forked process; a context manager that ends it, and whatever it started."""

    def __init__(self, talk: Talk, status: Connection) -> None:
        self.talk = talk
        self._status = status
        self._ended = False
        self._pid = self._number()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.end()

    def say(self, **record: Any) -> None:
        """Send a record; whether the worker hears it shows when it answers."""
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            self.talk.send(**record)

    def hear(self, within_s: float) -> dict[str, Any]:
        """Return the worker's next record.

        Raises:
            Died: it ended, or said something that is no record.
            TimedOut: it said nothing in time.
            ResultsError: the server is gone.
        """
        return self._hear(self.talk.receive, within_s)

    def hear_decisions(self, rows: Any, within_s: float) -> Decisions:
        """Return the decisions that follow a record.

        Raises:
            PluginError: they are no decisions.
            Died, TimedOut, ResultsError: as :meth:`hear`.
        """
        return self._hear(lambda: self.talk.receive_decisions(rows), within_s)

    def _hear(self, receive: Callable[[], _T], within_s: float) -> _T:
        if not wait([self.talk.connection, self._status], within_s):
            raise TimedOut(f"it took longer than {within_s:g} s")
        try:
            if self.talk.connection.poll():
                return receive()
        except (EOFError, ConnectionResetError):
            pass  # it has closed its end: how it ended follows
        except (OSError, ValueError) as error:
            raise Died("it disturbed the connection of its process") from error
        raise Died(self._ending())

    def end(self) -> None:
        """End the process and its group, and wait until they are gone."""
        if self._status.closed:
            return
        if not self._ended and not (
            self._status.poll() and os.read(self._status.fileno(), NUMBER.size)
        ):
            for kill in (os.killpg, os.kill):  # it may not have its group yet
                with contextlib.suppress(ProcessLookupError, PermissionError):
                    kill(self._pid, signal.SIGKILL)
            wait([self._status], _GRACE_S)
        self.talk.connection.close()
        self._status.close()

    def _ending(self) -> str:
        if not wait([self._status], _GRACE_S):
            return "it closed the connection of its process"
        code = os.waitstatus_to_exitcode(self._number())
        self._ended = True
        if code < 0:
            return f"its process was ended by {signal.Signals(-code).name}"
        return f"its process ended with exit status {code} before it had answered"

    def _number(self) -> int:
        data = os.read(self._status.fileno(), NUMBER.size)
        if len(data) < NUMBER.size:
            raise lost()
        number: int = NUMBER.unpack(data)[0]
        return number
