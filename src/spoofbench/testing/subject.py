"""What the checks work on: one detector, the material, and the rule that tells decisions apart."""

import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np

from spoofbench import plugins
from spoofbench.detector import Decisions, Detector, detect
from spoofbench.errors import PluginError, SpoofbenchError
from spoofbench.recording import Recording
from spoofbench.testing.recordings import drive, spoofed_drive

TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True)
class Example:
    """A recording under a name that a reason can cite."""

    name: str
    recording: Recording

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True)
class Subject:
    """A detector under test: an instance, or the name of an entry point and its parameters."""

    given: str | Detector
    parameters: Mapping[str, Any]

    @cached_property
    def detector(self) -> Detector:
        """The instance, made from the entry point where a name was given.

        Raises:
            PluginError: there is no such entry point, or it refuses the parameters.
        """
        if not isinstance(self.given, str):
            return self.given
        made: Detector = plugins.make(plugins.DETECTORS, self.given, self.parameters)
        return made

    @cached_property
    def decided(self) -> Mapping[str, Decisions]:
        """The decisions on each example, by its name."""
        return {example.name: decide(self.detector, example.recording) for example in examples()}


@cache
def examples() -> tuple[Example, ...]:
    """The recordings on which every detector must give decisions."""
    return (
        Example("a drive at 1 Hz under attack", spoofed_drive(1, 240.0)),
        Example("a drive at 10 Hz with second sources", drive(2, 60.0, 10.0, second_sources=True)),
        Example(
            "a drive whose receiver gives no velocity at first", _late_velocity(drive(3, 90.0, 2.0))
        ),
    )


def _late_velocity(recording: Recording) -> Recording:
    table = recording["/gnss0/gnss/pvt"]
    late = np.arange(len(table)) >= len(table) // 2
    names = ("vel_n_mps", "vel_e_mps", "vel_d_mps")
    return recording.replace(
        {
            "/gnss0/gnss/pvt": table.replace(
                **{name: np.where(late, table[name], np.nan) for name in names}
            )
        }
    )


def private(recording: Recording) -> Recording:
    """Return a recording of tables of its own over the same columns, so that nobody else sees what
    is done to them.
    """
    return Recording(
        {topic: table.take(slice(None)) for topic, table in recording.items()}, recording.metadata
    )


def decide(detector: Detector, recording: Recording) -> Decisions:
    """Run the detector as the harness does."""
    with quiet():
        return detect(detector, private(recording))


@contextmanager
def quiet() -> Iterator[None]:
    """Let a detector's warnings pass, whatever the caller makes of warnings: they are the author's
    own matter.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def decide_if_possible(detector: Detector, recording: Recording) -> Decisions | None:
    """Run the detector; None where it refuses the recording with a clear error.

    A :class:`PluginError` is not one: it says that the detector, not the recording, is at fault.
    """
    try:
        return decide(detector, recording)
    except PluginError:
        raise
    except SpoofbenchError:
        return None


def difference(
    left: Decisions | None, right: Decisions | None, until_ns: int | None = None
) -> str | None:
    """Say how two decisions differ at or before a time, None where they agree.

    Scores agree to 1e-9 relative; alerts are equal unless a score lies within that of 1. A refusal
    agrees with decisions of which none is available.
    """
    if left is None or right is None:
        known = left or right
        count = (
            0
            if known is None
            else int(np.count_nonzero(known.available & _within(known, until_ns)))
        )
        return f"{count} available decisions against a refusal" if count else None
    a, b = _within(left, until_ns), _within(right, until_ns)
    if not np.array_equal(left.time_ns[a], right.time_ns[b]):
        return f"{np.count_nonzero(a)} decisions against {np.count_nonzero(b)}, or at other times"
    time_ns, available = left.time_ns[a], left.available[a]
    if not np.array_equal(available, right.available[b]):
        return f"availability differs at {time_ns[np.argmax(available != right.available[b])]}"
    one, other = left.score[a][available], right.score[b][available]
    off = ~np.isclose(one, other, rtol=TOLERANCE, atol=0)
    off |= (left.alert[a][available] != right.alert[b][available]) & (np.abs(one - 1) > TOLERANCE)
    if not off.any():
        return None
    row = int(np.argmax(off))
    return f"the score at {time_ns[available][row]} is {one[row]!r} against {other[row]!r}"


def _within(decisions: Decisions, until_ns: int | None) -> Any:
    return (
        np.ones(decisions.time_ns.size, bool) if until_ns is None else decisions.time_ns <= until_ns
    )
