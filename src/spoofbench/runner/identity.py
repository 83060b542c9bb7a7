"""Names of tasks and variants: the SHA-256 of everything that decides what comes out.

Equal inputs have equal ids on any machine, and an input that changes changes the id, so a result
that is there is right.
"""

import hashlib
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import spoofbench
from spoofbench.fingerprint import canonical, digest_of, package_digest
from spoofbench.plugins import Plugin
from spoofbench.schema import SCHEMA_VERSION

__all__ = ["DECISIVE", "canonical", "code_of", "core", "digest_of", "identify", "versions"]

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


def identify(**inputs: Any) -> str:
    """Return the id of what these inputs decide."""
    return hashlib.sha256(canonical(inputs).encode()).hexdigest()


@cache
def core() -> str:
    """Return the digest of the core's code that decides results."""
    return digest_of(Path(spoofbench.__file__).parent, DECISIVE)


def code_of(plugin: Plugin) -> str:
    """Return the digest of the code of a plugin; of one of spoofbench's own, that of the core."""
    if plugin.entry_point.module.partition(".")[0] == spoofbench.__name__:
        return core()
    return package_digest(plugin)


@cache
def versions() -> dict[str, str]:
    """Versions of what computes every result."""
    return {
        "schema": SCHEMA_VERSION,
        "spoofbench": core(),
        "numpy": version("numpy"),
        "scipy": version("scipy"),
    }
