"""A worker of the fuzzer that fails, dies and hangs."""

import os
import time
from collections.abc import Sequence

from spoofbench.sandbox import WorkerChannel


def misbehave(
    channel: WorkerChannel, target: str, seeds: Sequence[bytes], seed: int, first: int
) -> None:
    """Fail on input 1, die on 2, hang on 3, go on from 4."""
    for turn in range(first, 6):
        if turn == 2:
            os._exit(7)
        if turn == 3:
            time.sleep(60)
        signature = "ValueError in nmea.py:read" if turn == 1 else None
        channel.send(peak_bytes=turn, signature=signature, text="a traceback")
    time.sleep(60)
