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
    hold_s = 1.0                       # how long a decision stands; default: one epoch

A detector with a parameter called ``rate_per_hour`` that the suite leaves open gets
``target_far_per_hour``.
"""

import difflib
import math
import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from spoofbench.errors import SuiteError

RATE_PARAMETER = "rate_per_hour"
"""A detector's parameter of this name defaults to the suite's target false-alert rate."""

MOST_S = 1e9
"""Longest time that a suite can ask for, over 30 years: it fits in nanoseconds, and in what a
system can wait.
"""

LEAST_MEMORY_MB = 256
"""A worker with less cannot even import what it needs."""

_LABEL = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")


@dataclass(frozen=True, slots=True)
class Limits:
    """What one task may take: wall-clock time, and memory over that of a worker that holds the
    recording.
    """

    time_s: float = 60.0
    memory_mb: int = 512


@dataclass(frozen=True, slots=True)
class RecordingEntry:
    """A recording, and the ids of those that attacks on it may take signals from."""

    id: str
    path: Path
    session: str
    donors: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class AttackEntry:
    """An attack plugin with parameters; ``recordings`` None means all."""

    id: str
    plugin: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    recordings: tuple[str, ...] | None = None


@dataclass(frozen=True, slots=True)
class DetectorEntry:
    """A detector plugin with parameters; ``hold_s`` None means one epoch."""

    id: str
    plugin: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    hold_s: float | None = None


@dataclass(frozen=True, slots=True)
class Suite:
    """A benchmark: every recording unattacked, and recordings x attacks x seeds, before every
    detector.
    """

    name: str
    seed: int
    seeds: tuple[int, ...]
    warm_up_s: float
    duration_s: float
    target_far_per_hour: float
    limits: Limits
    recordings: tuple[RecordingEntry, ...]
    attacks: tuple[AttackEntry, ...]
    detectors: tuple[DetectorEntry, ...]

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
    folder = Path(__file__).parent / "suites"
    texts = {path.stem: path for path in folder.glob("*.toml")}
    if name not in texts:
        raise SuiteError(f"no suite called {name!r} comes with spoofbench{_meant(name, texts)}")
    return texts[name].read_text("utf-8")


def load_suite(path: Path) -> Suite:
    """Read and check a suite file.

    Raises:
        SuiteError: names the key, the value and what to do.
    """
    try:
        document = tomllib.loads(path.read_text("utf-8"))
    except OSError as error:
        raise SuiteError(f"the suite {path.name!r} cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise SuiteError(f"the suite {path.name!r} is not TOML: {error}") from error
    try:
        return _suite(path, document)
    except RecursionError as error:
        raise SuiteError(
            f"the suite {path.name!r} nests its tables too deeply; write parameters flat"
        ) from error


def _suite(path: Path, document: Mapping[str, Any]) -> Suite:
    top = _Section(f"suite {path.name!r}", document)
    suite = Suite(
        name=top.label("name"),
        seed=top.whole("seed", 0),
        seeds=top.seeds("seeds"),
        warm_up_s=top.seconds("warm_up_s"),
        duration_s=top.seconds("duration_s", exclusive=True),
        target_far_per_hour=top.number("target_far_per_hour", 0.0),
        limits=_limits(top.section("limits")),
        recordings=tuple(
            _recording(section, path.parent) for section in top.sections("recordings")
        ),
        attacks=tuple(_attack(section) for section in top.sections("attacks", may_be_empty=True)),
        detectors=tuple(_detector(section) for section in top.sections("detectors")),
    )
    top.close()
    for key in ("recordings", "attacks", "detectors"):
        _distinct(
            f"suite {path.name!r}: id of [[{key}]]", [entry.id for entry in getattr(suite, key)]
        )
    _refer_to_recordings(suite, path.name)
    return suite


def _limits(section: "_Section") -> Limits:
    limits = Limits(
        section.seconds("time_s", Limits().time_s, exclusive=True),
        section.whole("memory_mb", LEAST_MEMORY_MB, Limits().memory_mb),
    )
    section.close()
    return limits


def _recording(section: "_Section", folder: Path) -> RecordingEntry:
    name = section.label("id")
    entry = RecordingEntry(
        name,
        folder / section.text("path"),
        section.label("session", name),
        section.labels("donors", ()) or (),
    )
    section.close()
    return entry


def _attack(section: "_Section") -> AttackEntry:
    plugin = section.label("name")
    entry = AttackEntry(
        section.label("id", plugin),
        plugin,
        section.parameters("parameters"),
        section.labels("recordings", None),
    )
    section.close()
    return entry


def _detector(section: "_Section") -> DetectorEntry:
    plugin = section.label("name")
    hold_s = section.seconds("hold_s", exclusive=True) if "hold_s" in section else None
    entry = DetectorEntry(
        section.label("id", plugin), plugin, section.parameters("parameters"), hold_s
    )
    section.close()
    return entry


def _distinct(what: str, values: Iterable[Any]) -> None:
    twice = [value for value, count in Counter(values).items() if count > 1]
    if twice:
        raise SuiteError(f"{what} {twice[0]!r} stands there twice; give each its own")


def _refer_to_recordings(suite: Suite, name: str) -> None:
    known = [entry.id for entry in suite.recordings]
    references = [(f"donors of recording {entry.id!r}", entry.donors) for entry in suite.recordings]
    references += [
        (f"recordings of attack {entry.id!r}", entry.recordings or ()) for entry in suite.attacks
    ]
    for where, ids in references:
        for reference in ids:
            if reference not in known:
                raise SuiteError(
                    f"suite {name!r}: {where} names {reference!r}, which is no recording of the "
                    f"suite{_meant(reference, known)}"
                )
    for entry in suite.recordings:
        if entry.id in entry.donors:
            raise SuiteError(
                f"suite {name!r}: recording {entry.id!r} is its own donor; leave it out of its "
                "donors"
            )


def _meant(given: str, known: Iterable[str]) -> str:
    known = sorted(known)
    near = difflib.get_close_matches(given, known, 1)
    return f"; did you mean {near[0]!r}?" if near else f"; there are {known}"


def _is_finite(value: Any) -> bool:
    """Whether a value is a number that a float can express."""
    try:
        return (
            isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        )
    except OverflowError:
        return False


_REQUIRED: Any = object()


class _Section:
    """A TOML table on its way to a dataclass: knows where it stands and which keys were asked
    for.
    """

    def __init__(self, where: str, table: Mapping[str, Any]) -> None:
        self.where = where
        self.table = table
        self.asked: set[str] = set()

    def __contains__(self, key: str) -> bool:
        self.asked.add(key)
        return key in self.table

    def wrong(self, key: str, wanted: str) -> SuiteError:
        return SuiteError(f"{self.where}: {key} = {self.table[key]!r} must be {wanted}")

    def get(self, key: str, default: Any = _REQUIRED) -> Any:
        if key not in self and default is _REQUIRED:
            raise SuiteError(f"{self.where} lacks the key {key!r}; add it")
        return self.table.get(key, default)

    def close(self) -> None:
        """Refuse keys that nobody asked for."""
        for key in self.table:
            if key not in self.asked:
                raise SuiteError(
                    f"{self.where} has an unknown key {key!r}{_meant(key, self.asked)}"
                )

    def text(self, key: str) -> str:
        value = self.get(key)
        if not isinstance(value, str) or not value or "\0" in value:
            raise self.wrong(key, "a text that is not empty")
        return value

    def label(self, key: str, default: Any = _REQUIRED) -> str:
        value = self.get(key, default)
        if not isinstance(value, str) or not _LABEL.fullmatch(value):
            raise self.wrong(
                key, "up to 64 letters, digits, '.', '_' or '-', with a letter or digit first"
            )
        return value

    def labels(self, key: str, default: tuple[str, ...] | None) -> tuple[str, ...] | None:
        if key not in self:
            return default
        value = self.get(key)
        if (
            not isinstance(value, list)
            or not all(isinstance(item, str) for item in value)
            or len(set(value)) < len(value)
        ):
            raise self.wrong(key, "a list of different ids of recordings")
        return tuple(value)

    def number(
        self, key: str, least: float, default: Any = _REQUIRED, *, exclusive: bool = False
    ) -> float:
        value = self.get(key, default)
        if not _is_finite(value) or value < least or (exclusive and value == least):
            raise self.wrong(key, f"a number {'above' if exclusive else 'of at least'} {least:g}")
        return float(value)

    def seconds(self, key: str, default: Any = _REQUIRED, *, exclusive: bool = False) -> float:
        value = self.number(key, 0.0, default, exclusive=exclusive)
        if value > MOST_S:
            raise self.wrong(key, f"at most {MOST_S:g} s")
        return value

    def whole(self, key: str, least: int, default: Any = _REQUIRED) -> int:
        value = self.get(key, default)
        if not isinstance(value, int) or isinstance(value, bool) or not least <= value < 2**63:
            raise self.wrong(key, f"a whole number of at least {least}")
        return value

    def seeds(self, key: str) -> tuple[int, ...]:
        value = self.get(key)
        fits = isinstance(value, list) and all(
            isinstance(seed, int) and not isinstance(seed, bool) for seed in value
        )
        if (
            not fits
            or not value
            or not all(0 <= seed < 2**63 for seed in value)
            or len(set(value)) < len(value)
        ):
            raise self.wrong(key, "a list of different whole numbers of at least 0, and not empty")
        return tuple(value)

    def parameters(self, key: str) -> Mapping[str, Any]:
        value = self.get(key, {})
        if not isinstance(value, dict):
            raise self.wrong(
                key, "a table of the plugin's parameters, such as { window_s = 120.0 }"
            )
        return {name: self.parameter(name, item) for name, item in value.items()}

    def parameter(self, name: str, value: Any) -> Any:
        if isinstance(value, list):
            return tuple(self.parameter(name, item) for item in value)
        if isinstance(value, dict):
            return {key: self.parameter(f"{name}.{key}", item) for key, item in value.items()}
        if not isinstance(value, str | bool) and not _is_finite(value):
            raise SuiteError(
                f"{self.where}: parameter {name} = {value!r} must be a text, a finite number, "
                "true or false; write dates as text"
            )
        return value

    def section(self, key: str) -> "_Section":
        value = self.get(key, {})
        if not isinstance(value, dict):
            raise self.wrong(key, f"a table: write it as [{key}]")
        return _Section(f"{self.where}, [{key}]", value)

    def sections(self, key: str, *, may_be_empty: bool = False) -> "list[_Section]":
        value = self.get(key, [])
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            raise self.wrong(key, f"tables: write each as [[{key}]]")
        if not value and not may_be_empty:
            raise SuiteError(f"{self.where} has no [[{key}]]; add at least one")
        return [
            _Section(f"{self.where}, [[{key}]] number {index}", item)
            for index, item in enumerate(value, 1)
        ]
