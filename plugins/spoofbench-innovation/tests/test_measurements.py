"""What is taken from a receiver."""

from typing import Any

import numpy as np
from spoofbench_innovation.measurements import measurements

from spoofbench.table import Table

FLOOR = (1.5, 3.0, 0.05, 0.1)


def pvt(rows: int = 6, **columns: Any) -> Table:
    time_ns = np.arange(rows, dtype=np.int64) * 1_000_000_000
    given = {
        "lat_deg": np.full(rows, 40.0),
        "lon_deg": np.full(rows, -84.0),
        "height_m": np.full(rows, 200.0),
    }
    given |= {f"vel_{axis}_mps": np.zeros(rows) for axis in "ned"}
    return Table("gnss/pvt", time_ns, {**given, **columns})


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
