"""What comes with spoofbench besides code: the suites, and the recipes of recordings.

They lie in the folder ``benchmarks`` of the repository, and in a wheel within the package.
"""

from pathlib import Path

_HERE = Path(__file__).parent


def shipped(name: str) -> Path:
    """Return the path of what comes with spoofbench, such as ``suites`` or ``recordings.toml``."""
    packaged = _HERE / "benchmarks"
    return (packaged if packaged.is_dir() else _HERE.parent.parent / "benchmarks") / name
