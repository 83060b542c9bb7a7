"""Real drives make sense: velocity is the derivative of position, the gyroscope turns with the
course.
"""

from typing import Any

import numpy as np
import pymap3d
import pytest

DRIVES = (
    "las_220114_0121_drive.ubx",
    "las_220110_0655_drive.ubx",
    "pyubx2_SF-calibration_drive.ubx",
)
PVT, PVA = "/gnss0/gnss/pvt", "/ins0/ins/pva"


@pytest.mark.parametrize("name", DRIVES)
def test_velocity_is_the_derivative_of_position(
    ubx: Any, real_logs: dict[str, list[bytes]], name: str
) -> None:
    decoded = ubx.decode(real_logs[name])
    table, time_s = decoded.tables[PVT], decoded.claimed_ns[decoded.epoch[PVT]] / 1e9
    place = [table[field] for field in ("lat_deg", "lon_deg", "height_m")]
    east, north, up = pymap3d.geodetic2enu(*place, *(float(axis[0]) for axis in place))
    for position, velocity in (
        (north, table["vel_n_mps"]),
        (east, table["vel_e_mps"]),
        (up, -table["vel_d_mps"]),
    ):
        error = np.diff(position) / np.diff(time_s) - (velocity[1:] + velocity[:-1]) / 2
        assert np.sqrt(np.mean(error**2)) < 0.2
    assert decoded.about["gnss0"]["solution"] == "fused"


@pytest.mark.parametrize("name", DRIVES[:2])
def test_the_gyroscope_turns_with_the_course(
    ubx: Any, real_logs: dict[str, list[bytes]], name: str
) -> None:
    decoded = ubx.decode(real_logs[name])
    pvt, pva = decoded.tables[PVT], decoded.tables[PVA]
    _, mine, its = np.intersect1d(decoded.epoch[PVT], decoded.epoch[PVA], return_indices=True)
    turn = (np.diff(pvt["course_deg"][mine]) + 180) % 360 - 180
    rate = np.degrees(pva["rate_z_radps"][its])
    moving = (pvt["speed_mps"][mine][1:] > 3) & ~np.isnan(rate[1:] + rate[:-1])
    assert np.corrcoef(turn[moving], ((rate[1:] + rate[:-1]) / 2)[moving])[0, 1] > 0.97


def test_gravity_points_up_at_rest(ubx: Any, real_logs: dict[str, list[bytes]]) -> None:
    for name in ("las_220111_2035_esfmeas_static.ubx", "gpsd_ublox-neo-m8u.log"):
        decoded = ubx.decode(real_logs[name])
        for topic in (topic for topic in decoded.tables if topic.endswith("/imu")):
            table = decoded.tables[topic]
            force = np.sqrt(sum(np.nanmean(table[f"accel_{axis}_mps2"]) ** 2 for axis in "xyz"))
            assert force == pytest.approx(9.85, abs=0.25), (name, topic)
            assert np.nanmean(table["accel_z_mps2"]) > 9
