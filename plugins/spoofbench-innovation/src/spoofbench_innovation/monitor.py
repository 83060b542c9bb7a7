"""The detector: the innovations of a loosely coupled INS/GNSS filter against a chi-square
threshold.

Tanil, Khanafseh, Joerger, Pervan: An INS Monitor to Detect GNSS Spoofers Capable of Tracking
Vehicle Position, IEEE TAES 54(1), 2018.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, Self, get_args

import numpy as np

from spoofbench.arrays import Floats, Times, run_starts
from spoofbench.detector import Decisions, Labelled
from spoofbench.errors import NotApplicable
from spoofbench.navigation.installation import best_lag, motion_series
from spoofbench.recording import Recording
from spoofbench_innovation.error_model import GRADES, Grade, GradeName
from spoofbench_innovation.filtering import FilterSettings, Innovations, innovations
from spoofbench_innovation.measurements import Measurements, measurements
from spoofbench_innovation.trajectory import WINDOW_S

InnovationStatistic = Literal["cumulative", "windowed", "per-epoch"]

_DAY_S = 86_400.0
_LARGEST = 1e9  # a squared innovation beyond it is cut, so that sums stay exact
# after attacks of five minutes on a 43-minute drive single epochs alerted for 160 s at the median,
# 382 s at most
_RECOVERY_S = 400.0


@dataclass(frozen=True)
class InnovationMonitor:
    """Alerts where q = sum of gamma^T S^-1 gamma exceeds T^2; the score is q / (inflation T^2).

    The paper's filter takes code and carrier of each satellite. This one takes a receiver's
    position and velocity, as recordings have them: the sum of fewer, less precise measurements,
    whose errors the receiver's own filter has made last. ``p_fa`` is the probability of one test on
    white innovations of the modelled covariance: of one epoch (``per-epoch``), of one position of
    the window, which shares most epochs with its neighbours (``windowed``), of the sum at one epoch
    (``cumulative``). It is no rate over time.

    Attributes:
        statistic: ``windowed``; ``cumulative``, since the alignment, the paper's with a start that
            no attacker chose; ``per-epoch``.
        window_s: length of the window.
        p_fa: of one test, see above.
        grade: of the IMU: ``consumer``, ``automotive``, ``tactical`` or ``navigation``.
        velocity_random_walk: m/s/sqrt(s); as all that follow to ``bias_s``, None: that of the
            grade.
        angle_random_walk: rad/sqrt(s).
        accel_bias_mps2: steady-state standard deviation.
        gyro_bias_radps: likewise.
        bias_s: time constant of the biases.
        position_m: standard deviation of a horizontal component of position; vertical is
            ``vertical_m``.
        vertical_m: likewise.
        velocity_mps: standard deviation of a horizontal component of velocity; vertical is
            ``climb_mps``.
        climb_mps: likewise.
        reported: let the receiver's own accuracy, where it is worse, take the place of the four
            before. A spoofer controls it.
        inflation: by which the covariance of the innovations is larger than modelled; :meth:`fit`
            measures it.
        lag_s: how late the receiver's epochs are against the IMU.
        restart_s: a longer time without epochs ends the filter's run; it starts anew when aligned.
    """

    statistic: InnovationStatistic = "windowed"
    window_s: float = 10.0
    p_fa: float = 1e-6
    grade: GradeName = "automotive"
    velocity_random_walk: float | None = None
    angle_random_walk: float | None = None
    accel_bias_mps2: float | None = None
    gyro_bias_radps: float | None = None
    bias_s: float | None = None
    position_m: float = 1.5
    vertical_m: float = 3.0
    velocity_mps: float = 0.05
    climb_mps: float = 0.1
    reported: bool = False
    inflation: float = 1.0
    lag_s: float = 0.0
    restart_s: float = 60.0

    requires: ClassVar[tuple[str, ...]] = ("gnss/pvt", "imu")
    uses: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        for name, kind in (("statistic", InnovationStatistic), ("grade", GradeName)):
            if getattr(self, name) not in get_args(kind):
                raise ValueError(
                    f"{name} must be one of {list(get_args(kind))}, not {getattr(self, name)!r}"
                )
        positive = (
            "window_s",
            "position_m",
            "vertical_m",
            "velocity_mps",
            "climb_mps",
            "inflation",
            *_OVERRIDES,
        )
        for name in positive:
            value = getattr(self, name)
            if value is not None and not 0 < value < np.inf:
                raise ValueError(f"{name} must be positive and finite, not {value!r}")
        if not 0 < self.p_fa < 1:
            raise ValueError(f"p_fa must lie between 0 and 1, not {self.p_fa!r}")
        if not 0 <= self.lag_s < np.inf:
            raise ValueError(
                "lag_s must be 0 or more, or a decision would rest on the future, not "
                f"{self.lag_s!r}"
            )
        if not 2 <= self.restart_s < np.inf:
            raise ValueError(f"restart_s must be finite and at least 2, not {self.restart_s!r}")

    @property
    def memory_s(self) -> float:
        """How long a filter that was led astray takes to come back, and the window; a cumulative
        sum hardly ever comes back.
        """
        return (
            _DAY_S
            if self.statistic == "cumulative"
            else _RECOVERY_S + (self.window_s if self.statistic == "windowed" else 0.0)
        )

    @property
    def warm_up_s(self) -> float:
        """Lag, and the window of the alignment; without enough acceleration in it, longer."""
        return self.lag_s + WINDOW_S

    @property
    def imu_errors(self) -> Grade:
        """The error parameters of the IMU: those of its grade, and what is given instead."""
        given = {name: getattr(self, name) for name in _OVERRIDES}
        return replace(
            GRADES[self.grade],
            **{name: value for name, value in given.items() if value is not None},
        )

    def detect(self, recording: Recording) -> Decisions:
        """Return a decision per epoch of the primary receiver, available where the filter is
        aligned and the epoch measures something.

        Raises:
            RecordingError: a required kind is missing.
        """
        found, filtered = self.filtered(recording)
        score = (
            ratio(found.time_ns, filtered, self.statistic, self.window_s, self.p_fa)
            / self.inflation
        )
        return Decisions(found.time_ns, score, ~np.isnan(score))

    def filtered(self, recording: Recording) -> tuple[Measurements, Innovations]:
        """Return what GNSS measured, and the filter's innovations.

        Raises:
            RecordingError: a required kind is missing.
        """
        floor = (self.position_m, self.vertical_m, self.velocity_mps, self.climb_mps)
        found = measurements(recording.primary("gnss/pvt"), floor, self.reported)
        settings = FilterSettings(self.imu_errors, round(self.lag_s * 1e9), self.restart_s)
        return found, innovations(recording.primary("imu"), found, settings)

    def fit(self, clean: Sequence[Recording], attacked: Sequence[Labelled]) -> Self:  # noqa: ARG002, what is attacked says nothing of lag and noise
        """Return the monitor with the lag of the receiver, and noise as large as it is.

        ``lag_s`` is that of the horizontal force, and not below 0. With it, ``inflation`` is the
        mean of the normalised innovations squared per measurement, and at least 1: a mean below it
        comes of position errors that last, so that a filter soon foresees them. The variance that
        covers them must stay. The deviations of the single sensors stay, too.

        Raises:
            NotApplicable: the recordings do not determine the lag, or have too little motion to
                align the filter.
            RecordingError: a required kind is missing.
        """
        found = best_lag([motion_series(one, "horizontal_force") for one in clean])
        fitted = replace(self, lag_s=max(0.0, found.lag_s))
        squared, degrees = 0.0, 0
        for recording in clean:
            _, filtered = fitted.filtered(recording)
            squared += float(filtered.squared[filtered.run >= 0].sum())
            degrees += int(filtered.measured[filtered.run >= 0].sum())
        if not degrees:
            raise NotApplicable(
                "the innovation monitor cannot be fitted: no clean recording has enough motion to "
                "align it"
            )
        return replace(fitted, inflation=max(1.0, squared / degrees))


_OVERRIDES = (
    "velocity_random_walk",
    "angle_random_walk",
    "accel_bias_mps2",
    "gyro_bias_radps",
    "bias_s",
)


def ratio(
    time_ns: Times,
    found: Innovations,
    statistic: InnovationStatistic,
    window_s: float,
    p_fa: float,
) -> Floats:
    """Return q / T^2 of each epoch, ``(m,)``; NaN where nothing is measured.

    q is the sum of the normalised innovations squared of the epoch (``per-epoch``), of the epochs
    of the run within the last ``window_s`` (``windowed``), or of all epochs of the run
    (``cumulative``; Tanil et al. 2018, Eq 19). T^2 is exceeded by a chi-square variable of as many
    degrees of freedom as there are measurements in the sum with the probability ``p_fa``.

    Args:
        time_ns: of the epochs, increasing, ``(m,)``.
        found: their innovations.
        statistic: which sum.
        window_s: of ``windowed``.
        p_fa: of one test.
    """
    size = time_ns.size
    squared = np.nan_to_num(np.minimum(found.squared, _LARGEST), nan=_LARGEST)
    first = run_starts(found.run)
    if statistic == "per-epoch":
        first = np.arange(size)
    elif statistic == "windowed":
        first = np.maximum(
            first, np.searchsorted(time_ns, time_ns - round(window_s * 1e9), "right")
        )
    q, degrees = (np.append(0.0, np.cumsum(values)) for values in (squared, found.measured))
    usable = (found.run >= 0) & (found.measured > 0)
    result = np.full(size, np.nan)
    result[usable] = (q[1:] - q[first])[usable] / thresholds_squared(
        (degrees[1:] - degrees[first])[usable], p_fa
    )
    return result


def thresholds_squared(degrees: Floats, p_fa: float) -> Floats:
    """Return T^2 for each number of degrees of freedom, ``(k,)``: the chi-square point that
    ``p_fa`` lies above.
    """
    from scipy.special import chdtri

    distinct, index = np.unique(degrees, return_inverse=True)
    return np.asarray(chdtri(distinct, p_fa), np.float64)[index]
