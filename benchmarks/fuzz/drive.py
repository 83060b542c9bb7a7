"""Workers that make inputs and try them, and threads that watch that none hangs."""

import hashlib
import os
import time
import traceback
import warnings
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.fuzz.mutate import TOKENS, mutate
from benchmarks.fuzz.targets import check
from spoofbench import plugins
from spoofbench.sandbox import (
    Sandbox,
    WorkerChannel,
    WorkerDied,
    WorkerTimedOut,
    limit_memory,
    peak_bytes,
)

MEMORY_BYTES = 2**30
INPUT_S = 20.0
_KEPT = 3


@dataclass
class FuzzFindings:
    """What fuzzing of a target gave: inputs tried, seconds, failures by signature, peak memory of a
    worker.
    """

    target: str
    inputs: int = 0
    seconds: float = 0.0
    peak_bytes: int = 0
    failures: dict[str, int] = field(default_factory=dict)

    @property
    def failed(self) -> int:
        return sum(self.failures.values())

    def add(self, other: "FuzzFindings") -> None:
        """Add what another worker found."""
        self.inputs += other.inputs
        self.peak_bytes = max(self.peak_bytes, other.peak_bytes)
        for signature, times in other.failures.items():
            self.failures[signature] = self.failures.get(signature, 0) + times


def make(seeds: Sequence[bytes], target: str, seed: int, turn: int) -> bytes:
    """Return the input of a turn: the same for the same seeds, seed and turn."""
    rng = np.random.default_rng([seed, turn])
    log = seeds[int(rng.integers(len(seeds)))]
    return log if turn < 2 else mutate(rng, log, seeds, TOKENS.get(target, TOKENS["table"]))


def fuzz(
    target: str,
    seeds: Sequence[bytes],
    seconds: float,
    corpus: Path,
    workers: int = 2,
    seed: int = 0,
) -> FuzzFindings:
    """Try inputs for some seconds; save failing ones to the corpus, three of each kind a worker."""
    found, begin = FuzzFindings(target), time.monotonic()
    end = begin + seconds
    with ThreadPoolExecutor(workers) as pool, Sandbox(_preload) as sandbox:
        streams = [_Stream(target, seeds, seed + number, corpus) for number in range(workers)]
        for one in pool.map(lambda stream: stream.follow(sandbox, end), streams):
            found.add(one)
    found.seconds = time.monotonic() - begin
    return found


def _preload() -> None:
    """Import what a worker needs, which this module does, and the converters."""
    for plugin in plugins.found(plugins.CONVERTERS).values():
        plugin.load()


class _Stream:
    """One stream of inputs; it goes on in another worker where one hangs or dies."""

    def __init__(self, target: str, seeds: Sequence[bytes], seed: int, corpus: Path) -> None:
        self._target, self._seeds, self._seed, self._corpus = target, seeds, seed, corpus
        self._found = FuzzFindings(target)

    def follow(self, sandbox: Sandbox, end: float) -> FuzzFindings:
        """Have inputs tried until :func:`time.monotonic` is ``end``."""
        while time.monotonic() < end:
            first = self._found.inputs
            with sandbox.start(_try, self._target, self._seeds, self._seed, first) as worker:
                try:
                    while (left_s := end - time.monotonic()) > 0:
                        self._take(worker.receive(min(INPUT_S, left_s)))
                except WorkerTimedOut:
                    if left_s > INPUT_S:
                        self._fail(f"hang of more than {INPUT_S:g} s", "")
                except WorkerDied as error:
                    self._fail(str(error), "")
        return self._found

    def _take(self, record: dict[str, Any]) -> None:
        self._found.peak_bytes = max(self._found.peak_bytes, record["peak_bytes"])
        if record["signature"] is None:
            self._found.inputs += 1
        else:
            self._fail(record["signature"], record["text"])

    def _fail(self, signature: str, text: str) -> None:
        """Note that the input under way failed, and go on to the next."""
        turn, failures = self._found.inputs, self._found.failures
        self._found.inputs += 1
        failures[signature] = failures.get(signature, 0) + 1
        if failures[signature] <= _KEPT:
            kind = hashlib.sha256(signature.encode()).hexdigest()[:8]
            path = self._corpus / f"{self._target}-{kind}-{self._seed}-{turn}"
            self._corpus.mkdir(parents=True, exist_ok=True)
            path.write_bytes(make(self._seeds, self._target, self._seed, turn))
            path.with_name(f"{path.name}.txt").write_text(f"{signature}\n{text}", encoding="utf-8")


def _try(
    channel: WorkerChannel, target: str, seeds: Sequence[bytes], seed: int, first: int
) -> None:
    """Try inputs from a turn on, for ever, and say of each what came of it."""
    warnings.simplefilter("ignore")
    limit_memory(MEMORY_BYTES)
    base = peak_bytes()
    folder = Path(str(os.getpid()))  # of the sandbox's, which goes with it
    folder.mkdir()
    path = folder / "log"
    for turn in count(first):
        path.write_bytes(make(seeds, target, seed, turn))
        signature, text = None, ""
        try:
            check(target, path, turn)
        except Exception as error:  # noqa: BLE001 - that is what is looked for
            signature, text = _signature(error), traceback.format_exc()
        channel.send(peak_bytes=peak_bytes() - base, signature=signature, text=text)


def _signature(error: BaseException) -> str:
    """Return what tells failures apart: the kind of the first cause, and where our code was."""
    cause = error
    while cause.__cause__ is not None:
        cause = cause.__cause__
    places = [
        frame
        for frame in traceback.extract_tb(cause.__traceback__)
        if "spoofbench" in frame.filename
    ]
    place = f"{Path(places[-1].filename).name}:{places[-1].name}" if places else "?"
    text = (
        str(cause).partition(":")[0][:60]
        if type(cause).__name__ in ("Broken", "CheckFailed")
        else ""
    )
    return f"{type(cause).__name__} in {place} {text}".strip()
