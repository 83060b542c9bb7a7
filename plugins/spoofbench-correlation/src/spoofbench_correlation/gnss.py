"""The receiver's share: velocity per epoch, and acceleration and heading rate per pair of
epochs.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spoofbench.schema.v1 import gnss_pb2
from spoofbench.table import Table

Floats = NDArray[np.float64]

LONGEST_PAIR_S = 2.5  # over a longer gap the vehicle turns under its mean acceleration
# a dead-reckoned velocity is the inertial sensors' own: compared with them, it agrees with itself
_NO_VELOCITY = (
    gnss_pb2.FIX_TYPE_NONE,
    gnss_pb2.FIX_TYPE_DEAD_RECKONING,
    gnss_pb2.FIX_TYPE_TIME_ONLY,
)


class Velocity(NamedTuple):
    """Epochs of distinct times, shapes ``(n,)`` and ``(3, n)``; NaN where the receiver has no
    velocity.

    Of several rows at one time the last counts. Down is 0 where only speed and course are given.
    """

    time_ns: NDArray[np.int64]
    ned_mps: Floats

    @property
    def speed_mps(self) -> Floats:
        """Speed over ground, shape ``(n,)``."""
        return np.asarray(np.hypot(self.ned_mps[0], self.ned_mps[1]))


def velocity(pvt: Table) -> Velocity:
    """Return the velocity of each epoch, from speed and course where there is no velocity
    vector.
    """
    pvt = pvt.last_per_time()
    ned = np.stack([pvt[f"vel_{axis}_mps"] for axis in "ned"])
    if pvt.has("speed_mps", "course_deg"):
        course = np.radians(pvt["course_deg"])
        polar = pvt["speed_mps"] * np.stack([np.cos(course), np.sin(course), np.zeros(len(pvt))])
        ned = np.where(np.isnan(ned[:2]).any(axis=0), polar, ned)
    if "fix_type" in pvt:
        ned[:, np.isin(pvt["fix_type"], _NO_VELOCITY)] = np.nan
    return Velocity(pvt.time_ns, ned)


def acceleration(velocity: Velocity) -> Floats:
    """NED acceleration over ``(t[n-1], t[n]]`` for n = 1, ..., shape ``(3, n - 1)``, m/s^2 (Borio,
    Eq 2).
    """
    return np.diff(velocity.ned_mps, axis=1) / (np.diff(velocity.time_ns) / 1e9)


def heading_rate(velocity: Velocity, slowest_mps: float = 1.0) -> Floats:
    """Heading rate over ``(t[n-1], t[n]]``, positive clockwise from above, rad/s, shape ``(n -
    1,)`` (Borio, Eq 4).

    The heading's difference is wrapped to (-pi, pi]. Below ``slowest_mps`` a velocity has no
    heading to speak of: the rate is 0 where either end is slower.
    """
    turn = np.diff(np.arctan2(velocity.ned_mps[1], velocity.ned_mps[0]))
    turn = np.pi - np.mod(np.pi - turn, 2 * np.pi)
    speed = velocity.speed_mps
    slow = np.minimum(speed[1:], speed[:-1]) < slowest_mps
    return np.where(slow, 0.0, turn / (np.diff(velocity.time_ns) / 1e9))
