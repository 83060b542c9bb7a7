"""What the processes of a run do: describe a plugin, prepare a recording, run a detector.

A job is a function of a plain specification, which goes through JSON and back, and of folders; it
yields plain records. :mod:`spoofbench.runner.execution` runs each in a worker of a sandbox; a
cluster can run them as they are::

    DescriptionJob   -> describe_plugin  -> what a plugin says of itself
    RecordingJob     -> survey_recording -> what is in a recording, and where attacks may lie
                     -> make_variants    -> truth files in the results, blind material in a folder
    FitJob           -> fit_detector     -> what a detector has learned from blind material
    DetectorJob      -> run_detector     -> decisions on blind material, and what they cost

Only the job of a recording knows the truth, and that of a fit the truth of its attacked material.
"""

import hashlib
import math
import pickle
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from functools import cache, partial
from pathlib import Path
from typing import Any

from spoofbench import codec, plugins
from spoofbench.attacks.contract import Attack, attackable_span, draw_windows, make_variant
from spoofbench.detector import (
    Decisions,
    Detector,
    Labelled,
    Trainable,
    declared,
    detect,
    is_baseline,
    learns_from_attacks,
    seen,
    warm_up_s,
)
from spoofbench.errors import NotApplicable, PluginError, RecordingError, ResultsError
from spoofbench.recording import Interval, Recording, is_really_attacked
from spoofbench.results import write_truth
from spoofbench.runner.blind import BlindReader, BlindWriter
from spoofbench.sandbox import MemoryMeter, limit_memory, one_line
from spoofbench.schema import TRUTH_TOPIC
from spoofbench.scoring.grid import build_truth
from spoofbench.suite import RATE_PARAMETER

Record = dict[str, Any]
"""What a job says: values that JSON knows, among them ``status`` and, unless it is ``ok``, a
``reason``.
"""

Unfit = dict[str, tuple[str, str]]
"""Status and reason by id of attack."""


@dataclass(frozen=True, slots=True)
class DescriptionJob:
    """A plugin to describe; ``rate_per_hour`` is the suite's target false-alert rate, which only
    detectors get.
    """

    group: plugins.Group
    plugin: str
    parameters: Mapping[str, Any]
    rate_per_hour: float | None = None


@dataclass(frozen=True, slots=True)
class RecordingJob:
    """A recording to prepare.

    Attributes:
        recording: its id, from which windows are drawn.
        path: its file.
        donors: files that attacks may take signals from.
        attacks: id, plugin and parameters of each attack on it.
        seed: of the windows, and of what attacks draw.
        first_s: how long after the first row windows may begin.
        duration_s, gap_s: of each window, and after it.
        windows: how many; None for as many as fit.
        memory_mb: how far memory may grow while variants are made.
    """

    recording: str
    path: str
    donors: Sequence[str]
    attacks: Sequence[Mapping[str, Any]]
    seed: int
    first_s: float
    duration_s: float
    gap_s: float
    windows: int | None
    memory_mb: int


@dataclass(frozen=True, slots=True)
class VariantJob:
    """A variant to make: one attack, by id, or none, in a window; ``number`` is what detectors'
    processes know it by.
    """

    id: str
    number: str
    attack: str | None = None
    plugin: str = ""
    window: Sequence[int] = ()


@dataclass(frozen=True, slots=True)
class TeachingMaterial:
    """A part of a variant to fit on: its folder and number, and when it is attacked."""

    material: str
    variant: str
    start_ns: int
    end_ns: int
    attacked: Sequence[Sequence[int]] = ()


@dataclass(frozen=True, slots=True)
class FitJob:
    """A detector to fit; it has to do without the ``withheld`` kinds."""

    plugin: str
    parameters: Mapping[str, Any]
    clean: Sequence[TeachingMaterial]
    attacked: Sequence[TeachingMaterial]
    withheld: Sequence[str]
    memory_mb: int


