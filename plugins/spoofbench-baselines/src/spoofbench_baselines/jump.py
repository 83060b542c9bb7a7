"""The simplest check that GNSS alone allows: does the position go where the velocity says?"""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from spoofbench.arrays import Bools, Floats
from spoofbench.detector import Decisions
from spoofbench.navigation.gnss import lacks_fix, travelled_ned, velocity_ned
from spoofbench.recording import Recording
from spoofbench.table import Table

_BEYOND_ANY_M = 1e6
_BEYOND_ANY_MPS = 1e5


@dataclass(frozen=True)
class Jump:
    """Alerts where the position jumps: abs(Δp - v Δt) of consecutive fixes, in the level plane.

    Δp is the step from the fix before, v the mean of the two reported velocities, Δt the time on
    the recording's clock between them. The score is that distance over ``threshold_m``. It is
    unavailable at the first fix, after a gap, and where either fix lacks position or velocity.

    Both defaults rest on data sheets and on the physics of cars, not on any recording:

    - ``threshold_m``: consumer receivers promise half of their positions within 2.5 m (u-blox
      NEO-M8 data sheet, UBX-15031086: 2.5 m CEP, 0.05 m/s). Were the errors of consecutive fixes
      independent and normal, |Δp - v Δt| would be Rayleigh-distributed, and exceed
      2.5 m sqrt(2 ln(3600) / ln(2)) = 12.2 m once in 3,600 epochs: once an hour at 1 Hz. They are
      strongly correlated, so real false alerts come from outages and multipath.
    - ``longest_gap_s``: with accelerations up to A the mean of the two velocities may miss the way
      by A Δt^2 / 4; at full braking, 5 m/s^2, that reaches 11 m, nearly the threshold, at 3 s.

    Attributes:
        threshold_m: how far the position may be from where the velocity takes it.
        longest_gap_s: after a longer time without a fix nothing is compared.
    """

    requires: ClassVar[tuple[str, ...]] = ("gnss/pvt",)
    uses: ClassVar[tuple[str, ...]] = ()
    baseline: ClassVar[bool] = True
    memory_s: ClassVar[float] = 0.0

    threshold_m: float = 12.2
    longest_gap_s: float = 3.0

    def __post_init__(self) -> None:
        for name in ("threshold_m", "longest_gap_s"):
            value = getattr(self, name)
            if not 0 < value < math.inf:
                raise ValueError(f"{name} must be finite and above 0, not {value!r}")

    def detect(self, recording: Recording) -> Decisions:
        """Score the step that ends at each epoch of the primary receiver."""
        pvt = recording.primary("gnss/pvt").last_per_time()
        velocity = velocity_ned(pvt)[:, :2]
        fixes = np.flatnonzero(_is_usable(pvt, velocity))
        step_s = np.diff(pvt.time_ns[fixes]) / 1e9
        mean_mps = (velocity[fixes][1:] + velocity[fixes][:-1]) / 2
        position = travelled_ned(*(values[fixes] for values in _geodetic(pvt)))[:, :2]
        miss_m = np.linalg.norm(np.diff(position, axis=0) - mean_mps * step_s[:, None], axis=1)
        score = np.full(len(pvt), np.nan)
        score[fixes[1:]] = np.where(step_s <= self.longest_gap_s, miss_m / self.threshold_m, np.nan)
        return Decisions(pvt.time_ns, score, ~np.isnan(score))


def _geodetic(pvt: Table) -> tuple[Floats, Floats, Floats]:
    """Return latitude, longitude, deg, and the height that the radii are taken at, m."""
    height_m = np.where(np.isnan(pvt["height_m"]), pvt["height_msl_m"], pvt["height_m"])
    height_m = np.where(np.abs(height_m) < _BEYOND_ANY_M, height_m, np.nan)
    return pvt["lat_deg"], pvt["lon_deg"], height_m


def _is_usable(pvt: Table, velocity_mps: Floats) -> Bools:
    """Where there is a fix with a position and a level velocity that can be one, ``(n,)``."""
    on_earth = (np.abs(pvt["lat_deg"]) <= 90) & (np.abs(pvt["lon_deg"]) <= 360)
    credible = (np.abs(velocity_mps) < _BEYOND_ANY_MPS).all(axis=1)
    return np.asarray(~lacks_fix(pvt) & on_earth & credible)
