"""An aircraft, its altitude autopilot, and the closed loop of both with the estimator under attack,
in the mean (Tanil et al. 2018, Eqs 29-38).

The aircraft is the Boeing 747 at Mach 0.198 and sea level, from the stability derivatives of
Heffley and Jewell (1972), body axes; ``Mu`` is unconfirmed. The paper does not publish its
autopilot's gains: this one is a linear quadratic regulator.

The loop's state y stacks the INS state x and the error of its estimate x~ (each ``s``), the
innovations gamma (``n``) and the aircraft's state x_d (5). The form is not minimal, x and x_d being
two accounts of one motion, and has integrator modes: it is for attacks up to some 280 s.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm, solve_continuous_are

from spoofbench.arrays import Floats
from spoofbench_papers.integrity.filtering import Run
from spoofbench_papers.integrity.model import ACCEL_BIAS, ATTITUDE, GYRO_BIAS, VELOCITY
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

    dynamics: Floats
    control: Floats
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


def altitude_autopilot(aircraft: Aircraft) -> Floats:
    """Return the gain K of u = -K x, ``(2, 5)``: the regulator that weighs 2 m/s, 2 deg/s, 2 deg, 3
    m against 5 deg and 0.3 m/s^2.
    """
    allowed = np.array([2, 2, np.radians(2), np.radians(2), 3.0])
    effort = np.array([np.radians(5), 0.3])
    cost, price = np.diag(allowed**-2), np.diag(effort**-2)
    solution = solve_continuous_are(aircraft.dynamics, aircraft.control, cost, price)
    return np.asarray(np.linalg.solve(price, aircraft.control.T @ solution))


def imu_of_motion(aircraft: Aircraft) -> tuple[Floats, Floats]:
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


def aircraft_state_of_ins(aircraft: Aircraft) -> Floats:
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


_PITCH_RATE = 4


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """Means over an attack: INS state ``(k, s)``, error of its estimate ``(k, s)``, innovations
    ``(k, n)``, aircraft ``(k, 5)``.
    """

    state: Floats
    error: Floats
    innovation: Floats
    aircraft: Floats


def respond(
    run: Run, aircraft: Aircraft, gains: Floats, fault: Floats, interval_s: float
) -> Response:
    """Return the mean response to a fault, ``(k, n)``, of an aircraft under the control -gains x,
    gains ``(2, 5)``.
    """
    states, count = run.gain.shape[1:]
    loop = _Loop(run, aircraft, gains, interval_s)
    y = np.zeros(2 * states + count + 5)
    history = np.empty((len(run), y.size))
    for k in range(len(run)):
        transition, input_matrix = loop.step(k)
        y = transition @ y + input_matrix @ fault[k]
        history[k] = y
    return Response(*np.split(history, np.cumsum([states, states, count]), axis=1))


class _Loop:
    """The matrices of Eq (37)."""

    def __init__(self, run: Run, aircraft: Aircraft, gains: Floats, interval_s: float) -> None:
        self._run = run
        states = len(run.model.transition)
        self._effect = _held_input(run, interval_s)
        discrete = _discrete(
            np.block([[aircraft.dynamics, aircraft.control], [np.zeros((2, 7))]]), interval_s
        )
        self._aircraft, self._control = discrete[:5, :5], discrete[:5, 5:]

        rates, motion = imu_of_motion(aircraft)
        biases = np.zeros((6, states))
        biases[:3, ACCEL_BIAS] = biases[3:, GYRO_BIAS] = np.eye(3)
        to_aircraft = np.zeros((5, states))
        to_aircraft[:, :9] = aircraft_state_of_ins(aircraft)
        measured = np.zeros((1, 6))
        measured[0, _PITCH_RATE] = 1
        # K_u~: the pitch rate comes from the gyro, less its estimated bias
        from_rate = gains[:, 2:3] @ measured
        from_state = gains @ to_aircraft - from_rate @ biases  # K'_x
        by_control = rates @ aircraft.control
        together = np.eye(6) + by_control @ from_rate
        self._imu_of_state = np.linalg.solve(together, biases - by_control @ from_state)  # U_x
        self._imu_of_error = -np.linalg.solve(together, by_control @ from_state)  # U_x~
        self._imu_of_aircraft = np.linalg.solve(together, rates @ aircraft.dynamics + motion)  # U_d
        self._control_of_state = -from_state - from_rate @ self._imu_of_state  # Delta_x
        self._control_of_error = -from_state - from_rate @ self._imu_of_error  # Delta_x~
        self._control_of_aircraft = -from_rate @ self._imu_of_aircraft  # Delta_d

    def step(self, k: int) -> tuple[Floats, Floats]:
        """Return Phi_y and Psi_y of one epoch."""
        model, gain = self._run.model, self._run.gain[k]
        states, count = gain.shape
        kept = (np.eye(states) - gain @ model.observation) @ model.transition
        zero = np.zeros
        transition = np.block(
            [
                [
                    model.transition + self._effect @ self._imu_of_state,
                    self._effect @ self._imu_of_error,
                    zero((states, count)),
                    self._effect @ self._imu_of_aircraft,
                ],
                [zero((states, states)), kept, zero((states, count + 5))],
                [
                    zero((count, states)),
                    -model.observation @ model.transition,
                    zero((count, count + 5)),
                ],
                [
                    self._control @ self._control_of_state,
                    self._control @ self._control_of_error,
                    zero((5, count)),
                    self._aircraft + self._control @ self._control_of_aircraft,
                ],
            ]
        )
        return transition, np.vstack([zero((states, count)), gain, np.eye(count), zero((5, count))])


def _held_input(run: Run, interval_s: float) -> Floats:
    """Return Gamma of Eq (5), ``(s, 6)``: what specific force and rate, held over one interval, add
    to the INS state.

    The inertial part of the transition is recovered from the model, of which only r, v and E
    respond.
    """
    states = len(run.model.transition)
    # [f x], exact: E is constant without noise
    specific_force = -run.model.transition[VELOCITY, ATTITUDE] / interval_s
    dynamics = np.zeros((9, 15))
    dynamics[:3, 3:6] = np.eye(3)
    dynamics[3:6, 6:9] = -specific_force
    dynamics[3:9, 9:15] = np.eye(6)
    effect = np.zeros((states, 6))
    effect[:9] = _discrete(np.vstack([dynamics, np.zeros((6, 15))]), interval_s)[:9, 9:15]
    return effect


def _discrete(dynamics: Floats, interval_s: float) -> Floats:
    return np.asarray(expm(dynamics * interval_s))
