"""Names of tasks and variants: the SHA-256 of everything that decides what comes out.

Equal inputs have equal ids on any machine, and an input that changes changes the id, so a result
that is there is right.
"""

import hashlib
import importlib.util
import json
from collections.abc import Iterable, Iterator
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import spoofbench
from spoofbench.plugins import Plugin
from spoofbench.schema import SCHEMA_VERSION

DECISIVE = (
    "arrays",
    "attacks",
    "config",
    "detector",
    "gnss_time",
    "navigation",
    "recording",
    "results",
    "runner.blind",
    "runner.jobs",
    "schema",
    "scoring.grid",
    "table",
)
"""The modules of the core that decide the files of a task: its decisions, and the truth of its
variant; and the toolbox that a plugin may compute with.

What reads a recording is left out, because the digest of the rows it gives is an input, and so are
converters. So is what turns decisions and truth into scores, because every run ends with scoring
all of them again. A module that one of these imports must be listed, or decide nothing.
"""

_CODE = frozenset({".py", ".so", ".pyd", ".dylib"})


def canonical(value: Any) -> str:
    """Return the one JSON text of a value."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"))


def identify(**inputs: Any) -> str:
    """Return the id of what these inputs decide."""
    return hashlib.sha256(canonical(inputs).encode()).hexdigest()


@cache
def core() -> str:
    """Return the digest of the core's code that decides results."""
    return digest_of(Path(spoofbench.__file__).parent, DECISIVE)


def digest_of(folder: Path, modules: Iterable[str]) -> str:
    """Return the digest of these modules and packages of a folder, named relative to it.

    Raises:
        FileNotFoundError: one of them is not there.
    """
    found: dict[str, Path] = {}
    for module in modules:
        path = folder / module.replace(".", "/")
        paths = list(_files(path)) if path.is_dir() else [path.with_suffix(".py")]
        found |= {path.relative_to(folder).as_posix(): path for path in paths}
    return _digest(found.items())


def code_of(plugin: Plugin) -> str:
    """Digest of the code of a plugin: its top package (or module), and what code its distribution
    lists besides.

    Of an installation that is edited in place, the distribution lists nothing, and the package is
    found where it is.
    """
    name = plugin.entry_point.module.partition(".")[0]
    if name == spoofbench.__name__:
        return core()
    found: dict[str, Path] = {}
    spec = importlib.util.find_spec(name)
    if spec is not None:
        for folder in spec.submodule_search_locations or ():
            found |= {
                f"{name}/{path.relative_to(folder).as_posix()}": path
                for path in _files(Path(folder))
            }
        if not spec.submodule_search_locations and spec.origin:
            found[Path(spec.origin).name] = Path(spec.origin)
    listed = (plugin.entry_point.dist.files if plugin.entry_point.dist else None) or ()
    for entry in listed:
        path = Path(str(entry.locate()))
        if (
            entry.suffix in _CODE
            and not entry.name.startswith("__editable__")
            and ".." not in entry.parts
            and path.is_file()
        ):
            found[entry.as_posix()] = path
    return _digest(found.items())


@cache
def versions() -> dict[str, str]:
    """Versions of what computes every result."""
    return {
        "schema": SCHEMA_VERSION,
        "spoofbench": core(),
        "numpy": version("numpy"),
        "scipy": version("scipy"),
    }


def _files(folder: Path) -> Iterator[Path]:
    for path in folder.rglob("*"):
        if "__pycache__" not in path.relative_to(folder).parts and path.is_file():
            yield path


def _digest(files: Iterable[tuple[str, Path]]) -> str:
    digest = hashlib.sha256()
    for name, path in sorted(files):
        digest.update(canonical([name, hashlib.sha256(path.read_bytes()).hexdigest()]).encode())
    return digest.hexdigest()
