"""Rows of a receiver: finding them by time, giving one row the values of another, and what delayed
ones need.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from spoofbench.attacks.laws import GENUINE, Rows
from spoofbench.attacks.motion import interval_s
from spoofbench.errors import NotApplicable
from spoofbench.recording import Interval, Recording
from spoofbench.table import Column, Table

PVT = "gnss/pvt"
SAME_RATE = 0.02
"""Share by which two nominal intervals of one rate may differ: they are medians of stamps that
jitter.
"""


def nearest_rows(
    time_ns: NDArray[np.int64], wanted_ns: NDArray[np.int64], within_ns: float
) -> Rows:
    """Return the row nearest to each wanted time, the earlier of two, -1 where none is within
    ``within_ns``.
    """
    if time_ns.size == 0:
        return np.full(wanted_ns.size, -1, np.intp)
    after = np.clip(np.searchsorted(time_ns, wanted_ns), 0, time_ns.size - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(
        np.abs(wanted_ns - time_ns[before]) <= np.abs(time_ns[after] - wanted_ns), before, after
    )
    return np.where(np.abs(time_ns[nearest] - wanted_ns) <= within_ns, nearest, -1)


def rows_in_step(
    time_ns: NDArray[np.int64], wanted_ns: NDArray[np.int64], within_ns: float
) -> Rows:
    """Return the nearest rows as :func:`nearest_rows` does, once the first of them that exists lies
    at its wanted time.

    Epochs of two times or receivers differ in phase: near half an interval, jitter alone would
    choose between two rows.
    """
    nearest = nearest_rows(time_ns, wanted_ns, within_ns)
    first = np.flatnonzero(nearest >= 0)[:1]
    phase_ns = int((time_ns[nearest[first]] - wanted_ns[first]).sum())
    return nearest_rows(time_ns, wanted_ns + phase_ns, within_ns)


def rows_within(table: Table, window: Interval) -> Rows:
    """Return the numbers of the rows within an interval."""
    return np.flatnonzero(window.covers(table.time_ns))


def with_rows_of(victim: Table, rows: Rows, donor: Table, sources: Rows) -> Table:
    """Return the victim's table with these rows' values taken from the donor's rows ``sources``,
    and deleted where that is -1.

    The victim keeps its times and the fields that claim time; fields that it never reports stay
    absent.

    Raises:
        NotApplicable: the donor never reports a field that the victim does.
    """
    lacking = [
        name for name in victim if victim.has(name) and name not in GENUINE and not donor.has(name)
    ]
    if lacking:
        raise NotApplicable(
            f"the donor's {victim.kind.name} rows lack {lacking[0]!r}, which the victim's have"
        )
    known = sources >= 0
    columns: dict[str, Column] = {}
    for name in victim:
        if name in GENUINE or not victim.has(name):
            continue
        values, valid = victim[name].copy(), victim.valid(name).copy()
        values[rows[known]] = donor[name][sources[known]]
        valid[rows[known]] = donor.valid(name)[sources[known]]
        columns[name] = Column(values, None if values.dtype.kind == "f" else valid)
    attacked = victim.replace(**columns)
    return (
        attacked if known.all() else attacked.take(np.delete(np.arange(len(victim)), rows[~known]))
    )


def delayed_rows(table: Table, rows: Rows, delay_s: float) -> Rows:
    """Return the rows in step with the times of ``rows`` less a delay, -1 where none is within half
    a nominal interval.
    """
    wanted_ns = table.time_ns[rows] - round(delay_s * 1e9)
    return rows_in_step(table.time_ns, wanted_ns, interval_s(table) * 0.5e9)


def require_delay(clean: Recording, delay_s: float) -> None:
    """Refuse a delay that the data are too slow for.

    Raises:
        NotApplicable: the delay is shorter than the nominal interval of a source.
    """
    for topic in clean.topics(PVT):
        interval = interval_s(clean[topic])
        # a delay of just one epoch may seem shorter than the median
        if delay_s < (1 - SAME_RATE) * interval:
            raise NotApplicable(
                f"a delay of {delay_s!r} s is shorter than the interval of {topic!r}, "
                f"{interval:.3g} s"
            )


def supply_from(clean: Recording, history_s: float) -> Interval:
    """Return the interval that begins when the primary receiver has this much history.

    Raises:
        NotApplicable: it never has.
    """
    time_ns = clean.primary(PVT).time_ns if clean.topics(PVT) else np.empty(0, np.int64)
    if not time_ns.size or history_s > (time_ns[-1] - time_ns[0]) / 1e9:
        raise NotApplicable(
            f"the primary {PVT!r} has less than the {history_s:.6g} s of history that the attack "
            "needs"
        )
    return Interval(int(time_ns[0]) + round(history_s * 1e9), clean.span.end_ns)


def require_at_least_0(name: str, value: float) -> None:
    """Refuse a parameter that is negative or not finite.

    Raises:
        ValueError: it is.
    """
    if not (np.isfinite(value) and value >= 0):
        raise ValueError(f"{name} must be finite and at least 0, not {value!r}")


@dataclass(frozen=True, slots=True)
class Delayed:
    """Base of the attacks that are made of what the receiver itself said ``delay_s`` before."""

    delay_s: float

    models: ClassVar[frozenset[str]] = frozenset({PVT})
    level: ClassVar[str] = "pvt"
    strength_unit: ClassVar[str] = "s"

    def __post_init__(self) -> None:
        require_at_least_0("delay_s", self.delay_s)

    @property
    def strength(self) -> float:
        return self.delay_s
