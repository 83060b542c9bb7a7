"""What every attack must keep, as checks that name the law that is broken.

Three lines hold an attack to its contract::

    from spoofbench.testing import check_attack

    @check_attack("my-attack", strength=2.0)
    def test_conformance(check): check()
"""

import pickle
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from spoofbench import plugins
from spoofbench.attacks.contract import (
    Attack,
    attackable_span,
    draw_window,
    make_variant,
    parameters_of,
)
from spoofbench.attacks.laws import differing
from spoofbench.attacks.resolution import resolutions
from spoofbench.errors import NotApplicable
from spoofbench.recording import Interval, Recording
from spoofbench.schema import KINDS, TRUTH_TOPIC, split_topic
from spoofbench.table import Table
from spoofbench.testing.attack_cases import degraded_recordings, examples, inner
from spoofbench.testing.kit import (
    Check,
    CheckFailed,
    CheckResult,
    global_seed,
    parametrised,
    require,
)

if TYPE_CHECKING:
    import pytest

_WINDOW_S = 20.0
_SEEDS = (0, 1)


@dataclass(frozen=True, slots=True)
class AttackCase:
    """One attacked recording beside the clean one."""

    name: str
    clean: Recording
    donors: tuple[Recording, ...]
    window: Interval
    seed: int
    attacked: Recording


@dataclass(frozen=True)
class AttackUnderTest:
    """An attack under test: an instance, or the name of an entry point and its parameters."""

    given: str | Attack
    parameters: Mapping[str, Any]

    @property
    def name(self) -> str:
        return self.given if isinstance(self.given, str) else type(self.given).__name__

    @cached_property
    def attack(self) -> Attack:
        """The instance, made from the entry point where a name was given.

        Raises:
            PluginError: there is no such entry point, or it refuses the parameters.
        """
        if not isinstance(self.given, str):
            return self.given
        made: Attack = plugins.make(plugins.ATTACKS, self.given, self.parameters)
        return made

    @cached_property
    def variants(self) -> tuple[AttackCase, ...]:
        """What the attack makes of the examples that it can be made on."""
        made: list[AttackCase] = []
        for name, (clean, donors) in examples().items():
            for seed in _SEEDS:
                try:
                    window = draw_window(
                        0, name, seed, attackable_span(self.attack, clean, donors), _WINDOW_S
                    )
                    attacked = make_variant(self.name, self.attack, clean, window, seed, donors)
                except NotApplicable:
                    continue
                made.append(AttackCase(name, clean, donors, window, seed, attacked))
        return tuple(made)


def check_attack(attack: str | Attack, **parameters: Any) -> "pytest.MarkDecorator":
    """Parametrise a test's argument ``check`` with all checks of an attack.

    Args:
        attack: name of an entry point of ``spoofbench.attacks``, or an instance.
        parameters: of the entry point's dataclass.
    """
    return parametrised(LAWS, AttackUnderTest(attack, MappingProxyType(parameters)))


def run_attack_checks(
    attack: str | Attack, parameters: Mapping[str, Any] = MappingProxyType({})
) -> list[CheckResult]:
    """Run all checks of an attack and return what each said.

    Raises:
        PluginError: there is no such attack, it cannot be loaded, or it refuses the parameters.
    """
    subject = AttackUnderTest(attack, parameters)
    _ = subject.attack
    return [Check(law, subject).result() for law in LAWS]


def is_a_frozen_dataclass(subject: AttackUnderTest) -> None:
    """It is a frozen dataclass whose parameters JSON can hold, and it models GNSS-derived kinds."""
    attack: Any = subject.attack
    parameters_of(subject.name, attack)
    require(
        attack.__dataclass_params__.frozen,
        f"{type(attack).__name__} is not frozen: write @dataclass(frozen=True)",
    )
    for name in ("attack_class", "level", "strength_unit"):
        text = getattr(attack, name)
        require(isinstance(text, str) and bool(text), f"{name} must be a text, not {text!r}")
    require(bool(attack.models), "models is empty: an attack must change at least one kind")


def attacks(subject: AttackUnderTest) -> None:
    """It can be made on at least one example, and keeps the laws that the harness enforces on all
    of them.
    """
    require(
        bool(subject.variants),
        f"no example can be attacked with a window of {_WINDOW_S} s: try a smaller strength",
    )


def leaves_what_it_cannot_touch(subject: AttackUnderTest) -> None:
    """Other sensors, the reference and metadata are the clean recording's; GNSS-derived kinds
    without a model are gone.
    """
    for variant in subject.variants:
        clean, attacked = variant.clean, variant.attacked
        for topic in clean:
            kind = KINDS[split_topic(topic)[1]]
            if not kind.is_gnss_derived:
                require(
                    topic in attacked and _same_rows(clean[topic], attacked[topic]),
                    f"on {variant.name}, {topic} has changed",
                )
            elif kind.name not in subject.attack.models:
                require(
                    topic not in attacked,
                    f"on {variant.name}, {topic} is still there though it is not modelled",
                )
        require(attacked.metadata == clean.metadata, f"on {variant.name}, metadata have changed")


