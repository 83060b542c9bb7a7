"""Increments of an IMU against a loop over its rows and SciPy's rotations."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from spoofbench.navigation.preintegration import (
    LONGEST_SILENCE_S,
    SILENCE_S,
    increments,
    rotation_vectors,
    rotations,
)
from spoofbench.table import Table

Array = np.ndarray[Any, Any]
NAMES = [
    f"{sensor}_{axis}_{unit}"
    for sensor, unit in (("accel", "mps2"), ("gyro", "radps"))
    for axis in "xyz"
]


def imu(time_s: Array, values: Array) -> Table:
    return Table(
        "imu", np.round(time_s * 1e9).astype(np.int64), dict(zip(NAMES, values.T, strict=True))
    )


@given(st.integers(0, 2**32 - 1), st.sampled_from([8.0, 50.0]))
@settings(max_examples=25)
def test_increments_against_a_loop(seed: int, rate_hz: float) -> None:
    rng = np.random.default_rng(seed)
    time_s = np.round(np.cumsum(rng.uniform(0.8, 1.2, 200) / rate_hz), 9)
    time_s[100:] += rng.choice([0.0, 0.5, 4.0])
    values = np.column_stack(
        [rng.normal(0, 3, (200, 3)) - [0, 0, 9.8], rng.normal(0, 0.7, (200, 3))]
    )
    values[rng.random(200) < 0.03, rng.integers(6)] = np.nan
    edges = np.arange(0, time_s[-1] + 1, 0.7)
    edges_ns = np.round(edges * 1e9).astype(np.int64)
    found = increments(imu(time_s, values), edges_ns[:-1], edges_ns[1:], 2.0)
    good = ~np.isnan(values).any(axis=1)
    t, x = time_s[good], values[good]
    for n, (a, b) in enumerate(pairwise(edges)):
        inside = np.flatnonzero((t > a) & (t <= b))
        before = np.flatnonzero(t <= a)
        last = np.flatnonzero(t <= b)
        stamps = t[before[-1] : last[-1] + 1] if before.size else t[:0]
        lost = (
            not before.size
            or max([a - t[before[-1]], b - t[last[-1]], *np.diff(stamps)]) > LONGEST_SILENCE_S
        )
        assert found.known[n] == (not lost)
        if lost:
            continue
        turn, velocity, position, since, silent = (
            Rotation.identity(),
            np.zeros(3),
            np.zeros(3),
            a,
            0.0,
        )
        for row, until in [*((int(i), t[i]) for i in inside), (int(last[-1]), b)]:
            dt = until - since
            force = (turn * Rotation.from_rotvec(x[row, 3:] * dt / 2)).apply(x[row, :3])
            position, velocity = position + velocity * dt + force * dt**2 / 2, velocity + force * dt
            turn = turn * Rotation.from_rotvec(x[row, 3:] * dt)
            gap = until - t[row - 1] if until == t[row] and row in inside else until - t[row]
            silent += dt if gap > SILENCE_S else 0.0
            since = until
        np.testing.assert_allclose(found.rotation[n], turn.as_matrix(), atol=1e-9)
        np.testing.assert_allclose(found.velocity_mps[n], velocity, atol=1e-7)
        np.testing.assert_allclose(found.position_m[n], position, atol=1e-7)
        assert found.silent_s[n] == pytest.approx(silent, abs=1e-6)


@given(st.integers(0, 2**32 - 1))
def test_rotations_are_scipys(seed: int) -> None:
    angles = np.random.default_rng(seed).normal(0, 1, (20, 3)) * np.logspace(-9, 0.5, 20)[:, None]
    angles[np.linalg.norm(angles, axis=1) > 3] /= 10
    np.testing.assert_allclose(
        rotations(angles), Rotation.from_rotvec(angles).as_matrix(), atol=1e-12
    )
    np.testing.assert_allclose(rotation_vectors(rotations(angles)), angles, atol=1e-6)
