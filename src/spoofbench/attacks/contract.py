"""The attack's contract: a clean recording in, an attacked one out.

An attack is a frozen dataclass whose fields are its parameters, behind an entry point of the group
``spoofbench.attacks``. It returns attacked tables and nothing more; :func:`make_variant` holds them
to the laws, removes what the attack does not model, rounds, and writes the truth.
:func:`attack_file` does so from file to file.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from spoofbench import config, plugins
from spoofbench.attacks.laws import attacked_tables
from spoofbench.codec import read, write
from spoofbench.errors import NotApplicable, PluginError, SpoofbenchError
from spoofbench.recording import Interval, Recording
from spoofbench.schema import KINDS, TRUTH_TOPIC, split_topic
from spoofbench.table import Table


@runtime_checkable
class Attack(Protocol):
    """A spoofing attack on a recording; it refuses invalid parameters by ``ValueError``.

    Attributes:
        models: the GNSS kinds whose change it models; other GNSS-derived kinds leave the variant.
        attack_class: ``replay``, ``meaconing``, ``generated``, ...; ``time`` alone may change the
            claimed times.
        level: what it falsifies: ``pvt``, ``measurement`` or ``signal``.
        strength: how strong it is, in ``strength_unit``; 0 changes nothing.
    """

    @property
    def models(self) -> frozenset[str]: ...
    @property
    def attack_class(self) -> str: ...
    @property
    def level(self) -> str: ...
    @property
    def strength(self) -> float: ...
    @property
    def strength_unit(self) -> str: ...

    def apply(
        self,
        clean: Recording,
        window: Interval,
        rng: np.random.Generator,
        donors: Sequence[Recording] = (),
    ) -> Recording:
        """Return the recording with rows of the modelled kinds changed or deleted within the
        window.

        A source that the attack cannot serve is taken away as a whole.

        Raises:
            NotApplicable: the attack cannot be made here; says why.
        """
        ...


@runtime_checkable
class HasAttackableSpan(Protocol):
    """An attack that needs material from other times or other recordings."""

    def attackable_span(self, clean: Recording, donors: Sequence[Recording] = ()) -> Interval:
        """Return the interval of the clean recording within which a window can be supplied.

        Raises:
            NotApplicable: no window can be supplied.
        """
        ...


def attackable_span(attack: Attack, clean: Recording, donors: Sequence[Recording] = ()) -> Interval:
    """Return the interval within which the attack's window may lie: all of the recording unless the
    attack is :class:`HasAttackableSpan`.

    Raises:
        NotApplicable: no window can be supplied.
    """
    return (
        attack.attackable_span(clean, donors)
        if isinstance(attack, HasAttackableSpan)
        else clean.span
    )


def draw_window(
    suite_seed: int, recording: str, seed: int, within: Interval, duration_s: float
) -> Interval:
    """Draw a window by SHA-256 of the suite's seed, the recording's name and the seed: the same for
    every attack and detector.

    Raises:
        NotApplicable: it does not fit.
    """
    duration_ns = round(duration_s * 1e9)
    room_ns = within.end_ns - within.start_ns - duration_ns
    if duration_ns <= 0 or room_ns < 0:
        raise NotApplicable(
            f"a window of {duration_s!r} s does not fit into the {within.duration_s:.1f} s of "
            f"{recording!r} that can be attacked"
        )
    start_ns = within.start_ns + _hash([suite_seed, recording, seed]) % (room_ns + 1)
    return Interval(start_ns, start_ns + duration_ns)


def draw_windows(
    suite_seed: int,
    recording: str,
    within: Interval,
    duration_s: float,
    gap_s: float,
    count: int | None = None,
) -> tuple[Interval, ...]:
    """Draw disjoint windows with a gap after each, in the order of time, by SHA-256 of the suite's
    seed and the recording's name.

    Args:
        suite_seed, recording: what they are drawn by.
        within: where they may lie; the gap of the last one may lie beyond.
        duration_s: of each.
        gap_s: least time from the end of one to the start of the next.
        count: how many; None, or more than fit, for as many as fit.
    """
    duration_ns, gap_ns = round(duration_s * 1e9), round(gap_s * 1e9)
    room_ns = within.end_ns - within.start_ns
    fit = max(0, (room_ns + gap_ns) // (duration_ns + gap_ns))
    n = fit if count is None else min(count, fit)
    slack_ns = room_ns - n * duration_ns - (n - 1) * gap_ns
    # sorted draws from the slack, spread by what stands before each: uniform over all placements
    offsets_ns = sorted(
        _hash([suite_seed, recording, number]) % (slack_ns + 1) for number in range(n)
    )
    starts_ns = (
        within.start_ns + offset_ns + number * (duration_ns + gap_ns)
        for number, offset_ns in enumerate(offsets_ns)
    )
    return tuple(Interval(start_ns, start_ns + duration_ns) for start_ns in starts_ns)


def choose_window(
    attack: Attack,
    clean: Recording,
    donors: Sequence[Recording],
    start_s: float | None,
    duration_s: float,
    seed: int,
) -> Interval:
    """Return the window that begins ``start_s`` after the recording's first row; where that is
    None, one drawn by the seed of where the attack can be made.

    Raises:
        NotApplicable: it does not fit.
    """
    if start_s is None:
        span = attackable_span(attack, clean, donors)
        return draw_window(seed, clean.digest(), seed, span, duration_s)
    span = clean.span
    start_ns, end_ns = (
        span.start_ns + round(seconds * 1e9) for seconds in (start_s, start_s + duration_s)
    )
    if not span.start_ns <= start_ns < end_ns <= span.end_ns:
        raise NotApplicable(
            f"an attack from {start_s!r} s for {duration_s!r} s does not lie within the "
            f"recording's {span.duration_s:.1f} s"
        )
    return Interval(start_ns, end_ns)


def make_variant(
    name: str,
    attack: Attack,
    clean: Recording,
    window: Interval,
    seed: int,
    donors: Sequence[Recording] = (),
) -> Recording:
    """Return the variant of a recording: attacked, held to the laws, rounded, with its truth row.

    The truth interval starts at the first changed or deleted row of any source and ends one
    nanosecond after the last one; it lies within the window. Strength 0 gives the clean recording
    itself.

    Args:
        name: of the attack's entry point.
        attack: with its parameters.
        clean: recording without attack.
        window: where the attack may change rows.
        seed: of whatever the attack draws; the draw also depends on the name, the parameters, the
            recordings and the window.
        donors: further recordings that the attack may take rows from.

    Raises:
        NotApplicable: the attack cannot be made here, or changes nothing.
        PluginError: the attack breaks a law, or raises anything else; says what.
    """
    parameters = parameters_of(name, attack)
    topics = [topic for kind in sorted(attack.models) for topic in clean.topics(kind)]
    if TRUTH_TOPIC in clean:
        raise NotApplicable(f"the recording has {TRUTH_TOPIC!r}: it is attacked already")
    if attack.strength == 0:
        return clean
    if not topics:
        raise NotApplicable(
            f"attack {name!r} models {sorted(attack.models)}, of which the recording has none"
        )
    base_ids = [recording.digest() for recording in (clean, *donors)]
    rng = np.random.default_rng(
        _hash([seed, name, parameters, base_ids, window.start_ns, window.end_ns])
    )
    attacked = _apply(name, attack, clean, window, rng, donors)
    try:
        results = attacked_tables(
            clean, attacked, window, attack.models, donors, about_time=attack.attack_class == "time"
        )
    except PluginError as error:
        raise PluginError(f"attack {name!r}: {error}") from error
    changed = {topic: result.changed_ns for topic, result in results.items() if result.changed_ns}
    if not changed:
        raise NotApplicable(
            f"attack {name!r} changes no row within its window of {window.duration_s:.1f} s"
        )
    truth = {
        "start_ns": min(first for first, _ in changed.values()),
        "end_ns": max(last for _, last in changed.values()) + 1,
        "attack": name,
        "class": attack.attack_class,
        "strength": float(attack.strength),
        "strength_unit": attack.strength_unit,
        "level": attack.level,
        "sources": json.dumps(sorted({split_topic(topic)[0] for topic in changed})),
        "base_ids": json.dumps(base_ids),
        "seed": seed,
        "parameters": parameters,
    }
    unmodelled = (topic for topic in clean if KINDS[split_topic(topic)[1]].is_gnss_derived)
    tables: dict[str, Table | None] = {
        **dict.fromkeys(unmodelled),
        **{topic: result.table for topic, result in results.items()},
    }
    row = Table(
        "truth/attack",
        np.array([truth["start_ns"]], np.int64),
        {field: [value] for field, value in truth.items()},
    )
    return clean.replace({**tables, TRUTH_TOPIC: row})


def parameters_of(name: str, attack: Attack) -> str:
    """Return the attack's parameters as canonical JSON.

    Raises:
        PluginError: the attack does not keep the contract's form; says how.
    """
    given: object = attack
    is_instance = is_dataclass(given) and not isinstance(given, type)
    if not (is_instance and isinstance(given, Attack)):
        raise PluginError(
            f"attack {name!r} is not an instance of a dataclass with all members of "
            "spoofbench.attacks.Attack"
        )
    unknown = sorted(
        kind for kind in attack.models if kind not in KINDS or not KINDS[kind].is_gnss_derived
    )
    if unknown:
        raise PluginError(
            f"attack {name!r} models {unknown[0]!r}, which is not a GNSS-derived kind of the schema"
        )
    if not (np.isfinite(attack.strength) and attack.strength >= 0):
        raise PluginError(
            f"attack {name!r} has strength {attack.strength!r}; it must be finite and at least 0"
        )
    form: Any = attack
    try:
        values = {field.name: config.plain(getattr(attack, field.name)) for field in fields(form)}
        return _canonical(values)
    except (TypeError, ValueError) as error:
        raise PluginError(
            f"attack {name!r} has a parameter that JSON cannot hold: {error}"
        ) from error


def _apply(
    name: str,
    attack: Attack,
    clean: Recording,
    window: Interval,
    rng: np.random.Generator,
    donors: Sequence[Recording],
) -> Recording:
    try:
        supply = attackable_span(attack, clean, donors)
        if window.start_ns < supply.start_ns or window.end_ns > supply.end_ns:
            start_ns, *edges_ns = (
                clean.span.start_ns,
                supply.start_ns,
                supply.end_ns,
                window.start_ns,
                window.end_ns,
            )
            first, last, start, end = (f"{(edge_ns - start_ns) / 1e9:.1f}" for edge_ns in edges_ns)
            raise NotApplicable(
                f"attack {name!r} has material for {first} to {last} s of the recording, not for "
                f"{start} to {end} s"
            )
        # copies: what a stranger does to its arguments must not reach the rows that its result is
        # compared with
        clean_copy, *donor_copies = (
            Recording(dict(recording), recording.metadata) for recording in (clean, *donors)
        )
        attacked = attack.apply(clean_copy, window, rng, donor_copies)
    except SpoofbenchError:
        raise
    except Exception as error:  # a plugin may raise anything
        raise PluginError(f"attack {name!r} failed: {type(error).__name__}: {error}") from error
    returned: object = attacked
    if not isinstance(returned, Recording):
        raise PluginError(f"attack {name!r} must return a Recording, not {type(returned).__name__}")
    return returned


def _canonical(value: Any) -> str:
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _hash(value: Any) -> int:
    return int.from_bytes(hashlib.sha256(_canonical(value).encode()).digest())


def attack_file(
    file: Path,
    out: Path,
    name: str,
    parameters: Mapping[str, Any],
    donors: Sequence[Path] = (),
    *,
    start_s: float | None = None,
    duration_s: float = 120.0,
    seed: int = 0,
) -> list[dict[str, Any]]:
    """Write the variant of a recording under an attack, and return its truth rows.

    Args:
        file, out: clean recording and variant.
        name, parameters: the attack's entry point and fields.
        donors: recordings that it may take signals from.
        start_s: of the window, after the recording's first row; None draws it by the seed.
        duration_s: of the window.
        seed: of the window and of whatever the attack draws.

    Returns:
        Rows of ``/truth/attack`` as dictionaries, with ``start_s`` and ``end_s`` after the first
        row added.

    Raises:
        PluginError: there is no such attack or parameter, or it breaks a law.
        NotApplicable: it cannot be made on this recording.
        FormatError: a file is no recording.
    """
    attack = plugins.make(plugins.ATTACKS, name, parameters)
    clean, given = read(file), [read(donor) for donor in donors]
    window = choose_window(attack, clean, given, start_s, duration_s, seed)
    variant = make_variant(name, attack, clean, window, seed, given)
    write(variant, out)
    first_ns = clean.span.start_ns
    return [
        {
            **row,
            "start_s": (row["start_ns"] - first_ns) / 1e9,
            "end_s": (row["end_ns"] - first_ns) / 1e9,
        }
        for row in _truth_rows(variant)
    ]


def _truth_rows(variant: Recording) -> list[dict[str, Any]]:
    if TRUTH_TOPIC not in variant:
        return []
    table = variant[TRUTH_TOPIC]
    columns = {
        name: table[name].tolist() if table.column(name).categories is None else table.texts(name)
        for name in table
    }
    return [{name: values[row] for name, values in columns.items()} for row in range(len(table))]
