"""The 43-minute drive: counts, units, frames and the traps that it is known for."""

from typing import Any

import numpy as np
import pytest

from spoofbench.table import Table

pytestmark = pytest.mark.drive

SECOND_NS = 1_000_000_000


@pytest.fixture(scope="module")
def imu(drive: Any) -> Table:
    table: Table = drive.recording["/imu0/imu"]
    return table


@pytest.fixture(scope="module")
def pvt(drive: Any) -> Table:
    table: Table = drive.recording["/gnss0/gnss/pvt"]
    return table


@pytest.fixture(scope="module")
def reference(drive: Any) -> Table:
    table: Table = drive.recording["/reference/pva"]
    return table


def test_every_message_is_used(drive: Any, imu: Table, pvt: Table, reference: Table) -> None:
    assert (len(imu), len(pvt), len(reference)) == (260_204, 2_602, 520_411)
    assert drive.used == 260_204 + 2 * 2_602 + 520_411
    assert not drive.rejects


def test_positions_and_velocities_join_completely(pvt: Table) -> None:
    assert pvt.valid("lat_deg").all()
    assert pvt.valid("vel_n_mps").all()
    assert np.all(np.diff(pvt.time_ns) > 0.9 * SECOND_NS)


def test_increments_become_specific_force(imu: Table) -> None:
    force = np.stack([imu[f"accel_{axis}_mps2"] for axis in "xyz"])
    assert force[:, :100].mean(axis=1) == pytest.approx([0.21, 0.10, -9.85], abs=0.01)
    assert np.linalg.norm(force[:, :10_000].mean(axis=1)) == pytest.approx(9.855, abs=0.002)
    assert set(imu["interval_s"].tolist()) == {0.01}


def test_recorder_runs_before_validity(imu: Table) -> None:
    assert np.median(imu.time_ns - imu["receive_time_ns"]) / 1e9 == pytest.approx(0.207, abs=0.002)


def test_positions_are_the_receivers_decimals(pvt: Table) -> None:
    for name, decimals in (
        ("lat_deg", 7),
        ("lon_deg", 7),
        ("height_m", 3),
        ("vel_n_mps", 3),
        ("vel_e_mps", 3),
        ("vel_d_mps", 3),
    ):
        assert np.array_equal(pvt[name], np.round(pvt[name], decimals)), name


def test_speeds(pvt: Table) -> None:
    speed = np.hypot(pvt["vel_n_mps"], pvt["vel_e_mps"])
    assert speed.max() == pytest.approx(19.1, abs=0.05)
    assert np.mean(speed < 0.3) == pytest.approx(0.22, abs=0.01)
    assert speed[:120].max() < 0.3


def test_reference_heading_follows_the_course(reference: Table) -> None:
    speed = np.hypot(reference["vel_n_mps"], reference["vel_e_mps"])
    course = np.rad2deg(np.arctan2(reference["vel_e_mps"], reference["vel_n_mps"]))
    off = (reference["yaw_deg"] - course + 180) % 360 - 180
    assert abs(np.median(off[speed > 5])) < 1
    assert np.std(off[speed > 5]) < 1


def test_reference_tilt_follows_the_accelerometers_at_rest(imu: Table, reference: Table) -> None:
    seconds = np.arange(imu.time_ns[0], imu.time_ns[-1], SECOND_NS)

    def means(table: Table, values: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        first = np.searchsorted(table.time_ns, seconds)
        return np.add.reduceat(values, first) / np.diff(np.append(first, len(table)))

    x, y, z = (means(imu, imu[f"accel_{axis}_mps2"]) for axis in "xyz")
    first = np.searchsorted(reference.time_ns, seconds)
    still = (
        np.maximum.reduceat(np.hypot(reference["vel_n_mps"], reference["vel_e_mps"]), first) < 0.05
    )
    assert still.sum() > 400
    roll = means(reference, reference["roll_deg"]) - np.rad2deg(np.arctan2(-y, -z))
    pitch = means(reference, reference["pitch_deg"]) - np.rad2deg(np.arctan2(x, np.hypot(y, z)))
    assert np.median(roll[still]) == pytest.approx(-0.24, abs=0.02)
    assert np.median(pitch[still]) == pytest.approx(-3.54, abs=0.02)
    assert max(np.std(roll[still]), np.std(pitch[still])) < 0.06


def test_metadata_name_sources_and_corrections(drive: Any) -> None:
    about = drive.recording.metadata
    assert about["source/imu0"]["axes"] == "frd"
    assert about["source/gnss0"]["solution"] == "gnss"
    assert about["source/reference"]["topic"] == "/sensor/ins_d/pva"
    assert "(a, c, b, -d)" in about["source/reference"]["attitude"]
    assert about["recording"]["clock"] == "sensor"
