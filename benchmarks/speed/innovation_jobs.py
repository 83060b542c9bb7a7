"""A Kalman monitor on many variants of one recording, against a filterpy ``KalmanFilter`` per
variant.

Both get the same matrices and measurements and return all innovations; the check holds them to
1e-9. Ours includes the covariance recursion and the blocks, once for all variants. The peer does a
few variants, and its time is scaled: each costs the same. ``innovation-variant`` is one more
variant of a recording whose gains are known.
"""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from spoofbench_innovation import error_model, filtering, gains
from spoofbench_innovation.error_model import GRADES

from benchmarks.speed.frame import Job
from spoofbench.arrays import Floats
from spoofbench.navigation.preintegration import rotations

EPOCHS, VARIANTS, PEER_VARIANTS = 2602, 100, 2


class Material:
    """The matrices of a made-up drive at 1 Hz, and what GNSS measures in each variant."""

    def __init__(self, rng: np.random.Generator) -> None:
        heading = np.cumsum(rng.normal(0, 0.05, EPOCHS))
        attitude = rotations(np.column_stack([np.zeros((EPOCHS, 2)), heading]))
        matrices = error_model.dynamics(
            attitude, rng.normal(0, 1, (EPOCHS, 3)) - [0, 0, 9.8], 3600.0
        )
        density = error_model.driving(GRADES["automotive"])
        self.transition, self.process = error_model.discretised(matrices, density, np.ones(EPOCHS))
        self.noise = np.tile([2.25, 2.25, 9.0, 0.0025, 0.0025, 0.01], (EPOCHS, 1))
        self.initial = np.diag(np.repeat([2.25, 0.01, 0.005, 0.0025, 3e-6], 3))
        self.values = np.sqrt(self.noise)[:, :, None] * rng.normal(0, 1, (EPOCHS, 6, VARIANTS))

    def prepared(self) -> filtering.FilterRun:
        """What the variants share."""
        found = gains.recursion(self.initial, self.transition, self.process, self.noise)
        still = np.zeros((EPOCHS, error_model.STATES, 5))
        return filtering.FilterRun(
            gains.block_matrices(self.transition, found.gain),
            gains.block_motion(self.transition, still),
            found.innovation,
        )

    def ours(self, shared: filtering.FilterRun | None, variants: int) -> Floats:
        """The innovations of so many variants, ``(n, 6, v)``."""
        state = np.zeros((error_model.STATES, variants))
        return filtering.run_filter(
            shared or self.prepared(), self.values[:, :, :variants], state, 0.0, (0.0, 0.0, 0.0)
        )

    def filterpy(self, variants: int) -> Floats:
        """The same by one filter per variant, the azimuth moved at the same epochs."""
        from filterpy.kalman import KalmanFilter

        result, observation = np.empty((EPOCHS, 6, variants)), np.eye(6, error_model.STATES)
        noise = [np.diag(row) for row in self.noise]
        for variant in range(variants):
            kalman = KalmanFilter(dim_x=error_model.STATES, dim_z=6)
            kalman.x, kalman.P, kalman.H = np.zeros(error_model.STATES), self.initial, observation
            azimuth = 0.0
            for k in range(EPOCHS):
                if k % gains.BLOCK == 0:
                    azimuth += kalman.x[error_model.AZIMUTH]
                    kalman.x[:9] = _turned(kalman.x[:9], kalman.x[error_model.AZIMUTH])
                    kalman.x[error_model.AZIMUTH] = 0.0
                kalman.predict(F=self.transition[k], Q=self.process[k])
                kalman.update(_turned(self.values[k, :, variant], azimuth), R=noise[k])
                result[k, :, variant] = kalman.y
        return result


def _turned(vectors: Floats, angle_rad: float) -> Floats:
    """Three-vectors in a frame turned about its third axis."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    turned: Floats = (
        vectors.reshape(-1, 3) @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]).T
    ).ravel()
    return turned


def jobs(folder: Path) -> Iterator[Job]:  # noqa: ARG001, needs no file
    """Yield the innovation monitor's jobs."""
    material = Material(np.random.default_rng(0))
    shared = material.prepared()
    peers: dict[str, Callable[[], Any]] = {"filterpy": partial(material.filterpy, PEER_VARIANTS)}
    yield Job(
        "innovation-variants",
        (
            f"{EPOCHS} epochs, 15 states, {VARIANTS} variants with gains; filterpy {PEER_VARIANTS} "
            "of them"
        ),
        partial(material.ours, None, VARIANTS),
        peers,
        check=_same,
        parts={"filterpy": PEER_VARIANTS / VARIANTS},
    )
    one: dict[str, Callable[[], Any]] = {"filterpy": partial(material.filterpy, 1)}
    yield Job(
        "innovation-variant",
        f"{EPOCHS} epochs, 15 states, one variant, gains known",
        partial(material.ours, shared, 1),
        one,
        check=_same,
    )


def _same(ours: Floats, theirs: Floats) -> None:
    """The innovations agree to 1e-9 of the largest."""
    np.testing.assert_allclose(
        ours[:, :, : theirs.shape[2]], theirs, rtol=0, atol=1e-9 * float(np.abs(theirs).max())
    )
