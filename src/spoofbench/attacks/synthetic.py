"""Attacks that invent a motion: one without knowledge of the victim's acceleration, and a slow
drag-off.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from spoofbench.arrays import Floats, Indices
from spoofbench.attacks.pvt import (
    PVT,
    GeodeticMotion,
    epochs_s,
    metres_per_unit,
    motion_of,
    require_at_least_0,
    rows_within,
    with_motion,
)
from spoofbench.errors import NotApplicable
from spoofbench.recording import Interval, Recording
from spoofbench.table import Table

# least-squares parabola through five samples (Savitzky, Golay 1964)
_SMOOTHER = np.array([-3.0, 12.0, 17.0, 12.0, -3.0]) / 35
_SAME_SPEED_MPS = 2.0


@dataclass(frozen=True, slots=True)
class ZeroAcceleration:
    """The best that an attacker can do who does not know the victim's acceleration: none (Lo et al.
    2017).

    Velocity is held from the last genuine epoch (where the receiver reports none: from its last two
    positions), position is its integral. On top lie residuals of the clean data, so that noise
    stays natural: rows outside the window less their local parabola, from a drawn one on; those at
    about the held speed where there are enough, since noise at rest is not that of driving.

    Attributes:
        strength: share of the genuine motion that is replaced: 0 leaves it, 1 leaves none of the
            acceleration.
    """

    strength: float = 1.0

    models: ClassVar[frozenset[str]] = frozenset({PVT})
    attack_class: ClassVar[str] = "generated"
    level: ClassVar[str] = "pvt"
    strength_unit: ClassVar[str] = "1"

    def __post_init__(self) -> None:
        if not 0 <= self.strength <= 1:
            raise ValueError(f"strength must be between 0 and 1, not {self.strength!r}")

    def apply(
        self,
        clean: Recording,
        window: Interval,
        rng: np.random.Generator,
        donors: Sequence[Recording] = (),
    ) -> Recording:
        draw = rng.random()
        return clean.replace(
            {topic: self._hold(clean[topic], window, draw) for topic in clean.topics(PVT)}
        )

    def _hold(self, table: Table, window: Interval, draw: float) -> Table:
        rows = rows_within(table, window)
        if rows.size == 0:
            return table
        motion, epoch = motion_of(table), epochs_s(table)
        before, last = _last_known(motion, epoch, int(rows[0]))
        elapsed = (epoch[rows] - epoch[last])[:, None]
        noise = _residuals(motion, epoch, rows, _speeds(motion) - _speeds(motion)[last], draw)
        # genuine noise fades with the genuine motion: the two shares keep its variance
        share = np.sqrt(1 - (1 - self.strength) ** 2)
        slope = (motion.position[last] - motion.position[before]) / (epoch[last] - epoch[before])
        steady = np.where(np.isfinite(motion.rate[last]), motion.rate[last], slope)
        held = GeodeticMotion(
            motion.position[last] + steady * elapsed, np.broadcast_to(steady, noise.rate.shape)
        )
        position, rate = motion.position.copy(), motion.rate.copy()
        for genuine, invented, residual in (
            (position, held.position, noise.position),
            (rate, held.rate, noise.rate),
        ):
            genuine[rows] += self.strength * (invented - genuine[rows]) + share * residual
        return with_motion(table, GeodeticMotion(position, rate))


def _last_known(motion: GeodeticMotion, epoch: Floats, row: int) -> tuple[int, int]:
    """Return the last two epochs before this row that have all the position and velocity components
    that any row has.
    """
    both = np.hstack([motion.position, motion.rate])
    reported = np.isfinite(both).any(axis=0)
    known = np.flatnonzero(np.isfinite(both[:row, reported]).all(axis=1))
    earlier = known[epoch[known] < epoch[known].max(initial=-np.inf)]
    if not reported.any() or not earlier.size:
        raise NotApplicable("there are fewer than two genuine epochs with a fix before the window")
    return int(earlier[-1]), int(known[-1])


def _speeds(motion: GeodeticMotion) -> Floats:
    """Return the level speed, m/s, ``(n,)``."""
    return np.asarray(
        np.hypot(*(motion.rate * metres_per_unit(motion.position))[:, :2].T), np.float64
    )


def _residuals(
    motion: GeodeticMotion, epoch: Floats, rows: Indices, faster: Floats, draw: float
) -> GeodeticMotion:
    """Return rows outside the window less their local parabola, as many as the window has, in their
    order from a drawn one on.

    Args:
        motion: of all rows.
        epoch: their times, s, ``(n,)``.
        rows: of the window.
        faster: each row's speed above the wanted one, m/s, ``(n,)``.
        draw: which row comes first, 0 to 1.
    """
    n = epoch.size
    both = np.hstack([motion.position, motion.rate])
    middle = np.arange(2, n - 2)
    smooth = sum(
        weight * both[middle + lag] for weight, lag in zip(_SMOOTHER, range(-2, 3), strict=True)
    )
    residual = both[middle] - smooth
    reported = np.isfinite(both).any(axis=0)
    step = np.diff(epoch)
    even = np.abs(np.lib.stride_tricks.sliding_window_view(step, 4) - np.median(step)).max(
        axis=1
    ) < 0.1 * np.median(step)
    usable = (
        even
        & np.isfinite(residual[:, reported]).all(axis=1)
        & ((middle + 2 < rows[0]) | (middle - 2 > rows[-1]))
    )
    alike = usable & (np.abs(faster[middle]) < _SAME_SPEED_MPS)
    pool = residual[alike if alike.sum() >= rows.size else usable]
    if not len(pool):
        raise NotApplicable(
            "the receiver's noise is unknown: there are no five regular epochs outside the window"
        )
    drawn = np.nan_to_num(pool[(int(draw * len(pool)) + np.arange(rows.size)) % len(pool)])
    return GeodeticMotion(drawn[:, :3], drawn[:, 3:])


@dataclass(frozen=True, slots=True)
class DragOff:
    """A slow pull away from the truth: an offset that grows at ``rate_mps``, added to the measured
    rows with its exact derivative.

    The rate rises as a raised cosine over ``ramp_s``. Noise and lag of the measured rows stay.

    Attributes:
        rate_mps: final speed of the offset.
        ramp_s: time to reach it.
        direction_deg: level direction of the offset, clockwise from true north; None draws it.
        vertical_share: upward share of the speed, -1 (down) to 1 (up); the level share is the rest
            of the unit vector.
    """

    rate_mps: float = 1.0
    ramp_s: float = 10.0
    direction_deg: float | None = None
    vertical_share: float = 0.0

    models: ClassVar[frozenset[str]] = frozenset({PVT})
    attack_class: ClassVar[str] = "generated"
    level: ClassVar[str] = "pvt"
    strength_unit: ClassVar[str] = "m/s"

    def __post_init__(self) -> None:
        require_at_least_0("rate_mps", self.rate_mps)
        require_at_least_0("ramp_s", self.ramp_s)
        if not np.isfinite(self.direction_deg or 0.0):
            raise ValueError(f"direction_deg must be finite, not {self.direction_deg!r}")
        if not abs(self.vertical_share) <= 1:
            raise ValueError(
                f"vertical_share must be between -1 and 1, not {self.vertical_share!r}"
            )

    @property
    def strength(self) -> float:
        return self.rate_mps

    def apply(
        self,
        clean: Recording,
        window: Interval,
        rng: np.random.Generator,
        donors: Sequence[Recording] = (),
    ) -> Recording:
        direction = (
            rng.uniform(0, 2 * np.pi)
            if self.direction_deg is None
            else np.radians(self.direction_deg)
        )
        level = np.sqrt(1 - self.vertical_share**2)
        unit = np.array(
            [level * np.cos(direction), level * np.sin(direction), -self.vertical_share]
        )
        return clean.replace(
            {topic: self._drag(clean[topic], window, unit) for topic in clean.topics(PVT)}
        )

    def _drag(self, table: Table, window: Interval, unit: Floats) -> Table:
        rows = rows_within(table, window)
        if rows.size == 0:
            return table
        motion, epoch = motion_of(table), epochs_s(table)
        elapsed = epoch[rows] - epoch[rows[0]] + (table.time_ns[rows[0]] - window.start_ns) / 1e9
        offset, rate = (self.rate_mps * value[:, None] for value in _ramp(elapsed, self.ramp_s))
        metres = metres_per_unit(motion.position)[
            rows[0]
        ]  # one scale for all rows, so that the rate is the offset's derivative
        position, speed = motion.position.copy(), motion.rate.copy()
        position[rows] += offset * unit / metres
        speed[rows] += rate * unit / metres
        return with_motion(table, GeodeticMotion(position, speed))


def _ramp(elapsed: Floats, ramp_s: float) -> tuple[Floats, Floats]:
    """Return offset and rate of a pull of final rate 1, ``(n,)`` each.

    The rate is (1 - cos(pi t / T)) / 2 up to T = ``ramp_s``, then 1; the offset is its integral.
    """
    if ramp_s == 0:
        return elapsed, np.ones_like(elapsed)
    phase = np.minimum(elapsed / ramp_s, 1.0)
    rate = (1 - np.cos(np.pi * phase)) / 2
    offset = ramp_s * (phase / 2 - np.sin(np.pi * phase) / (2 * np.pi)) + np.maximum(
        elapsed - ramp_s, 0.0
    )
    return offset, rate
