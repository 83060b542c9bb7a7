"""A converter of logs that start with ``steps``: each further letter is a row, ``!`` none, and some
do harm.
"""

import os
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from spoofbench.conversion import Block, Item, Reject, Source
from spoofbench.table import Table

VERSION = "1"
UNIT = "bytes"


@dataclass(frozen=True)
class Options:
    date: str | None = None


def sniff(source: Source) -> float:
    if source.path.is_dir():
        return float("one log" in source.members())
    return float(source.head.startswith(b"steps"))


def convert(source: Source, options: Options) -> Iterator[Item]:
    if source.path.is_dir():
        yield _rows(0, 1, sum(member.size for member in source.members().values()))
        return
    with source.open() as file:
        yield Reject(0, len(file.read(5)), "the head")
        offset = 0
        while letter := file.read(1):
            if letter == b"D":
                os.kill(os.getpid(), signal.SIGKILL)
            if letter == b"W":
                time.sleep(60)
            if letter == b"L":
                return
            yield Reject(offset + 5, 1, "junk") if letter == b"!" else _rows(offset, 1, 1)
            offset += 1


def _rows(first: int, count: int, used: int) -> Block:
    times = 1_700_000_000_000_000_000 + np.arange(first, first + count)
    return Block("/imu0/imu", Table("imu", times, {"accel_x_mps2": np.zeros(count)}), used)
