"""Workers that make inputs and try them, and whoever watches that none hangs."""

import hashlib
import multiprocessing
import os
import resource
import tempfile
import time
import traceback
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.fuzz.mutate import TOKENS, mutate
from benchmarks.fuzz.targets import check
from spoofbench.testing.converter_alone import peak_bytes

MEMORY_BYTES = 2**30
INPUT_S = 20.0
_KEPT = 3
_QUEUE_S = 0.2


@dataclass
class Found:
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
) -> Found:
    """Try inputs for some seconds; save failing ones to the corpus, three of each kind."""
    found, begin = Found(target), time.monotonic()
    context = multiprocessing.get_context("fork")
    running = [_Worker(context, target, seeds, seed + number, corpus) for number in range(workers)]
    while time.monotonic() - begin < seconds:
        time.sleep(_QUEUE_S)
        for worker in running:
            worker.watch(found)
    for worker in running:
        worker.stop(found)
    found.seconds = time.monotonic() - begin
    return found


class _Worker:
    """A process that tries one input after the other, and is started anew where it hangs or
    dies.
    """

    def __init__(
        self, context: Any, target: str, seeds: Sequence[bytes], seed: int, corpus: Path
    ) -> None:
        self._context, self._target, self._seeds, self._seed, self._corpus = (
            context,
            target,
            seeds,
            seed,
            corpus,
        )
        self._turn: Synchronized[int] = context.Value("q", -1)
        self._peak: Synchronized[int] = context.Value("q", 0)
        self._answers = context.SimpleQueue()
        self._seen, self._since = -1, time.monotonic()
        self._start(0)

    def _start(self, turn: int) -> None:
        arguments = (
            self._target,
            self._seeds,
            self._seed,
            turn,
            self._turn,
            self._peak,
            self._answers,
        )
        self._process = self._context.Process(target=_try, args=arguments, daemon=True)
        self._process.start()
        self._since = time.monotonic()

    def watch(self, found: Found) -> None:
        """Take what the process says; where it hangs or has died, note it and go on with the next
        input.
        """
        self._take(found)
        turn, now = self._turn.value, time.monotonic()
        if turn != self._seen:
            self._seen, self._since = turn, now
        elif now - self._since > INPUT_S:
            self._process.kill()
            self._process.join()
            self._fail(found, turn, f"hang of more than {INPUT_S:g} s", "")
            self._start(turn + 1)
        if not self._process.is_alive():
            self._take(found)
            self._fail(found, turn, f"process died with {self._process.exitcode}", "")
            self._start(turn + 1)

    def stop(self, found: Found) -> None:
        """End the process."""
        self._take(found)
        self._process.kill()
        self._process.join()
        found.inputs += max(self._turn.value, 0)
        found.peak_bytes = max(found.peak_bytes, self._peak.value)

    def _take(self, found: Found) -> None:
        while not self._answers.empty():
            self._fail(found, *self._answers.get())

    def _fail(self, found: Found, turn: int, signature: str, text: str) -> None:
        found.failures[signature] = found.failures.get(signature, 0) + 1
        if found.failures[signature] <= _KEPT:
            name = f"{self._target}-{hashlib.sha256(signature.encode()).hexdigest()[:8]}-{self._seed}-{turn}"
            self._corpus.mkdir(parents=True, exist_ok=True)
            (self._corpus / name).write_bytes(make(self._seeds, self._target, self._seed, turn))
            (self._corpus / f"{name}.txt").write_text(f"{signature}\n{text}", encoding="utf-8")


def _try(
    target: str,
    seeds: Sequence[bytes],
    seed: int,
    turn: int,
    shown: "Synchronized[int]",
    peak: "Synchronized[int]",
    answers: Any,
) -> None:
    """Try inputs from a turn on, for ever."""
    warnings.simplefilter("ignore")
    _limit_memory()
    base = peak_bytes()
    with tempfile.TemporaryDirectory(prefix="fuzz") as folder:
        path = Path(folder, "log")
        while True:
            shown.value = turn
            path.write_bytes(make(seeds, target, seed, turn))
            try:
                check(target, path, turn)
            except Exception as error:  # noqa: BLE001 - that is what is looked for
                answers.put((turn, _signature(error), traceback.format_exc()))
            peak.value = max(peak.value, peak_bytes() - base)
            turn += 1
            if os.getppid() == 1:
                return


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


def _limit_memory() -> None:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    limit = pages * resource.getpagesize() + MEMORY_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, resource.getrlimit(resource.RLIMIT_AS)[1]))
