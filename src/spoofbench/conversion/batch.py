"""Many logs at once: under which names their recordings go, and each converted in a worker of its
own, so that one which breaks its process costs itself alone.
"""

import os
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import dataclass, field, fields
from itertools import count
from pathlib import Path, PurePosixPath
from typing import Any, Literal

from spoofbench import plugins
from spoofbench.conversion.contract import Ledger
from spoofbench.conversion.convert import NotRecognised, convert, detect_format
from spoofbench.conversion.sources import Source
from spoofbench.errors import ConversionError, PluginError, SpoofbenchError
from spoofbench.sandbox import Sandbox, WorkerChannel, WorkerDied

_PACKED = (".gz", ".zst", ".bz2", ".xz")
_REPORT_EVERY_S = 0.1


@dataclass(frozen=True, slots=True)
class ConversionJob:
    """One log and its recording.

    Attributes:
        found_in_folder: found in a folder, where what no converter recognises is no error.
    """

    source: Path
    target: Path
    found_in_folder: bool = False


@dataclass(frozen=True, slots=True)
class ConversionRequest:
    """How logs are to be converted.

    Attributes:
        format: name of the converter; else each log's is found by content.
        options: a converter's options, as texts.
        optional_options: options for those converters that have them.
        strict: fail at the first part that must be skipped.
    """

    format: str | None = None
    options: Mapping[str, str] = field(default_factory=dict)
    optional_options: Mapping[str, str] = field(default_factory=dict)
    strict: bool = False


ConversionStatus = Literal["converted", "not recognised", "failed"]


@dataclass(frozen=True, slots=True)
class ConversionOutcome:
    """What became of one log.

    Attributes:
        reason: why there is no recording.
        ignored: optional options that its converter does not have.
    """

    job: ConversionJob
    status: ConversionStatus
    ledger: Ledger | None = None
    reason: str | None = None
    ignored: tuple[str, ...] = ()


def plan(inputs: Sequence[Path], out: Path, log_format: str | None = None) -> list[ConversionJob]:
    """Return a job per log.

    A folder that a converter claims as a whole is one log; any other is walked, hidden files left
    out. One log goes to ``out`` itself unless that is a folder. Several go into the folder ``out``,
    those of a walked folder into its subfolders, as ``<stem>.mcap``; where two names collide, the
    name of the folder stands before the stem, or the whole name takes its place.

    Args:
        inputs: files and folders.
        out: the recording, or the folder of the recordings.
        log_format: the only converter to ask; a file that is named goes to it unasked.

    Raises:
        ConversionError: an input does not exist, or nothing is left to convert.
    """
    logs: dict[Path, _FoundLog] = {}
    for path in inputs:
        if not path.exists():
            raise ConversionError(f"{str(path)!r} does not exist")
        for log in _logs(path, out.resolve(), log_format):
            logs.setdefault(log.path.resolve(), log)
    if not logs:
        raise ConversionError(f"there is no file in {str(inputs[0])!r}")
    only = next(iter(logs.values()))
    if len(logs) == 1 and not only.found_in_folder and not out.is_dir():
        return [ConversionJob(only.path, out)]
    names = _distinct(list(logs.values()))
    return [
        ConversionJob(log.path, out / log.within / f"{name}.mcap", log.found_in_folder)
        for log, name in zip(logs.values(), names, strict=True)
    ]


@dataclass(frozen=True, slots=True)
class _FoundLog:
    """A log, and where in a walked folder it lies: empty at the top, and for one that was named."""

    path: Path
    within: PurePosixPath
    found_in_folder: bool


def _logs(path: Path, out: Path, log_format: str | None) -> Iterator[_FoundLog]:
    if not path.is_dir() or _is_one_log(path, log_format):
        yield _FoundLog(path, PurePosixPath(), found_in_folder=False)
    else:
        yield from _walk(path, PurePosixPath(), out, log_format)


def _walk(
    folder: Path, within: PurePosixPath, out: Path, log_format: str | None
) -> Iterator[_FoundLog]:
    with os.scandir(folder) as found:
        entries = sorted(
            (entry for entry in found if not entry.name.startswith(".")),
            key=lambda entry: entry.name,
        )
    for entry in entries:
        path = folder / entry.name
        if path.resolve() == out:
            continue
        if entry.is_dir(follow_symlinks=False) and not _is_one_log(path, log_format):
            yield from _walk(path, within / entry.name, out, log_format)
        elif path.is_dir() or path.is_file():
            yield _FoundLog(path, within, found_in_folder=True)


def _is_one_log(folder: Path, log_format: str | None) -> bool:
    try:
        detect_format(Source.of(folder), log_format)
    except NotRecognised:
        return False
    except ConversionError:  # claimed by two: reported when it is converted
        return True
    return True


def _distinct(logs: Sequence[_FoundLog]) -> list[str]:
    """Return a name for each log that no other in its subfolder has, whatever the file system makes
    of upper case.
    """
    names = [_stem(log.path) for log in logs]
    for longer in (_with_folder, _whole):
        often = Counter(_key(log, name) for log, name in zip(logs, names, strict=True))
        names = [
            longer(log) if often[_key(log, name)] > 1 else name
            for log, name in zip(logs, names, strict=True)
        ]
    taken: set[tuple[PurePosixPath, str]] = set()
    for i, log in enumerate(logs):
        tries = (names[i] if n == 1 else f"{names[i]}-{n}" for n in count(1))
        names[i] = next(name for name in tries if _key(log, name) not in taken)
        taken.add(_key(log, names[i]))
    return names


def _key(log: _FoundLog, name: str) -> tuple[PurePosixPath, str]:
    return log.within, name.casefold()


