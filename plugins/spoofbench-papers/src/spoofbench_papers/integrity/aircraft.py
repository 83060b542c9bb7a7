"""Longitudinal motion of an aircraft and its altitude autopilot (Tanil et al. 2018, Eqs 29-33).

The Boeing 747 at Mach 0.198 and sea level, from the stability derivatives of Heffley and Jewell
(1972), body axes; ``Mu`` is unconfirmed. The paper does not publish its autopilot's gains: this one
is a linear quadratic regulator.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_continuous_are

from spoofbench_papers.integrity.model import Array
from spoofbench_papers.integrity.scenario import GRAVITY_MPS2

_FOOT_M = 0.3048
_SLUG_WEIGHT_LB = 32.174


@dataclass(frozen=True, slots=True, eq=False)
class Aircraft:
    """dx/dt = dynamics x + control u about a level trimmed flight.

    States: forward speed u and down speed w in body axes (m/s), pitch rate q (rad/s), pitch theta
    (rad), altitude h (m). Inputs: elevator (rad), thrust over mass (m/s^2).

    Attributes:
        dynamics: F_d, ``(5, 5)``.
        control: G_delta, ``(5, 2)``.
        speed_mps: V; pitch_rad: theta_0 of the trim, equal to its angle of attack.
    """

    dynamics: Array
    control: Array
    speed_mps: float
    pitch_rad: float


def boeing_747() -> Aircraft:
    """Return the B747 on approach: 221 ft/s, angle of attack 8.5 deg, 564,000 lb."""
    speed, pitch = 221 * _FOOT_M, np.radians(8.5)
    forward, down = speed * np.cos(pitch), speed * np.sin(pitch)
    thrust = 564_000 / _SLUG_WEIGHT_LB  # pounds of thrust per ft/s^2
    xu, xw, zu, zw, mq = -0.0209, 0.122, -0.202, -0.512, -0.357
    mu, mw, mw_dot = (value / _FOOT_M for value in (0.000117, -0.00177, -0.000246))
    x_control = np.array([0.959 * _FOOT_M, 0.570e-4 * thrust])
    z_control = np.array([-6.42 * _FOOT_M, -0.252e-5 * thrust])
    m_control = np.array([-0.378, 0.310e-6 * thrust / _FOOT_M])

    x_row = np.array([xu, xw, -down, -GRAVITY_MPS2 * np.cos(pitch), 0])
    z_row = np.array([zu, zw, forward, -GRAVITY_MPS2 * np.sin(pitch), 0])
    m_row = np.array([mu, mw, mq, 0, 0]) + mw_dot * z_row
    h_row = np.array([np.sin(pitch), -np.cos(pitch), 0, speed, 0])
    dynamics = np.stack([x_row, z_row, m_row, [0, 0, 1, 0, 0], h_row])
    control = np.stack([x_control, z_control, m_control + mw_dot * z_control, [0, 0], [0, 0]])
    return Aircraft(dynamics, control, speed, float(pitch))


def altitude_autopilot(aircraft: Aircraft) -> Array:
    """Return the gain K of u = -K x, ``(2, 5)``: the regulator that weighs 2 m/s, 2 deg/s, 2 deg, 3
    m against 5 deg and 0.3 m/s^2.
    """
    allowed = np.array([2, 2, np.radians(2), np.radians(2), 3.0])
    effort = np.array([np.radians(5), 0.3])
    cost, price = np.diag(allowed**-2), np.diag(effort**-2)
    solution = solve_continuous_are(aircraft.dynamics, aircraft.control, cost, price)
    return np.asarray(np.linalg.solve(price, aircraft.control.T @ solution))


def imu_of_motion(aircraft: Aircraft) -> tuple[Array, Array]:
    """Return T and T' of (f, omega) = T dx/dt + T' x, each ``(6, 5)``: what an IMU feels, in NED
    axes.

    The paper's Eq (33) leaves out gravity and the Coriolis terms: df_x = du/dt + W_0 q + g
    cos(theta_0) dtheta and df_z = dw/dt - U_0 q + g sin(theta_0) dtheta.
    """
    sine, cosine = np.sin(aircraft.pitch_rad), np.cos(aircraft.pitch_rad)
    forward, down = aircraft.speed_mps * cosine, aircraft.speed_mps * sine
    body_rate, body = np.zeros((6, 5)), np.zeros((6, 5))
    body_rate[0, 0] = body_rate[2, 1] = 1
    body[0] = [0, 0, down, GRAVITY_MPS2 * cosine, 0]
    body[2] = [0, 0, -forward, GRAVITY_MPS2 * sine, 0]
    body[4, 2] = 1
    level = np.eye(6)
    level[np.ix_([0, 2], [0, 2])] = [[cosine, sine], [-sine, cosine]]
    return level @ body_rate, level @ body


def aircraft_state_of_ins(aircraft: Aircraft) -> Array:
    """Return the matrix that takes (r, v, E) in NED to the aircraft's states u, w, theta and h,
    ``(5, 9)``; that of q is 0.
    """
    sine, cosine = np.sin(aircraft.pitch_rad), np.cos(aircraft.pitch_rad)
    matrix = np.zeros((5, 9))
    matrix[0, [3, 5, 7]] = [cosine, -sine, -sine * aircraft.speed_mps]
    matrix[1, [3, 5, 7]] = [sine, cosine, cosine * aircraft.speed_mps]
    matrix[3, 7] = 1
    matrix[4, 2] = -1
    return matrix
