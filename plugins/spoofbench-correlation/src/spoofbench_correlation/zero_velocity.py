"""The zero-velocity detector: GNSS and IMU must stand still at the same times."""

from dataclasses import dataclass
from typing import ClassVar, Literal, get_args

import numpy as np

from spoofbench.arrays import Bools, Floats
from spoofbench.detector import Decisions
from spoofbench.navigation.imu import Standstill, is_stationary
from spoofbench.recording import Recording
from spoofbench_correlation import windows
from spoofbench_correlation.series import LONGEST_PAIR_S, receiver_velocity

Contradiction = Literal["either", "gnss_still", "imu_still"]


@dataclass(frozen=True)
class ZeroVelocity:
    """Alerts where GNSS and IMU contradict each other on standing still (after Borio, Section V-A).

    A pair of epochs is a contradiction if the receiver stands still at both ends and the IMU moves
    in the ``span_s`` before the later one, or if the receiver moves at both ends and the IMU stands
    still, as in :func:`spoofbench.navigation.imu.is_stationary`. The statistic is contradicted
    seconds per minute over the window, ``score`` its ratio to ``threshold_per_min``. The paper
    gives no numbers; the thresholds here are ours.

    Attributes:
        contradiction: ``gnss_still`` or ``imu_still`` counts one kind alone: a running engine may
            shake a parked car, and a smooth road may not shake a driving one.
        speed_mps: GNSS speed over ground below which the receiver stands still.
        force_std_mps2: standard deviation of the smoothed specific force below which the IMU may
            stand still.
        rate_rms_radps: root mean square of the angular rate below which it does.
        smooth_s: smoothing of the specific force.
        span_s: time before an epoch over which the IMU is judged.
        window_s: length of the window that contradictions are counted in.
        threshold_per_min: contradicted seconds per minute above which there is an alert.
        lag_s: how late the receiver's velocities are against the IMU.
        min_share: share of the window in which both must be known.
    """

    requires: ClassVar[tuple[str, ...]] = ("imu", "gnss/pvt")
    uses: ClassVar[tuple[str, ...]] = ()

    contradiction: Contradiction = "either"
    speed_mps: float = 0.3
    force_std_mps2: float = 0.15
    rate_rms_radps: float = 0.010
    smooth_s: float = 0.2
    span_s: float = 1.0
    window_s: float = 120.0
    threshold_per_min: float = 5.0
    lag_s: float = 0.0
    min_share: float = 0.8

    def __post_init__(self) -> None:
        if self.contradiction not in get_args(Contradiction):
            raise ValueError(
                f"contradiction must be one of {list(get_args(Contradiction))}, not "
                f"{self.contradiction!r}"
            )
        if not 0 <= self.lag_s < np.inf:
            raise ValueError(
                "lag_s must be 0 or more, or a decision would rest on the future, not "
                f"{self.lag_s!r}"
            )
        if not 0 < self.min_share <= 1:
            raise ValueError(f"min_share must be above 0 and at most 1, not {self.min_share!r}")
        if not 0 < 2 * self.smooth_s <= self.span_s:
            raise ValueError(
                f"smooth_s must be positive and at most half of span_s = {self.span_s!r}, not "
                f"{self.smooth_s!r}"
            )
        for name in (
            "speed_mps",
            "force_std_mps2",
            "rate_rms_radps",
            "window_s",
            "threshold_per_min",
        ):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} must be positive and finite, not {getattr(self, name)!r}")

    @property
    def memory_s(self) -> float:
        """The window, and the pair that reaches into it."""
        return self.window_s + LONGEST_PAIR_S

    @property
    def warm_up_s(self) -> float:
        """Lag, the span over which the IMU is judged, the share of the window that must be known,
        and a pair.
        """
        return self.lag_s + self.span_s + self.min_share * self.window_s + LONGEST_PAIR_S

    def detect(self, recording: Recording) -> Decisions:
        """Decide at each epoch of the primary receiver; the first has no pair and is
        unavailable.
        """
        velocity = receiver_velocity(recording.primary("gnss/pvt"))
        start, end = velocity.time_ns[:-1], velocity.time_ns[1:]
        dt_s = (end - start) / 1e9
        imu_still = is_stationary(
            recording.primary("imu"),
            end - round(self.lag_s * 1e9),
            Standstill(self.span_s, self.smooth_s, self.force_std_mps2, self.rate_rms_radps),
        )
        speed = velocity.speed_mps
        known = (dt_s <= LONGEST_PAIR_S) & ~np.isnan(speed[1:] + speed[:-1] + imu_still)
        first = windows.first_of_window(start, end, self.window_s)
        known_s = windows.covered_s(dt_s, known, first)
        contradicted_s = windows.covered_s(
            dt_s, known & self._contradicted(speed, imu_still == 1), first
        )
        available = known_s >= self.min_share * self.window_s
        per_min = 60 * np.divide(
            contradicted_s, known_s, out=np.zeros_like(known_s), where=available
        )
        return Decisions(
            velocity.time_ns,
            np.append(np.zeros(speed[:1].size), per_min / self.threshold_per_min),
            np.append(np.zeros(speed[:1].size, bool), available),
        )

    def _contradicted(self, speed: Floats, imu_still: Bools) -> Bools:
        slow = speed < self.speed_mps
        gnss_still = slow[1:] & slow[:-1] & ~imu_still
        gnss_moves = ~slow[1:] & ~slow[:-1] & imu_still
        if self.contradiction == "either":
            return gnss_still | gnss_moves
        return gnss_still if self.contradiction == "gnss_still" else gnss_moves
