"""A distribution of fake plugins, short recordings, and suites of them."""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from spoofbench import codec, plugins
from spoofbench.suite import AttackEntry, DetectorEntry, RecordingEntry, Suite, TaskLimits
from spoofbench.testing.recordings import drive

FAKES = Path(__file__).parent / "fakes"


@pytest.fixture(scope="session")
def fakes() -> Iterator[Path]:
    """The fake distribution is installed."""
    sys.path.insert(0, str(FAKES))
    plugins.found.cache_clear()
    yield FAKES
    sys.path.remove(str(FAKES))
    plugins.found.cache_clear()


@pytest.fixture(scope="session")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two short recordings."""
    folder = tmp_path_factory.mktemp("logs")
    for seed in (1, 2):
        codec.write(drive(seed, 90.0), folder / f"drive-{seed}.mcap")
    return folder


MakeSuite = Callable[..., Suite]


def _sourced(entry: DetectorEntry) -> DetectorEntry:
    """Say where parameters come from, unless the entry does itself."""
    return entry if entry.source or entry.sources else replace(entry, source="by hand")


@pytest.fixture(scope="session")
def make_suite(fakes: Path, logs: Path) -> MakeSuite:
    def make(
        detectors: Sequence[str | DetectorEntry],
        attacks: Sequence[str | AttackEntry] = ("nudge",),
        recordings: Mapping[str, Path] | None = None,
        **changes: Any,
    ) -> Suite:
        paths = {"drive-1": logs / "drive-1.mcap"} if recordings is None else recordings
        given: dict[str, Any] = {
            "name": "fakes",
            "seed": 1,
            "windows": 1,
            "warm_up_s": 10.0,
            "duration_s": 20.0,
            "target_far_per_hour": 3.5,
            "limits": TaskLimits(time_s=20.0, memory_mb=256),
            "recordings": tuple(RecordingEntry(name, path, name) for name, path in paths.items()),
            "attacks": tuple(
                AttackEntry(entry, entry) if isinstance(entry, str) else entry for entry in attacks
            ),
            "detectors": tuple(
                DetectorEntry(entry, entry) if isinstance(entry, str) else _sourced(entry)
                for entry in detectors
            ),
        }
        return Suite(**(given | changes))

    return make
