"""A worker that runs one detector on variants of one recording, knowing nothing but their blind
material.
"""

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from spoofbench import plugins
from spoofbench.detector import Decisions, Detector, detect
from spoofbench.errors import PluginError
from spoofbench.recording import Recording
from spoofbench.runner import confine
from spoofbench.runner.describing import frozen
from spoofbench.runner.material import Shelf
from spoofbench.runner.talk import Talk, one_line

Judge = Callable[[Recording], Decisions]


def work(
    talk: Talk,
    name: str,
    parameters: dict[str, Any],
    material: str,
    variants: list[str],
    withheld: list[str],
    memory_mb: int,
) -> None:
    """Send a record and, where it went well, decisions for each variant in turn.

    Memory is limited to its growth over this process and the largest variant's tables.
    """
    shelf = Shelf(Path(material))
    confine.limit_memory((memory_mb << 20) + max(map(shelf.size, variants)))
    try:
        detector: Detector = plugins.make(plugins.DETECTORS, name, frozen(parameters))
    except PluginError as error:
        talk.send(status="failed", reason=one_line(error))
        return
    talk.send(status="ok")
    for variant in variants:
        _judge(
            talk, partial(detect, detector, withheld=frozenset(withheld)), shelf, variant, memory_mb
        )


def _judge(talk: Talk, judge: Judge, shelf: Shelf, variant: str, memory_mb: int) -> None:
    meter, start = confine.MemoryMeter(), time.perf_counter()
    status, reason, decisions = _attempt(judge, shelf, variant, memory_mb)
    seconds, growth_mb = round(time.perf_counter() - start, 6), meter.growth_mb()
    rows = 0 if decisions is None else decisions.time_ns.size
    talk.send(
        variant=variant,
        status=status,
        reason=reason,
        seconds=seconds,
        growth_mb=growth_mb,
        rows=rows,
    )
    if decisions is not None:
        talk.send_decisions(decisions)


def _attempt(
    judge: Judge, shelf: Shelf, variant: str, memory_mb: int
) -> tuple[str, str | None, Decisions | None]:
    try:
        return "ok", None, judge(shelf.get(variant))
    except MemoryError:
        return "out_of_memory", f"it needs more than {memory_mb} MB", None
    except Exception as error:  # noqa: BLE001, a plugin may raise anything
        return "failed", one_line(error), None
