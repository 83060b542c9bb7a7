"""What a worker process does to itself: die with its parent, keep to its memory, and know what it
took.

Linux has all of it; elsewhere the parent is watched by a thread, and memory is neither limited nor
measured.
"""

import contextlib
import ctypes
import os
import resource
import signal
import sys
import threading
import time
from pathlib import Path

_PR_SET_PDEATHSIG = 1
_LINUX = sys.platform == "linux"
_WATCH_S = 0.5


def die_with(parent: int, how: signal.Signals) -> None:
    """Get a signal as soon as the parent process ends, however it ends."""
    if _LINUX:
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(how))
    else:
        threading.Thread(target=_watch, args=(parent, how), daemon=True).start()
    if os.getppid() != parent:
        os.kill(os.getpid(), how)


def _watch(parent: int, how: signal.Signals) -> None:
    while os.getppid() == parent:
        time.sleep(_WATCH_S)
    os.kill(os.getpid(), how)


def silence() -> None:
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
        with contextlib.suppress(ValueError):  # a lower limit is in force already
            resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


class MemoryMeter:
    """Measures the peak of resident memory over where it stood at the start, in MB; None where the
    system cannot tell.
    """

    def __init__(self) -> None:
        self._start = 0
        if _LINUX:
            with contextlib.suppress(OSError):
                Path("/proc/self/clear_refs").write_text("5")  # the peak starts anew
            self._start = _pages()[1] * resource.getpagesize()

    def growth_mb(self) -> float | None:
        if not _LINUX:
            return None
        status = Path("/proc/self/status").read_text()
        peak_kb = next(
            int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM")
        )
        return max(0.0, round((peak_kb * 1024 - self._start) / 2**20, 3))


def _pages() -> tuple[int, int]:
    """Virtual and resident size of this process in pages."""
    virtual, resident = Path("/proc/self/statm").read_text().split()[:2]
    return int(virtual), int(resident)
