"""What the checks of detectors work on: drives, changed futures, degraded recordings, and the rule
that tells decisions apart.
"""

import os
import random
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench import plugins
from spoofbench.detector import Decisions, Detector, detect
from spoofbench.errors import PluginError, SpoofbenchError
from spoofbench.recording import Recording
from spoofbench.table import Column, Table
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
class DetectorUnderTest:
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


def fingerprint(recording: Recording) -> tuple[str, dict[str, dict[str, str]]]:
    """Return what changes when a recording does."""
    metadata = {name: dict(record) for name, record in recording.metadata.items()}
    return Recording(dict(recording.items()), recording.metadata).digest(), metadata


def process_state() -> dict[str, Any]:
    """Return what a detector must leave alone, by the name that a reason can cite."""
    name, keys, *rest = np.random.get_state()  # noqa: NPY002  the very state that must stay
    state = {
        "numpy's global random generator": (name, np.asarray(keys).tobytes(), *rest),
        "the random module": random.getstate(),
    }
    return {
        **state,
        "numpy's error state": np.geterr(),
        "the folder": Path.cwd(),
        "the environment": dict(os.environ),
    }


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


_SEED = 20_170_503


def futures(recording: Recording, time_ns: int) -> Iterator[tuple[str, Recording]]:
    """Yield recordings whose rows at or before a time are those given, and what became of the rows
    after it.
    """
    yield "cut off", recording.until(time_ns)
    for name, change in (("scrambled", _scrambled), ("altered", _altered)):
        rng = np.random.default_rng(_SEED)
        tables = {}
        for topic, table in recording.items():
            first = int(np.searchsorted(table.time_ns, time_ns, "right"))
            tables[topic] = change(table, first, rng) if first < len(table) else table
        yield name, Recording(tables, recording.metadata)


def cuts(time_ns: NDArray[np.int64], thorough: bool) -> list[int]:
    """Choose times for :func:`futures` from those of the epochs, ``(n,)``: before all, at rows,
    1 ns before and after, between, at the end.
    """
    if not time_ns.size:
        return [0]
    rows = [round(share * (time_ns.size - 1)) for share in (0.3, 0.45, 0.65, 1.0)]
    at = [int(time_ns[row]) for row in rows]
    if not thorough:
        return at[:-1]
    half = int(time_ns[rows[2] + 1] - time_ns[rows[2]]) // 2 if rows[2] + 1 < time_ns.size else 1
    return [int(time_ns[0]) - 1, *at, at[1] - 1, at[1] + 1, at[2] + half]


def _scrambled(table: Table, first: int, rng: np.random.Generator) -> Table:
    order = np.concatenate([np.arange(first), first + rng.permutation(len(table) - first)])
    columns = {}
    for name in table:
        column = table.column(name)
        columns[name] = Column(
            column.values[order],
            None if column.valid is None else column.valid[order],
            column.categories,
        )
    return Table(table.kind.name, table.time_ns, columns)


def _altered(table: Table, first: int, rng: np.random.Generator) -> Table:
    """Scale and shift floats and lose some, change some counts and flags, lose every third row, let
    time run ahead.
    """
    after = np.arange(len(table)) >= first
    changed = {name: table.column(name) for name in table}
    for name, column in changed.items():
        values, some = column.values, after & (rng.random(len(table)) < 0.2)
        if values.dtype.kind == "f":
            moved = values * 1.7 + rng.normal(0, 3, values.size)
            changed[name] = Column(np.where(some, np.nan, np.where(after, moved, values)))
        elif column.categories is None:
            changed[name] = Column(
                np.where(some, values ^ np.ones((), values.dtype), values), column.valid
            )
    altered = Table(table.kind.name, table.time_ns + np.where(after, 37_000_000, 0), changed)
    return altered.take(~after | (np.arange(len(table)) % 3 != 0))


def degraded_recordings(recording: Recording) -> Iterator[tuple[str, Recording]]:
    """Yield the recording in many poor states, each under a name that a reason can cite."""
    span, rng = recording.span, np.random.default_rng(4)
    start, end = span.start_ns, span.end_ns
    third = (end - start) // 3

    def each(change: Callable[[Table], Table]) -> Recording:
        return Recording(
            {topic: change(table) for topic, table in recording.items()}, recording.metadata
        )

    def floats(table: Table, change: Callable[[Any], Any]) -> Table:
        return table.replace(
            **{name: change(table[name]) for name in table if table[name].dtype.kind == "f"}
        )

    yield "a recording without rows", recording.until(start - 1)
    yield "a recording of one row each", each(lambda table: table.take(slice(0, 1)))
    yield "a recording of two rows each", each(lambda table: table.take(slice(0, 2)))
    yield (
        "a recording without values",
        each(lambda table: Table(table.kind.name, table.time_ns, {})),
    )
    yield "a recording of zeros", each(lambda table: floats(table, np.zeros_like))
    yield (
        "a recording with a third of the values missing",
        each(
            lambda table: floats(
                table, lambda values: np.where(rng.random(values.size) < 1 / 3, np.nan, values)
            )
        ),
    )
    yield (
        "a recording with every time twice",
        each(lambda table: table.take(np.repeat(np.arange(len(table)), 2))),
    )
    yield (
        "a recording of one time",
        each(
            lambda table: Table(
                table.kind.name,
                np.full(len(table), start),
                {name: table.column(name) for name in table},
            )
        ),
    )
    yield (
        "a recording with a gap",
        each(
            lambda table: table.take(
                (table.time_ns < start + third) | (table.time_ns > end - third)
            )
        ),
    )
    for kind in sorted(recording.kinds):
        late = {
            topic: recording[topic].take(recording[topic].time_ns > end - third)
            for topic in recording.topics(kind)
        }
        early = {
            topic: recording[topic].until(start + third) for topic in recording if topic not in late
        }
        yield (
            f"a recording whose {kind} begins after all else has ended",
            recording.replace({**early, **late}),
        )