def stays_within_its_truth(subject: AttackUnderTest) -> None:
    """The truth interval begins at the first and ends right after the last changed or deleted row,
    within the window.
    """
    for variant in subject.variants:
        truth = variant.attacked[TRUTH_TOPIC]
        require(len(truth) == 1, f"on {variant.name}, there are {len(truth)} truth rows")
        said = Interval(int(truth["start_ns"][0]), int(truth["end_ns"][0]))
        changed = np.concatenate(
            [_changed_ns(variant.clean[t], variant.attacked[t]) for t in _attacked_topics(variant)]
        )
        require(changed.size > 0, f"on {variant.name}, nothing has changed")
        found = Interval(int(changed.min()), int(changed.max()) + 1)
        require(said == found, f"on {variant.name}, the truth says {said!r} and the rows {found!r}")
        within = variant.window.start_ns <= found.start_ns and found.end_ns <= variant.window.end_ns
        require(within, f"on {variant.name}, {found!r} is not within the window {variant.window!r}")


def _attacked_topics(variant: AttackCase) -> list[str]:
    return [
        topic
        for topic in variant.attacked
        if topic != TRUTH_TOPIC and KINDS[split_topic(topic)[1]].is_gnss_derived
    ]


def _changed_ns(clean: Table, attacked: Table) -> Any:
    """Times at which two tables do not have the same rows."""
    rows: dict[int, tuple[list[Any], list[Any]]] = {}
    for which, table in enumerate((clean, attacked)):
        fields = [
            table.texts(n) if table.column(n).categories is not None else _bits(table, n)
            for n in clean.kind.fields
        ]
        for time_ns, *row in zip(table.time_ns.tolist(), *fields, strict=True):
            rows.setdefault(time_ns, ([], []))[which].append(row)
    return np.array([time_ns for time_ns, (was, now) in rows.items() if was != now], np.int64)


def _bits(table: Table, name: str) -> list[Any]:
    values = table[name]
    bits = values.view(f"u{values.dtype.itemsize}").tolist()
    return [
        value if known else None
        for value, known in zip(bits, table.valid(name).tolist(), strict=True)
    ]


def _same_rows(one: Table, other: Table) -> bool:
    return np.array_equal(one.time_ns, other.time_ns) and not any(
        differing(one, other, name).any() for name in one.kind.fields
    )


def rounds_as_the_receiver_does(subject: AttackUnderTest) -> None:
    """Every float of an attacked row is one that the victim's receiver could have written."""
    for variant in subject.variants:
        for topic in _attacked_topics(variant):
            clean, attacked = variant.clean[topic], variant.attacked[topic]
            for name, resolution in resolutions(
                clean, [name for name in clean if clean[name].dtype.kind == "f"]
            ).items():
                if resolution.rounding is None or resolution.has_ulp_noise or name not in attacked:
                    continue
                values = attacked[name][~np.isnan(attacked[name])].astype(float)
                require(
                    np.array_equal(resolution.rounding(values), values),
                    f"on {variant.name}, {name!r} of {topic} has other last digits",
                )


def is_deterministic(subject: AttackUnderTest) -> None:
    """The same seed gives the same bytes, from a fresh instance and whatever the state of the
    global generators.
    """
    fresh: Attack = pickle.loads(pickle.dumps(subject.attack))
    for variant in subject.variants:
        with global_seed(variant.seed + 1):
            again = make_variant(
                subject.name, fresh, variant.clean, variant.window, variant.seed, variant.donors
            )
        require(
            again.digest() == variant.attacked.digest(),
            f"on {variant.name}, seed {variant.seed} gives other rows the second time",
        )


def leaves_its_arguments(subject: AttackUnderTest) -> None:
    """The clean recording and the donors are the same after the call."""
    for variant in subject.variants:
        given = [
            Recording(dict(recording), recording.metadata)
            for recording in (variant.clean, *variant.donors)
        ]
        subject.attack.apply(
            given[0], variant.window, np.random.default_rng(variant.seed), given[1:]
        )
        for recording, same in zip(given, (variant.clean, *variant.donors), strict=True):
            require(
                recording.digest() == same.digest(),
                f"on {variant.name}, the attack alters the recordings that it is given",
            )


def says_when_it_cannot_be_made(subject: AttackUnderTest) -> None:
    """A poor recording gives a variant or :class:`NotApplicable`, never anything else."""
    clean, _ = examples()["a drive at 1 Hz"]
    for name, recording, donors in degraded_recordings(clean):
        span = clean.span
        for window in (inner(span), Interval(span.start_ns, span.end_ns)):
            try:
                make_variant(subject.name, subject.attack, recording, window, 0, donors)
            except NotApplicable:
                continue
            except Exception as error:
                raise CheckFailed(f"on {name} it raises {type(error).__name__}: {error}") from error


def pickles(subject: AttackUnderTest) -> None:
    """It can go to another process and is equal there."""
    copied = pickle.loads(pickle.dumps(subject.attack))
    require(copied == subject.attack, f"{subject.attack!r} comes back from pickle as {copied!r}")


LAWS: tuple[Callable[[AttackUnderTest], None], ...] = (
    is_a_frozen_dataclass,
    attacks,
    leaves_what_it_cannot_touch,
    stays_within_its_truth,
    rounds_as_the_receiver_does,
    is_deterministic,
    leaves_its_arguments,
    says_when_it_cannot_be_made,
    pickles,
)
