"""Gravity in the sensor frame, from the past alone: what an accelerometer would feel at rest (it
points up), m/s^2.

All take the specific force per epoch, ``(3, n)`` with NaN where unknown, and give gravity of that
shape.
"""

import math

import numpy as np

from spoofbench.arrays import Bools, Floats, forward_fill

BLOCK = 30.0  # time constants that are filtered at once: e^30 leaves room in a double
DESCENT_STEPS = 5  # per epoch, from the last epoch's estimate
PENALTY = 1.0  # lambda of Eq (14), in units of g^2
CURVATURE = (
    2 + 8 * PENALTY
)  # the cost's steepest, in units of g^2: along gravity, on the unit sphere


def low_pass(values: Floats, dt_s: Floats, time_constant_s: float) -> Floats:
    """Return the first-order low-pass of each row, ``(k, n)``; it starts at the first value and
    holds over NaN.

    Args:
        values: ``(k, n)``.
        dt_s: the time since the column before, ``(n,)``.
        time_constant_s: of the filter.
    """
    known = np.asarray(~np.isnan(values).any(axis=0))
    filtered = np.full_like(values, np.nan)
    filtered[:, known] = _filtered(values[:, known], dt_s[known] / time_constant_s)
    return forward_fill(filtered, known, np.nan)


def _filtered(values: Floats, steps: Floats) -> Floats:
    """Return y of the recursion y += (1 - exp(-step)) (x - y), ``(k, n)``, in closed form.

    Block by block, lest the exponentials overflow.
    """
    steps = np.minimum(steps, BLOCK)
    time = np.cumsum(steps)
    ends = np.append(np.flatnonzero(np.diff(time // BLOCK)) + 1, time.size)
    out = np.empty_like(values)
    latest, start = values[:, :1], 0
    for end in ends.tolist():
        rows = slice(start, end)
        growth = np.exp(time[rows] - time[start : start + 1])
        driven = np.cumsum(-np.expm1(-steps[rows]) * growth * values[:, rows], axis=1)
        out[:, rows] = (latest * np.exp(-steps[start : start + 1]) + driven) / growth
        latest, start = out[:, end - 1 : end], end
    return out


def constant(force: Floats, dt_s: Floats) -> Floats:
    """Return the mean of all specific force so far, ``(3, n)``.

    The accelerations of a drive cancel, gravity stays.

    Args:
        force: m/s^2, ``(3, n)``.
        dt_s: the time since the column before, ``(n,)``.
    """
    known = ~np.isnan(force).any(axis=0)
    seconds = np.cumsum(np.where(known, dt_s, 0.0))
    total = np.cumsum(np.where(known, force * dt_s, 0.0), axis=1)
    mean: Floats = np.divide(total, seconds, out=np.full_like(force, np.nan), where=seconds > 0)
    return mean


def static_norm(force: Floats, still: Bools) -> Floats:
    """Return the mean norm of the specific force over all epochs at rest so far, m/s^2, ``(n,)``;
    NaN before the first.

    Args:
        force: m/s^2, ``(3, n)``.
        still: which epochs are at rest, ``(n,)``.
    """
    norm = np.where(still, np.linalg.norm(force, axis=0), np.nan)
    count = np.cumsum(~np.isnan(norm))
    mean: Floats = np.divide(
        np.cumsum(np.nan_to_num(norm)), count, out=np.full_like(norm, np.nan), where=count > 0
    )
    return mean


def descent(
    force: Floats, rate: Floats, dt_s: Floats, g: Floats, w: float, time_constant_s: float
) -> Floats:
    """Return gravity by gradient descent on Borio's cost, ``(3, n)``: Eq (13) with the penalty of
    Eq (14).

    The paper's cost of one sample is averaged over ``time_constant_s`` (one sample is met by a
    whole cone of directions), and the descent goes on from the last epoch's direction.

    Args:
        force: specific force, m/s^2, ``(3, n)``.
        rate: angular rate, rad/s, ``(3, n)``.
        dt_s: the time since the column before, ``(n,)``.
        g: the sensor's own static norm, m/s^2, ``(n,)``; NaN: not known yet, so no estimate.
        w: weight of the rotation, (m/s^2)^2/(rad/s)^2.
        time_constant_s: of the average of the cost.
    """
    pairs = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
    squares = [force[i] * force[j] - w * rate[i] * rate[j] for i, j in pairs]
    averages = low_pass(np.stack([*squares, *force]), dt_s, time_constant_s)
    gravity = np.full_like(force, np.nan)
    ready = np.flatnonzero((np.linalg.norm(averages[6:], axis=0) > 0) & (g > 0))
    if not ready.size:
        return gravity
    unit = averages[6:, ready[0]] / np.linalg.norm(averages[6:, ready[0]])
    u: tuple[float, float, float] = tuple(unit.tolist())
    estimates = []
    for cost, norm in zip(averages[:, ready].T.tolist(), g[ready].tolist(), strict=True):
        u = _descend(u, cost, norm)
        estimates.append(u)
    gravity[:, ready] = g[ready] * np.array(estimates).T
    return gravity


def _descend(
    u: tuple[float, float, float], cost: list[float], g: float
) -> tuple[float, float, float]:
    """Return a unit vector after some steps down the cost, from another.

    J(u) = u'Mu - 2 g a'u + g^2 + lambda (|u|^2 - 1)^2; ``cost`` holds M's upper triangle, then a.
    """
    xx, xy, xz, yy, yz, zz, ax, ay, az = cost
    x, y, z = u
    step = 2 / (CURVATURE * g * g)
    for _ in range(DESCENT_STEPS):
        pull = 2 * PENALTY * g * g * (x * x + y * y + z * z - 1)
        x, y, z = (
            x - step * (xx * x + xy * y + xz * z - g * ax + pull * x),
            y - step * (xy * x + yy * y + yz * z - g * ay + pull * y),
            z - step * (xz * x + yz * y + zz * z - g * az + pull * z),
        )
    norm = math.sqrt(x * x + y * y + z * z)
    return x / norm, y / norm, z / norm
