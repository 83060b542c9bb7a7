"""The two series that each statistic of Borio's Eq (9) correlates, per pair of epochs: the IMU's
and the receiver's.
"""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from spoofbench_correlation.gnss import Velocity, acceleration, heading_rate
from spoofbench_correlation.imu import Motion

Floats = NDArray[np.float64]
Comparison = Literal["M_acc", "M_ag", "H_acc", "H_ag"]


def series(
    comparison: Comparison, motion: Motion, gravity: Floats, velocity: Velocity
) -> tuple[Floats, Floats]:
    """Return the IMU's and the receiver's series, shapes ``(n,)``.

    Args:
        comparison: which statistic.
        motion: the IMU's means per pair.
        gravity: what the accelerometer would feel at rest, shape ``(3, n)``; it points up.
        velocity: of n + 1 epochs.
    """
    match comparison:
        case "M_acc":
            return norm(motion.force_mps2 - gravity), norm(acceleration(velocity))
        case "M_ag":
            return norm(motion.rate_radps), np.abs(heading_rate(velocity))
        case "H_acc":
            up = _unit(gravity)
            level = motion.force_mps2 - (motion.force_mps2 * up).sum(axis=0) * up
            return norm(level), norm(acceleration(velocity)[:2])
        case "H_ag":
            # About up, a turn to the right is negative; however the sensor's own axes are named.
            return -(motion.rate_radps * _unit(gravity)).sum(axis=0), heading_rate(velocity)


def norm(vectors: Floats) -> Floats:
    """Euclidean norm over the first axis."""
    return np.asarray(np.sqrt((vectors * vectors).sum(axis=0)))


def _unit(vectors: Floats) -> Floats:
    length = norm(vectors)
    return np.asarray(
        np.divide(vectors, length, out=np.full_like(vectors, np.nan), where=length > 0)
    )
