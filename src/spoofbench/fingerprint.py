"""Digests of code: what a result or a recording was made by, so that it is made again after a
change.
"""

import hashlib
import importlib.util
import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from spoofbench.plugins import Plugin

_CODE = frozenset({".py", ".so", ".pyd", ".dylib"})


def canonical(value: Any) -> str:
    """Return the one JSON text of a value."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"))


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


def package_digest(plugin: Plugin) -> str:
    """Return the digest of the code of a plugin: its top package (or module), and what code its
    distribution lists besides.

    Of an installation that is edited in place, the distribution lists nothing, and the package is
    found where it is.
    """
    name = plugin.entry_point.module.partition(".")[0]
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


def _files(folder: Path) -> Iterator[Path]:
    for path in folder.rglob("*"):
        if "__pycache__" not in path.relative_to(folder).parts and path.is_file():
            yield path


def _digest(files: Iterable[tuple[str, Path]]) -> str:
    digest = hashlib.sha256()
    for name, path in sorted(files):
        digest.update(canonical([name, hashlib.sha256(path.read_bytes()).hexdigest()]).encode())
    return digest.hexdigest()
