"""What happens within the processes of a sandbox: the server that forks, and a worker that limits
and measures itself.

Linux has all of it. Elsewhere a thread watches the parent, memory is neither limited nor measured,
and what a worker started may outlive a main process that was killed.
"""

import atexit
import contextlib
import ctypes
import gc
import importlib
import os
import pickle
import resource
import shutil
import signal
import sys
import threading
import time
from dataclasses import dataclass
from multiprocessing import forkserver
from pathlib import Path

from spoofbench.sandbox.channel import WorkerChannel, one_line

_PR_SET_PDEATHSIG = 1
_LINUX = sys.platform == "linux"
_WATCH_S = 0.5
_PATIENCE_S = 2.0


def serve(listener: int, alive: int, module: str, preload: str) -> None:
    """Call a function that imports what workers need, and fork them until the main process is gone.

    The folder that the server was started in is private to it; it goes with the server.
    """
    atexit.register(_tidy_up, Path.cwd())
    getattr(importlib.import_module(module), preload)()
    gc.freeze()
    forkserver.main(listener, alive, [])


def _tidy_up(folder: Path) -> None:
    """End the workers that are left, with all that they started: politely first, so that they can
    remove what is half written.
    """
    groups = _children()
    for number, patience_s in ((signal.SIGTERM, _PATIENCE_S), (signal.SIGKILL, 0.0)):
        for pid in groups:
            kill_group(pid, number)
        until = time.monotonic() + patience_s
        while time.monotonic() < until and _any_left():
            time.sleep(0.01)
    shutil.rmtree(folder, ignore_errors=True)


def _children() -> list[int]:
    listing = Path(f"/proc/self/task/{os.getpid()}/children")
    return [int(pid) for pid in listing.read_text().split()] if listing.exists() else []


def _any_left() -> bool:
    try:
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass
    except ChildProcessError:
        return False
    return True


def kill_group(pid: int, number: signal.Signals = signal.SIGKILL) -> None:
    """Send a signal to a worker and all that it started."""
    for kill in (os.killpg, os.kill):  # it may not have its group yet
        # macOS says EPERM for a group of ended processes
        with contextlib.suppress(ProcessLookupError, PermissionError):
            kill(pid, number)


@dataclass(frozen=True, slots=True)
class Order:
    """What the server's child unpickles and runs, in the place of a
    :class:`multiprocessing.Process`.

    Attributes:
        server: process id of the server.
        call: pickle of a function, its arguments beyond the channel, and its keywords.
    """

    server: int
    call: bytes

    def _bootstrap(self, parent_sentinel: int) -> int:  # noqa: ARG002 - the server's word
        """Be a worker: leave all behind that is not its own, call the function, end."""
        with contextlib.suppress(PermissionError):
            os.setpgid(0, 0)  # a group, so that what it starts can be ended with it
        (connection,) = forkserver.get_inherited_fds()  # type: ignore[misc]  # typeshed knows None
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        _die_with(self.server)
        os.closerange(3, connection)
        os.closerange(connection + 1, os.sysconf("SC_OPEN_MAX"))
        _silence()
        channel = WorkerChannel(connection)
        function, arguments, keywords = pickle.loads(self.call)
        try:
            function(channel, *arguments, **keywords)
        except Exception as error:  # noqa: BLE001 - it may come from a plugin's code
            channel.send(status="failed", reason=one_line(error))
        return 0


def _die_with(parent: int) -> None:
    """End as soon as the parent process ends, however it ends."""
    if _LINUX:
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL))
    else:
        threading.Thread(target=_watch, args=(parent,), daemon=True).start()
    if os.getppid() != parent:
        os.kill(os.getpid(), signal.SIGKILL)


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_WATCH_S)
    os.kill(os.getpid(), signal.SIGKILL)


def _silence() -> None:
    """Turn standard input, output and error away, and leave no core file after a crash."""
    void = os.open(os.devnull, os.O_RDWR)
    for standard in (0, 1, 2):
        os.dup2(void, standard)
    os.close(void)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def limit_memory(growth_bytes: int) -> None:
    """Let the address space grow by no more than this from now on; beyond it an allocation is a
    MemoryError.
    """
    if _LINUX:
        limit = _pages()[0] * resource.getpagesize() + growth_bytes
        hard = resource.getrlimit(resource.RLIMIT_AS)[1]
        if hard == resource.RLIM_INFINITY or limit <= hard:
            resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


class MemoryMeter:
    """Measures how far resident memory has risen since the meter was made.

    A meter starts the peak anew, so there is one at a time in a process.
    """

    def __init__(self) -> None:
        self._start_bytes = 0
        if _LINUX:
            with contextlib.suppress(OSError):
                Path("/proc/self/clear_refs").write_text("5")
            self._start_bytes = _pages()[1] * resource.getpagesize()

    def growth_mb(self) -> float | None:
        """Return the peak over the start in MB; None where the system cannot tell."""
        if not _LINUX:
            return None
        return max(0.0, round((peak_bytes() - self._start_bytes) / 2**20, 3))


def peak_bytes() -> int:
    """Return the most memory that this process had resident.

    ``ru_maxrss`` alone would include the process that started it.
    """
    status = Path("/proc/self/status")
    if not status.exists():
        return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    lines = status.read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))


def _pages() -> tuple[int, int]:
    """Virtual and resident size of this process in pages."""
    virtual, resident = Path("/proc/self/statm").read_text().split()[:2]
    return int(virtual), int(resident)
