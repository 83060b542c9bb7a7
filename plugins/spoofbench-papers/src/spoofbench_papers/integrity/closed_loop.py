"""The closed loop of estimator, autopilot and aircraft under a spoofing attack, in the mean (Tanil
et al. 2018, Eqs 34-38).

The state y stacks the INS state x and the error of its estimate x~ (each ``s``), the innovations
gamma (``n``) and the aircraft's state x_d (5). The form is not minimal, x and x_d being two
accounts of one motion, and has integrator modes: for attacks up to some 280 s.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from spoofbench_papers.integrity.aircraft import Aircraft, aircraft_state_of_ins, imu_of_motion
from spoofbench_papers.integrity.filtering import Run
from spoofbench_papers.integrity.model import ACCEL_BIAS, ATTITUDE, GYRO_BIAS, VELOCITY, Array

_PITCH_RATE = 4


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """Means over an attack: INS state ``(k, s)``, error of its estimate ``(k, s)``, innovations
    ``(k, n)``, aircraft ``(k, 5)``.
    """

    state: Array
    error: Array
    innovation: Array
    aircraft: Array


def respond(
    run: Run, aircraft: Aircraft, gains: Array, fault: Array, interval_s: float
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

    def __init__(self, run: Run, aircraft: Aircraft, gains: Array, interval_s: float) -> None:
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
        from_rate = (
            gains[:, 2:3] @ measured
        )  # K_u~: the pitch rate comes from the gyro, less its estimated bias
        from_state = gains @ to_aircraft - from_rate @ biases  # K'_x
        by_control = rates @ aircraft.control
        together = np.eye(6) + by_control @ from_rate
        self._imu_of_state = np.linalg.solve(together, biases - by_control @ from_state)  # U_x
        self._imu_of_error = -np.linalg.solve(together, by_control @ from_state)  # U_x~
        self._imu_of_aircraft = np.linalg.solve(together, rates @ aircraft.dynamics + motion)  # U_d
        self._control_of_state = -from_state - from_rate @ self._imu_of_state  # Delta_x
        self._control_of_error = -from_state - from_rate @ self._imu_of_error  # Delta_x~
        self._control_of_aircraft = -from_rate @ self._imu_of_aircraft  # Delta_d

    def step(self, k: int) -> tuple[Array, Array]:
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


def _held_input(run: Run, interval_s: float) -> Array:
    """Return Gamma of Eq (5), ``(s, 6)``: what specific force and rate, held over one interval, add
    to the INS state.

    The inertial part of the transition is recovered from the model, of which only r, v and E
    respond.
    """
    states = len(run.model.transition)
    specific_force = (
        -run.model.transition[VELOCITY, ATTITUDE] / interval_s
    )  # [f x], exact: E is constant without noise
    dynamics = np.zeros((9, 15))
    dynamics[:3, 3:6] = np.eye(3)
    dynamics[3:6, 6:9] = -specific_force
    dynamics[3:9, 9:15] = np.eye(6)
    effect = np.zeros((states, 6))
    effect[:9] = _discrete(np.vstack([dynamics, np.zeros((6, 15))]), interval_s)[:9, 9:15]
    return effect


def _discrete(dynamics: Array, interval_s: float) -> Array:
    return np.asarray(expm(dynamics * interval_s))
