"""The common frame of the speed benchmarks: contestants side by side in interleaved rounds,
medians, ratios.
"""

import gc
import json
import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True, slots=True)
class Job:
    """One piece of work that we and peers do.

    Attributes:
        name: of the job.
        timed: what is timed, in one line.
        ours: does the work and returns what came of it.
        peers: by name, the same; empty where nothing else does this work.
        missing: peers that are not installed.
        check: is given our result and a peer's, once before timing, and raises where they do not
            agree.
        prepare: what to do before each turn, untimed.
        parts: by peer, the share of the work that it does, where the whole would take it too long;
            its time is divided by that.
    """

    name: str
    timed: str
    ours: Callable[[], Any]
    peers: Mapping[str, Callable[[], Any]]
    missing: Sequence[str] = ()
    check: Callable[[Any, Any], None] | None = None
    prepare: Callable[[], None] | None = None
    parts: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Result:
    """A peer's median time over ours; above 1 we are quicker. None where there is no peer."""

    job: str
    peer: str
    ratio: float | None
    ours_ms: float
    peer_ms: float | None


def run(job: Job, rounds: int) -> list[Result]:
    """Time a job: in each round we and every peer take a turn in one process."""
    contestants = {"": job.ours, **job.peers}
    first = {name: work() for name, work in contestants.items()}
    if job.check:
        for name in job.peers:
            job.check(first[""], first[name])
    del first
    times: dict[str, list[float]] = {name: [] for name in contestants}
    for _ in range(rounds):
        for name, work in contestants.items():
            if job.prepare:
                job.prepare()
            gc.collect()
            begin = time.perf_counter()
            result = work()
            times[name].append(1e3 * (time.perf_counter() - begin))
            del result
    medians = {
        name: statistics.median(values) / job.parts.get(name, 1.0) for name, values in times.items()
    }
    ours = medians.pop("")
    if not medians:
        return [Result(job.name, "none", None, round(ours, 2), None)]
    return [
        Result(job.name, name, round(peer / ours, 2), round(ours, 2), round(peer, 2))
        for name, peer in medians.items()
    ]


def report(results: Sequence[Result]) -> Iterator[str]:
    """Yield the lines of a table that fits 80 columns."""
    yield f"{'job':<24}{'peer':<16}{'ratio':>9}{'ours ms':>12}{'peer ms':>12}"
    for result in results:
        ratio = "-" if result.ratio is None else f"{result.ratio:.1f}x"
        peer_ms = "-" if result.peer_ms is None else f"{result.peer_ms:.1f}"
        yield f"{result.job:<24}{result.peer:<16}{ratio:>9}{result.ours_ms:>12.1f}{peer_ms:>12}"


def save(results: Sequence[Result], path: Path) -> None:
    """Write the results as JSON."""
    path.write_text(json.dumps([asdict(result) for result in results], indent=1) + "\n")
