"""The conformance kit refuses attacks that break a law, and names it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest

from spoofbench.errors import PluginError
from spoofbench.recording import Interval, Recording
from spoofbench.table import Table
from spoofbench.testing.attacks import LAWS, check_attack, run_attack_checks


@dataclass(frozen=True)
class Honest:
    """Raises the height within the window."""

    height_m: float = 3.0
    models: ClassVar[frozenset[str]] = frozenset({"gnss/pvt"})
    attack_class: ClassVar[str] = "generated"
    level: ClassVar[str] = "pvt"
    strength_unit: ClassVar[str] = "m"

    @property
    def strength(self) -> float:
        return self.height_m

    def apply(
        self,
        clean: Recording,
        window: Interval,
        rng: np.random.Generator,
        donors: Sequence[Recording] = (),
    ) -> Recording:
        tables: dict[str, Table | None] = {}
        for topic in clean.topics("gnss/pvt"):
            table = clean[topic]
            raised = self.raised(rng) * window.covers(table.time_ns)
            names = [name for name in ("height_m", "height_msl_m", "h_acc_m") if name in table]
            tables[topic] = table.replace(**{name: table[name] + raised for name in names})
        return clean.replace(tables)

    def raised(self, rng: np.random.Generator) -> float:
        return self.height_m + rng.random()


class DrawsFromTheGlobalGenerator(Honest):
    def raised(self, rng: np.random.Generator) -> float:
        return self.height_m + np.random.random()  # noqa: NPY002


class Remembers(Honest):
    calls: ClassVar[list[int]] = []

    def raised(self, rng: np.random.Generator) -> float:
        self.calls.append(1)
        return self.height_m + len(self.calls)


class RaisesOneHeight(Honest):
    def apply(
        self,
        clean: Recording,
        window: Interval,
        rng: np.random.Generator,
        donors: Sequence[Recording] = (),
    ) -> Recording:
        table = clean.primary("gnss/pvt")
        raised = table["height_m"] + 3.0 * window.covers(table.time_ns)
        return clean.replace({clean.topics("gnss/pvt")[0]: table.replace(height_m=raised)})


class NeedsAFix(Honest):
    def apply(
        self,
        clean: Recording,
        window: Interval,
        rng: np.random.Generator,
        donors: Sequence[Recording] = (),
    ) -> Recording:
        if not clean.primary("gnss/pvt")["h_acc_m"][
            window.covers(clean.primary("gnss/pvt").time_ns)
        ].any():
            raise ValueError("no accuracy")
        return super().apply(clean, window, rng, donors)


class DoesNothing(Honest):
    def apply(
        self,
        clean: Recording,
        window: Interval,
        rng: np.random.Generator,
        donors: Sequence[Recording] = (),
    ) -> Recording:
        return clean


class ModelsTheImu(Honest):
    models: ClassVar[frozenset[str]] = frozenset({"imu"})


class AltersTheRecording(Honest):
    def apply(
        self,
        clean: Recording,
        window: Interval,
        rng: np.random.Generator,
        donors: Sequence[Recording] = (),
    ) -> Recording:
        variant = super().apply(clean, window, rng, donors)
        clean._tables.update({topic: variant[topic] for topic in variant})
        return variant


class DiffersWhenPickled(Honest):
    def __reduce__(self) -> Any:
        return Honest, (self.height_m + 1,)


BROKEN = {
    DrawsFromTheGlobalGenerator: "is_deterministic",
    Remembers: "is_deterministic",
    RaisesOneHeight: "attacks",
    NeedsAFix: "says_when_it_cannot_be_made",
    DoesNothing: "attacks",
    ModelsTheImu: "is_a_frozen_dataclass",
    AltersTheRecording: "leaves_its_arguments",
    DiffersWhenPickled: "pickles",
}


@check_attack(Honest())
def test_an_honest_attack_passes(check: Any) -> None:
    check()


@pytest.mark.parametrize("attack", BROKEN, ids=lambda attack: attack.__name__)
def test_a_broken_law_is_named(attack: type[Honest]) -> None:
    failed = {
        result.name: result.reason for result in run_attack_checks(attack()) if not result.passed
    }
    assert BROKEN[attack] in failed
    assert failed[BROKEN[attack]]


def test_every_check_is_run() -> None:
    assert [result.name for result in run_attack_checks("drag-off")] == [
        law.__name__ for law in LAWS
    ]


def test_an_unknown_attack_is_refused() -> None:
    with pytest.raises(PluginError, match="did you mean 'drag-off'"):
        run_attack_checks("drag-of")