@dataclass(frozen=True, slots=True)
class DetectorJob:
    """A detector to run on variants, by number; it has to do without the ``withheld`` kinds.

    ``state`` is the file of what it has learned, with its digest; "" if it has not.
    """

    plugin: str
    parameters: Mapping[str, Any]
    variants: Sequence[str]
    withheld: Sequence[str] = field(default_factory=tuple)
    memory_mb: int = 512
    state: str = ""
    state_sha256: str = ""


def describe_plugin(job: DescriptionJob) -> Record:
    """Return all parameters of a plugin, and its contract.

    The status is ``failed`` if it cannot be loaded, ``refused`` if it does not take the suite's
    parameters.
    """
    plugin = plugins.find(job.group, job.plugin)
    try:
        factory = plugin.load()
    except PluginError as error:
        return {"status": "failed", "reason": one_line(error)}
    parameters = job.parameters
    has_rate = RATE_PARAMETER in getattr(factory, "__dataclass_fields__", {})
    if job.rate_per_hour is not None and has_rate:
        parameters = {RATE_PARAMETER: job.rate_per_hour, **parameters}
    try:
        made = plugins.make(job.group, job.plugin, _frozen(parameters))
    except PluginError as error:
        return {"status": "refused", "reason": str(error)}
    if job.group == plugins.DETECTORS and not isinstance(made, Detector):
        reason = (
            f"PluginError: {plugin} is no detector; it needs requires, uses, memory_s and detect()"
        )
        return {"status": "failed", "reason": reason}
    try:
        return {"status": "ok", **_contract(job.group, made)}
    except Exception as error:  # noqa: BLE001, properties of a plugin may raise anything
        return {"status": "failed", "reason": one_line(error)}


def _contract(group: plugins.Group, made: Any) -> Record:
    parameters = {
        field.name: _plain(getattr(made, field.name)) for field in fields(made) if field.init
    }
    defaults = {
        field.name: _plain(field.default)
        for field in fields(made)
        if field.init and field.default is not MISSING
    }
    about: Record = {
        "parameters": parameters,
        "changed": [
            name
            for name, value in parameters.items()
            if name not in defaults or value != defaults[name]
        ],
    }
    if group == plugins.ATTACKS:
        return about | {"models": sorted(map(str, made.models)), "strength": float(made.strength)}
    for name, value_s in (("memory_s", made.memory_s), ("warm_up_s", warm_up_s(made))):
        if not 0 <= value_s < math.inf:
            raise ValueError(f"{name} must be finite and at least 0, not {value_s!r}")
    return about | {
        "requires": [str(kind) for kind in made.requires],
        "uses": [str(kind) for kind in made.uses],
        "memory_s": float(made.memory_s),
        "warm_up_s": warm_up_s(made),
        "baseline": is_baseline(made),
        "is_trainable": isinstance(made, Trainable),
        "learns_from_attacks": learns_from_attacks(made),
    }


def survey_recording(job: RecordingJob) -> Iterator[Record]:
    """Read a recording and draw its windows, which all its attacks share.

    Each attack is announced, with the status ``asking``, before its code runs, so that it is known
    whom to blame. The last record has the status ``ok``.

    Raises:
        RecordingError: the recording or a donor cannot be read, or a donor is attacked.
    """
    clean, donors = _read(job.path), _donors(job)
    attacked = is_really_attacked(clean)
    attacks, unfit = {} if attacked else _attacks(job), Unfit()
    first_ns = min(clean.span.start_ns + round(job.first_s * 1e9), clean.span.end_ns)
    common = Interval(first_ns, clean.span.end_ns)
    has_room = common.duration_s >= job.duration_s
    if not has_room:
        reason = (
            f"the recording has {common.duration_s:.1f} s after the warm-up, too few for an attack "
            f"of {job.duration_s:g} s"
        )
        unfit = dict.fromkeys(attacks, ("skipped", reason))
    for name, attack in attacks.items() if has_room else ():
        yield {"status": "asking", "attack": name}
        try:
            common = _shared_span(common, attack, clean, donors, job.duration_s)
        except NotApplicable as error:
            unfit[name] = ("skipped", str(error))
        except Exception as error:  # noqa: BLE001, a plugin may raise anything
            unfit[name] = ("failed", one_line(error))
    windows = (
        draw_windows(job.seed, job.recording, common, job.duration_s, job.gap_s, job.windows)
        if has_room and attacks
        else ()
    )
    yield {
        "status": "ok",
        "digest": clean.digest(),
        "donors": [donor.digest() for donor in donors],
        "kinds": sorted(clean.blind().kinds),
        "span": (clean.span.start_ns, clean.span.end_ns),
        "is_fused": _is_fused(clean),
        "is_really_attacked": attacked,
        "windows": [(window.start_ns, window.end_ns) for window in windows],
        "unfit": unfit,
    }


