"""The nominal trajectory of a motion that is known, and where a run can be aligned."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose
from spoofbench_innovation.measurements import measurements
from spoofbench_innovation.trajectory import nominal_trajectory, rotation, starts

from spoofbench.arrays import Floats
from spoofbench.navigation.preintegration import rotations
from spoofbench.testing import drive

FLOOR = (1.5, 3.0, 0.05, 0.1)
OFFSET = 0.005


@pytest.mark.parametrize("gnss_hz", [1.0, 10.0])
def test_the_nominal_attitude_is_level_and_feels_the_motion(gnss_hz: float) -> None:
    """In the wander frame gravity is down within a few degrees, whatever the vehicle does;
    durations add up.
    """
    recording = drive(2, 240.0, gnss_hz, flaws=False)
    epochs = recording.primary("gnss/pvt").time_ns
    found = nominal_trajectory(recording.primary("imu"), epochs, 0, 60.0, OFFSET)
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
    found = nominal_trajectory(table, epochs, 0, 60.0, OFFSET)
    assert found.duration_s.max() <= 1.5
    np.testing.assert_allclose(
        np.cumsum(found.duration_s)[found.epoch[1:]], (epochs[1:] - epochs[0]) * 1e-9
    )
    parted = nominal_trajectory(table, epochs, 0, 5.0, OFFSET)
    assert (parted.run == -1).all()
    hole = table.take((table.time_ns < epochs[5]) | (table.time_ns > epochs[5] + 4_000_000_000))
    assert np.unique(nominal_trajectory(hole, epochs, 0, 60.0, OFFSET).run).size == 3
    short = table.take((table.time_ns < epochs[5]) | (table.time_ns > epochs[5] + 2_000_000_000))
    bridged = nominal_trajectory(short, epochs, 0, 60.0, OFFSET)
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
        nominal_trajectory(each, epochs, 0, 60.0, 0.06).attitude[30:, 2]
        for each in (table, table.replace(**offset))
    )
    assert np.degrees(np.linalg.norm(up - other, axis=1)).max() < 10
    untold = nominal_trajectory(table.replace(**offset), epochs, 0, 60.0, 1e-6).attitude[30:, 2]
    assert np.degrees(np.linalg.norm(up - untold, axis=1)).max() > 20


@given(st.integers(0, 2**32 - 1), st.sampled_from([1.0, 5.0]))
def test_alignment_finds_the_heading_whatever_the_mounting(seed: int, gnss_hz: float) -> None:
    """Turning the GNSS track by an angle turns the azimuth by it, and mounting the IMU otherwise
    changes nothing of GNSS.
    """
    rng = np.random.default_rng(seed % 3)
    recording = drive(seed % 3, 60.0, gnss_hz, flaws=False)
    table = recording.primary("gnss/pvt")
    angle = rng.uniform(-np.pi, np.pi)
    turned = np.exp(1j * angle) * (table["vel_n_mps"] + 1j * table["vel_e_mps"])
    trajectory = nominal_trajectory(recording.primary("imu"), table.time_ns, 0, 60.0, OFFSET)
    (start,) = starts(measurements(table, FLOOR, False), trajectory)
    (other,) = starts(
        measurements(table.replace(vel_n_mps=turned.real, vel_e_mps=turned.imag), FLOOR, False),
        trajectory,
    )
    assert other.epoch == start.epoch
    assert np.angle(np.exp(1j * (other.azimuth_rad - start.azimuth_rad - angle))) == pytest.approx(
        0, abs=1e-6
    )


def test_alignment_is_within_its_claimed_precision() -> None:
    """The forward axis turned by the azimuth points along the track; 1 sigma of 5 deg is
    claimed.
    """
    errors = []
    for seed in range(8):
        recording = drive(seed, 120.0, flaws=False)
        table = recording.primary("gnss/pvt")
        found = measurements(table, FLOOR, False)
        trajectory = nominal_trajectory(recording.primary("imu"), table.time_ns, 0, 60.0, OFFSET)
        (start,) = starts(found, trajectory)
        forward = trajectory.attitude[trajectory.epoch[start.epoch], :, 0]
        heading = start.azimuth_rad + np.arctan2(forward[1], forward[0])
        north, east = found.values[start.epoch - 1 : start.epoch + 1, 3:5].mean(axis=0)
        errors.append(np.angle(np.exp(1j * (heading - np.arctan2(east, north)))))
    assert np.degrees(np.sqrt(np.mean(np.square(errors)))) < 5


def test_no_alignment_without_motion_or_with_another_motion() -> None:
    parked, other = drive(0, 60.0, flaws=False), drive(1, 60.0, flaws=False)
    table, imu = parked.primary("gnss/pvt"), parked.primary("imu")
    still = table.until(int(table.time_ns[8]))
    assert not list(
        starts(
            measurements(still, FLOOR, False),
            nominal_trajectory(imu, still.time_ns, 0, 60.0, OFFSET),
        )
    )
    foreign = nominal_trajectory(other.primary("imu"), table.time_ns, 0, 60.0, OFFSET)
    assert not list(starts(measurements(table, FLOOR, False), foreign))


@given(
    angle_rad=arrays(float, 3, elements=st.floats(-3, 3) | st.just(0.0) | st.floats(-1e-9, 1e-9))
)
def test_the_rotation_of_one_step_is_that_of_many(angle_rad: Floats) -> None:
    assert_allclose(rotation(*angle_rad.tolist()), rotations(angle_rad), rtol=0, atol=1e-14)
