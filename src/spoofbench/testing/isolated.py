"""A detector alone with blind recordings, in a process of its own.

The process has another hash seed, an empty folder and only the blind rows; it notes the files and
the network that the detector reaches for beyond installed code.
"""

import importlib
import importlib.util
import os
import pickle
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from spoofbench.detector import Decisions, Detector
from spoofbench.recording import Recording
from spoofbench.testing.detector_cases import decide_if_possible

_KEPT_ENVIRONMENT = ("PATH", "HOME", "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH", "SYSTEMROOT")
_FORBIDDEN_EVENTS = (
    "socket.connect",
    "socket.sendto",
    "subprocess.Popen",
    "os.system",
    "os.exec",
    "os.posix_spawn",
)
_CODE = (".py", ".pyc", ".so", ".pyd", ".dylib")
_TIMEOUT_S = 600.0


@dataclass(frozen=True, slots=True)
class Answer:
    """What came out: one outcome per recording, and the first thing that the detector reached
    for.
    """

    decisions: tuple[Decisions | None, ...]
    reached: str | None


def decide_alone(detector: Detector, recordings: Sequence[Recording], hash_seed: int = 1) -> Answer:
    """Run a detector on the blind part of recordings in a process that has nothing else.

    Raises:
        RuntimeError: the process failed; gives the last line that it wrote. Or the detector is of a
            script, which another process cannot import.
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
    task = (
        sys.path,
        module.__name__,
        getattr(module, "__file__", None),
        pickle.dumps((detector, blind)),
    )
    threads = {name: value for name, value in os.environ.items() if name.endswith("_NUM_THREADS")}
    kept = {name: os.environ[name] for name in _KEPT_ENVIRONMENT if name in os.environ}
    environment = {
        **kept,
        **threads,
        "PYTHONHASHSEED": str(hash_seed),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as answers:
        command = [sys.executable, "-P", "-c", _BOOTSTRAP, str(Path(answers, "answer"))]
        done = subprocess.run(
            command,
            input=pickle.dumps(task),
            cwd=folder,
            env=environment,
            capture_output=True,
            timeout=_TIMEOUT_S,
            check=False,
        )
        if done.returncode:
            lines = done.stderr.decode(errors="replace").strip().splitlines()
            raise RuntimeError(
                lines[-1] if lines else f"the process ended with code {done.returncode}"
            )
        answer: Answer = pickle.loads(Path(answers, "answer").read_bytes())
    return answer


_BOOTSTRAP = """
import pickle, sys
path, module, file, payload = pickle.load(sys.stdin.buffer)
sys.path[:] = path
from spoofbench.testing.isolated import _answer
_answer(sys.argv.pop(), module, file, payload)
"""


def _answer(place: str, module: str, file: str | None, payload: bytes) -> None:
    import_module(module, file)
    detector, recordings = pickle.loads(payload)
    reached = _watch(module)
    decisions = tuple(decide_if_possible(detector, recording) for recording in recordings)
    answer = pickle.dumps(Answer(decisions, reached[0] if reached else None))
    Path(place).write_bytes(answer)


def import_module(name: str, file: str | None) -> ModuleType:
    """Import the detector's module, from its file where it is on no path, as a test's module may
    be.
    """
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
