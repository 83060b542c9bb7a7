"""The covariance recursion, and the filter as one matrix per block of steps.

Gains and innovation covariances do not depend on what GNSS measured. With them the filter is
linear, so all innovations of a block, and the state at its end, are one matrix times the state at
its start and the measurements. Whoever runs many variants of a recording computes the matrices
once.
"""

from dataclasses import dataclass

import numpy as np

from spoofbench.arrays import Bools, Floats
from spoofbench_innovation.error_model import MEASURED, STATES

BLOCK = 16


@dataclass(frozen=True, slots=True, eq=False)
class Gains:
    """What the covariance recursion gives over ``n`` steps.

    Attributes:
        gain: L_k, ``(n, 15, 6)``; zero columns where nothing is measured.
        innovation: S_k, ``(n, 6, 6)``; rows and columns of what is not measured are those of the
            identity.
    """

    gain: Floats
    innovation: Floats


def recursion(initial: Floats, transition: Floats, process: Floats, noise: Floats) -> Gains:
    """Return gains and innovation covariances of the Kalman filter over steps.

    P = Phi P Phi' + Q, then S = H P H' + R, K = P H' S^-1 and Joseph's form
    P = (I - K H) P (I - K H)' + K R K', multiplied out for H = [I 0].

    Args:
        initial: P_0 before the first step, ``(15, 15)``.
        transition: ``(n, 15, 15)``.
        process: ``(n, 15, 15)``.
        noise: variances of what is measured of ``r v`` at the end of a step, ``(n, 6)``; NaN where
            it is not.
    """
    from scipy.linalg.lapack import dposv

    measured: Bools = np.isfinite(noise)
    kept: Floats = measured[:, :, None].astype(np.float64)
    variance = np.where(measured, noise, 0.0)
    count: list[int] = np.count_nonzero(measured, axis=1).tolist()
    gain, innovation = (
        np.zeros((len(noise), STATES, MEASURED)),
        np.where(measured, noise, 1.0)[:, None] * np.eye(MEASURED),
    )
    covariance: Floats = initial
    for k, (phi, added) in enumerate(zip(transition, process, strict=True)):
        covariance = phi @ covariance @ phi.T
        covariance += added
        if not count[k]:
            continue
        crossed, spread = covariance[:MEASURED], innovation[k]
        if count[k] < MEASURED:
            crossed = crossed * kept[k]
            spread += crossed[:, :MEASURED] * kept[k].T
        else:
            spread += crossed[:, :MEASURED]
        weights = dposv(spread, crossed)[1].T  # by Cholesky: S is symmetric and positive
        covariance -= weights @ crossed
        covariance += (weights * variance[k] - covariance[:, :MEASURED]) @ weights.T
        if k % BLOCK == 0:
            covariance = (covariance + covariance.T) / 2  # rounding takes long to matter
        gain[k] = weights
    return Gains(gain, innovation)


def block_matrices(transition: Floats, gain: Floats) -> Floats:
    """Return the filter over each block, ``(b, 6 B + 15, 15 + 6 B)`` with B = 16 steps in a block.

    It takes the state at the start and the measurements to the innovations and the state at the
    end; free motion is not in it. The last block is filled up with steps in which nothing happens.

    Args:
        transition: ``(n, 15, 15)``.
        gain: ``(n, 15, 6)``.
    """
    blocks = -(-len(gain) // BLOCK)
    missing = blocks * BLOCK - len(gain)
    phi = np.concatenate([transition, np.tile(np.eye(STATES), (missing, 1, 1))]).reshape(
        blocks, BLOCK, STATES, STATES
    )
    weight = np.concatenate([gain, np.zeros((missing, STATES, MEASURED))]).reshape(
        blocks, BLOCK, STATES, MEASURED
    )
    width = STATES + MEASURED * BLOCK
    result = np.zeros((blocks, MEASURED * BLOCK + STATES, width))
    state = np.tile(np.eye(STATES, width), (blocks, 1, 1))
    for step in range(BLOCK):
        rows, past = slice(MEASURED * step, MEASURED * (step + 1)), STATES + MEASURED * step
        state[:, :, :past] = phi[:, step] @ state[:, :, :past]
        innovations = -state[:, :MEASURED, : past + MEASURED]
        innovations[:, :, past:] = np.eye(MEASURED)
        state[:, :, : past + MEASURED] += weight[:, step] @ innovations
        result[:, rows, : past + MEASURED] = innovations
    result[:, -STATES:] = state
    return result


def block_motion(transition: Floats, motion: Floats) -> Floats:
    """Return the free motion from zero at the start of each block: ``r v`` after each step, all
    states after the last.

    Args:
        transition: ``(n, 15, 15)``.
        motion: per step, ``(n, 15, c)``.

    Returns:
        ``(b, 6 B + 15, c)``.
    """
    blocks = -(-len(motion) // BLOCK)
    missing = blocks * BLOCK - len(motion)
    phi = np.concatenate([transition, np.tile(np.eye(STATES), (missing, 1, 1))]).reshape(
        blocks, BLOCK, STATES, STATES
    )
    moved = np.concatenate([motion, np.zeros((missing, *motion.shape[1:]))]).reshape(
        blocks, BLOCK, *motion.shape[1:]
    )
    result = np.zeros((blocks, MEASURED * BLOCK + STATES, motion.shape[2]))
    state = np.zeros((blocks, STATES, motion.shape[2]))
    for step in range(BLOCK):
        state = phi[:, step] @ state + moved[:, step]
        result[:, MEASURED * step : MEASURED * (step + 1)] = state[:, :MEASURED]
    result[:, -STATES:] = state
    return result
