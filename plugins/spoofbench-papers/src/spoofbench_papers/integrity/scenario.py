"""Scenarios: satellite geometry, rates, error models and thresholds as data.

Angles of the sky are in degrees; everything else is SI.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from spoofbench import config
from spoofbench.arrays import Floats
from spoofbench.errors import SpoofbenchError

GRAVITY_MPS2 = 9.80665


class ScenarioError(SpoofbenchError):
    """A scenario of an integrity evaluation is incomplete or invalid."""


_MAX_VALUE = 1e9
_MAX_EPOCHS, _MAX_WARM_UP_EPOCHS = 100_000, 1_000_000
_MIN_TIME_CONSTANT = 0.01
"""In intervals between epochs; the exponential of shorter ones overflows."""
_MIN_SPREAD = 1e-3
"""By how much sines of elevations must differ: without it the altitude is not observable."""


def _check(of: Any, above_0: Sequence[str] = ()) -> None:
    """Refuse numbers of a dataclass that are negative, not finite or too large, and zeros among
    those that must be above 0.
    """
    for field in fields(of):
        value = getattr(of, field.name)
        if field.type is float and not (
            0 <= value <= _MAX_VALUE and (value or field.name not in above_0)
        ):
            minimum = "above 0" if field.name in above_0 else "0 or more"
            raise ScenarioError(
                f"{field.name} must be {minimum} and at most {_MAX_VALUE:g}, not {value!r}"
            )


@dataclass(frozen=True, slots=True)
class ImuErrors:
    """White noise and first-order Gauss-Markov biases of an inertial measurement unit.

    Attributes:
        velocity_random_walk: m/s/sqrt(s).
        angle_random_walk: rad/sqrt(s).
        accel_bias_mps2, gyro_bias_radps: steady-state standard deviations.
        accel_bias_s, gyro_bias_s: time constants.
    """

    velocity_random_walk: float
    angle_random_walk: float
    accel_bias_mps2: float
    gyro_bias_radps: float
    accel_bias_s: float
    gyro_bias_s: float

    def __post_init__(self) -> None:
        _check(self, above_0=("accel_bias_s", "gyro_bias_s"))


@dataclass(frozen=True, slots=True)
class GnssErrors:
    """Errors of undifferenced ranges: white noise per epoch, and first-order Gauss-Markov
    multipath.

    Attributes:
        code_noise_m, carrier_noise_m: standard deviations of one epoch.
        code_multipath_m, carrier_multipath_m: steady-state standard deviations.
        code_multipath_s, carrier_multipath_s: time constants.
    """

    code_noise_m: float
    carrier_noise_m: float
    code_multipath_m: float
    carrier_multipath_m: float
    code_multipath_s: float
    carrier_multipath_s: float

    def __post_init__(self) -> None:
        _check(
            self,
            above_0=("code_noise_m", "carrier_noise_m", "code_multipath_s", "carrier_multipath_s"),
        )


@dataclass(frozen=True, slots=True)
class InitialErrors:
    """Standard deviations with which the filter starts; ambiguities are of undifferenced ranges."""

    position_m: float = 10.0
    velocity_mps: float = 1.0
    attitude_rad: float = float(np.radians(0.1))
    ambiguity_m: float = 10.0

    def __post_init__(self) -> None:
        _check(self)


@dataclass(frozen=True)
class Scenario:
    """A vehicle under a spoofing attack, and the monitor that watches over it.

    Attributes:
        name: of the scenario.
        satellites_deg: azimuth and elevation of each satellite, ``(m, 2)``.
        reference: the satellite that the others are differenced against; None is the highest.
        imu, gnss, initial: error models.
        rate_hz: of the GNSS epochs.
        warm_up_s: how long the filter runs before the monitor starts.
        period_s: length of the attack; the attack has ``period_s * rate_hz + 1`` epochs.
        alert_limit_m: on the vertical position error.
        false_alert_probability: of one test.
    """

    name: str
    satellites_deg: tuple[tuple[float, float], ...]
    imu: ImuErrors
    gnss: GnssErrors
    initial: InitialErrors = InitialErrors()
    reference: int | None = None
    rate_hz: float = 2.0
    warm_up_s: float = 3600.0
    period_s: float = 140.0
    alert_limit_m: float = 10.0
    false_alert_probability: float = 1e-6

    def __post_init__(self) -> None:
        _check(self, above_0=("rate_hz", "period_s", "alert_limit_m", "false_alert_probability"))
        if self.false_alert_probability >= 1:
            raise ScenarioError(
                "false_alert_probability must lie between 0 and 1, not "
                f"{self.false_alert_probability!r}"
            )
        self._check_satellites()
        for name, limit in (("period_s", _MAX_EPOCHS), ("warm_up_s", _MAX_WARM_UP_EPOCHS)):
            if getattr(self, name) * self.rate_hz > limit:
                raise ScenarioError(
                    f"{name} must be at most {limit} epochs of the scenario {self.name!r}, not "
                    f"{getattr(self, name)!r} s"
                )
        for part in (self.imu, self.gnss):
            for name in (field.name for field in fields(part) if field.name.endswith("_s")):
                if getattr(part, name) * self.rate_hz < _MIN_TIME_CONSTANT:
                    shortest = _MIN_TIME_CONSTANT / self.rate_hz
                    raise ScenarioError(
                        f"{name} must be at least {shortest:g} s at {self.rate_hz!r} Hz, not "
                        f"{getattr(part, name)!r}"
                    )

    def _check_satellites(self) -> None:
        count = len(self.satellites_deg)
        if count < 2:
            raise ScenarioError(
                f"the scenario {self.name!r} has {count} satellites; differences need at least 2"
            )
        for azimuth, elevation in self.satellites_deg:
            if not (abs(azimuth) <= 360 and abs(elevation) <= 90):
                raise ScenarioError(
                    "satellites_deg must be azimuths within 360 and elevations within 90 degrees "
                    f"of 0, not {[azimuth, elevation]!r}"
                )
        if (
            np.ptp(np.sin(np.radians([elevation for _, elevation in self.satellites_deg])))
            < _MIN_SPREAD
        ):
            raise ScenarioError(
                f"the satellites of {self.name!r} are all at one elevation; differences between "
                "them do not tell the altitude"
            )
        if self.reference is not None and not 0 <= self.reference < count:
            raise ScenarioError(
                f"reference must be the index of a satellite, 0 to {count - 1}, not "
                f"{self.reference!r}"
            )

    @property
    def measurements(self) -> int:
        """Code and carrier differences of one epoch."""
        return 2 * (len(self.satellites_deg) - 1)

    def epochs(self, period_s: float | None = None) -> int:
        """Number of epochs of an attack of this length, both ends included."""
        return round((self.period_s if period_s is None else period_s) * self.rate_hz) + 1

    def threshold_squared(self, epochs: int) -> float:
        """T^2 of the cumulative statistic after so many epochs (Tanil et al. 2018, Eq 17)."""
        return float(stats.chi2.isf(self.false_alert_probability, epochs * self.measurements))

    @cached_property
    def lines_of_sight(self) -> Floats:
        """Unit vectors to the satellites, NED, ``(m, 3)``, the reference satellite first."""
        azimuth, elevation = np.radians(np.asarray(self.satellites_deg)).T
        reference = int(np.argmax(elevation)) if self.reference is None else self.reference
        lines = np.stack(
            [
                np.cos(elevation) * np.cos(azimuth),
                np.cos(elevation) * np.sin(azimuth),
                -np.sin(elevation),
            ],
            1,
        )
        order = [reference, *(i for i in range(len(lines)) if i != reference)]
        return np.asarray(lines[order])

    def at(self, **changes: Any) -> "Scenario":
        """Return the scenario with other values."""
        return replace(self, **changes)


def load_scenario(path: Path) -> Scenario:
    """Read a scenario from TOML: the attributes of :class:`Scenario`, with tables ``imu``, ``gnss``
    and ``initial``.

    Raises:
        ScenarioError: the file cannot be read, a key is unknown or missing, or a value is invalid.
    """
    table = config.read_toml(path, f"the scenario {path.name!r}", ScenarioError)
    return config.read(
        Scenario, {"name": path.stem, **table}, f"scenario {path.name!r}", error=ScenarioError
    )
