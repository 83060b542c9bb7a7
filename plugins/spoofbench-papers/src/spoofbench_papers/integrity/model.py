"""The linear error model of a tightly coupled INS/GNSS filter (Tanil et al. 2018, Eqs 1-8).

States, in this order, with ``d`` differenced satellites:

====================  =========  ==========================================
``r v E``             3 + 3 + 3  errors of position (m), velocity (m/s) and attitude (rad), NED
``b_a b_g``           3 + 3      accelerometer (m/s^2) and gyro (rad/s) bias, first-order
                      Gauss-Markov
code multipath        d          m, differenced against the reference satellite, first-order
                      Gauss-Markov
carrier multipath     d          m, likewise
ambiguities           d          m, constant
====================  =========  ==========================================

The paper leaves open, and this chooses: a flat Earth without rotation, the vehicle level and
heading north, so that f = (0, 0, -g); multipath and ambiguities carried as differences.
"""

from dataclasses import dataclass

import numpy as np
from filterpy.common import van_loan_discretization

from spoofbench.arrays import Floats
from spoofbench_papers.integrity.scenario import GRAVITY_MPS2, Scenario

POSITION, VELOCITY, ATTITUDE, ACCEL_BIAS, GYRO_BIAS = (slice(3 * i, 3 * i + 3) for i in range(5))
ALTITUDE = 2
"""Index of the vertical position error (down) among the states."""
INERTIAL_STATES = 15


@dataclass(frozen=True, slots=True, eq=False)
class LinearModel:
    """x_k = transition x_{k-1} + w, cov(w) = process; z_k = observation x_k + v, cov(v) = noise;
    cov(x_0) = initial.

    Shapes with ``s`` states and ``n`` measurements: ``(s, s)``, ``(s, s)``, ``(n, s)``, ``(n, n)``,
    ``(s, s)``.
    """

    transition: Floats
    process: Floats
    observation: Floats
    noise: Floats
    initial: Floats


def linear_model(scenario: Scenario) -> LinearModel:
    """Return a scenario's discrete error model at its GNSS rate, discretised by Van Loan's
    method.
    """
    differences = differencing(len(scenario.satellites_deg))
    together = differences @ differences.T
    count = len(together)
    states = INERTIAL_STATES + 3 * count
    code, carrier, ambiguity = (
        slice(INERTIAL_STATES + i * count, INERTIAL_STATES + (i + 1) * count) for i in range(3)
    )
    imu, gnss, start = scenario.imu, scenario.gnss, scenario.initial

    dynamics, driving, initial = (
        np.zeros((states, states)),
        np.zeros((states, states)),
        np.zeros((states, states)),
    )
    dynamics[:INERTIAL_STATES, :INERTIAL_STATES] = inertial_dynamics(
        imu.accel_bias_s, imu.gyro_bias_s
    )
    driving[VELOCITY, VELOCITY] = np.eye(3) * imu.velocity_random_walk**2
    driving[ATTITUDE, ATTITUDE] = np.eye(3) * imu.angle_random_walk**2
    for part, deviation, time_s, shape in (
        (ACCEL_BIAS, imu.accel_bias_mps2, imu.accel_bias_s, np.eye(3)),
        (GYRO_BIAS, imu.gyro_bias_radps, imu.gyro_bias_s, np.eye(3)),
        (code, gnss.code_multipath_m, gnss.code_multipath_s, together),
        (carrier, gnss.carrier_multipath_m, gnss.carrier_multipath_s, together),
    ):
        dynamics[part, part] = -np.eye(len(shape)) / time_s
        driving[part, part] = 2 * deviation**2 / time_s * shape
        initial[part, part] = deviation**2 * shape
    for part, deviation in (
        (POSITION, start.position_m),
        (VELOCITY, start.velocity_mps),
        (ATTITUDE, start.attitude_rad),
    ):
        initial[part, part] = np.eye(3) * deviation**2
    initial[ambiguity, ambiguity] = start.ambiguity_m**2 * together

    observation = np.zeros((2 * count, states))
    observation[:, POSITION] = np.tile(-differences @ scenario.lines_of_sight, (2, 1))
    observation[:count, code] = observation[count:, carrier] = observation[count:, ambiguity] = (
        np.eye(count)
    )
    noise: Floats = np.kron(
        np.diag([gnss.code_noise_m**2, gnss.carrier_noise_m**2]), together
    ).astype(np.float64)
    transition, process = discretised(dynamics, driving, 1 / scenario.rate_hz)
    return LinearModel(transition, process, observation, noise, initial)


def inertial_dynamics(accel_bias_s: float, gyro_bias_s: float) -> Floats:
    """Return F of the fifteen inertial states, level and heading north, ``(15, 15)`` (Tanil et al.
    2018, Eq 4).
    """
    dynamics = np.zeros((INERTIAL_STATES, INERTIAL_STATES))
    dynamics[POSITION, VELOCITY] = np.eye(3)
    dynamics[VELOCITY, ATTITUDE] = -cross_matrix(np.array([0.0, 0.0, -GRAVITY_MPS2]))
    dynamics[VELOCITY, ACCEL_BIAS] = -np.eye(3)
    dynamics[ATTITUDE, GYRO_BIAS] = -np.eye(3)
    dynamics[ACCEL_BIAS, ACCEL_BIAS] = -np.eye(3) / accel_bias_s
    dynamics[GYRO_BIAS, GYRO_BIAS] = -np.eye(3) / gyro_bias_s
    return dynamics


def discretised(dynamics: Floats, driving: Floats, interval_s: float) -> tuple[Floats, Floats]:
    """Return the transition matrix and process covariance of dx/dt = dynamics x + w, w of spectral
    density ``driving``; all ``(s, s)``.
    """
    values, vectors = np.linalg.eigh(driving)
    factor = vectors * np.sqrt(np.maximum(values, 0))  # a root, though not all states are driven
    transition, process = van_loan_discretization(dynamics, factor, interval_s)
    return np.asarray(transition), np.asarray((process + process.T) / 2)


def differencing(satellites: int) -> Floats:
    """Return D = [-1 I], ``(m - 1, m)``: differences against the first satellite."""
    return np.hstack([-np.ones((satellites - 1, 1)), np.eye(satellites - 1)])


def cross_matrix(vector: Floats) -> Floats:
    """Return [v x], so that ``cross_matrix(v) @ u`` is v x u."""
    x, y, z = vector
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
