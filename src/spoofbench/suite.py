"""Suites: which recordings, attacks and detectors a benchmark crosses, and how it calibrates, read
from a TOML file.

::

    name = "drive"                     # a label, as every id below
    seed = 1                           # of where the windows of attack lie, and of the attacks
    windows = 4                        # disjoint ones per recording; default: as many as fit
    duration_s = 300.0                 # of every window
    warm_up_s = 180.0                  # before the first; default: the longest a detector declares
    memory_cap_s = 130.0               # how long an alarm may outlast its cause
    target_far_per_hour = 1.0          # false-alert rate at which detectors are ranked
    alert_limit_m = 50.0               # errors above it are hazardous ...
    time_to_alert_s = 10.0             # ... unless an alert comes within this
    ranks_fused = ["phone-1hz"]        # classes whose fused positions may be held against an IMU

    [calibration]                      # without it, thresholds are the published ones
    split = "leave-one-session-out"    # or "sides", "first-part"
    until_s = 900.0                    # of each recording, for "first-part"
    classes = ["car-mems"]             # others stay at the published thresholds; default: all

    [limits]                           # per task
    time_s = 60.0
    memory_mb = 512                    # over that of a worker that holds the recording

    [[recordings]]
    id = "drive"
    path = "drive.mcap"                # absolute, or relative to this file; or
    fetch = "drive"                    # the name of a recipe, which says session, class and whether
                                       # it is simulated; the id is the name
    session = "2024-05-01"             # recordings of one outing share it; default: the id
    class = "car-mems"                 # of its sensors; thresholds are fitted within one
    side = "judged"                    # or "calibration", for the split "sides"
    simulated = false
    donors = ["other"]                 # recordings that attacks may take signals from

    [[attacks]]
    name = "drag-off"                  # plugin
    id = "drag-off"                    # default: the name
    parameters = { rate_mps = [0.3, 1.0] }    # each number of a list is an attack of its own
    recordings = ["drive"]             # default: all

    [[detectors]]
    name = "correlation"               # plugin
    id = "correlation-H_ag"            # default: the name
    parameters = { statistic = "H_ag" }
    source = "published"               # of parameters that are not the plugin's defaults, or
    sources = { statistic = "published" }     # of each: published, data sheet, by hand, session ID
    fit = true                         # let one that learns learn from the calibration side
    classes = ["car-mems"]             # of recordings that it is made for; default: all
    hold_s = 1.0                       # how long a decision stands; default: by its own rate

A detector with a parameter called ``rate_per_hour`` that the suite leaves open gets
``target_far_per_hour``.
"""

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from annotated_types import Ge, Gt, Le, MinLen, Predicate, doc

from spoofbench import config
from spoofbench.errors import SpoofbenchError, SuiteError
from spoofbench.shipped import shipped

RATE_PARAMETER = "rate_per_hour"
"""A detector's parameter of this name defaults to the suite's target false-alert rate."""

MAX_S = 1e9
"""Longest time that a suite can ask for, over 30 years: it fits in nanoseconds, and in what a
system can wait.
"""

MIN_MEMORY_MB = 256
"""A worker with less cannot even import what it needs."""

MEMORY_CAP_S = 130.0
"""Longest that an alarm may outlast its cause, unless a suite says otherwise."""

SOURCES = ("published", "data sheet", "by hand")
SUITES_TARGET = "the suite's target"
"""Where the rate of a detector comes from that the suite leaves open."""

_SESSION = "session "


def _is_label(text: str) -> bool:
    return re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}", text) is not None


def _is_source(text: str) -> bool:
    return text in SOURCES or (text.startswith(_SESSION) and _is_label(text[len(_SESSION) :]))


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
Classes = Annotated[tuple[Label, ...], Predicate(_differ), doc("a list of different classes")]
Source = Annotated[
    str,
    Predicate(_is_source),
    doc("'published', 'data sheet', 'by hand', or 'session ID' for one it was measured on"),
]
Seconds = Annotated[float, Ge(0), Le(MAX_S)]
Duration = Annotated[float, Gt(0), Le(MAX_S)]

Side = Literal["judged", "calibration"]


@dataclass(frozen=True, slots=True)
class TaskLimits:
    """What one task may take: wall-clock time, and memory over that of a worker that holds the
    recording.
    """

    time_s: Duration = 60.0
    memory_mb: Annotated[int, Ge(MIN_MEMORY_MB)] = 512


