"""A converter at work in a process of its own: elsewhere, in another time zone, with little
memory.
"""

import os
import pickle
import resource
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from spoofbench import plugins
from spoofbench.conversion import Converter, Source
from spoofbench.errors import SpoofbenchError
from spoofbench.testing.converter_cases import outcome
from spoofbench.testing.isolated import import_module

_ELSEWHERE = {
    "TZ": "Pacific/Chatham",
    "LC_ALL": "C",
    "LANG": "C",
    "PYTHONHASHSEED": "7",
    "PYTHONUTF8": "0",
    "OPENBLAS_NUM_THREADS": "1",
}
_BUDGET_BYTES = 2**31
_TIMEOUT_S = 600.0


@dataclass(frozen=True, slots=True)
class Alone:
    """What came of a log: the digests of its outcome, the peak memory after it in bytes, and files
    left in the folder.
    """

    digests: Mapping[str, str]
    peak_bytes: int
    left: tuple[str, ...]


def convert_alone(
    converter: str | Converter, paths: Sequence[Path], options: Mapping[str, Any], keep: bool = True
) -> list[Alone]:
    """Convert logs one after the other in a process in another folder, time zone, locale and hash
    seed.

    Args:
        keep: digest what comes of a log; else let it pass, so that the peak memory is the
            converter's alone.

    Raises:
        RuntimeError: the process failed; gives the last line that it wrote.
    """
    task = pickle.dumps(
        (sys.path, _way_to(converter), [path.resolve() for path in paths], dict(options), keep)
    )
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as answers:
        place = Path(answers, "answer")
        done = subprocess.run(
            [sys.executable, "-P", "-c", _BOOTSTRAP, str(place)],
            input=task,
            cwd=folder,
            env={**os.environ, **_ELSEWHERE, "PYTHONDONTWRITEBYTECODE": "1"},
            capture_output=True,
            timeout=_TIMEOUT_S,
            check=False,
        )
        if done.returncode:
            lines = done.stderr.decode(errors="replace").strip().splitlines()
            raise RuntimeError(
                lines[-1] if lines else f"the process ended with code {done.returncode}"
            )
        answers_given: list[Alone] = pickle.loads(place.read_bytes())
    return answers_given


_BOOTSTRAP = """
import pickle, sys
path, *task = pickle.load(sys.stdin.buffer)
sys.path[:] = path
from spoofbench.testing.converter_alone import _answer
_answer(sys.argv.pop(), *task)
"""


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


def _answer(
    place: str,
    way: tuple[str, str | None, bytes | None],
    paths: Sequence[Path],
    options: Mapping[str, Any],
    keep: bool,
) -> None:
    name, file, pickled = way
    converter: Any
    if pickled is None:
        converter = plugins.find(plugins.CONVERTERS, name).load()
    else:
        module = import_module(name, file)
        converter = pickle.loads(pickled) if pickled else module
    _limit_memory()
    answers = []
    for path in paths:
        digests = (
            outcome(converter, path, options).digests
            if keep
            else _let_pass(converter, path, options)
        )
        left = tuple(sorted(str(path) for path in Path().rglob("*")))
        answers.append(Alone(digests, peak_bytes(), left))
    Path(place).write_bytes(pickle.dumps(answers))


def _let_pass(converter: Converter, path: Path, options: Mapping[str, Any]) -> Mapping[str, str]:
    """Convert a log and keep nothing."""
    try:
        for _ in converter.convert(Source.of(path), converter.Options(**options)):
            pass
    except SpoofbenchError:
        pass
    return {}


def peak_bytes() -> int:
    """Return the most memory that this process had resident; ``ru_maxrss`` alone would include the
    process that started it.
    """
    status = Path("/proc/self/status")
    if status.exists():
        return 1024 * next(
            int(line.split()[1])
            for line in status.read_text().splitlines()
            if line.startswith("VmHWM")
        )
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _limit_memory() -> None:
    """Let the address space grow by 2 GiB and no further, where the system can say how large it
    is.
    """
    statm = Path("/proc/self/statm")
    if statm.exists():
        pages = int(statm.read_text().split()[0])
        limit = pages * resource.getpagesize() + _BUDGET_BYTES
        hard = resource.getrlimit(resource.RLIMIT_AS)[1]
        resource.setrlimit(
            resource.RLIMIT_AS,
            (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard),
        )
