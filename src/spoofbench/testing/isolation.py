"""A plugin in a process of its own, which has nothing that its contract does not give it.

A detector gets the blind rows alone, another hash seed and an empty folder; the process notes the
files and the network that it reaches for beyond installed code. A converter works elsewhere, in
another time zone, locale and hash seed, with little memory.
"""

import importlib
import importlib.util
import os
import pickle
import sys
import sysconfig
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from spoofbench import plugins
from spoofbench.conversion import Converter, Source
from spoofbench.detector import Decisions, Detector
from spoofbench.errors import SpoofbenchError
from spoofbench.recording import Recording
from spoofbench.sandbox import (
    Sandbox,
    WorkerChannel,
    WorkerDied,
    WorkerTimedOut,
    limit_memory,
    peak_bytes,
)
from spoofbench.testing.converter_cases import outcome
from spoofbench.testing.detector_cases import decide_if_possible

_FORBIDDEN_EVENTS = (
    "socket.connect",
    "socket.sendto",
    "subprocess.Popen",
    "os.system",
    "os.exec",
    "os.posix_spawn",
)
_CODE = (".py", ".pyc", ".so", ".pyd", ".dylib")
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
_ELSEWHERE = {
    "TZ": "Pacific/Chatham",
    "LC_ALL": "C",
    "LANG": "C",
    "PYTHONHASHSEED": "7",
    "PYTHONUTF8": "0",
}
_CONVERTER_BYTES = 2**31
_TIMEOUT_S = 600.0


@dataclass(frozen=True, slots=True)
class DecidedAlone:
    """What came of recordings: decisions for each, None where the detector cannot run on it; and
    the first thing that the detector reached for.
    """

    decisions: tuple[Decisions | None, ...]
    reached: str | None


@dataclass(frozen=True, slots=True)
class ConvertedAlone:
    """What came of a log: the digests of its outcome, the peak memory after it in bytes, and files
    left in the folder.
    """

    digests: Mapping[str, str]
    peak_bytes: int
    left: tuple[str, ...]


def decide_alone(
    detector: Detector, recordings: Sequence[Recording], hash_seed: int = 1
) -> DecidedAlone:
    """Run a detector on the blind part of recordings in a process that has nothing else.

    Raises:
        RuntimeError: the process failed; says how. Or the detector is of a script, which another
            process cannot import.
    """
    module = sys.modules[type(detector).__module__]
    if module.__name__ == "__main__":
        raise RuntimeError(
            f"{type(detector).__name__} is defined in a script; put it into a module, so that "
            "another process can import it"
        )
    blind = [
        Recording(dict(recording.blind().items()), recording.blind().metadata)
        for recording in recordings
    ]
    task = (module.__name__, getattr(module, "__file__", None), pickle.dumps((detector, blind)))
    # as many threads as here: sums of another order round otherwise
    environment = {name: os.environ.get(name) for name in _THREADS}
    answer = _answer(environment | {"PYTHONHASHSEED": str(hash_seed)}, _decide, *task)
    decisions = tuple(
        None if columns is None else Decisions(*columns) for columns in answer["decisions"]
    )
    return DecidedAlone(decisions, answer["reached"])


def _decide(channel: WorkerChannel, module: str, file: str | None, payload: bytes) -> None:
    _enter_empty_folder()
    _import_module(module, file)
    detector, recordings = pickle.loads(payload)
    reached = _watch(module)
    decisions = [decide_if_possible(detector, recording) for recording in recordings]
    first = reached[0] if reached else None
    columns = [
        d and [array.tolist() for array in (d.time_ns, d.score, d.available)] for d in decisions
    ]
    channel.send(status="ok", decisions=columns, reached=first)


def convert_alone(
    converter: str | Converter, paths: Sequence[Path], options: Mapping[str, Any], keep: bool = True
) -> list[ConvertedAlone]:
    """Convert logs one after the other in a process in another folder, time zone, locale and hash
    seed.

    Args:
        keep: digest what comes of a log; else let it pass, so that the peak memory is the
            converter's alone.

    Raises:
        RuntimeError: the process failed; says how.
    """
    logs = [path.resolve() for path in paths]
    answer = _answer(_ELSEWHERE, _convert, _way_to(converter), logs, dict(options), keep)
    return [
        ConvertedAlone(each["digests"], each["peak_bytes"], tuple(each["left"]))
        for each in answer["logs"]
    ]