def _is_fused(recording: Recording) -> bool:
    source = recording.metadata.get("primary", {}).get("gnss/pvt")
    return recording.metadata.get(f"source/{source}", {}).get("solution") == "fused"


def make_variants(
    job: RecordingJob, variants: Sequence[VariantJob], results: Path, material: Path
) -> Iterator[Record]:
    """Write truth into the results and blind material into a folder of its own; yield a record for
    each variant, with its kinds, or why it could not be made.
    """
    clean, donors = _read(job.path), _donors(job)
    limit_memory(job.memory_mb << 20)
    attacks, writer = _attacks(job), BlindWriter(material, clean)
    for wanted in variants:
        try:
            variant = _variant(wanted, attacks, clean, donors, job.seed)
            kinds = sorted(variant.blind().kinds)
            write_truth(results, wanted.id, build_truth(clean, variant), kinds)
        except NotApplicable as error:
            record: Record = {"status": "skipped", "reason": str(error)}
        except MemoryError:
            reason = "MemoryError: making the variant needs more memory than the suite's limit"
            record = {"status": "failed", "reason": reason}
        except Exception as error:  # noqa: BLE001, a plugin may raise anything
            record = {"status": "failed", "reason": one_line(error)}
        else:
            writer.put(wanted.number, variant)
            record = {"status": "ok", "kinds": kinds}
        yield {"id": wanted.id, **record}


@cache
def _read(path: str) -> Recording:
    """Read a recording, once in a process.

    Raises:
        RecordingError: it is a variant that an attack has made.
    """
    recording = codec.read(Path(path))
    if TRUTH_TOPIC in recording and not is_really_attacked(recording):
        raise RecordingError(
            f"{Path(path).name!r} is attacked already; a suite makes its attacks itself, from "
            "clean recordings"
        )
    return recording


def _donors(job: RecordingJob) -> list[Recording]:
    donors = [_read(path) for path in job.donors]
    for path, donor in zip(job.donors, donors, strict=True):
        if is_really_attacked(donor):
            raise RecordingError(f"{Path(path).name!r} is attacked; a donor must be clean")
    return donors


def _attacks(job: RecordingJob) -> dict[str, Attack]:
    return {
        entry["id"]: plugins.make(plugins.ATTACKS, entry["plugin"], _frozen(entry["parameters"]))
        for entry in job.attacks
    }


def _shared_span(
    common: Interval, attack: Attack, clean: Recording, donors: Sequence[Recording], needed_s: float
) -> Interval:
    """Return where windows may lie for this attack and those before it in the suite.

    Raises:
        NotApplicable: they would leave no room for a window.
    """
    own = attackable_span(attack, clean, donors)
    start_ns, end_ns = max(common.start_ns, own.start_ns), min(common.end_ns, own.end_ns)
    if end_ns - start_ns < round(needed_s * 1e9):
        room_s = max(0.0, (end_ns - start_ns) / 1e9)
        raise NotApplicable(
            f"it can be supplied for {room_s:.1f} s of what the attacks before it leave, not for "
            f"{needed_s:g} s"
        )
    return Interval(start_ns, end_ns)


def _variant(
    wanted: VariantJob,
    attacks: Mapping[str, Attack],
    clean: Recording,
    donors: Sequence[Recording],
    seed: int,
) -> Recording:
    if wanted.attack is None:
        return clean
    window = Interval(*wanted.window)
    return make_variant(wanted.plugin, attacks[wanted.attack], clean, window, seed, donors)


