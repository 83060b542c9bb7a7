"""The detector: acceleration of GNSS against that of an accelerometer, and an executive monitor
over two tests.

Lo, Chen, Reid, Perkins, Walter, Enge: The Benefit of Low Cost Accelerometers for GNSS
Anti-Spoofing, ION Pacific PNT 2017.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, Self, get_args

import numpy as np

from spoofbench.arrays import Floats, Ints, Times
from spoofbench.detector import Decisions, Labelled
from spoofbench.errors import NotApplicable
from spoofbench.navigation.gnss import lacks_fix, local_position_ned, velocity_ned
from spoofbench.navigation.imu import imu_axes, turned_axes
from spoofbench.navigation.installation import (
    LagSeries,
    best_lag,
    imu_heading_rad,
    motion_series,
    trimmed_mean,
)
from spoofbench.recording import Recording
from spoofbench.table import Table
from spoofbench_acceleration.motion import (
    GnssMotion,
    heading_rad,
    motion_from_position,
    motion_from_velocity,
    pitch_rad,
    roll_rad,
    sensed_force,
    specific_force,
)
from spoofbench_acceleration.statistics import (
    Averaging,
    Executive,
    chi_square,
    executive_margin,
    exponential_average,
    mean_difference,
    sample_statistics,
)

ComparedAxis = Literal["vertical", "along_track"]
AccelerationSource = Literal["velocity", "position"]


_AXES: Mapping[ComparedAxis, str] = {"along_track": "forward", "vertical": "up"}
NORMAL_95 = 1.96
"""Standard deviations within which 95 % of a normal distribution lie."""


@dataclass(frozen=True, slots=True)
class ForceComparison:
    """Specific force along the compared axis over the interval that ends at each epoch, ``(n,)``;
    NaN is unavailable.

    Attributes:
        time_ns: of the epochs.
        sensed_mps2: what the accelerometer felt.
        expected_mps2: what GNSS lets expect.
    """

    time_ns: Times
    sensed_mps2: Floats
    expected_mps2: Floats


@dataclass(frozen=True)
class AccelerationMonitor:
    """Mean-difference and chi-square test of the acceleration difference under an executive
    monitor.

    The defaults are the paper's. It compares the vertical axis of an aircraft on approach; a ground
    vehicle needs ``axis="along_track"`` with ``pitch=True``.

    Attributes:
        executive: ``simple``: both tests must flag; ``multi``: or the chi-square test alone, more
            often.
        axis: ``vertical`` or ``along_track``.
        pitch: compensate pitch by the direction of the velocity, Eq (2).
        roll: compensate roll as in a coordinated turn, Eq (3).
        acceleration_from: ``velocity`` (first difference) or ``position`` (second difference).
        averaging: what ``averaging_s`` is: a ``span`` or a ``time_constant``; the paper does not
            say.
        averaging_s: of the exponential average; it restarts after a longer gap, over which no
            acceleration is taken.
        samples: n of Eq (6).
        stride: every how many epochs a sample is taken; the paper does not say.
        bias_mps2: b, the largest nominal bias, Eq (5).
        sigma_mps2: standard deviation of the averaged difference, Eq (7).
        z_threshold: of the mean-difference test, 1e-9 two-sided.
        chi2_threshold: of the chi-square test, 1e-9 at 7 degrees of freedom.
        window_s: observation window of the executive monitor.
        flagged_share: more than this share of the window's epochs must be flagged by both tests.
        flagged_share_alone: or more than this share by the chi-square test alone (``multi``).
        lag_s: how late the receiver's epochs are against the IMU; the IMU is averaged over (t[n-1]
            - lag, t[n] - lag].
        gate: leave out epochs whose fix type says that there is no fix.
        slowest_mps: below this speed over ground pitch is held and roll is 0, below a quarter of it
            heading is held. The along-track axis is unavailable before the first motion.
        mounting_pitch_deg: how much further than the vehicle's nose the IMU's forward axis points
            up.
        gravity_mps2: g; a sensor's own reading at rest is better where it is known.
        axes: what the IMU's x, y, z point to, such as ``frd``; empty: as the recording says, else
            ``frd``.
    """

    executive: Executive = "multi"
    axis: ComparedAxis = "vertical"
    pitch: bool = False
    roll: bool = False
    acceleration_from: AccelerationSource = "velocity"
    averaging: Averaging = "span"
    averaging_s: float = 5.0
    samples: int = 8
    stride: int = 1
    bias_mps2: float = 0.03
    sigma_mps2: float = 0.06
    z_threshold: float = 6.1
    chi2_threshold: float = 55.87
    window_s: float = 5.0
    flagged_share: float = 0.06
    flagged_share_alone: float = 0.12
    lag_s: float = 0.0
    gate: bool = True
    slowest_mps: float = 2.0
    mounting_pitch_deg: float = 0.0
    gravity_mps2: float = 9.81
    axes: str = ""

    requires: ClassVar[tuple[str, ...]] = ("gnss/pvt", "imu")
    uses: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        for name, kind in (
            ("executive", Executive),
            ("axis", ComparedAxis),
            ("acceleration_from", AccelerationSource),
            ("averaging", Averaging),
        ):
            if getattr(self, name) not in get_args(kind):
                raise ValueError(
                    f"{name} must be one of {get_args(kind)}, not {getattr(self, name)!r}"
                )
        for name in (
            "averaging_s",
            "sigma_mps2",
            "z_threshold",
            "chi2_threshold",
            "window_s",
            "gravity_mps2",
        ):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be above 0, not {getattr(self, name)!r}")
        if not (self.samples >= 2 and self.stride >= 1):
            raise ValueError(
                f"samples must be at least 2 and stride at least 1, not {self.samples!r} and "
                f"{self.stride!r}"
            )
        if not self.lag_s >= 0:
            raise ValueError(
                f"lag_s must be at least 0, since the IMU's future is unknown, not {self.lag_s!r}"
            )

    @property
    def memory_s(self) -> float:
        """Lag, decay of the average to 1 %, samples at 1 Hz (the slowest receiver it is meant for),
        and window.
        """
        decay_s = np.log(100) * self.averaging_s / (2 if self.averaging == "span" else 1)
        return float(self.lag_s + decay_s + self.samples * self.stride + self.window_s)

    @property
    def warm_up_s(self) -> float:
        """Lag and samples at 1 Hz, the first of them after as many steps as its acceleration takes;
        along the track, from the first motion on.
        """
        steps = 1 if self.acceleration_from == "velocity" else 2
        return float(self.lag_s + steps + (self.samples - 1) * self.stride)

    def detect(self, recording: Recording) -> Decisions:
        """Return a decision per epoch of the primary receiver, available where both tests are.

        Raises:
            RecordingError: a required kind is missing, or the IMU's axes are unknown.
        """
        comparison = self.compare(recording)
        time_s = _seconds(comparison.time_ns)
        average, runs = self._averaged(comparison)
        mean, variance = sample_statistics(average, runs, self.samples, self.stride)
        z = mean_difference(mean, self.bias_mps2, self.sigma_mps2) / self.z_threshold
        chi2 = chi_square(variance, self.samples, self.sigma_mps2) / self.chi2_threshold
        shares = (self.flagged_share, self.flagged_share_alone)
        score = executive_margin(time_s, z, chi2, self.window_s, shares, self.executive)
        return Decisions(comparison.time_ns, score, ~np.isnan(mean))

    def compare(self, recording: Recording) -> ForceComparison:
        """Return what the accelerometer felt and what GNSS lets expect, neither of them averaged
        over epochs.

        Raises:
            RecordingError: a required kind is missing, or the IMU's axes are unknown.
        """
        pvt = recording.primary("gnss/pvt").last_per_time()
        motion = self._motion(pvt, _seconds(pvt.time_ns))
        sensed = self._sensed(recording, pvt.time_ns, self.lag_s)
        return ForceComparison(pvt.time_ns, sensed, self._expected(motion))

    def fit(self, clean: Sequence[Recording], attacked: Sequence[Labelled]) -> Self:  # noqa: ARG002, what is attacked says nothing of the installation
        """Return the monitor with what clean recordings say of installation and noise.

        ``lag_s`` is where the correlation of the sensed with the expected force is largest, not
        below 0. Along the track, unless ``axes`` are given, they are turned about the vertical by
        quarters to where the IMU's forward axis points; with ``pitch``, ``mounting_pitch_deg`` is
        where the difference has no mean in motion: the offset of the accelerometer is part of it.
        ``sigma_mps2`` is the 95 % point of the averaged difference's deviation from its mean over
        1.96, so that a few outliers do not count; ``bias_mps2`` the largest mean of a recording,
        and no less than it was. The thresholds stay.

        Raises:
            NotApplicable: the recordings do not determine the lag.
            RecordingError: a required kind is missing, or the IMU's axes are unknown.
        """
        turned = self._turned(clean) if self.axis == "along_track" and not self.axes else self
        found = best_lag([turned._lag_series(one) for one in clean])
        fitted = replace(turned, lag_s=max(0.0, found.lag_s))
        if self.axis == "along_track" and self.pitch:
            level = replace(fitted, mounting_pitch_deg=0.0)
            offset_mps2 = trimmed_mean(np.concatenate([level._in_motion(one) for one in clean]))
            sine = np.clip(offset_mps2 / self.gravity_mps2, -1, 1)
            fitted = replace(level, mounting_pitch_deg=float(np.degrees(np.arcsin(sine))))
        averages = [fitted._averaged(fitted.compare(one))[0] for one in clean]
        averages = [one[~np.isnan(one)] for one in averages]
        means = [one.mean() for one in averages if one.size]
        deviations = np.concatenate([one - one.mean() for one in averages if one.size])
        return replace(
            fitted,
            sigma_mps2=float(np.quantile(np.abs(deviations), 0.95) / NORMAL_95),
            bias_mps2=max(self.bias_mps2, float(np.abs(means).max())),
        )

    def _turned(self, clean: Sequence[Recording]) -> Self:
        """Return the monitor with axes turned to where the IMU points; itself, where they are what
        the recordings say.
        """
        named = {imu_axes(one) for one in clean}
        lag_s = best_lag([motion_series(one, "horizontal_force") for one in clean]).lag_s
        quarters = round(imu_heading_rad(clean, lag_s) / (np.pi / 2)) % 4
        if not quarters:
            return self
        if len(named) > 1:
            raise NotApplicable(
                f"the IMU does not point forward, and its axes have several names: {sorted(named)}"
            )
        return replace(self, axes=turned_axes(named.pop(), quarters))

    def _lag_series(self, recording: Recording) -> LagSeries:
        pvt = recording.primary("gnss/pvt").last_per_time()
        expected = self._expected(self._motion(pvt, _seconds(pvt.time_ns)))
        return LagSeries(
            pvt.time_ns,
            expected[None],
            lambda lag_s: self._sensed(recording, pvt.time_ns, lag_s)[None],
        )

    def _in_motion(self, recording: Recording) -> Floats:
        """Return the differences of force while the vehicle moves, m/s^2, ``(k,)``."""
        pvt = recording.primary("gnss/pvt").last_per_time()
        motion = self._motion(pvt, _seconds(pvt.time_ns))
        difference = self._sensed(recording, pvt.time_ns, self.lag_s) - self._expected(motion)
        speed_mps = np.hypot(motion.velocity_mps[:, 0], motion.velocity_mps[:, 1])
        return difference[(speed_mps >= self.slowest_mps) & ~np.isnan(difference)]

    def _averaged(self, comparison: ForceComparison) -> tuple[Floats, Ints]:
        """Return the averaged difference and the number of its run, ``(n,)`` each."""
        return exponential_average(
            _seconds(comparison.time_ns),
            comparison.sensed_mps2 - comparison.expected_mps2,
            self.averaging_s,
            self.averaging,
        )

    def _expected(self, motion: GnssMotion) -> Floats:
        return specific_force(motion, self._attitude(motion), _AXES[self.axis], self.gravity_mps2)

    def _sensed(self, recording: Recording, time_ns: Times, lag_s: float) -> Floats:
        axes = self.axes or imu_axes(recording)
        edges_ns = time_ns - round(lag_s * 1e9)
        return sensed_force(recording.primary("imu"), axes, _AXES[self.axis], edges_ns)

    def _attitude(self, motion: GnssMotion) -> tuple[Floats, Floats, Floats]:
        """Return roll, pitch and heading of the IMU, rad, ``(n,)`` each."""
        velocity = motion.velocity_mps
        level = np.zeros(len(velocity))
        heading = heading_rad(velocity, self.slowest_mps / 4)
        pitch = pitch_rad(velocity, self.slowest_mps) if self.pitch else level
        roll = roll_rad(motion, self.gravity_mps2, self.slowest_mps) if self.roll else level
        if self.axis == "vertical":  # hardly depends on them: what is unknown counts as level
            heading, pitch = np.nan_to_num(heading), np.nan_to_num(pitch)
        return roll, pitch + np.radians(self.mounting_pitch_deg), heading

    def _motion(self, pvt: Table, time_s: Floats) -> GnssMotion:
        if self.acceleration_from == "velocity":
            vectors = velocity_ned(pvt)
        else:
            vectors = np.column_stack([pvt[name] for name in ("lat_deg", "lon_deg", "height_m")])
        if self.gate:
            vectors[lacks_fix(pvt)] = np.nan
        steps_s = np.diff(time_s)
        steps_s[steps_s > self.averaging_s] = np.nan
        if self.acceleration_from == "velocity":
            return motion_from_velocity(steps_s, vectors)
        return motion_from_position(steps_s, local_position_ned(*vectors.T))


def _seconds(time_ns: Times) -> Floats:
    """Return seconds since the first epoch, ``(n,)``."""
    return (time_ns - time_ns[:1]).astype(np.float64) * 1e-9
