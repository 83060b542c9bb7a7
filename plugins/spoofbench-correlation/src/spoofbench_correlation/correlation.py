"""The correlation detector: magnitude verification (MAV) and horizontal components (HoC)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, Self, get_args

import numpy as np

from spoofbench.arrays import Floats, Times
from spoofbench.detector import Decisions, Labelled
from spoofbench.navigation.imu import ImuMeans, Standstill, interval_means, is_stationary
from spoofbench.navigation.installation import LagSeries, best_lag
from spoofbench.recording import Recording
from spoofbench.table import Table
from spoofbench_correlation import gravity, windows
from spoofbench_correlation.series import (
    LONGEST_PAIR_S,
    ReceiverVelocity,
    SeriesName,
    receiver_velocity,
    series,
)

CorrelationStatistic = Literal[SeriesName, "M", "H"]
Gravity = Literal["low_pass", "descent", "constant"]

SERIES: Mapping[CorrelationStatistic, tuple[SeriesName, ...]] = {
    "M_acc": ("M_acc",),
    "M_ag": ("M_ag",),
    "H_acc": ("H_acc",),
    "H_ag": ("H_ag",),
    "M": ("M_acc", "M_ag"),
    "H": ("H_acc", "H_ag"),
}
TURN_SPEED_MPS = 10.0
"""At which adaptive weighting takes a yaw rate and its centripetal acceleration as equal."""


@dataclass(frozen=True)
class Correlation:
    """Alerts where the correlation of GNSS motion with IMU motion falls below a threshold (Borio,
    Eq 1-15).

    ``score = (1 - C) / (1 - threshold)``: 0 for perfect agreement, 1 at the threshold. Unavailable
    where valid pairs cover too little of the window, where either series is constant, or before
    gravity is known.

    Attributes:
        statistic: ``M_acc``, ``M_ag`` (norms), ``H_acc``, ``H_ag`` (levelled) of Eq (9), or ``M``,
            ``H`` of Eq (15).
        alpha: weight of the angular rate in Eq (15).
        adaptive: weigh by dynamics. The paper gives no formula; here ``alpha : 1 - alpha`` is
            multiplied by the ratio of the rate's standard deviation, times 10 m/s, to the
            acceleration's, each the smaller of what GNSS and IMU saw in the window.
        window_s: length of the window.
        threshold: lowest correlation that raises no alert; 0.7 is the paper's for its best IMU,
            others need their own.
        gravity: ``low_pass`` with time constant ``gravity_s``; ``descent`` on Eq (13) and (14),
            averaged over ``gravity_s``; ``constant``, the mean of all specific force so far.
        gravity_s: time constant of the gravity estimate.
        w: weight of the rotation in Eq (13), (m/s^2)^2/(rad/s)^2.
        g: for ``descent``, the sensor's own norm at rest, m/s^2; None: the mean over the epochs at
            rest so far.
        lag_s: how late the receiver's velocities are; the IMU is averaged over ``(t[n-1] - lag,
            t[n] - lag]``.
        median_filter: length of a trailing median over all series, odd; 1 is none.
        min_share: share of the window that valid pairs must cover.
    """

    requires: ClassVar[tuple[str, ...]] = ("imu", "gnss/pvt")
    uses: ClassVar[tuple[str, ...]] = ()

    statistic: CorrelationStatistic = "H"
    alpha: float = 0.5
    adaptive: bool = False
    window_s: float = 120.0
    threshold: float = 0.7
    gravity: Gravity = "low_pass"
    gravity_s: float = 30.0
    w: float = 100.0
    g: float | None = None
    lag_s: float = 0.0
    median_filter: int = 1
    min_share: float = 0.8

    def __post_init__(self) -> None:
        for name, value, choices in (
            ("statistic", self.statistic, CorrelationStatistic),
            ("gravity", self.gravity, Gravity),
        ):
            if value not in get_args(choices):
                raise ValueError(f"{name} must be one of {list(get_args(choices))}, not {value!r}")
        checks = {
            "alpha": (0 <= self.alpha <= 1, "between 0 and 1"),
            "threshold": (-1 <= self.threshold < 1, "at least -1 and below 1"),
            "window_s": (0 < self.window_s < np.inf, "positive and finite"),
            "gravity_s": (self.gravity_s > 0, "positive"),
            "w": (self.w >= 0, "0 or more"),
            "g": (self.g is None or self.g > 0, "positive"),
            "lag_s": (
                0 <= self.lag_s < np.inf,
                "0 or more, or a decision would rest on the future",
            ),
            "median_filter": (
                isinstance(self.median_filter, int)
                and self.median_filter > 0
                and self.median_filter % 2 == 1,
                "an odd whole number",
            ),
            "min_share": (0 < self.min_share <= 1, "above 0 and at most 1"),
        }
        for name, (good, rule) in checks.items():
            if not good:
                raise ValueError(f"{name} must be {rule}, not {getattr(self, name)!r}")

    @property
    def memory_s(self) -> float:
        """The window, and the pairs that reach into it."""
        return self.window_s + self.median_filter * LONGEST_PAIR_S

    @property
    def warm_up_s(self) -> float:
        """Lag, the share of the window that must be covered, and a pair, or as many as the median
        takes; ``descent`` without ``g`` decides from the first rest on.
        """
        covered_s = self.min_share * self.window_s
        return self.lag_s + covered_s + self.median_filter * LONGEST_PAIR_S

    def detect(self, recording: Recording) -> Decisions:
        """Decide at each epoch of the primary receiver; the first has no pair and is
        unavailable.
        """
        velocity = receiver_velocity(recording.primary("gnss/pvt"))
        if velocity.time_ns.size < 2:
            return Decisions(
                velocity.time_ns,
                np.zeros(velocity.time_ns.size),
                np.zeros(velocity.time_ns.size, bool),
            )
        start_ns, end_ns = velocity.time_ns[:-1], velocity.time_ns[1:]
        x, y = self._series(recording.primary("imu"), velocity, self.lag_s)
        dt_s = (end_ns - start_ns) / 1e9
        valid = (dt_s <= LONGEST_PAIR_S) & ~np.isnan(x).any(axis=0) & ~np.isnan(y).any(axis=0)
        first = windows.first_of_window(start_ns, end_ns, self.window_s)
        value = self._combined(windows.correlate(x, y, valid, first))
        covered = windows.covered_s(dt_s, valid, first) >= self.min_share * self.window_s
        score = np.append(np.nan, np.where(covered, (1 - value) / (1 - self.threshold), np.nan))
        return Decisions(velocity.time_ns, score, ~np.isnan(score))

    def fit(self, clean: Sequence[Recording], attacked: Sequence[Labelled]) -> Self:  # noqa: ARG002, what is attacked says nothing of the receiver's lag
        """Return the detector with the ``lag_s``, not below 0, at which its own statistic, taken
        over the clean recordings as one window, is largest.

        Raises:
            NotApplicable: the recordings do not determine the lag.
            RecordingError: a required kind is missing.
        """
        weights = (1 - self.alpha, self.alpha) if len(SERIES[self.statistic]) == 2 else (1.0,)
        found = best_lag([self._lag_series(recording) for recording in clean], weights)
        return replace(self, lag_s=max(0.0, found.lag_s))

    def _lag_series(self, recording: Recording) -> LagSeries:
        imu, velocity = recording.primary("imu"), receiver_velocity(recording.primary("gnss/pvt"))
        _, y = self._series(imu, velocity, 0.0)
        long = np.diff(velocity.time_ns) > round(LONGEST_PAIR_S * 1e9)
        return LagSeries(
            velocity.time_ns[1:],
            np.where(long, np.nan, y),
            lambda lag_s: self._series(imu, velocity, lag_s)[0],
        )

    def _series(
        self, imu: Table, velocity: ReceiverVelocity, lag_s: float
    ) -> tuple[Floats, Floats]:
        """Return the IMU's and the receiver's series per pair of epochs, ``(k, n)`` each, k = 2 for
        a combination.
        """
        start_ns, end_ns = velocity.time_ns[:-1], velocity.time_ns[1:]
        lag_ns = round(lag_s * 1e9)
        means = interval_means(imu, start_ns - lag_ns, end_ns - lag_ns)
        at_rest = self._gravity(imu, means, end_ns - lag_ns, (end_ns - start_ns) / 1e9)
        pairs = [series(name, means, at_rest, velocity) for name in SERIES[self.statistic]]
        x, y = (
            windows.trailing_median(np.stack(sides), self.median_filter)
            for sides in zip(*pairs, strict=True)
        )
        return x, y

    def _gravity(self, imu: Table, means: ImuMeans, time_ns: Times, dt_s: Floats) -> Floats:
        force = means.force_mps2.T
        if self.gravity == "low_pass":
            return gravity.low_pass(force, dt_s, self.gravity_s)
        if self.gravity == "constant":
            return gravity.constant(force, dt_s)
        if self.g is not None:
            g = np.full(dt_s.size, self.g)
        else:
            g = gravity.static_norm(force, is_stationary(imu, time_ns, Standstill()) == 1)
        return gravity.descent(force, means.rate_radps.T, dt_s, g, self.w, self.gravity_s)

    def _combined(self, found: windows.WindowCorrelations) -> Floats:
        """Return the one coefficient, or Eq (15), ``(1 - alpha) C_acc + alpha C_ag``; ``(n,)``."""
        if len(found.coefficient) == 1:
            return np.asarray(found.coefficient[0])
        alpha = np.full(found.std_x.shape[1], self.alpha)
        if self.adaptive:
            spread = np.minimum(found.std_x, found.std_y)
            acceleration, rate = (1 - alpha) * spread[0], alpha * spread[1] * TURN_SPEED_MPS
            np.divide(rate, acceleration + rate, out=alpha, where=acceleration + rate > 0)
        combined: Floats = (1 - alpha) * found.coefficient[0] + alpha * found.coefficient[1]
        return combined
