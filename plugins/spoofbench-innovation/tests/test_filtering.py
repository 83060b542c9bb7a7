"""The filter against filterpy."""

from typing import Any

import numpy as np
import pytest
from filterpy.common import van_loan_discretization
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from spoofbench_innovation import InnovationMonitor, error_model, filtering, gains
from spoofbench_innovation.error_model import GRADES, Grade
from spoofbench_innovation.trajectory import nominal_trajectory, starts

from spoofbench.navigation.preintegration import rotations
from spoofbench.testing import drive

Array = np.ndarray[Any, Any]
TOLERANCE = 1e-9
OFFSET = 5 * GRADES["automotive"].gyro_bias_radps


def close(ours: Array, theirs: Array) -> bool:
    """Whether they are equal to 1e-9 of the largest value."""
    return np.allclose(
        ours,
        theirs,
        rtol=0,
        atol=TOLERANCE * max(1.0, float(np.nanmax(np.abs(theirs)))),
        equal_nan=True,
    )


@given(st.integers(0, 2**32 - 1), st.floats(0.01, 1.5), st.sampled_from(sorted(GRADES)))
@settings(max_examples=30)
def test_discretisation_against_van_loan(seed: int, duration_s: float, grade: Any) -> None:
    rng = np.random.default_rng(seed)
    matrices = error_model.dynamics(
        rotations(rng.normal(0, 1, (3, 3))), rng.normal(0, 5, (3, 3)) - [0, 0, 9.8], 3600.0
    )
    density = error_model.driving(GRADES[grade])
    transition, process = error_model.discretised(matrices, density, np.full(3, duration_s))
    for k in range(3):
        phi, noise = van_loan_discretization(matrices[k], np.sqrt(density), duration_s)
        np.testing.assert_allclose(transition[k], phi, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(process[k], noise, rtol=1e-6, atol=1e-12 * noise.max())


def random_model(rng: np.random.Generator, steps: int) -> tuple[Array, Array, Array]:
    attitude = rotations(rng.normal(0, 1, (steps, 3)))
    matrices = error_model.dynamics(attitude, rng.normal(0, 2, (steps, 3)) - [0, 0, 9.8], 3600.0)
    transition, process = error_model.discretised(
        matrices, error_model.driving(GRADES["automotive"]), rng.uniform(0.1, 1.5, steps)
    )
    noise = rng.uniform(0.01, 4, (steps, 6))
    noise[rng.random((steps, 6)) < 0.2] = np.nan
    return transition, process, noise


@given(st.integers(0, 2**32 - 1), st.integers(1, 40))
@settings(max_examples=30)
def test_blocks_against_filterpy(seed: int, steps: int) -> None:
    """States, innovations and their covariances of the blockwise filter are those of the ordinary
    one, steps without rows included.
    """
    rng = np.random.default_rng(seed)
    transition, process, noise = random_model(rng, steps)
    initial = np.diag(rng.uniform(0.1, 2, 15))
    found = gains.recursion(initial, transition, process, noise)
    matrices = gains.block_matrices(transition, found.gain)
    values = np.where(np.isnan(noise), 0.0, rng.normal(0, 3, (steps, 6)))
    padded = np.zeros((len(matrices) * gains.BLOCK, 6))
    padded[:steps] = values

    kalman = KalmanFilter(dim_x=15, dim_z=6)
    kalman.x, kalman.P = rng.normal(0, 1, 15), initial
    state = kalman.x
    for block, matrix in enumerate(matrices):
        rows = slice(block * gains.BLOCK, (block + 1) * gains.BLOCK)
        result = matrix @ np.concatenate([state, padded[rows].ravel()])
        state = result[-15:]
        for k in range(rows.start, min(rows.stop, steps)):
            measured = np.flatnonzero(~np.isnan(noise[k]))
            kalman.predict(F=transition[k], Q=process[k])
            if measured.size:
                kalman.dim_z = measured.size
                kalman.update(
                    values[k, measured], R=np.diag(noise[k, measured]), H=np.eye(15)[measured]
                )
                assert close(result[:-15].reshape(-1, 6)[k - rows.start, measured], kalman.y)
                assert close(found.innovation[k][np.ix_(measured, measured)], kalman.S)
        assert close(state, kalman.x)


def test_a_recording_against_filterpy() -> None:
    """All of a drive, with the azimuth moved at the start of each block, as one variant and as one
    of several.
    """
    monitor = InnovationMonitor(lag_s=0.1)
    recording = drive(3, 240.0)
    measured, found = monitor.filtered(recording)
    configuration = filtering.FilterSettings(monitor.imu_errors, 100_000_000, monitor.restart_s)
    trajectory = nominal_trajectory(
        recording.primary("imu"),
        measured.time_ns,
        configuration.lag_ns,
        configuration.restart_s,
        OFFSET,
    )
    (start,) = starts(measured, trajectory)
    expected, covariance = _by_filterpy(measured, trajectory, start, configuration.grade)
    assert len(expected) > 150
    for epoch, innovation in expected.items():
        rows = ~np.isnan(found.value[epoch])
        assert close(found.value[epoch, rows], innovation)
        assert close(found.covariance[epoch][np.ix_(rows, rows)], covariance[epoch])
    assert (found.run >= 0).sum() == np.count_nonzero(
        measured.time_ns > measured.time_ns[start.epoch]
    )


def _by_filterpy(
    measured: Any, trajectory: Any, start: Any, grade: Grade
) -> tuple[dict[int, Array], dict[int, Array]]:
    transition, process = error_model.model(trajectory, grade)
    motion = error_model.free_motion(trajectory, transition)
    noise = np.where(np.isnan(measured.values), np.nan, measured.variances)
    kalman = KalmanFilter(dim_x=15, dim_z=6)
    kalman.x, (gravity, earth, down) = filtering._start(measured, start)
    kalman.P = np.diag(filtering._initial_variances(noise[start.epoch], grade))
    azimuth, first = start.azimuth_rad, int(trajectory.epoch[start.epoch]) + 1
    epoch_of = {int(step): epoch for epoch, step in enumerate(trajectory.epoch)}
    innovations, covariances = {}, {}
    for step in range(first, start.end):
        if (step - first) % gains.BLOCK == 0:
            turn, azimuth = kalman.x[8], azimuth + kalman.x[8]
            wander = np.array(
                [[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
            )
            kalman.x[8] = 0
            kalman.x[:9] = (kalman.x[:9].reshape(3, 3) @ wander.T).ravel()
        to_wander = np.array(
            [
                [np.cos(azimuth), np.sin(azimuth), 0],
                [-np.sin(azimuth), np.cos(azimuth), 0],
                [0, 0, 1],
            ]
        )
        kalman.predict(F=transition[step], Q=process[step])
        kalman.x = kalman.x + motion[step] @ np.concatenate(
            [[1, gravity], to_wander @ [earth, 0, down]]
        )
        epoch = epoch_of.get(step)
        if epoch is not None and (rows := np.flatnonzero(~np.isnan(noise[epoch]))).size:
            values = (measured.values[epoch].reshape(2, 3) @ to_wander.T).ravel()
            kalman.dim_z = rows.size
            kalman.update(values[rows], R=np.diag(noise[epoch, rows]), H=np.eye(15)[rows])
            innovations[epoch], covariances[epoch] = kalman.y, kalman.S
    return innovations, covariances


def test_the_squared_innovations_of_the_model_itself_are_chi_square() -> None:
    """Truth drawn from the filter's own model: each epoch's sum has its distribution, and epochs
    are independent.
    """
    rng = np.random.default_rng(5)
    steps, variants = 64, 400
    transition, process, noise = random_model(rng, steps)
    noise = np.nan_to_num(noise, nan=1.0)
    initial = np.diag(rng.uniform(0.1, 2, 15))
    found = gains.recursion(initial, transition, process, noise)
    matrices = gains.block_matrices(transition, found.gain)
    truth = rng.multivariate_normal(np.zeros(15), initial, variants).T
    values = np.empty((steps, 6, variants))
    for k in range(steps):
        truth = (
            transition[k] @ truth
            + rng.multivariate_normal(np.zeros(15), process[k], variants, tol=1e-6).T
        )
        values[k] = truth[:6] + np.sqrt(noise[k])[:, None] * rng.normal(0, 1, (6, variants))
    state, squared = np.zeros((15, variants)), []
    for matrix, block in zip(matrices, values.reshape(-1, gains.BLOCK * 6, variants), strict=True):
        result = matrix @ np.concatenate([state, block])
        state = result[-15:]
        squared.append(result[:-15].reshape(gains.BLOCK, 6, variants))
    innovation = np.concatenate(squared)
    nis = np.vecdot(innovation, np.linalg.solve(found.innovation, innovation), axis=1)
    assert stats.kstest(nis.ravel(), stats.chi2(6).cdf).pvalue > 0.001
    assert stats.kstest(nis.sum(axis=0), stats.chi2(6 * steps).cdf).pvalue > 0.001
    assert abs(np.corrcoef(nis[:-1].ravel(), nis[1:].ravel())[0, 1]) < 4 / np.sqrt(steps * variants)


def test_no_covariance_depends_on_the_azimuth() -> None:
    """A wander frame turned about the vertical gives the same normalised innovations: gains need no
    heading.
    """
    rng = np.random.default_rng(2)
    attitude, force = rotations(rng.normal(0, 1, (30, 3))), rng.normal(0, 2, (30, 3)) - [0, 0, 9.8]
    noise = np.tile([2.0, 2.0, 5.0, 0.01, 0.01, 0.02], (30, 1))
    turn = rotations(np.array([0, 0, 1.1]))
    found = []
    for frame in (np.eye(3), turn):
        matrices = error_model.dynamics(frame @ attitude, force @ frame.T, 3600.0)
        transition, process = error_model.discretised(
            matrices, error_model.driving(GRADES["tactical"]), np.ones(30)
        )
        initial = np.diag(np.repeat([4.0, 1.0, 0.01, 0.01, 1e-4], 3))
        found.append(gains.recursion(initial, transition, process, noise).innovation)
    whole = np.kron(np.eye(2), turn)
    np.testing.assert_allclose(whole @ found[0] @ whole.T, found[1], atol=1e-10)


@pytest.mark.parametrize("variants", [1, 3])
def test_variants_together_are_variants_alone(variants: int) -> None:
    rng = np.random.default_rng(variants)
    transition, process, noise = random_model(rng, 50)
    noise = np.where(rng.random((50, 1)) < 0.2, np.nan, np.nan_to_num(noise, nan=1.0))
    found = gains.recursion(np.eye(15), transition, process, noise)
    motion = gains.block_motion(transition, rng.normal(0, 0.01, (50, 15, 5)))
    shared = filtering.FilterRun(
        gains.block_matrices(transition, found.gain), motion, found.innovation
    )
    values = np.where(np.isnan(noise)[:, :, None], np.nan, rng.normal(0, 3, (50, 6, variants)))
    state = rng.normal(0, 0.1, (15, variants))
    constants = (9.8, 5e-5, -5e-5)
    together = filtering.run_filter(shared, values, state, 0.3, constants)
    for n in range(variants):
        alone = filtering.run_filter(
            shared, values[:, :, n : n + 1], state[:, n : n + 1], 0.3, constants
        )
        assert close(together[:, :, n], alone[:, :, 0])


@given(st.lists(st.integers(0, 9), max_size=40), st.integers(0, 30))
def test_results_are_right_and_bounded(keys: list[int], limit: int) -> None:
    made: list[int] = []

    def make(key: int) -> bytes:
        made.append(key)
        return bytes(key)

    cache = filtering.ResultCache(limit, len)
    for index, key in enumerate(keys):
        before = len(made)
        assert cache.get(key, lambda key=key: make(key)) == bytes(key)
        assert sum(map(len, cache._kept.values())) <= max(limit, key)
        if index and keys[index - 1] == key:
            assert len(made) == before


def test_equal_tables_are_different_keys() -> None:
    """Comparing them would cost more than it saves."""
    one, other = (drive(0, 60.0).primary("imu") for _ in range(2))
    assert filtering.SameTable(one) == filtering.SameTable(one)
    assert hash(filtering.SameTable(one)) == hash(filtering.SameTable(one))
    assert filtering.SameTable(one) != filtering.SameTable(other)
