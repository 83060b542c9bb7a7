"""Suites: which recordings, attacks, seeds and detectors a benchmark crosses, read from a TOML
file.

::

    name = "drive"                     # a label, as every id below
    seed = 1                           # of the windows of attack
    seeds = [1, 2, 3]                  # each attack once per seed
    warm_up_s = 120.0                  # before the first window
    duration_s = 120.0                 # of every attack
    target_far_per_hour = 1.0          # false-alert rate at which detectors are ranked

    [limits]                           # per task
    time_s = 60.0
    memory_mb = 512                    # over that of a worker that holds the recording

    [[recordings]]
    id = "drive"
    path = "drive.mcap"                # absolute, or relative to this file
    session = "2024-05-01"             # recordings of one outing share it; default: the id
    donors = ["other"]                 # recordings that attacks may take signals from

    [[attacks]]
    name = "replay"                    # plugin
    id = "replay-60s"                  # default: the name
    parameters = { delay_s = 60.0 }
    recordings = ["drive"]             # default: all

    [[detectors]]
    name = "correlation"               # plugin
    id = "correlation-H_ag"            # default: the name
    parameters = { statistic = "H_ag" }
    hold_s = 1.0                       # how long a decision stands; default: 1.1 intervals

A detector with a parameter called ``rate_per_hour`` that the suite leaves open gets
``target_far_per_hour``.
"""

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Ge, Gt, Le, MinLen, Predicate, doc

from spoofbench import config
from spoofbench.errors import SuiteError
from spoofbench.shipped import shipped

RATE_PARAMETER = "rate_per_hour"
"""A detector's parameter of this name defaults to the suite's target false-alert rate."""

MAX_S = 1e9
"""Longest time that a suite can ask for, over 30 years: it fits in nanoseconds, and in what a
system can wait.
"""

MIN_MEMORY_MB = 256
"""A worker with less cannot even import what it needs."""


def _is_label(text: str) -> bool:
    return re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}", text) is not None


def _differ(items: tuple[Any, ...]) -> bool:
    return len(set(items)) == len(items)


Label = Annotated[
    str,
    Predicate(_is_label),
    doc("up to 64 letters, digits, '.', '_' or '-', with a letter or digit first"),
]
"""An id; it is safe as the name of a file."""

Labels = Annotated[
    tuple[str, ...], Predicate(_differ), doc("a list of different ids of recordings")
]
Seconds = Annotated[float, Ge(0), Le(MAX_S)]
Duration = Annotated[float, Gt(0), Le(MAX_S)]
Seeds = Annotated[
    tuple[Annotated[int, Ge(0)], ...],
    MinLen(1),
    Predicate(_differ),
    doc("a non-empty list of different whole numbers of at least 0"),
]


@dataclass(frozen=True, slots=True)
class TaskLimits:
    """What one task may take: wall-clock time, and memory over that of a worker that holds the
    recording.
    """

    time_s: Duration = 60.0
    memory_mb: Annotated[int, Ge(MIN_MEMORY_MB)] = 512


@dataclass(frozen=True, slots=True)
class RecordingEntry:
    """A recording, and the ids of those that attacks on it may take signals from."""

    id: Label
    path: Path
    session: Label
    donors: Labels = ()


@dataclass(frozen=True, slots=True)
class AttackEntry:
    """An attack plugin with parameters; ``recordings`` None means all."""

    id: Label
    plugin: Label = field(metadata={"key": "name"})
    parameters: Mapping[str, Any] = field(default_factory=dict)
    recordings: Labels | None = None


@dataclass(frozen=True, slots=True)
class DetectorEntry:
    """A detector plugin with parameters; ``hold_s`` None means the default of the scoring grid."""

    id: Label
    plugin: Label = field(metadata={"key": "name"})
    parameters: Mapping[str, Any] = field(default_factory=dict)
    hold_s: Duration | None = None


@dataclass(frozen=True, slots=True)
class Suite:
    """A benchmark: every recording unattacked, and recordings x attacks x seeds, before every
    detector.
    """

    name: Label
    seed: Annotated[int, Ge(0)]
    seeds: Seeds
    warm_up_s: Seconds
    duration_s: Duration
    target_far_per_hour: Annotated[float, Ge(0)]
    limits: TaskLimits
    recordings: Annotated[tuple[RecordingEntry, ...], MinLen(1)]
    attacks: tuple[AttackEntry, ...]
    detectors: Annotated[tuple[DetectorEntry, ...], MinLen(1)]

    def __post_init__(self) -> None:
        for key in ("recordings", "attacks", "detectors"):
            ids = [entry.id for entry in getattr(self, key)]
            repeated = [name for name, count in Counter(ids).items() if count > 1]
            if repeated:
                raise ValueError(
                    f"id of [[{key}]] {repeated[0]!r} is duplicated; give each its own"
                )
        for recording in self.recordings:
            self._require_known(f"donors of recording {recording.id!r}", recording.donors)
            if recording.id in recording.donors:
                raise ValueError(
                    f"recording {recording.id!r} is its own donor; leave it out of its donors"
                )
        for attack in self.attacks:
            self._require_known(f"recordings of attack {attack.id!r}", attack.recordings or ())

    def _require_known(self, where: str, ids: Iterable[str]) -> None:
        known = [entry.id for entry in self.recordings]
        for name in ids:
            if name not in known:
                raise ValueError(
                    f"{where} names {name!r}, which is no recording of the suite"
                    f"{config.did_you_mean(name, known)}"
                )

    def attacks_on(self, recording: str) -> tuple[AttackEntry, ...]:
        """The attacks on one recording, in the suite's order."""
        return tuple(
            attack
            for attack in self.attacks
            if attack.recordings is None or recording in attack.recordings
        )


def packaged_suite(name: str) -> str:
    """Return the text of a suite that comes with spoofbench, such as ``drive``.

    Raises:
        SuiteError: there is none of that name.
    """
    folder = shipped("suites")
    texts = {path.stem: path for path in folder.glob("*.toml")}
    if name not in texts:
        hint = config.did_you_mean(name, texts)
        raise SuiteError(f"no suite called {name!r} comes with spoofbench{hint}")
    return texts[name].read_text("utf-8")


def load_suite(path: Path) -> Suite:
    """Read and check a suite file.

    Raises:
        SuiteError: names the key, the value and what to do.
    """
    table = config.read_toml(path, f"the suite {path.name!r}", SuiteError)
    table = {"limits": {}, "attacks": []} | table
    for key, origin, heir in (
        ("recordings", "id", "session"),
        ("attacks", "name", "id"),
        ("detectors", "name", "id"),
    ):
        entries = table.get(key)
        for entry in entries if isinstance(entries, list) else ():
            if isinstance(entry, dict) and origin in entry:
                entry.setdefault(heir, entry[origin])
    suite = config.read(Suite, table, f"suite {path.name!r}", error=SuiteError)
    recordings = (replace(entry, path=path.parent / entry.path) for entry in suite.recordings)
    return replace(suite, recordings=tuple(recordings))
