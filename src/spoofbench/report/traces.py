"""Decisions and tracks as the page carries them: little-endian integers in base64, each array
stored once.

Rounding, said on the page too: times to 1 ms, positions to 0.1 m, scores to 0.0005 up to 1 and to
0.12 % above. Rounding never moves a score over the threshold.
"""

import base64
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spoofbench.detector import Decisions
from spoofbench.recording import Interval
from spoofbench.results import Truth

ABSENT_DM = np.iinfo(np.int32).min
UNAVAILABLE = np.iinfo(np.int16).min
INFINITE = np.iinfo(np.int16).max
STEPS = 2000
"""Steps of the score axis per unit, see :func:`pack_scores`."""


@dataclass(slots=True)
class Pool:
    """Arrays in base64, equal ones once: epochs and clean tracks are shared by all variants of a
    recording.
    """

    items: list[str] = field(default_factory=list)
    _places: dict[str, int] = field(default_factory=dict)

    def add(self, values: ArrayLike, dtype: str) -> int:
        """Return the place in ``items`` of these values as little-endian ``dtype``."""
        text = base64.b64encode(np.ascontiguousarray(values, dtype).tobytes()).decode()
        if text not in self._places:
            self._places[text] = len(self.items)
            self.items.append(text)
        return self._places[text]


@dataclass(frozen=True, slots=True)
class Plane:
    """East-north plane tangent to the WGS84 ellipsoid at a point."""

    lat_deg: float
    lon_deg: float

    @classmethod
    def at_start(cls, truth: Truth) -> "Plane | None":
        """Return the plane at the first clean position, None where there is no position at all."""
        known = np.flatnonzero(~np.isnan(truth.clean_lat_deg) & ~np.isnan(truth.clean_lon_deg))
        return (
            cls(float(truth.clean_lat_deg[known[0]]), float(truth.clean_lon_deg[known[0]]))
            if known.size
            else None
        )

    def east_north_dm(
        self, lat_deg: NDArray[np.float64], lon_deg: NDArray[np.float64]
    ) -> NDArray[np.int32]:
        """Return east and north in decimetres, int32 ``(2, n)``, ``ABSENT_DM`` where there is no
        position.
        """
        import pymap3d

        east_m, north_m, _ = pymap3d.geodetic2enu(
            lat_deg, lon_deg, 0.0, self.lat_deg, self.lon_deg, 0.0
        )
        plane_dm = np.rint(10 * np.array([east_m, north_m]))
        return np.where(np.isnan(plane_dm).any(0), ABSENT_DM, np.nan_to_num(plane_dm)).astype(
            np.int32
        )


def milliseconds(time_ns: NDArray[np.int64], start_ns: int) -> NDArray[np.int64]:
    """Return times since the start, to the nearest millisecond."""
    return (time_ns - start_ns + 500_000) // 1_000_000


def interval_s(interval: Interval, start_ns: int) -> tuple[float, float]:
    """Return an interval in seconds since the start."""
    return (interval.start_ns - start_ns) / 1e9, (interval.end_ns - start_ns) / 1e9


def thinned(decisions: Decisions, limit: int) -> NDArray[np.intp]:
    """Return the rows to draw: all, or about ``limit`` of them.

    Of each of ``limit // 4`` equal stretches of rows the lowest score, the highest, and the first
    and last unavailable row stay. The highest stays, so a stretch with an alert keeps one.
    """
    n = decisions.time_ns.size
    if n <= limit:
        return np.arange(n)
    kept = {0, n - 1}
    for rows in np.array_split(np.arange(n), max(limit // 4, 1)):
        usable = decisions.available[rows]
        seen, unseen = rows[usable], rows[~usable]
        if seen.size:
            kept |= {
                int(seen[np.argmin(decisions.score[seen])]),
                int(seen[np.argmax(decisions.score[seen])]),
            }
        if unseen.size:
            kept |= {int(unseen[0]), int(unseen[-1])}
    return np.array(sorted(kept))


def pack_scores(score: NDArray[np.float64], available: NDArray[np.bool_]) -> NDArray[np.int16]:
    """Return scores on an axis linear up to 1 and logarithmic above, in steps of 1 / ``STEPS``.

    ``y = s`` for ``|s| <= 1``, else ``sign(s) (1 + log10 |s|)``; +inf is ``INFINITE``, unavailable
    ``UNAVAILABLE``. A score above 1 stays above, one at or below 1 stays there.
    """
    size = np.abs(np.where(available, score, 0.0))
    y = np.where(size > 1, 1 + np.log10(np.maximum(size, 1)), size) * np.sign(
        np.where(available, score, 0.0)
    )
    steps = np.rint(np.clip(y * STEPS, UNAVAILABLE + 1, INFINITE - 1))
    steps = np.where(score > 1, np.maximum(steps, STEPS + 1), np.minimum(steps, STEPS))
    steps = np.where(np.isposinf(score), INFINITE, steps)
    return np.where(available, steps, UNAVAILABLE).astype(np.int16)
