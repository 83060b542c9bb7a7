"""The attack's contract: a clean recording in, a falsified one out.

An attack is a frozen dataclass whose fields are its parameters, behind an entry point of the group
``spoofbench.attacks``. It returns falsified tables and nothing more; :func:`falsify` holds it to the laws,
removes what it does not model, rounds, and writes the truth.
"""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from spoofbench.recording import Interval, Recording


@runtime_checkable
class Attack(Protocol):
    """A spoofing attack on a recording.

    Attributes:
        models: the GNSS kinds whose change it models; other GNSS-derived kinds leave the variant.
        attack_class: ``replay``, ``meaconing``, ``generated``, ...
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

    def apply(self, clean: Recording, window: Interval, rng: np.random.Generator, donors: Sequence[Recording] = ()) -> Recording:
        """Return the recording with rows of the modelled kinds falsified within the window.

        Raises:
            NotApplicable: the attack cannot be made here; says why.
        """
        ...


@runtime_checkable
class Supplied(Protocol):
    """An attack that needs material from other times or other recordings."""

    def supply(self, clean: Recording, donors: Sequence[Recording] = ()) -> Interval:
        """Return the interval of the clean recording within which a window can be supplied.

        Raises:
            NotApplicable: no window can be supplied.
        """
        ...