@dataclass(frozen=True, slots=True)
class Calibration:
    """Which clean material sets thresholds and fits detectors, and which is judged.

    Attributes:
        split: ``sides``: each recording says its own. ``leave-one-session-out``: each session is
            judged with everything fitted on the others of its class. ``first-part``: the beginning
            of each recording calibrates, the rest is judged.
        until_s: length of the first part.
        classes: sensor classes that are calibrated; None for all.
    """

    split: Literal["sides", "leave-one-session-out", "first-part"]
    until_s: Duration | None = None
    classes: Classes | None = None

    def __post_init__(self) -> None:
        if (self.split == "first-part") != (self.until_s is not None):
            raise ValueError(
                "the split 'first-part' needs until_s, the length of the first part in seconds"
                if self.until_s is None
                else f"until_s belongs to the split 'first-part'; leave it out of {self.split!r}"
            )


@dataclass(frozen=True, slots=True)
class RecordingEntry:
    """A recording, and the ids of those that attacks on it may take signals from.

    The path of one with a recipe is in the cache, whether or not it has been fetched.
    """

    id: Label
    path: Path
    session: Label
    sensor_class: Label = field(default="default", metadata={"key": "class"})
    side: Side | None = None
    simulated: bool = False
    donors: Labels = ()
    recipe: str | None = field(default=None, metadata={"key": "fetch"})


@dataclass(frozen=True, slots=True)
class AttackEntry:
    """An attack plugin with parameters; ``recordings`` None means all.

    Attacks of one ``group`` are one at several strengths; None is a group of its own.
    """

    id: Label
    plugin: Label = field(metadata={"key": "name"})
    parameters: Mapping[str, Any] = field(default_factory=dict)
    recordings: Labels | None = None
    group: Label | None = None


@dataclass(frozen=True, slots=True)
class DetectorEntry:
    """A detector plugin with parameters and where they come from; ``classes`` None means all,
    ``hold_s`` None by its own rate.
    """

    id: Label
    plugin: Label = field(metadata={"key": "name"})
    parameters: Mapping[str, Any] = field(default_factory=dict)
    source: Source | None = None
    sources: Mapping[str, Source] = field(default_factory=dict)
    fit: bool = True
    classes: Classes | None = None
    hold_s: Duration | None = None

    def source_of(self, parameter: str) -> str | None:
        """Return where the value of a parameter comes from; None where the suite does not say."""
        return self.sources.get(parameter, self.source)


@dataclass(frozen=True, slots=True)
class Suite:
    """A benchmark: every recording unattacked, and recordings x attacks x windows, before every
    detector.
    """

    name: Label
    seed: Annotated[int, Ge(0)]
    duration_s: Duration
    target_far_per_hour: Annotated[float, Ge(0)]
    recordings: Annotated[tuple[RecordingEntry, ...], MinLen(1)]
    detectors: Annotated[tuple[DetectorEntry, ...], MinLen(1)]
    attacks: tuple[AttackEntry, ...] = ()
    windows: Annotated[int, Ge(1)] | None = None
    warm_up_s: Seconds | None = None
    memory_cap_s: Seconds = MEMORY_CAP_S
    alert_limit_m: Annotated[float, Gt(0)] | None = None
    time_to_alert_s: Seconds = 0.0
    ranks_fused: Classes = ()
    calibration: Calibration | None = None
    limits: TaskLimits = TaskLimits()

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
        for detector in self.detectors:
            self._require_class(f"classes of detector {detector.id!r}", detector.classes or ())
        self._require_class("ranks_fused", self.ranks_fused)
        if self.calibration:
            self._require_class("classes of [calibration]", self.calibration.classes or ())
        self._check_sides()
        self._check_sources()

    def _require_known(self, where: str, ids: Iterable[str]) -> None:
        known = [entry.id for entry in self.recordings]
        for name in ids:
            if name not in known:
                raise ValueError(
                    f"{where} names {name!r}, which is no recording of the suite"
                    f"{config.did_you_mean(name, known)}"
                )

    def _require_class(self, where: str, classes: Iterable[str]) -> None:
        known = sorted({entry.sensor_class for entry in self.recordings})
        for name in classes:
            if name not in known:
                raise ValueError(
                    f"{where} names {name!r}, which is the class of no recording"
                    f"{config.did_you_mean(name, known)}"
                )

    def _check_sides(self) -> None:
        has_sides = self.calibration is not None and self.calibration.split == "sides"
        sides: dict[str, set[Side | None]] = {}
        for recording in self.recordings:
            sides.setdefault(recording.session, set()).add(recording.side)
            if has_sides != (recording.side is not None):
                raise ValueError(
                    f"recording {recording.id!r} says no side; with the split 'sides' each says "
                    "'judged' or 'calibration'"
                    if has_sides
                    else f"recording {recording.id!r} says a side; that needs the split 'sides'"
                )
        both = [session for session, of in sides.items() if len(of) > 1]
        if both:
            raise ValueError(
                f"session {both[0]!r} is on both sides; what it calibrates cannot be judged on it"
            )

    def _check_sources(self) -> None:
        judged = {entry.session for entry in self.recordings if entry.side != "calibration"}
        for detector in self.detectors:
            for source in (detector.source, *detector.sources.values()):
                if source and source.removeprefix(_SESSION) in judged - {source}:
                    raise ValueError(
                        f"a parameter of detector {detector.id!r} comes from the {source}, which "
                        "is judged; let the run fit it, or judge on others"
                    )

    def attacks_on(self, recording: str) -> tuple[AttackEntry, ...]:
        """The attacks on one recording, in the suite's order."""
        return tuple(
            attack
            for attack in self.attacks
            if attack.recordings is None or recording in attack.recordings
        )

    def detectors_for(self, recording: RecordingEntry) -> tuple[DetectorEntry, ...]:
        """The detectors that are made for a recording's class, in the suite's order."""
        return tuple(
            detector
            for detector in self.detectors
            if detector.classes is None or recording.sensor_class in detector.classes
        )

    def is_calibrated(self, recording: RecordingEntry) -> bool:
        """Whether thresholds for the recording's sensor class are fitted by the run."""
        return self.calibration is not None and (
            self.calibration.classes is None or recording.sensor_class in self.calibration.classes
        )