def _stem(path: Path) -> str:
    if path.is_dir():
        return path.resolve().name or "recording"
    name = path.name.removesuffix(path.suffix) if path.suffix.lower() in _PACKED else path.name
    return PurePosixPath(name).stem


def _with_folder(log: _FoundLog) -> str:
    return f"{log.path.resolve().parent.name or 'root'}-{_stem(log.path)}"


def _whole(log: _FoundLog) -> str:
    return log.path.name or _stem(log.path)


def convert_job(
    job: ConversionJob, request: ConversionRequest, progress: Callable[[float], None] | None = None
) -> ConversionOutcome:
    """Convert one log; whatever a log can cause is an outcome."""
    claimed = True
    try:
        name, claimed = _converter_of(job, request)
        known = {
            option.name for option in fields(plugins.find(plugins.CONVERTERS, name).load().Options)
        }
        optional_options = {
            key: text for key, text in request.optional_options.items() if key in known
        }
        job.target.parent.mkdir(parents=True, exist_ok=True)
        options = {**optional_options, **request.options}
        ledger = convert(
            job.source,
            job.target,
            format=name,
            options=options,
            strict=request.strict,
            progress=progress,
        )
        return ConversionOutcome(
            job, "converted", ledger, ignored=tuple(sorted(set(request.optional_options) - known))
        )
    except NotRecognised as error:
        return ConversionOutcome(
            job,
            "not recognised",
            reason="; ".join(error.broken) or None if job.found_in_folder else str(error),
        )
    except SpoofbenchError as error:
        return ConversionOutcome(job, "failed" if claimed else "not recognised", reason=str(error))
    except OSError as error:
        return ConversionOutcome(
            job, "failed", reason=f"{error.filename or job.target}: {error.strerror or error}"
        )
    except MemoryError:
        return ConversionOutcome(job, "failed", reason="this takes more memory than there is")


def _converter_of(job: ConversionJob, request: ConversionRequest) -> tuple[str, bool]:
    """Return a log's converter, and whether the log was named or claimed: else it is only tried by
    the mapping that the user gives.
    """
    if request.format is not None and not job.found_in_folder:
        return request.format, True
    log = Source.of(job.source)
    try:
        return detect_format(log, request.format)[0].name, True
    except NotRecognised:
        if "mapping" not in {**request.optional_options, **request.options}:
            raise
        return detect_format(log, request.format, by_mapping=True)[0].name, not job.found_in_folder


def convert_many(
    jobs: Sequence[ConversionJob],
    request: ConversionRequest,
    *,
    workers: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Generator[ConversionOutcome, None, None]:
    """Convert logs in parallel; yield their outcomes as they come.

    Args:
        jobs: what to convert.
        request: how.
        workers: logs at a time; else one per processor.
        progress: gets the share of all bytes that is done, 0 to 1, from several threads, one at a
            time.
    """
    sizes = [max(job.source.stat().st_size, 1) for job in jobs]
    shares = [0.0] * len(jobs)
    lock = threading.Lock()

    def convert_one(index: int) -> ConversionOutcome:
        def report(share: float) -> None:
            with lock:
                shares[index] = share
                if progress:
                    done = sum(size * share for size, share in zip(sizes, shares, strict=True))
                    progress(done / sum(sizes))

        outcome = _convert_in_worker(sandbox, jobs[index], request, report)
        report(1.0)
        return outcome

    with (
        ThreadPoolExecutor(max(workers or os.cpu_count() or 1, 1)) as pool,
        Sandbox(_preload) as sandbox,
    ):
        for future in as_completed([pool.submit(convert_one, index) for index in range(len(jobs))]):
            yield future.result()


def _preload() -> None:
    """Import what a process that converts needs, converters included."""
    import spoofbench.codec  # noqa: F401

    with suppress(PluginError):  # reported when it is asked for
        for plugin in plugins.found(plugins.CONVERTERS).values():
            with suppress(PluginError):
                plugin.load()


def _convert_in_worker(
    sandbox: Sandbox,
    job: ConversionJob,
    request: ConversionRequest,
    report: Callable[[float], None],
) -> ConversionOutcome:
    """Convert one log in a worker, and remove what a worker that was ended leaves half written."""
    worker = sandbox.start(_convert, Path.cwd(), job, request)
    try:
        with worker:
            while "share" in (record := worker.receive(None)):
                report(record["share"])
    except WorkerDied as error:
        return ConversionOutcome(job, "failed", reason=f"while it was converted, {error}")
    finally:
        with suppress(OSError):
            job.target.with_name(f".{job.target.name}.{worker.pid}.part").unlink(missing_ok=True)
    ledger = record["ledger"] and Ledger.of_metadata(record["ledger"])
    status, reason, ignored = record["status"], record["reason"], tuple(record["ignored"])
    return ConversionOutcome(job, status, ledger, reason, ignored)


def _convert(
    channel: WorkerChannel, folder: Path, job: ConversionJob, request: ConversionRequest
) -> None:
    """Convert one log in the folder of the main process, whose paths may be relative to it."""
    os.chdir(folder)
    signal.signal(signal.SIGTERM, _end)
    last = 0.0

    def report(share: float) -> None:
        nonlocal last
        if time.monotonic() - last > _REPORT_EVERY_S:
            last = time.monotonic()
            channel.send(share=float(share))

    outcome = convert_job(job, request, report)
    channel.send(
        status=outcome.status,
        ledger=outcome.ledger and outcome.ledger.as_metadata(),
        reason=outcome.reason,
        ignored=outcome.ignored,
    )


def _end(number: int, _: Any) -> None:
    """Remove what is half written on the way out, and let no second signal disturb that."""
    signal.signal(number, signal.SIG_IGN)
    sys.exit(128 + number)
