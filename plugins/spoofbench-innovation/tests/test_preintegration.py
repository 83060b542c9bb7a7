"""Increments and the nominal trajectory against literal loops and a motion that is known."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from spoofbench_innovation.nominal import nominal
from spoofbench_innovation.preintegration import (
    LONGEST_SILENCE_S,
    SILENCE_S,
    increments,
    rotation_vectors,
    rotations,
)

from spoofbench.table import Table
from spoofbench.testing import drive

Array = np.ndarray[Any, Any]
OFFSET = 0.005
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


@pytest.mark.parametrize("gnss_hz", [1.0, 10.0])
def test_the_nominal_attitude_is_level_and_feels_the_motion(gnss_hz: float) -> None:
    """In the wander frame gravity is down within a few degrees, whatever the vehicle does;
    durations add up.
    """
    recording = drive(2, 240.0, gnss_hz, flaws=False)
    epochs = recording.primary("gnss/pvt").time_ns
    found = nominal(recording.primary("imu"), epochs, 0, 60.0, OFFSET)
    assert found.duration_s.sum() == pytest.approx((epochs[-1] - epochs[0]) * 1e-9)
    assert (found.run == found.run[-1]).all()
    settled = found.velocity_mps[30:] / found.duration_s[30:, None]
    assert np.abs(settled[:, 2] + 9.8).max() < 1.0
    up = found.attitude[30:, 2]
    assert np.degrees(np.arccos(up[:, 2] / np.linalg.norm(up, axis=1))).max() < 10


def test_long_intervals_are_cut_and_gaps_part_runs() -> None:
    recording = drive(2, 120.0, flaws=False)
    table = recording.primary("imu")
    epochs = recording.primary("gnss/pvt").time_ns[::7]
    found = nominal(table, epochs, 0, 60.0, OFFSET)
    assert found.duration_s.max() <= 1.5
    np.testing.assert_allclose(
        np.cumsum(found.duration_s)[found.epoch[1:]], (epochs[1:] - epochs[0]) * 1e-9
    )
    parted = nominal(table, epochs, 0, 5.0, OFFSET)
    assert (parted.run == -1).all()
    hole = table.take((table.time_ns < epochs[5]) | (table.time_ns > epochs[5] + 4_000_000_000))
    assert np.unique(nominal(hole, epochs, 0, 60.0, OFFSET).run).size == 3
    short = table.take((table.time_ns < epochs[5]) | (table.time_ns > epochs[5] + 2_000_000_000))
    bridged = nominal(short, epochs, 0, 60.0, OFFSET)
    assert np.unique(bridged.run).size == 1
    assert bridged.silent_s.sum() == pytest.approx(2.0, abs=0.02)


def test_an_offset_of_the_gyros_does_not_tilt_the_nominal_attitude() -> None:
    """One degree per second would tilt it by half a right angle within a minute; the azimuth is
    free and may drift.
    """
    recording = drive(3, 240.0, flaws=False)
    table, epochs = recording.primary("imu"), recording.primary("gnss/pvt").time_ns
    offset = {f"gyro_{axis}_radps": table[f"gyro_{axis}_radps"] + np.radians(1.0) for axis in "xyz"}
    up, other = (
        nominal(each, epochs, 0, 60.0, 0.06).attitude[30:, 2]
        for each in (table, table.replace(**offset))
    )
    assert np.degrees(np.linalg.norm(up - other, axis=1)).max() < 10
    untold = nominal(table.replace(**offset), epochs, 0, 60.0, 1e-6).attitude[30:, 2]
    assert np.degrees(np.linalg.norm(up - untold, axis=1)).max() > 20
