"""Attacks that give the victim whole rows of another time or place: replay, repeat-back,
meaconing.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from spoofbench.attacks.pvt import (
    PVT,
    SAME_RATE,
    DelayedAttack,
    delayed_rows,
    interval_s,
    nearest_rows,
    require_at_least_0,
    require_delay,
    rows_in_step,
    rows_within,
    span_with_history,
    with_rows_of,
)
from spoofbench.errors import NotApplicable
from spoofbench.recording import Interval, Recording
from spoofbench.table import Table


@dataclass(frozen=True, slots=True)
class _DelayedRows(DelayedAttack):
    """Whole rows of the receiver's own as of ``delay_s`` earlier, rounded to whole epochs.

    An epoch without such a row is deleted.
    """

    attack_class: ClassVar[str] = "replay"

    def attackable_span(self, clean: Recording, donors: Sequence[Recording] = ()) -> Interval:
        return span_with_history(clean, self.delay_s)

    def apply(
        self,
        clean: Recording,
        window: Interval,
        rng: np.random.Generator,
        donors: Sequence[Recording] = (),
    ) -> Recording:
        require_delay(clean, self.delay_s)
        tables: dict[str, Table | None] = {}
        for topic in clean.topics(PVT):
            table = clean[topic]
            rows = rows_within(table, window)
            tables[topic] = with_rows_of(
                table, rows, table, delayed_rows(table, rows, self.delay_s)
            )
        return clean.replace(tables)


@dataclass(frozen=True, slots=True)
class Replay(_DelayedRows):
    """Record now, play much later: what the receiver said ``delay_s`` before."""

    delay_s: float = 300.0


@dataclass(frozen=True, slots=True)
class RepeatBack(_DelayedRows):
    """A delayed rebroadcast of what the victim receives (Lo et al. 2017: 0.5 and 2 s)."""

    delay_s: float = 2.0


@dataclass(frozen=True, slots=True)
class Meacon:
    """A rebroadcast of what is received elsewhere: whole rows of the first donor, without
    interpolation.

    Without a donor they come from another stretch of the same recording. Sources are matched by
    topic, else primary to primary; a source without counterpart leaves the variant. An epoch
    without a donor row within half a nominal interval is deleted.

    Attributes:
        offset_s: where the stretch begins, from the donor's first PVT row; None draws it.
        separation_s: shortest time between the window and a stretch of the same recording.
        resample: whether a donor of another rate will do; its nearest rows are taken, so that those
            of a slower donor repeat.
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
        require_at_least_0("offset_s", self.offset_s or 0.0)
        require_at_least_0("separation_s", self.separation_s)
        if self.strength not in (0, 1):
            raise ValueError(f"strength must be 1 or 0, not {self.strength!r}")

    def apply(
        self,
        clean: Recording,
        window: Interval,
        rng: np.random.Generator,
        donors: Sequence[Recording] = (),
    ) -> Recording:
        donor = donors[0] if donors else clean
        if not donor.topics(PVT):
            raise NotApplicable(f"the donor has no {PVT!r}")
        victim = clean.primary(PVT)
        rows = rows_within(victim, window)
        if rows.size == 0:
            raise NotApplicable(f"the primary {PVT!r} has no row within the window")
        start_ns = self._start(
            _counterpart(clean, donor, clean.topics(PVT)[0]), window, rng, same=not donors
        )
        shift_ns = start_ns - int(victim.time_ns[rows[0]])
        tables: dict[str, Table | None] = {}
        for topic in clean.topics(PVT):
            other = _counterpart(clean, donor, topic)
            tables[topic] = (
                None if other is None else self._meaconed(clean[topic], other, window, shift_ns)
            )
        return clean.replace(tables)

    def _start(
        self, donor: Table | None, window: Interval, rng: np.random.Generator, *, same: bool
    ) -> int:
        """Return the time of the donor's row that the first row of the window becomes, ns."""
        time_ns = np.empty(0, np.int64) if donor is None else donor.time_ns
        duration_ns = window.end_ns - window.start_ns
        usable = time_ns + duration_ns <= time_ns.max(initial=0) + 1
        if same:
            gap_ns = round(self.separation_s * 1e9)
            usable &= (time_ns + duration_ns + gap_ns <= window.start_ns) | (
                time_ns >= window.end_ns + gap_ns
            )
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
        victim_s, donor_s = interval_s(victim), interval_s(donor)
        longer_s, shorter_s = max(victim_s, donor_s), min(victim_s, donor_s)
        if not self.resample and longer_s - shorter_s > SAME_RATE * shorter_s:
            raise NotApplicable(
                f"the donor's interval is {donor_s:.4g} s, the victim's {victim_s:.4g} s; "
                "resample=true takes the nearest rows"
            )
        wanted_ns = victim.time_ns[rows] + shift_ns
        sources = rows_in_step(donor.time_ns, wanted_ns, longer_s * 0.5e9)
        return with_rows_of(victim, rows, donor, sources)


def _counterpart(clean: Recording, donor: Recording, topic: str) -> Table | None:
    if topic in donor:
        return donor[topic]
    return donor[donor.topics(PVT)[0]] if topic == clean.topics(PVT)[0] else None
