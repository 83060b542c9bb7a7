"""The cache of recordings: made by recipe, found by everything that decides them.

A recording lies in ``recordings/KEY/NAME.mcap``, where the key is the digest of its recipe, its
labels and the code that converts it. A change of any of them leads to another path, so that a stale
recording is never found.
"""

import hashlib
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import cache
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory

import spoofbench
from spoofbench import config, plugins
from spoofbench.codec import write
from spoofbench.conversion import convert
from spoofbench.fetch.recipe_file import Recipe, Simulation, recipe, wheels
from spoofbench.fetch.sources import Mirror, Origins, digest_of_file
from spoofbench.fingerprint import canonical, digest_of, package_digest
from spoofbench.labels import label_file
from spoofbench.recording import Recording
from spoofbench.shipped import shipped

CACHE_VARIABLE = "SPOOFBENCH_CACHE"
"""Environment variable: the folder of the cache, instead of the user's own."""

MIRROR_VARIABLE = "SPOOFBENCH_MIRROR"
"""Environment variable: folders, separated as in PATH, in which files are looked for instead of on
the network.
"""

_DECISIVE = ("arrays", "codec", "conversion", "gnss_time", "labels", "recording", "schema", "table")
"""The modules of the core that decide a converted recording."""

_SIMULATING = ("testing.motion", "testing.recordings")
"""Those that decide a simulated one, too."""


def cache_folder() -> Path:
    """Return the folder of the cache; it need not exist."""
    given = os.environ.get(CACHE_VARIABLE)
    if given:
        return Path(given)
    import pooch

    return Path(pooch.os_cache("spoofbench"))


def cached_path(name: str) -> Path:
    """Return the path that a recording of a recipe has in the cache, once it has been fetched.

    Raises:
        SpoofbenchError: there is no such recipe.
    """
    return _place(recipe(name))


def fetch(
    name: str,
    mirror: Sequence[Path] = (),
    progress: Callable[[float], None] | None = None,
) -> Path:
    """Return the path of a recording in the cache, made now if it is not there.

    Args:
        name: of its recipe.
        mirror: folders in which its files are looked for; default: those of the environment. With
            any, the network is not used.
        progress: is told the share that is done, 0 to 1, of the download and again of the
            conversion.

    Raises:
        SpoofbenchError: there is no such recipe, a file is nowhere, is damaged or has changed, or
            cannot be converted.
    """
    made_by = recipe(name)
    path = _place(made_by)
    if not path.is_file():
        origins = Origins(cache_folder() / "raw", _mirror(tuple(mirror)), dict(wheels()))
        make(made_by, path, origins, progress)
    return path


def make(
    made_by: Recipe, out: Path, origins: Origins, progress: Callable[[float], None] | None = None
) -> None:
    """Make the recording of a recipe; it appears whole or not at all.

    Args:
        made_by: the recipe.
        out: the recording to write.
        origins: where its files are looked for.
        progress: as of :func:`fetch`.

    Raises:
        SpoofbenchError: as :func:`fetch`.
    """
    found = {file.called: origins.find(made_by.name, file, progress) for file in made_by.files}
    out.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=out.parent, prefix=".converting-") as folder:
        source, made = Path(folder) / made_by.name, Path(folder) / out.name
        source.mkdir()
        for called, path in found.items():
            (source / called).symlink_to(path.resolve())
        if made_by.simulation:
            write(_simulated(made_by.simulation), made)
        else:
            convert(
                source if len(found) > 1 else source / made_by.files[0].called,
                made,
                format=made_by.format,
                options=made_by.options,
                progress=progress,
            )
        if made_by.labels:
            label_file(made, _labels(made_by), made)
        made.replace(out)


def _place(made_by: Recipe) -> Path:
    return cache_folder() / "recordings" / _key(made_by)[:20] / f"{made_by.name}.mcap"


def _labels(made_by: Recipe) -> Path:
    return shipped("labels") / str(made_by.labels)


def _key(made_by: Recipe) -> str:
    """Return the digest of what decides a recording."""
    inputs = {
        "files": [[file.called, file.sha256] for file in made_by.files],
        "format": made_by.format,
        "options": config.plain(made_by.options),
        "code": _code(made_by.format) if made_by.files else _simulator(),
    }
    if made_by.simulation:
        inputs["simulation"] = asdict(made_by.simulation)
    if made_by.labels:
        inputs["labels"] = digest_of_file(_labels(made_by))
    return hashlib.sha256(canonical(inputs).encode()).hexdigest()


@cache
def _code(converter: str | None) -> dict[str, str]:
    """Return the digests of the code that makes a recording; where the format is found by content,
    that of all converters.
    """
    known = plugins.found(plugins.CONVERTERS)
    asked = [plugins.find(plugins.CONVERTERS, converter)] if converter else known.values()
    core = digest_of(Path(spoofbench.__file__).parent, _DECISIVE)
    return {"spoofbench": core, **{plugin.name: package_digest(plugin) for plugin in asked}}


@cache
def _simulator() -> dict[str, str]:
    """Return the digest of the code that computes a recording, and of the library it does it by."""
    code = digest_of(Path(spoofbench.__file__).parent, (*_DECISIVE, *_SIMULATING))
    return {"spoofbench": code, "numpy": version("numpy")}


def _simulated(simulation: Simulation) -> Recording:
    from spoofbench.testing.recordings import drive

    return drive(simulation.seed, simulation.duration_s, lag_s=simulation.lag_s)


def _mirror(folders: tuple[Path, ...]) -> Mirror | None:
    given = os.environ.get(MIRROR_VARIABLE, "")
    folders = folders or tuple(Path(part) for part in given.split(os.pathsep) if part)
    return Mirror(folders) if folders else None
