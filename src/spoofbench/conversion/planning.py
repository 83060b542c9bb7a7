"""What is to be converted, and under which names the recordings go."""

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path, PurePosixPath

from spoofbench.conversion.convert import NotRecognised, detect_format
from spoofbench.conversion.sources import Source
from spoofbench.errors import ConversionError

_PACKED = (".gz", ".zst", ".bz2", ".xz")


@dataclass(frozen=True, slots=True)
class Job:
    """One log and its recording.

    Attributes:
        walked: found in a folder, where what no converter recognises is no error.
    """

    source: Path
    target: Path
    walked: bool = False


@dataclass(frozen=True, slots=True)
class _Log:
    """A log, and where in a walked folder it lies: empty at the top, and for one that was named."""

    path: Path
    within: PurePosixPath
    walked: bool


def plan(inputs: Sequence[Path], out: Path, log_format: str | None = None) -> list[Job]:
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
    logs: dict[Path, _Log] = {}
    for path in inputs:
        if not path.exists():
            raise ConversionError(f"{str(path)!r} does not exist")
        for log in _logs(path, out.resolve(), log_format):
            logs.setdefault(log.path.resolve(), log)
    if not logs:
        raise ConversionError(f"there is no file in {str(inputs[0])!r}")
    only = next(iter(logs.values()))
    if len(logs) == 1 and not only.walked and not out.is_dir():
        return [Job(only.path, out)]
    names = _distinct(list(logs.values()))
    return [
        Job(log.path, out / log.within / f"{name}.mcap", log.walked)
        for log, name in zip(logs.values(), names, strict=True)
    ]


def _logs(path: Path, out: Path, log_format: str | None) -> Iterator[_Log]:
    if not path.is_dir() or _is_one_log(path, log_format):
        yield _Log(path, PurePosixPath(), walked=False)
    else:
        yield from _walk(path, PurePosixPath(), out, log_format)


def _walk(folder: Path, within: PurePosixPath, out: Path, log_format: str | None) -> Iterator[_Log]:
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
            yield _Log(path, within, walked=True)


def _is_one_log(folder: Path, log_format: str | None) -> bool:
    try:
        detect_format(Source.of(folder), log_format)
    except NotRecognised:
        return False
    except ConversionError:  # claimed by two: to be told when it is converted
        return True
    return True


def _distinct(logs: Sequence[_Log]) -> list[str]:
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


def _key(log: _Log, name: str) -> tuple[PurePosixPath, str]:
    return log.within, name.casefold()


def _stem(path: Path) -> str:
    if path.is_dir():
        return path.resolve().name or "recording"
    name = path.name.removesuffix(path.suffix) if path.suffix.lower() in _PACKED else path.name
    return PurePosixPath(name).stem


def _with_folder(log: _Log) -> str:
    return f"{log.path.resolve().parent.name or 'root'}-{_stem(log.path)}"


def _whole(log: _Log) -> str:
    return log.path.name or _stem(log.path)
