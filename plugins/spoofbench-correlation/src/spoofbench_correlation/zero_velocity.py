"""The zero-velocity detector: GNSS and IMU must stand still at the same times."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, Self, get_args

import numpy as np

from spoofbench.arrays import Bools, Floats
from spoofbench.detector import Decisions, Labelled
from spoofbench.errors import NotApplicable
from spoofbench.navigation.imu import Standstill, agitation, is_stationary
from spoofbench.navigation.installation import best_lag, motion_series
from spoofbench.recording import Recording
from spoofbench_correlation import windows
from spoofbench_correlation.series import LONGEST_PAIR_S, receiver_velocity

Contradiction = Literal["either", "gnss_still", "imu_still"]

LEAST_PAIRS = 30
"""Pairs of either kind without which nothing is known of standstill."""
LIMITS_TRIED = 101


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

    def fit(self, clean: Sequence[Recording], attacked: Sequence[Labelled]) -> Self:  # noqa: ARG002, what is attacked says nothing of the installation
        """Return the detector with the lag of the receiver and the limits of the IMU's standstill.

        The paper leaves the limits to the user: they are the IMU's noise and the vehicle's
        vibration. ``force_std_mps2`` and ``rate_rms_radps`` are those at which the smallest share
        of the clean pairs is contradicted, where standstill of the receiver and motion count alike.
        ``lag_s`` is that of the horizontal force, since contradictions are too few to tell it, and
        not below 0. ``speed_mps`` and the threshold stay.

        Raises:
            NotApplicable: the recordings do not determine the lag, or do not hold half a minute of
                both standstill and motion.
            RecordingError: a required kind is missing.
        """
        found = best_lag([motion_series(one, "horizontal_force") for one in clean])
        fitted = replace(self, lag_s=max(0.0, found.lag_s))
        felt, still = zip(*(fitted._standing(one) for one in clean), strict=True)
        agitated, stands = np.concatenate(felt, axis=1), np.concatenate(still)
        known = ~np.isnan(agitated).any(axis=0)
        standing, moving = (agitated[:, known & (stands == one)] for one in (1, 0))
        if min(standing.shape[1], moving.shape[1]) < LEAST_PAIRS:
            raise NotApplicable(
                "the limits of standstill cannot be fitted: GNSS stands still over "
                f"{standing.shape[1]} pairs of epochs and moves over {moving.shape[1]}, and "
                f"{LEAST_PAIRS} of both are needed"
            )
        force_std_mps2, rate_rms_radps = _limits(standing, moving)
        return replace(fitted, force_std_mps2=force_std_mps2, rate_rms_radps=rate_rms_radps)

    def _standing(self, recording: Recording) -> tuple[Floats, Floats]:
        """Return how the IMU varies before each pair's end, ``(2, n)``, and whether the receiver
        stands still at both ends: 1, 0, or NaN where it does at one or is unknown, ``(n,)``.
        """
        velocity = receiver_velocity(recording.primary("gnss/pvt"))
        end_ns = velocity.time_ns[1:] - round(self.lag_s * 1e9)
        felt = agitation(recording.primary("imu"), end_ns, self.span_s, self.smooth_s)
        slow, fast = velocity.speed_mps < self.speed_mps, velocity.speed_mps >= self.speed_mps
        still = np.where(slow[1:] & slow[:-1], 1.0, np.nan)
        still[fast[1:] & fast[:-1]] = 0.0
        still[np.diff(velocity.time_ns) > round(LONGEST_PAIR_S * 1e9)] = np.nan
        return np.stack(felt), still

    def _contradicted(self, speed: Floats, imu_still: Bools) -> Bools:
        slow = speed < self.speed_mps
        gnss_still = slow[1:] & slow[:-1] & ~imu_still
        gnss_moves = ~slow[1:] & ~slow[:-1] & imu_still
        if self.contradiction == "either":
            return gnss_still | gnss_moves
        return gnss_still if self.contradiction == "gnss_still" else gnss_moves


def _limits(standing: Floats, moving: Floats) -> tuple[float, float]:
    """Return the limits of force and rate below both of which the fewest are misjudged: the sum of
    the share of those standing, ``(2, m)``, that lie above one, and of those moving, ``(2, n)``,
    that lie below both.
    """
    steps = np.linspace(0, 1, LIMITS_TRIED)
    force, rate = np.quantile(np.concatenate([standing, moving], axis=1), steps, axis=1).T
    best, limits = np.inf, (0.0, 0.0)
    for force_limit in force[1:].tolist():
        stand, move = (np.sort(felt[1, felt[0] < force_limit]) for felt in (standing, moving))
        wrong = (
            1
            - np.searchsorted(stand, rate[1:], "left") / standing.shape[1]
            + np.searchsorted(move, rate[1:], "left") / moving.shape[1]
        )
        if wrong.min() < best:
            best, limits = wrong.min(), (force_limit, float(rate[1:][np.argmin(wrong)]))
    return limits
