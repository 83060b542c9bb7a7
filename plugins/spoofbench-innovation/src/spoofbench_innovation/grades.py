"""Error parameters of inertial measurement units by grade."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

GradeName = Literal["consumer", "automotive", "tactical", "navigation"]

STANDARD_GRAVITY_MPS2 = 9.80665
_DEG, _MG = math.radians(1.0), 1e-3 * STANDARD_GRAVITY_MPS2
_HOUR_S = 3600.0


@dataclass(frozen=True, slots=True)
class Grade:
    """White noise, and first-order Gauss-Markov biases, each the same on all three axes.

    Attributes:
        velocity_random_walk: m/s/sqrt(s).
        angle_random_walk: rad/sqrt(s).
        accel_bias_mps2, gyro_bias_radps: steady-state standard deviations, those after switching
            on.
        bias_s: time constant of both biases.
    """

    velocity_random_walk: float
    angle_random_walk: float
    accel_bias_mps2: float
    gyro_bias_radps: float
    bias_s: float = _HOUR_S


GRADES: Mapping[GradeName, Grade] = {
    # Bosch BMI160 data sheet: 180 ug/sqrt(Hz), 0.007 deg/s/sqrt(Hz); a third of its limits of 40 mg
    # and 3 deg/s
    "consumer": Grade(0.18 * _MG, 0.007 * _DEG, 13 * _MG, 1.0 * _DEG),
    # VectorNav VN-100 data sheet: 140 ug/sqrt(Hz), 0.0035 deg/s/sqrt(Hz); El-Sheimy and Youssef
    # (2020), Table 1: 0.1 deg/s, 5 mg
    "automotive": Grade(0.14 * _MG, 0.0035 * _DEG, 5 * _MG, 0.1 * _DEG),
    # El-Sheimy and Youssef (2020), Table 1: 0.05 deg/sqrt(h), 10 deg/h, 1 mg; 100 ug/sqrt(Hz) is
    # usual
    "tactical": Grade(0.1 * _MG, 0.05 * _DEG / math.sqrt(_HOUR_S), 1 * _MG, 10 * _DEG / _HOUR_S),
    # Tanil et al. (2018), Table I
    "navigation": Grade(1e-5, 0.001 * _DEG / math.sqrt(_HOUR_S), 0.01 * _MG, 0.01 * _DEG / _HOUR_S),
}
"""El-Sheimy and Youssef: Inertial sensors technologies for navigation applications, Satellite
Navigation 1:2, 2020.
"""
