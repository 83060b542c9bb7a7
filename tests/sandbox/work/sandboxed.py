"""What the workers of the tests of the sandbox do."""

import ctypes
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from spoofbench.sandbox import MemoryMeter, WorkerChannel, limit_memory

MB = 1 << 20


def double(channel: WorkerChannel, number: int) -> None:
    channel.send(result=2 * number)


def echo(channel: WorkerChannel) -> None:
    while True:
        size = channel.receive()["size"]
        channel.send_bytes(channel.receive_bytes(size)[::-1])


def raise_error(channel: WorkerChannel) -> None:
    raise ValueError(f"no such file: {Path(__file__).absolute()}\nin two lines")


def exit_with_three(channel: WorkerChannel) -> None:
    os._exit(3)


def read_where_nothing_is(channel: WorkerChannel) -> None:
    ctypes.string_at(0)


def sleep_in_company(channel: WorkerChannel) -> None:
    """Do not listen to polite signals, and have somebody wait as well."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    other = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
    channel.send(pids=[os.getpid(), other.pid])
    while True:
        time.sleep(60)


def leave_somebody(channel: WorkerChannel) -> None:
    channel.send(pid=subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"]).pid)


def scribble(channel: WorkerChannel) -> None:
    for descriptor in range(3, 64):
        try:
            os.write(descriptor, b'\x00\x00\x00\x05{"a":' * 8)
        except OSError:
            continue


def say_where(channel: WorkerChannel) -> None:
    open_ones = []
    for descriptor in range(256):
        try:
            os.fstat(descriptor)
        except OSError:
            continue
        open_ones.append(descriptor)
    channel.send(
        folder=str(Path.cwd()),
        arguments=sys.argv,
        environment=dict(os.environ),
        main=getattr(sys.modules["__main__"], "__file__", None),
        descriptors=open_ones,
    )


def allocate(channel: WorkerChannel, limit_mb: int, wanted_mb: int) -> None:
    limit_memory(limit_mb * MB)
    meter = MemoryMeter()
    try:
        np.ones(wanted_mb * MB // 8)
    except MemoryError:
        channel.send(fits=False)
    else:
        channel.send(fits=True, growth_mb=meter.growth_mb())


def say_yes_for_ever(channel: WorkerChannel) -> None:
    while True:
        channel.send(yes=True)


loaded: list[str] = []


def preload() -> None:
    loaded.append("once")


def say_what_is_loaded(channel: WorkerChannel) -> None:
    channel.send(loaded=loaded, numpy="numpy" in sys.modules)
