"""What a statistic correlates: per pair of epochs, the IMU's series and the receiver's.

D. Borio, *An Experimental Evaluation of GNSS/INS Verification Strategies for Vehicular
Applications*, Eq (2), (4) and (9). Within the plugin vectors are columns, shape ``(3, n)``; row n
of the toolbox's arrays is column n here.
"""

from typing import Literal, NamedTuple

import numpy as np

from spoofbench.arrays import Floats, Times
from spoofbench.navigation.gnss import lacks_fix, velocity_ned
from spoofbench.navigation.imu import ImuMeans
from spoofbench.table import Table

SeriesName = Literal["M_acc", "M_ag", "H_acc", "H_ag"]

LONGEST_PAIR_S = 2.5
"""Over a longer gap between epochs the vehicle turns under its mean acceleration."""


class ReceiverVelocity(NamedTuple):
    """Velocity at epochs of distinct times; of several rows at one time the last counts.

    Attributes:
        time_ns: ``(n,)``.
        ned_mps: ``(3, n)``; NaN where the receiver has no velocity. Down is 0 where only speed and
            course are given.
    """

    time_ns: Times
    ned_mps: Floats

    @property
    def speed_mps(self) -> Floats:
        """Speed over ground, ``(n,)``."""
        return np.asarray(np.hypot(self.ned_mps[0], self.ned_mps[1]))


def receiver_velocity(pvt: Table) -> ReceiverVelocity:
    """Return the velocity of each epoch that has a fix of GNSS, however it is reported."""
    pvt = pvt.last_per_time()
    ned = np.ascontiguousarray(velocity_ned(pvt).T)
    lacking = np.isnan(pvt["vel_n_mps"]) | np.isnan(pvt["vel_e_mps"])
    ned[2, lacking & ~np.isnan(ned[0])] = 0.0
    ned[:, lacks_fix(pvt)] = np.nan
    return ReceiverVelocity(pvt.time_ns, ned)


def acceleration(velocity: ReceiverVelocity) -> Floats:
    """Return the NED acceleration over ``(t[n-1], t[n]]`` for n = 1, ..., m/s^2, ``(3, n - 1)``
    (Borio, Eq 2).
    """
    return np.diff(velocity.ned_mps, axis=1) / (np.diff(velocity.time_ns) / 1e9)


def heading_rate(velocity: ReceiverVelocity, slowest_mps: float = 1.0) -> Floats:
    """Return the heading rate over ``(t[n-1], t[n]]``, rad/s, positive clockwise from above,
    ``(n - 1,)`` (Borio, Eq 4).

    The heading's difference is wrapped to (-pi, pi]. Below ``slowest_mps`` a velocity has no
    heading to speak of: the rate is 0 where either end is slower.
    """
    turn = np.diff(np.arctan2(velocity.ned_mps[1], velocity.ned_mps[0]))
    turn = np.pi - np.mod(np.pi - turn, 2 * np.pi)
    speed = velocity.speed_mps
    slow = np.minimum(speed[1:], speed[:-1]) < slowest_mps
    return np.where(slow, 0.0, turn / (np.diff(velocity.time_ns) / 1e9))


def series(
    name: SeriesName, means: ImuMeans, gravity: Floats, velocity: ReceiverVelocity
) -> tuple[Floats, Floats]:
    """Return the IMU's and the receiver's series, ``(n,)`` each, m/s^2 or rad/s.

    Args:
        name: which of Borio's Eq (9): ``M`` of norms, ``H`` of the horizontal plane; ``acc`` of
            accelerations, ``ag`` of angular rates.
        means: of the IMU per pair, ``(n, 3)``.
        gravity: what the accelerometer would feel at rest, ``(3, n)``; it points up.
        velocity: of n + 1 epochs.
    """
    force, rate = means.force_mps2.T, means.rate_radps.T
    match name:
        case "M_acc":
            return norm(force - gravity), norm(acceleration(velocity))
        case "M_ag":
            return norm(rate), np.abs(heading_rate(velocity))
        case "H_acc":
            up = _unit(gravity)
            return norm(force - (force * up).sum(axis=0) * up), norm(acceleration(velocity)[:2])
        case "H_ag":
            # About up, a turn to the right is negative; however the sensor's own axes are named.
            return -(rate * _unit(gravity)).sum(axis=0), heading_rate(velocity)


def norm(vectors: Floats) -> Floats:
    """Return the Euclidean norm over the first axis, ``(k, n)`` to ``(n,)``."""
    return np.asarray(np.sqrt((vectors * vectors).sum(axis=0)))


def _unit(vectors: Floats) -> Floats:
    length = norm(vectors)
    return np.asarray(
        np.divide(vectors, length, out=np.full_like(vectors, np.nan), where=length > 0)
    )
