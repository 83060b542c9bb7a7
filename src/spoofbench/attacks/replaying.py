"""Attacks that give the victim whole rows of another time or place: replay, repeat-back, meaconing."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from spoofbench.attacks.laws import GENUINE
from spoofbench.attacks.motion import interval_s
from spoofbench.errors import NotApplicable
from spoofbench.recording import Column, Interval, Recording, Table

PVT = "gnss/pvt"
_SAME_RATE = 0.02

Rows = NDArray[np.intp]


def nearest_rows(time_ns: NDArray[np.int64], wanted_ns: NDArray[np.int64], within_ns: float) -> Rows:
    """Return the row nearest to each wanted time, the earlier of two, -1 where none is within ``within_ns``."""
    if time_ns.size == 0:
        return np.full(wanted_ns.size, -1, np.intp)
    after = np.clip(np.searchsorted(time_ns, wanted_ns), 0, time_ns.size - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(wanted_ns - time_ns[before]) <= np.abs(time_ns[after] - wanted_ns), before, after)
    return np.where(np.abs(time_ns[nearest] - wanted_ns) <= within_ns, nearest, -1)


def rows_in_step(time_ns: NDArray[np.int64], wanted_ns: NDArray[np.int64], within_ns: float) -> Rows:
    """Return the nearest rows as :func:`nearest_rows` does, once the first of them that exists lies at its wanted time.

    Epochs of two times or receivers differ in phase: near half an interval, jitter alone would choose between two rows.
    """
    nearest = nearest_rows(time_ns, wanted_ns, within_ns)
    first = np.flatnonzero(nearest >= 0)[:1]
    phase_ns = int((time_ns[nearest[first]] - wanted_ns[first]).sum())
    return nearest_rows(time_ns, wanted_ns + phase_ns, within_ns)


def rows_within(table: Table, window: Interval) -> Rows:
    """Return the numbers of the rows within an interval."""
    return np.flatnonzero(window.covers(table.time_ns))


def with_rows_of(victim: Table, rows: Rows, donor: Table, sources: Rows) -> Table:
    """Return the victim's table with these rows' values taken from the donor's rows ``sources``, and deleted where that is -1.

    The victim keeps its times and the fields that claim time; fields that it never reports stay absent.

    Raises:
        NotApplicable: the donor never reports a field that the victim does.
    """
    lacking = [name for name in victim if victim.has(name) and name not in GENUINE and not donor.has(name)]
    if lacking:
        raise NotApplicable(f"the donor's {victim.kind.name} rows lack {lacking[0]!r}, which the victim's have")
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
    return attacked if known.all() else attacked.take(np.delete(np.arange(len(victim)), rows[~known]))


def delayed_rows(table: Table, rows: Rows, delay_s: float) -> Rows:
    """Return the rows in step with the times of ``rows`` less a delay, -1 where none is within half a nominal interval."""
    wanted_ns = table.time_ns[rows] - round(delay_s * 1e9)
    return rows_in_step(table.time_ns, wanted_ns, interval_s(table) * 0.5e9)


def require_delay(clean: Recording, delay_s: float) -> None:
    """Refuse a delay that the data are too slow for.

    Raises:
        NotApplicable: the delay is shorter than the nominal interval of a source.
    """
    for topic in clean.topics(PVT):
        interval = interval_s(clean[topic])
        # a nominal interval is a median of stamps that jitter, so a delay of just one epoch may seem shorter
        if delay_s < (1 - _SAME_RATE) * interval:
            raise NotApplicable(f"a delay of {delay_s!r} s is shorter than the interval of {topic!r}, {interval:.3g} s")


def supply_from(clean: Recording, history_s: float) -> Interval:
    """Return the interval that begins when the primary receiver has this much history.

    Raises:
        NotApplicable: it never has.
    """
    time_ns = clean.primary(PVT).time_ns if clean.topics(PVT) else np.empty(0, np.int64)
    start_ns = int(time_ns[0]) + round(history_s * 1e9) if time_ns.size else 0
    if not time_ns.size or start_ns > time_ns[-1]:
        raise NotApplicable(f"the primary {PVT!r} has less than the {history_s:.6g} s of history that the attack needs")
    return Interval(start_ns, clean.span.end_ns)


def _require_at_least_0(name: str, value: float) -> None:
    if not (np.isfinite(value) and value >= 0):
        raise ValueError(f"{name} must be finite and at least 0, not {value!r}")


@dataclass(frozen=True, slots=True)
class Delayed:
    """Whole rows of the receiver's own as of ``delay_s`` earlier, rounded to whole epochs.

    An epoch without such a row is deleted.
    """

    delay_s: float

    models: ClassVar[frozenset[str]] = frozenset({PVT})
    attack_class: ClassVar[str] = "replay"
    level: ClassVar[str] = "pvt"
    strength_unit: ClassVar[str] = "s"

    def __post_init__(self) -> None:
        _require_at_least_0("delay_s", self.delay_s)

    @property
    def strength(self) -> float:
        return self.delay_s

    def supply(self, clean: Recording, donors: Sequence[Recording] = ()) -> Interval:
        return supply_from(clean, self.delay_s)

    def apply(self, clean: Recording, window: Interval, rng: np.random.Generator, donors: Sequence[Recording] = ()) -> Recording:
        require_delay(clean, self.delay_s)
        tables: dict[str, Table | None] = {}
        for topic in clean.topics(PVT):
            table = clean[topic]
            rows = rows_within(table, window)
            tables[topic] = with_rows_of(table, rows, table, delayed_rows(table, rows, self.delay_s))
        return clean.replace(tables)


@dataclass(frozen=True, slots=True)
class Replay(Delayed):
    """Record now, play much later: what the receiver said ``delay_s`` before."""

    delay_s: float = 300.0


@dataclass(frozen=True, slots=True)
class RepeatBack(Delayed):
    """A delayed rebroadcast of what the victim receives (Lo et al. 2017: 0.5 and 2 s)."""

    delay_s: float = 2.0


@dataclass(frozen=True, slots=True)
class Meacon:
    """A rebroadcast of what is received elsewhere: whole rows of the first donor, without interpolation.

    Without a donor they come from another stretch of the same recording. Sources are matched by topic, else
    primary to primary; a source without counterpart leaves the variant. An epoch without a donor row within
    half a nominal interval is deleted.

    Attributes:
        offset_s: where the stretch begins, from the donor's first PVT row; None draws it.
        separation_s: least time between the window and a stretch of the same recording.
        resample: whether a donor of another rate will do; its nearest rows are taken, so that those of a slower donor repeat.
        strength: 1 is on, 0 is off.
    """

    offset_s: float | None = None
    separation_s: float = 60.0
    resample: bool = False
    strength: float = 1.0

    models: ClassVar[frozenset[str]] = frozenset({PVT})
    attack_class: ClassVar[str] = "meaconing"
    level: ClassVar[str] = "pvt"
    strength_unit: ClassVar[str] = "1"

    def __post_init__(self) -> None:
        _require_at_least_0("offset_s", self.offset_s or 0.0)
        _require_at_least_0("separation_s", self.separation_s)
        if self.strength not in (0, 1):
            raise ValueError(f"strength must be 1 or 0, not {self.strength!r}")

    def apply(self, clean: Recording, window: Interval, rng: np.random.Generator, donors: Sequence[Recording] = ()) -> Recording:
        donor = donors[0] if donors else clean
        if not donor.topics(PVT):
            raise NotApplicable(f"the donor has no {PVT!r}")
        victim = clean.primary(PVT)
        rows = rows_within(victim, window)
        if rows.size == 0:
            raise NotApplicable(f"the primary {PVT!r} has no row within the window")
        start_ns = self._start(_counterpart(clean, donor, clean.topics(PVT)[0]), window, rng, same=not donors)
        shift_ns = start_ns - int(victim.time_ns[rows[0]])
        tables: dict[str, Table | None] = {}
        for topic in clean.topics(PVT):
            other = _counterpart(clean, donor, topic)
            tables[topic] = None if other is None else self._meaconed(clean[topic], other, window, shift_ns)
        return clean.replace(tables)

    def _start(self, donor: Table | None, window: Interval, rng: np.random.Generator, *, same: bool) -> int:
        """Time of the donor's row that the first row of the window becomes."""
        time_ns = np.empty(0, np.int64) if donor is None else donor.time_ns
        duration_ns = window.end_ns - window.start_ns
        usable = time_ns + duration_ns <= time_ns.max(initial=0) + 1
        if same:
            gap_ns = round(self.separation_s * 1e9)
            usable &= (time_ns + duration_ns + gap_ns <= window.start_ns) | (time_ns >= window.end_ns + gap_ns)
        if self.offset_s is not None and time_ns.size:
            wanted = np.array([time_ns[0] + round(self.offset_s * 1e9)], np.int64)
            nearest = nearest_rows(time_ns, wanted, np.inf)[0]
            usable &= np.arange(time_ns.size) == nearest
        candidates = time_ns[usable]
        if candidates.size == 0:
            raise NotApplicable(
                f"the donor has no stretch of {window.duration_s:.1f} s"
                + (f" that is {self.separation_s!r} s away from the window" if same else "")
                + ("" if self.offset_s is None else f" at {self.offset_s!r} s")
            )
        return int(candidates[rng.integers(candidates.size)])

    def _meaconed(self, victim: Table, donor: Table, window: Interval, shift_ns: int) -> Table:
        rows = rows_within(victim, window)
        if rows.size == 0:
            return victim
        ours, theirs = interval_s(victim), interval_s(donor)
        if not self.resample and abs(ours - theirs) > _SAME_RATE * min(ours, theirs):
            raise NotApplicable(f"the donor's interval is {theirs:.4g} s, the victim's {ours:.4g} s; resample=true takes the nearest rows")
        wanted_ns = victim.time_ns[rows] + shift_ns
        return with_rows_of(victim, rows, donor, rows_in_step(donor.time_ns, wanted_ns, max(ours, theirs) * 0.5e9))


def _counterpart(clean: Recording, donor: Recording, topic: str) -> Table | None:
    if topic in donor:
        return donor[topic]
    return donor[donor.topics(PVT)[0]] if topic == clean.topics(PVT)[0] else None
