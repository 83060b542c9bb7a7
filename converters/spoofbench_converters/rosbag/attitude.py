"""Attitude quaternions."""

import numpy as np
from numpy.typing import NDArray

from spoofbench.conversion import Columns

_NORM_TOLERANCE = 1e-3


def enu_to_ned(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return NED to forward-right-down of ENU to right-forward-up, both ``(n, 4)`` as (a, b, c, d),
    a the scalar.

    Both frames swap their first two axes and turn their third round: (a, b, c, d) becomes (a, c, b,
    -d).
    """
    return np.asarray(quaternion[:, [0, 2, 1, 3]] * np.array([1.0, 1.0, 1.0, -1.0]))


def roll_pitch_yaw(quaternion: NDArray[np.float64]) -> Columns:
    """Return ``roll_deg pitch_deg yaw_deg`` of quaternions ``(n, 4)`` that turn NED into the body
    frame.

    Yaw, then pitch, then roll (Groves, Principles of GNSS, Inertial, and Multisensor Integrated
    Navigation Systems, 2nd ed., 2013, section 2.2); yaw from 0 to 360. Absent where the norm is not
    1.
    """
    norm = np.linalg.norm(quaternion, axis=1)
    proper = np.abs(norm - 1) < _NORM_TOLERANCE
    a, b, c, d = np.divide(
        quaternion.T, norm, out=np.full(quaternion.T.shape, np.nan), where=proper
    )
    roll = np.arctan2(2 * (a * b + c * d), 1 - 2 * (b * b + c * c))
    pitch = np.arcsin(np.clip(2 * (a * c - b * d), -1, 1))
    yaw = np.arctan2(2 * (a * d + b * c), 1 - 2 * (c * c + d * d))
    return {
        "roll_deg": np.rad2deg(roll),
        "pitch_deg": np.rad2deg(pitch),
        "yaw_deg": np.rad2deg(yaw) % 360,
    }
