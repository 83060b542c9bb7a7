"""The detector: a reported motion that no vehicle of the class can make, for long enough."""

import math
from dataclasses import dataclass
from typing import ClassVar, get_args

import numpy as np

from spoofbench.detector import Decisions
from spoofbench.recording import Recording
from spoofbench_kinematics.limits import LIMITS, Vehicle
from spoofbench_kinematics.motion import held, reported_motion


@dataclass(frozen=True)
class Envelope:
    """Alerts where a limit of the vehicle's class has been exceeded for ``hold_s`` without a break.

    Each of speed (at its height), acceleration and climb is a ratio that is 1 at the limit. The
    score is the largest ratio that has been kept up for ``hold_s``: above 1 exactly where the rule
    alerts. It is unavailable until that time has been seen since the first fix, or since a gap
    longer than ``longest_gap_s``, and where the speed, or for an airliner the height, is unknown.

    Attributes:
        vehicle: ``airliner`` (transport jets) or ``car``. The README has the limits' sources.
        hold_s: how long a violation must last; None takes that of the class, 15 s of an airliner
            (time to alert of GNSS in terminal areas, ICAO Annex 10 vol. I, table 3.7.2.4-1) and 0 s
            of a car, whose changes of speed last for no longer.
        baseline_s: where a receiver reports no velocity, positions and heights are differenced over
            at least this time: 10 s turn its position noise of 3 m into 0.4 m/s.
        longest_gap_s: three updates of en-route surveillance, 8 s each (EUROCONTROL ESASSP).
    """

    requires: ClassVar[tuple[str, ...]] = ("gnss/pvt",)
    uses: ClassVar[tuple[str, ...]] = ()

    vehicle: Vehicle = "airliner"
    hold_s: float | None = None
    baseline_s: float = 10.0
    longest_gap_s: float = 24.0

    def __post_init__(self) -> None:
        if self.vehicle not in get_args(Vehicle):
            raise ValueError(f"vehicle must be one of {get_args(Vehicle)}, not {self.vehicle!r}")
        if self.hold_s is not None and not 0 <= self.hold_s < math.inf:
            raise ValueError(f"hold_s must be finite and at least 0, not {self.hold_s!r}")
        if not 0 < self.baseline_s <= self.longest_gap_s < math.inf:
            raise ValueError(
                "baseline_s must be above 0 and at most longest_gap_s, which must be finite, not "
                f"{self.baseline_s!r} and {self.longest_gap_s!r}"
            )

    @property
    def memory_s(self) -> float:
        """How long a differenced value rests on a position from within the attack."""
        return self.longest_gap_s

    @property
    def warm_up_s(self) -> float:
        """Time until a differenced speed has been held."""
        return self.baseline_s + self._hold_s

    @property
    def _hold_s(self) -> float:
        return LIMITS[self.vehicle].hold_s if self.hold_s is None else self.hold_s

    def detect(self, recording: Recording) -> Decisions:
        """Return a decision per epoch of the primary receiver."""
        pvt = recording.primary("gnss/pvt").last_per_time()
        motion = reported_motion(pvt, self.baseline_s, self.longest_gap_s)
        limits = LIMITS[self.vehicle]
        speed, acceleration, climb = (
            held(ratio, pvt.time_ns, self._hold_s, self.longest_gap_s)
            for ratio in (
                limits.speed_excess(motion.speed_mps, motion.height_m),
                motion.acceleration_mps2 / limits.acceleration_mps2,
                motion.climb_mps / limits.climb_mps,
            )
        )
        score = np.fmax(speed, np.fmax(acceleration, climb))
        return Decisions(pvt.time_ns, score, ~np.isnan(speed))
