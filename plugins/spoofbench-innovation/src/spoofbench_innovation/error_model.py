"""The linear error model of a loosely coupled INS/GNSS filter, per step of the nominal trajectory,
and the error parameters of IMUs.

The fifteen states ``r v E b_a b_g`` are in the order, and the attitude error has the sign, of
``spoofbench_papers.integrity.model`` (Tanil et al. 2018, Eq 4): the true rotation from body to
wander frame is (I + [E x]) times the nominal one. Position and velocity are total, the rest are
differences from the nominal trajectory. States of GNSS errors would follow behind the inertial
ones, and a tightly coupled filter's observation would take the place of the identity on ``r v``.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from spoofbench.arrays import Floats
from spoofbench.navigation.preintegration import cross_matrices
from spoofbench_innovation.trajectory import Trajectory

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

POSITION, VELOCITY, ATTITUDE, ACCEL_BIAS, GYRO_BIAS = (slice(3 * i, 3 * i + 3) for i in range(5))
STATES, MEASURED = 15, 6
AZIMUTH = 8
"""Index of the attitude error about the vertical."""

# 1 sigma of what a vehicle does while the IMU is silent, beyond what it did before
SILENT_MPS2, SILENT_RADPS = 3.0, 0.3
# of the series: a step is at most 1.5 s, and without the biases' decay the dynamics are nilpotent
_ORDER = 8


def dynamics(attitude: Floats, force_mps2: Floats, bias_s: float) -> Floats:
    """Return F of each step, ``(n, 15, 15)``, flat Earth.

    Args:
        attitude: rotation from body to wander frame, ``(n, 3, 3)``.
        force_mps2: specific force in the wander frame, ``(n, 3)``.
        bias_s: time constant of the biases.
    """
    matrices = np.zeros((len(attitude), STATES, STATES))
    matrices[:, POSITION, VELOCITY] = np.eye(3)
    matrices[:, VELOCITY, ATTITUDE] = -cross_matrices(force_mps2)
    matrices[:, VELOCITY, ACCEL_BIAS] = matrices[:, ATTITUDE, GYRO_BIAS] = -attitude
    matrices[:, ACCEL_BIAS, ACCEL_BIAS] = matrices[:, GYRO_BIAS, GYRO_BIAS] = -np.eye(3) / bias_s
    return matrices


def driving(grade: Grade) -> Floats:
    """Return the spectral density of the driving noise, ``(15, 15)``."""
    bias = 2 / grade.bias_s * np.array([grade.accel_bias_mps2, grade.gyro_bias_radps]) ** 2
    return np.diag(
        np.repeat([0.0, grade.velocity_random_walk**2, grade.angle_random_walk**2, *bias], 3)
    )


def discretised(matrices: Floats, density: Floats, duration_s: Floats) -> tuple[Floats, Floats]:
    """Return transition matrices and process covariances of dx/dt = F x + w, ``(n, 15, 15)`` each.

    Both are Taylor series in the duration, all steps at once: dPhi/dt = F Phi, dQ/dt = F Q + Q F^T
    + density.
    """
    time = duration_s[:, None, None]
    transition, process = np.tile(np.eye(STATES), (len(matrices), 1, 1)), np.zeros_like(matrices)
    power, derivative = transition, np.broadcast_to(density, matrices.shape)
    for order in range(1, _ORDER + 1):
        power = matrices @ power * time / order
        transition = transition + power
        process += derivative * time if order == 1 else derivative
        grown = matrices @ derivative
        derivative = (
            (grown + grown.swapaxes(1, 2)) * time / (order + 1) * (time if order == 1 else 1.0)
        )
    return transition, process


def model(trajectory: Trajectory, grade: Grade) -> tuple[Floats, Floats]:
    """Return transition matrices and process covariances of a trajectory's steps, ``(n, 15, 15)``
    each.
    """
    force = trajectory.velocity_mps / trajectory.duration_s[:, None]
    transition, process = discretised(
        dynamics(trajectory.attitude, force, grade.bias_s), driving(grade), trajectory.duration_s
    )
    process[trajectory.silent_s > 0] += silence(trajectory.silent_s[trajectory.silent_s > 0])
    return transition, process


def silence(silent_s: Floats) -> Floats:
    """Return the covariance of the states from an acceleration and a rotation that the IMU did not
    say, ``(n, 15, 15)``.
    """
    effects = np.zeros((silent_s.size, STATES, 6))
    acceleration, turn = (
        SILENT_MPS2 * silent_s[:, None, None] * np.eye(3),
        SILENT_RADPS * silent_s[:, None, None] * np.eye(3),
    )
    effects[:, POSITION, :3], effects[:, VELOCITY, :3] = (
        acceleration * silent_s[:, None, None] / 2,
        acceleration,
    )
    effects[:, ATTITUDE, 3:] = turn
    return effects @ effects.swapaxes(1, 2)


def free_motion(trajectory: Trajectory, transition: Floats) -> Floats:
    """Return what moves the states without noise, as five columns per step, ``(n, 15, 5)``.

    The first column, to be multiplied by 1, is what the IMU measured and how the attitude was
    corrected. The second is to be multiplied by gravity, m/s^2, the last three by the rotation of
    the Earth in the wander frame, rad/s, which the gyros measure and the level frame does not have.
    """
    time = trajectory.duration_s
    columns = np.zeros((time.size, STATES, 5))
    columns[:, POSITION, 0], columns[:, VELOCITY, 0] = (
        trajectory.position_m,
        trajectory.velocity_mps,
    )
    columns[:, ATTITUDE, 0] = -trajectory.correction_rad
    columns[:, 2, 1], columns[:, 5, 1] = time**2 / 2, time
    half = -time[:, None, None] / 2 * np.eye(3)
    columns[:, :, 2:] = transition[:, :, ATTITUDE] @ half
    columns[:, ATTITUDE, 2:] += half
    return columns
