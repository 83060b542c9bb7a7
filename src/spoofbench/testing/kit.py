"""What the checks of all plugins share: laws as functions of a plugin under test."""

import random
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np

if TYPE_CHECKING:
    import pytest

UnderTest = TypeVar("UnderTest")


class CheckFailed(AssertionError):
    """A plugin breaks its contract; the text says how."""


@dataclass(frozen=True, slots=True)
class CheckResult:
    """What a check said: its name, whether the plugin passed, and if not, why."""

    name: str
    passed: bool
    reason: str | None


@dataclass(frozen=True, slots=True)
class Check(Generic[UnderTest]):
    """One law, ready to be called; the law's function names it.

    Raises:
        CheckFailed: the subject breaks the law.
    """

    law: Callable[[UnderTest], None]
    subject: UnderTest

    def __call__(self) -> None:
        self.law(self.subject)

    def __str__(self) -> str:
        return self.law.__name__

    def result(self) -> CheckResult:
        """Call the check and return what it said."""
        try:
            self()
        except CheckFailed as failure:
            return CheckResult(str(self), False, str(failure))
        except Exception as error:  # noqa: BLE001, a plugin may raise anything
            return CheckResult(str(self), False, f"{type(error).__name__}: {error}")
        return CheckResult(str(self), True, None)


def parametrised(
    laws: Sequence[Callable[[UnderTest], None]], subject: UnderTest
) -> "pytest.MarkDecorator":
    """Parametrise a test's argument ``check`` with a check per law."""
    import pytest

    return pytest.mark.parametrize("check", [Check(law, subject) for law in laws], ids=str)


def require(condition: bool, reason: str) -> None:
    """Raise CheckFailed with the reason where a condition does not hold."""
    if not condition:
        raise CheckFailed(reason)


@contextmanager
def global_seed(seed: int) -> Iterator[None]:
    """Seed the global random generators, and put them back."""
    numpy_state, state = np.random.get_state(), random.getstate()  # noqa: NPY002
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002
    try:
        yield
    finally:
        random.setstate(state)
        np.random.set_state(numpy_state)  # noqa: NPY002
