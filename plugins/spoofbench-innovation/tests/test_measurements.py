"""What is taken from a receiver, and where a run can be aligned."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from spoofbench_innovation import alignment
from spoofbench_innovation.measurements import gravity_mps2, measurements
from spoofbench_innovation.nominal import nominal

from spoofbench.table import Table
from spoofbench.testing import drive

FLOOR = (1.5, 3.0, 0.05, 0.1)
OFFSET = 0.005


def pvt(rows: int = 6, **columns: Any) -> Table:
    time_ns = np.arange(rows, dtype=np.int64) * 1_000_000_000
    given = {
        "lat_deg": np.full(rows, 40.0),
        "lon_deg": np.full(rows, -84.0),
        "height_m": np.full(rows, 200.0),
    }
    given |= {f"vel_{axis}_mps": np.zeros(rows) for axis in "ned"}
    return Table("gnss/pvt", time_ns, {**given, **columns})


def test_position_is_the_integral_of_velocity() -> None:
    """Over 50 km to the north-east, where one local frame would be tens of metres off, and over the
    antimeridian.
    """
    rcurve = pytest.importorskip("pymap3d.rcurve")
    velocity, step_s, rows = np.array([40.0, 30.0, -0.1]), 1.0, 1000
    lat, lon, height = [np.radians(48.0)], [np.radians(179.8)], [100.0]
    for _ in range(rows - 1):
        middle = lat[-1] + velocity[0] * step_s / 2 / (
            rcurve.meridian(lat[-1], deg=False) + height[-1]
        )
        up = height[-1] - velocity[2] * step_s / 2
        lat.append(lat[-1] + velocity[0] * step_s / (rcurve.meridian(middle, deg=False) + up))
        lon.append(
            lon[-1]
            + velocity[1] * step_s / ((rcurve.transverse(middle, deg=False) + up) * np.cos(middle))
        )
        height.append(height[-1] - velocity[2] * step_s)
    lon_deg = (np.degrees(lon) + 180) % 360 - 180
    assert lon_deg.min() < -179
    assert lon_deg.max() > 179
    found = measurements(
        pvt(rows, lat_deg=np.degrees(lat), lon_deg=lon_deg, height_m=np.array(height)), FLOOR, False
    )
    np.testing.assert_allclose(
        found.values[:, :3], np.outer(np.arange(rows) * step_s, velocity), atol=1e-3
    )


def test_a_position_that_goes_and_comes_back_closes() -> None:
    away = pvt(
        lat_deg=np.array([40, 40.0001, 41, 41, 40.0001, 40]),
        lon_deg=np.array([-84, -84, -83, -83, -84.0, -84]),
    )
    found = measurements(away, FLOOR, False).values
    np.testing.assert_allclose(found[[4, 5]], found[[1, 0]], atol=1e-6)


def test_what_is_missing_is_not_measured() -> None:
    lat, height = np.full(6, 40.0), np.full(6, 200.0)
    lat[1], height[2] = np.nan, np.nan
    north = np.zeros(6)
    north[3] = np.nan
    found = measurements(
        pvt(lat_deg=lat, height_m=height, vel_n_mps=north, fix_type=np.array([4, 4, 4, 4, 1, 2])),
        FLOOR,
        False,
    )
    known = ~np.isnan(found.values)
    expected = [
        [1] * 6,
        [0, 0, 1, 1, 1, 1],
        [1, 1, 0, 1, 1, 1],
        [1, 1, 1, 0, 0, 1],
        [0] * 6,
        [0] * 6,
    ]
    np.testing.assert_array_equal(known, np.array(expected, bool))


def test_what_no_vehicle_does_is_not_measured() -> None:
    found = measurements(pvt(vel_n_mps=np.array([0, np.inf, 1e300, -1e10, 10, 0])), FLOOR, False)
    np.testing.assert_array_equal(
        np.isnan(found.values[:, 3]), [False, True, True, True, False, False]
    )


def test_speed_and_course_stand_in_for_a_velocity() -> None:
    columns = {f"vel_{axis}_mps": None for axis in "ned"}
    table = pvt(speed_mps=np.full(6, 10.0), course_deg=np.full(6, 90.0)).replace(**columns)
    values = measurements(table, FLOOR, False).values
    np.testing.assert_allclose(values[:, 3:5], [[0, 10]] * 6, atol=1e-12)
    assert np.isnan(values[:, 5]).all()


def test_height_above_mean_sea_level_stands_in_for_a_height() -> None:
    height = np.array([10.0, 11, 12, 12, 12, 11])
    found = measurements(pvt().replace(height_m=None, height_msl_m=height), FLOOR, False)
    np.testing.assert_allclose(found.values[:, 2], 10 - height)
    later = pvt().replace(height_m=np.array([np.nan, np.nan, 45, 45, 45, 45]), height_msl_m=height)
    np.testing.assert_allclose(measurements(later, FLOOR, False).values[:, 2], 10 - height)


def test_the_receivers_accuracy_counts_where_it_is_asked_for_and_worse() -> None:
    table = pvt(
        h_acc_m=np.full(6, 10.0),
        v_acc_m=np.full(6, 1.0),
        cov_vel_nn_m2ps2=np.full(6, 0.5),
        cov_vel_ee_m2ps2=np.full(6, 1.5),
    )
    table = table.replace(cov_vel_dd_m2ps2=np.full(6, 1e-9))
    np.testing.assert_allclose(
        measurements(table, FLOOR, True).variances[0], [50, 50, 9, 1, 1, 0.01]
    )
    np.testing.assert_allclose(
        measurements(table, FLOOR, False).variances[0], [2.25, 2.25, 9, 0.0025, 0.0025, 0.01]
    )


def test_normal_gravity() -> None:
    """WGS 84: 9.7803 at the equator, 9.8322 at the poles; 3.1 m/s^2 less per 1000 km."""
    assert gravity_mps2(0.0, 0.0) == pytest.approx(9.7803253, abs=1e-6)
    assert gravity_mps2(np.pi / 2, 0.0) == pytest.approx(9.8321849, abs=1e-6)
    assert gravity_mps2(0.7, 1000.0) - gravity_mps2(0.7, 0.0) == pytest.approx(-3.086e-3)


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
    trajectory = nominal(recording.primary("imu"), table.time_ns, 0, 60.0, OFFSET)
    (start,) = alignment.starts(measurements(table, FLOOR, False), trajectory)
    (other,) = alignment.starts(
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
        trajectory = nominal(recording.primary("imu"), table.time_ns, 0, 60.0, OFFSET)
        (start,) = alignment.starts(found, trajectory)
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
        alignment.starts(
            measurements(still, FLOOR, False), nominal(imu, still.time_ns, 0, 60.0, OFFSET)
        )
    )
    foreign = nominal(other.primary("imu"), table.time_ns, 0, 60.0, OFFSET)
    assert not list(alignment.starts(measurements(table, FLOOR, False), foreign))
