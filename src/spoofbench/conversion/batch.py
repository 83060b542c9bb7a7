"""Many logs at once: each in a process of its own, so that one which breaks its process costs
itself alone.
"""

import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields
from multiprocessing import connection, get_context, parent_process
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Literal

from spoofbench import plugins
from spoofbench.conversion.contract import Ledger
from spoofbench.conversion.convert import NotRecognised, convert, detect_format
from spoofbench.conversion.planning import Job
from spoofbench.conversion.sources import Source
from spoofbench.errors import SpoofbenchError

_TOLD_EVERY_S = 0.1


@dataclass(frozen=True, slots=True)
class Request:
    """How logs are to be converted.

    Attributes:
        format: name of the converter; else each log's is found by content.
        options: a converter's options, as texts.
        wishes: options for those converters that have them.
        strict: fail at the first part that must be skipped.
    """

    format: str | None = None
    options: Mapping[str, str] = field(default_factory=dict)
    wishes: Mapping[str, str] = field(default_factory=dict)
    strict: bool = False


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one log.

    Attributes:
        reason: why there is no recording.
        ignored: wishes that its converter has no option for.
    """

    job: Job
    status: Literal["converted", "not recognised", "failed"]
    ledger: Ledger | None = None
    reason: str | None = None
    ignored: tuple[str, ...] = ()


def convert_job(
    job: Job, request: Request, progress: Callable[[float], None] | None = None
) -> Outcome:
    """Convert one log; whatever a log can cause is an outcome."""
    claimed = True
    try:
        name, claimed = _converter_of(job, request)
        known = {
            option.name for option in fields(plugins.find(plugins.CONVERTERS, name).load().Options)
        }
        wishes = {key: text for key, text in request.wishes.items() if key in known}
        job.target.parent.mkdir(parents=True, exist_ok=True)
        options = {**wishes, **request.options}
        ledger = convert(
            job.source,
            job.target,
            format=name,
            options=options,
            strict=request.strict,
            progress=progress,
        )
        return Outcome(job, "converted", ledger, ignored=tuple(sorted(set(request.wishes) - known)))
    except NotRecognised as error:
        return Outcome(
            job,
            "not recognised",
            reason="; ".join(error.broken) or None if job.walked else str(error),
        )
    except SpoofbenchError as error:
        return Outcome(job, "failed" if claimed else "not recognised", reason=str(error))
    except OSError as error:
        return Outcome(
            job, "failed", reason=f"{error.filename or job.target}: {error.strerror or error}"
        )
    except MemoryError:
        return Outcome(job, "failed", reason="this takes more memory than there is")


def _converter_of(job: Job, request: Request) -> tuple[str, bool]:
    """Return a log's converter, and whether the log was named or claimed: else it is only tried by
    the mapping that the user gives.
    """
    if request.format is not None and not job.walked:
        return request.format, True
    log = Source.of(job.source)
    try:
        return detect_format(log, request.format)[0].name, True
    except NotRecognised:
        if "mapping" not in {**request.wishes, **request.options}:
            raise
        return detect_format(log, request.format, by_mapping=True)[0].name, not job.walked


def convert_many(
    jobs: Sequence[Job],
    request: Request,
    *,
    workers: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Iterator[Outcome]:
    """Convert logs in parallel; yield their outcomes as they come.

    Args:
        jobs: what to convert.
        request: how.
        workers: logs at a time; else one per processor.
        progress: is told the share of all bytes that is done, 0 to 1.
    """
    context = get_context("forkserver")
    context.set_forkserver_preload(["spoofbench.conversion.preload"])
    most = max(workers or os.cpu_count() or 1, 1)
    sizes = [max(job.source.stat().st_size, 1) for job in jobs]
    done = [0.0] * len(jobs)
    waiting = deque(range(len(jobs)))
    running: dict[Connection, tuple[int, BaseProcess]] = {}
    try:
        while waiting or running:
            while waiting and len(running) < most:
                number = waiting.popleft()
                ours, theirs = context.Pipe(duplex=False)
                process: BaseProcess = context.Process(
                    target=_work, args=(theirs, jobs[number], request)
                )
                process.start()
                theirs.close()
                running[ours] = number, process
            ready = connection.wait(list(running))
            for pipe in [pipe for pipe in running if pipe in ready]:
                number, process = running[pipe]
                outcome = _told(pipe, process, jobs[number])
                done[number] = outcome if isinstance(outcome, float) else 1.0
                if isinstance(outcome, Outcome):
                    del running[pipe]
                    yield outcome
            if progress:
                progress(
                    sum(size * share for size, share in zip(sizes, done, strict=True)) / sum(sizes)
                )
    finally:
        for _, process in running.values():
            process.terminate()
        for _, process in running.values():
            process.join()


def _told(pipe: Connection, process: BaseProcess, job: Job) -> float | Outcome:
    """Return what a process says next: the share that is done, or the outcome; one that died says
    the latter by that.
    """
    with suppress(EOFError, OSError):
        message: float | Outcome = pipe.recv()
        if isinstance(message, float):
            return message
        process.join()
        pipe.close()
        return message
    process.join()
    pipe.close()
    code = process.exitcode or 0
    how = (
        f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
    )
    for left in job.target.parent.glob(f".{job.target.name}.{process.pid}.part"):
        left.unlink(missing_ok=True)
    return Outcome(job, "failed", reason=f"the process that converted it {how}")


def _work(pipe: Connection, job: Job, request: Request) -> None:
    """Convert one log in a process of its own, which tidies up when it or its parent is told to
    end.
    """
    signal.signal(
        signal.SIGINT, signal.SIG_IGN
    )  # of a terminal; the parent gets it too, and ends its children
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    threading.Thread(target=_end_with_parent, daemon=True).start()
    last = 0.0

    def tell(share: float) -> None:
        nonlocal last
        if time.monotonic() - last > _TOLD_EVERY_S:
            last = time.monotonic()
            pipe.send(float(share))

    with suppress(BrokenPipeError):  # nobody waits for it any more
        pipe.send(convert_job(job, request, tell))


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os.kill(os.getpid(), signal.SIGTERM)