def fit_detector(job: FitJob) -> tuple[Record, bytes]:
    """Fit a detector; return a record with its fitted parameters, and its pickle, or why there is
    none.
    """
    readers = {
        each.material: BlindReader(Path(each.material)) for each in (*job.clean, *job.attacked)
    }
    size = sum(readers[each.material].size(each.variant) for each in (*job.clean, *job.attacked))
    limit_memory((job.memory_mb << 20) + 2 * size)
    try:
        made = plugins.make(plugins.DETECTORS, job.plugin, _frozen(job.parameters))
        kinds = declared(made) - set(job.withheld)

        def part(each: TeachingMaterial) -> Recording:
            whole = readers[each.material].get(each.variant)
            return seen(whole, kinds).between(each.start_ns, each.end_ns)

        labelled = [
            Labelled(part(each), tuple(Interval(*pair) for pair in each.attacked))
            for each in job.attacked
        ]
        fitted = made.fit([part(each) for each in job.clean], labelled)
        if type(fitted) is not type(made):
            raise PluginError(f"fit() must return a {type(made).__name__}")
        state = pickle.dumps(fitted, protocol=5)
    except NotApplicable as error:
        return {"status": "skipped", "reason": f"it cannot be fitted: {one_line(error)}"}, b""
    except MemoryError:
        return {
            "status": "out_of_memory",
            "reason": f"fitting it needs more than {job.memory_mb} MB",
        }, b""
    except Exception as error:  # noqa: BLE001, a plugin may raise anything
        return {"status": "failed", "reason": f"fitting it: {one_line(error)}"}, b""
    learned = {
        field.name: _plain(getattr(fitted, field.name))
        for field in fields(fitted)
        if field.init
        and isinstance(getattr(fitted, field.name), bool | int | float | str)
        and getattr(fitted, field.name) != getattr(made, field.name)
    }
    return {"status": "ok", "learned": learned}, state


def run_detector(job: DetectorJob, material: Path) -> Iterator[tuple[Record, Decisions | None]]:
    """Load a detector and run it on variants; yield a record when it is loaded, then for each
    variant a record and, where it went well, decisions.

    Memory is limited to its growth over this process and the largest variant's tables.
    """
    reader = BlindReader(material)
    limit_memory((job.memory_mb << 20) + max(map(reader.size, job.variants)))
    try:
        detector: Detector = plugins.make(plugins.DETECTORS, job.plugin, _frozen(job.parameters))
        if job.state:
            state = Path(job.state).read_bytes()
            if hashlib.sha256(state).hexdigest() != job.state_sha256:
                raise ResultsError("what it has learned has been changed since; resume the run")
            detector = pickle.loads(state)
    except Exception as error:  # noqa: BLE001, a plugin may raise anything
        yield {"status": "failed", "reason": one_line(error)}, None
        return
    yield {"status": "ok"}, None
    decide = partial(detect, detector, withheld=frozenset(job.withheld))
    for variant in job.variants:
        meter, start = MemoryMeter(), time.perf_counter()
        record: Record = {"status": "ok", "reason": None}
        decisions = None
        try:
            decisions = decide(reader.get(variant))
        except MemoryError:
            reason = f"it needs more than {job.memory_mb} MB"
            record = {"status": "out_of_memory", "reason": reason}
        except Exception as error:  # noqa: BLE001, a plugin may raise anything
            record = {"status": "failed", "reason": one_line(error)}
        seconds, growth_mb = round(time.perf_counter() - start, 6), meter.growth_mb()
        yield {"variant": variant, **record, "seconds": seconds, "growth_mb": growth_mb}, decisions


def _frozen(value: Any) -> Any:
    """Return a parameter with tuples for lists, as a frozen dataclass wants it."""
    if isinstance(value, Mapping):
        return {key: _frozen(item) for key, item in value.items()}
    return tuple(map(_frozen, value)) if isinstance(value, list | tuple) else value


def _plain(value: Any) -> Any:
    """Return a parameter as JSON can say it; what JSON has no word for as text."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)