def packaged_suite(name: str) -> Path:
    """Return the file of a suite that comes with spoofbench, such as ``drive``.

    Raises:
        SuiteError: there is none of that name.
    """
    files = {path.stem: path for path in shipped("suites").glob("*.toml")}
    if name not in files:
        hint = config.did_you_mean(name, files)
        raise SuiteError(f"no suite called {name!r} comes with spoofbench{hint}")
    return files[name]


def find_suite(name: Path) -> Path:
    """Return a suite's file: the one of this path, or the shipped one of this name.

    Raises:
        SuiteError: there is neither.
    """
    return name if name.suffix or name.exists() else packaged_suite(str(name))


def load_suite(path: Path) -> Suite:
    """Read and check a suite file.

    Raises:
        SuiteError: names the key, the value and what to do.
    """
    where = f"suite {path.name!r}"
    table = config.read_toml(path, f"the {where}", SuiteError)
    for entry in _tables(table, "recordings"):
        if isinstance(name := entry.get("fetch"), str):
            _take_up_recipe(entry, name, where)
    for key, origin, heir in (
        ("recordings", "id", "session"),
        ("attacks", "name", "id"),
        ("detectors", "name", "id"),
    ):
        for entry in _tables(table, key):
            if origin in entry:
                entry.setdefault(heir, entry[origin])
    suite = config.read(Suite, table, where, error=SuiteError)
    recordings = (replace(entry, path=path.parent / entry.path) for entry in suite.recordings)
    attacks = (each for entry in suite.attacks for each in _strengths(entry, where))
    try:
        return replace(suite, recordings=tuple(recordings), attacks=tuple(attacks))
    except ValueError as error:
        raise SuiteError(f"{where}: {error}") from error


def _tables(table: Mapping[str, Any], key: str) -> list[dict[str, Any]]:
    entries = table.get(key)
    return [each for each in entries if isinstance(each, dict)] if isinstance(entries, list) else []


def _take_up_recipe(entry: dict[str, Any], name: str, where: str) -> None:
    """Take up what a recipe knows of its recording, and where that lies once it is fetched."""
    from spoofbench.fetch import cached_path, recipe

    try:
        known = recipe(name)
        path = str(cached_path(name))
    except SpoofbenchError as error:
        raise SuiteError(f"{where}: {error}") from error
    if "path" in entry:
        raise SuiteError(f"{where}: a recording has both 'path' and fetch = {name!r}; choose one")
    entry |= {"path": path} | {
        key: entry.get(key, value)
        for key, value in {
            "id": name,
            "session": known.session,
            "class": known.sensor_class,
            "simulated": known.simulation is not None,
        }.items()
    }


def _strengths(entry: AttackEntry, where: str) -> list[AttackEntry]:
    """Return an attack for each number of the parameter that is a list of numbers, if one is."""
    listed = [name for name, value in entry.parameters.items() if _is_severity_list(value)]
    if not listed:
        return [entry]
    if len(listed) > 1:
        raise SuiteError(
            f"{where}: attack {entry.id!r} has two lists of numbers, {listed[0]!r} and "
            f"{listed[1]!r}; write an attack for each value of one of them"
        )
    return [
        replace(
            entry,
            id=f"{entry.id}-{value:g}".replace("+", ""),
            parameters={**entry.parameters, listed[0]: value},
            group=entry.group or entry.id,
        )
        for value in entry.parameters[listed[0]]
    ]


def _is_severity_list(value: Any) -> bool:
    return (
        isinstance(value, list | tuple)
        and len(value) > 0
        and all(isinstance(item, int | float) and not isinstance(item, bool) for item in value)
    )