def _convert(
    channel: WorkerChannel,
    way: tuple[str, str | None, bytes | None],
    paths: Sequence[Path],
    options: Mapping[str, Any],
    keep: bool,
) -> None:
    _enter_empty_folder()
    name, file, pickled = way
    converter: Any
    if pickled is None:
        converter = plugins.find(plugins.CONVERTERS, name).load()
    else:
        module = _import_module(name, file)
        converter = pickle.loads(pickled) if pickled else module
    limit_memory(_CONVERTER_BYTES)
    answers = []
    for path in paths:
        digests = (
            outcome(converter, path, options).digests
            if keep
            else _let_pass(converter, path, options)
        )
        left = sorted(str(path) for path in Path().rglob("*"))
        answers.append({"digests": dict(digests), "peak_bytes": peak_bytes(), "left": left})
    channel.send(status="ok", logs=answers)


def _way_to(converter: str | Converter) -> tuple[str, str | None, bytes | None]:
    """Return how another process gets the converter: an entry point's name, or a module, its file
    and a pickled object.
    """
    if isinstance(converter, str):
        return converter, None, None
    if isinstance(converter, ModuleType):
        return converter.__name__, converter.__file__, b""
    module = sys.modules[type(converter).__module__]
    return module.__name__, getattr(module, "__file__", None), pickle.dumps(converter)


def _let_pass(converter: Converter, path: Path, options: Mapping[str, Any]) -> Mapping[str, str]:
    """Convert a log and keep nothing."""
    try:
        for _ in converter.convert(Source.of(path), converter.Options(**options)):
            pass
    except SpoofbenchError:
        pass
    return {}


def _answer(environment: Mapping[str, str | None], function: Any, *arguments: Any) -> Any:
    """Call a function in a process with this environment, and return its record.

    Raises:
        RuntimeError: there was none.
    """
    environment = {**environment, "PYTHONDONTWRITEBYTECODE": "1"}
    with Sandbox(environment=environment) as sandbox, sandbox.start(function, *arguments) as worker:
        try:
            answer = worker.receive(_TIMEOUT_S)
        except (WorkerDied, WorkerTimedOut) as error:
            raise RuntimeError(str(error)) from error
    if answer["status"] != "ok":
        raise RuntimeError(answer["reason"])
    return answer


def _enter_empty_folder() -> None:
    """Work in a folder that goes with the sandbox."""
    folder = Path("empty")
    folder.mkdir()
    os.chdir(folder)


def _import_module(name: str, file: str | None) -> ModuleType:
    """Import a plugin's module, from its file where it is on no path, as a test's module may be."""
    try:
        return importlib.import_module(name)
    except ImportError:
        if file is None:
            raise
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise ImportError(f"{file!r} cannot be imported")
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _watch(module: str) -> list[str]:
    """Note from now on what is opened beyond code and the detector's own package, and every way out
    of the process.
    """
    folders = [
        *sysconfig.get_paths().values(),
        sys.prefix,
        sys.base_prefix,
        "/proc",
        "/sys",
        "/dev",
    ]
    allowed = [Path(folder).resolve() for folder in folders]
    package = sys.modules[module.partition(".")[0]]
    if hasattr(package, "__path__") and package.__file__:
        allowed.append(Path(package.__file__).resolve().parent)
    reached: list[str] = []

    def note(event: str, arguments: tuple[object, ...]) -> None:
        if event in _FORBIDDEN_EVENTS:
            reached.append(f"{event} {arguments[0]!r}")
        elif event == "open" and isinstance(arguments[0], str | bytes | os.PathLike):
            path = Path(os.fsdecode(arguments[0])).resolve()
            if path.suffix not in _CODE and not any(
                path.is_relative_to(folder) for folder in allowed
            ):
                reached.append(f"file {os.fspath(arguments[0])!r}")

    sys.addaudithook(note)
    return reached
