"""Field logs: what the mappings that come with the converter make of them, against pandas and
against one another.
"""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from spoofbench_converters import rosbag, table
from spoofbench_converters.table import mapping

from spoofbench.conversion import Source

from .conftest import Result, convert_by, convert_table

PHONE = "phone_bag"
G = 9.80665


def _sniffed(path: Path) -> Result:
    assert table.sniff(Source.of(path)) == 0.9
    result = convert_table(path)
    assert result.total == path.stat().st_size
    return result


def test_pothole_trips(data: Path) -> None:
    for number, fixes in ((2, 399), (3, 443), (5, 327)):
        path = data / PHONE / f"iphone_car_trip{number}.csv"
        recording, log = _sniffed(path).recording, pd.read_csv(path)
        imu, pvt = recording["/imu0/imu"], recording["/gnss0/gnss/pvt"]
        assert np.allclose(imu["accel_y_mps2"], -G * log["accelerometerY"], rtol=1e-12)
        assert np.median(imu["accel_y_mps2"]) > 9
        assert len(pvt) == fixes
        assert not (pvt["speed_mps"] < 0).any()
        held = np.diff(pvt.time_ns).max() / 1e9
        assert held > 20 if number == 5 else held < 10


def test_car_logger(data: Path) -> None:
    path = data / PHONE / "balzer_car_50hz_20140326.csv"
    result, log = _sniffed(path), pd.read_csv(path)
    imu, pvt = result.recording["/imu0/imu"], result.recording["/gnss0/gnss/pvt"]
    assert len(imu) == len(log)
    assert np.median(imu["accel_z_mps2"]) > 9
    assert np.allclose(imu["gyro_z_radps"], np.deg2rad(log["yawrate"]), atol=1e-12)
    assert np.nanmax(pvt["speed_mps"]) == pytest.approx(16.1, abs=0.1)
    assert int(result.metadata["source/gnss0"]["repeated_rows"]) + len(pvt) == len(log)


def test_town(data: Path) -> None:
    for name, topic, rows in (("imu", "/imu0/imu", 26_857), ("gps", "/gnss0/gnss/pvt", 664)):
        result = _sniffed(data / PHONE / f"boston_town_run1_{name}.csv")
        assert len(result.recording[topic]) == rows
    mag = convert_table(data / PHONE / "boston_town_run1_imu.csv").recording["/mag0/mag"]
    strength = np.linalg.norm([mag[f"field_{axis}_ut"] for axis in "xyz"], axis=0)
    assert 20 < np.median(strength) < 70


def test_a_pair_is_a_folder(data: Path, tmp_path: Path) -> None:
    for name in ("imu", "gps"):
        shutil.copy(data / PHONE / f"car_circles_kiran_{name}.csv", tmp_path)
    assert table.sniff(Source.of(tmp_path)) == 0.9
    result = convert_table(tmp_path)
    assert {topic: len(rows) for topic, rows in result.recording.items()} == {
        "/gnss0/gnss/pvt": 66,
        "/imu0/imu": 2530,
        "/mag0/mag": 2530,
    }
    log = pd.read_csv(data / PHONE / "car_circles_kiran_imu.csv")
    raw = log["raw_vnymr"].str.split("[,*]", expand=True).iloc[:, 4:13].astype(float).to_numpy()
    mag, imu = result.recording["/mag0/mag"], result.recording["/imu0/imu"]
    assert np.allclose(
        np.stack([mag[f"field_{axis}_ut"] for axis in "xyz"], 1), raw[:, :3] * 100, atol=1e-9
    )
    assert np.allclose(
        np.stack([imu[f"accel_{axis}_mps2"] for axis in "xyz"], 1), raw[:, 3:6], atol=1e-9
    )
    assert np.allclose(
        np.stack([imu[f"gyro_{axis}_radps"] for axis in "xyz"], 1), raw[:, 6:9], atol=1e-9
    )


def test_one_session_in_two_formats(data: Path, tmp_path: Path) -> None:
    for name in ("imu", "gps"):
        shutil.copy(data / PHONE / f"car_circles_kiran_{name}.csv", tmp_path)
    text = convert_table(tmp_path).recording
    bag = convert_by(rosbag, data / PHONE / "mcap_car_circles_olive.mcap").recording
    assert set(bag) == set(text)
    for topic in text:
        assert (
            np.abs(bag[topic].time_ns - text[topic].time_ns).max() <= 500
        )  # the text has seven digits
        for field in text[topic]:
            assert np.array_equal(bag[topic][field], text[topic][field], equal_nan=True), field


def test_phone_of_means(data: Path) -> None:
    path = data / PHONE / "phone_car_1hz_20230809.csv"
    recording, log = _sniffed(path).recording, pd.read_csv(path)
    assert len(recording["/baro0/baro"]) == 2581
    assert np.allclose(recording["/gnss0/gnss/pvt"]["lat_deg"], log["latitude"].dropna())
    assert (np.diff(recording["/baro0/baro"].time_ns) == 10**9).mean() > 0.99


def test_flight_of_ardupilot(data: Path) -> None:
    result = _sniffed(data / PHONE / "fw_apm_testlog2.mat")
    pvt, imu = result.recording["/gnss0/gnss/pvt"], result.recording["/imu0/imu"]
    assert (len(pvt), len(imu)) == (3050, 30_650)
    assert np.median(imu["accel_z_mps2"]) < -9
    gps_s = pvt["gps_week"].astype(np.int64) * 604_800 + pvt["tow_s"] + 315_964_800 - 16
    behind = pvt.time_ns / 1e9 - gps_s
    assert abs(np.median(behind)) < 0.5
    assert behind[0] == pytest.approx(2.4, abs=0.1)


def test_flight_of_px4(data: Path) -> None:
    path = data / PHONE / "fw_px4_search_pattern.zip"
    assert table.sniff(Source.of(path)) == 0.9
    result = convert_table(path, date="2013-01-01T10:00:00")
    pvt = result.recording["/gnss0/gnss/pvt"]
    assert len(pvt) == 752
    assert np.datetime64(int(pvt.time_ns[0]), "ns") == np.datetime64("2013-01-01T10:00:00")
    assert np.hypot(pvt["vel_n_mps"], pvt["vel_e_mps"]).max() == pytest.approx(21.3, abs=0.1)
    assert result.ledger.reasons == {"a file that is not in the mapping": 169_200 + 1_749_909 + 153}


def test_arrays_of_comma(data: Path) -> None:
    path = data / PHONE / "comma2k19_example1_imu_gnss.zip"
    assert table.sniff(Source.of(path)) == 0.9
    result = convert_table(path)
    pvt, truth, wheels = (
        result.recording[topic]
        for topic in ("/gnss0/gnss/pvt", "/reference/pva", "/odometer0/odometer")
    )
    assert len(result.recording["/imu0/imu"]) == 6256
    speed = np.interp(pvt.time_ns, truth.time_ns, np.hypot(truth["vel_n_mps"], truth["vel_e_mps"]))
    assert np.sqrt(np.mean((pvt["speed_mps"] - speed) ** 2)) < 0.3
    assert (
        np.sqrt(
            np.mean(
                (np.interp(pvt.time_ns, wheels.time_ns, wheels["speed_mps"]) - pvt["speed_mps"])
                ** 2
            )
        )
        < 0.3
    )
    north_m = (
        np.deg2rad(pvt["lat_deg"] - np.interp(pvt.time_ns, truth.time_ns, truth["lat_deg"]))
        * 6.37e6
    )
    assert np.abs(north_m).max() < 5


def test_drive_with_time_tags(data: Path, tmp_path: Path) -> None:
    for name in ("rtk_drive_imu_1934.csv", "rtk_drive_imu_1934.csv.tag", "rtk_drive_gnss_1934.pos"):
        shutil.copy(data / PHONE / name, tmp_path)
    result = convert_table(tmp_path, mapping="gnss_imu_drive")
    assert result.total == sum(path.stat().st_size for path in tmp_path.iterdir())
    assert result.ledger.skipped == 0
    imu, pvt = result.recording["/imu0/imu"], result.recording["/gnss0/gnss/pvt"]
    assert (len(imu), len(pvt), int((pvt["fix_type"] == 9).sum())) == (54_860, 2197, 2189)
    course = np.unwrap(np.arctan2(pvt["vel_e_mps"], pvt["vel_n_mps"]))
    moving = np.hypot(pvt["vel_n_mps"], pvt["vel_e_mps"]) > 3
    rate = np.gradient(course, pvt.time_ns / 1e9)[moving]
    turned = -np.interp(pvt.time_ns[moving], imu.time_ns, imu["gyro_z_radps"])
    assert np.corrcoef(rate, turned)[0, 1] > 0.98


def test_walk(data: Path) -> None:
    folder = data / "nmea_ubx"
    truth = convert_table(
        folder / "rtkexp_walk_0827_gnss.pos", mapping="rtklib_reference"
    ).recording["/reference/pva"]
    even = convert_table(
        folder / "rtkexp_walk_0827_imu_sf.csv.gz", mapping="gnss_imu_resampled"
    ).recording["/imu0/imu"]
    raw: Any = convert_table(folder / "rtkexp_walk_0827_imu.csv", mapping="gnss_imu_drive")
    assert (len(truth), len(even), len(raw.recording["/imu0/imu"])) == (536, 20_455, 20_455)
    assert truth.time_ns[0] <= even.time_ns[0] <= truth.time_ns[-1]
    assert set(raw.ledger.reasons) == {"another number of cells than the table has columns"}


def test_a_folder_of_many_logs_is_no_session(data: Path) -> None:
    assert table.sniff(Source.of(data / PHONE)) == 0
    assert table.sniff(Source.of(data)) == 0


def test_a_mapping_beside_its_files_is_a_session(data: Path, tmp_path: Path) -> None:
    shutil.copy(data / PHONE / "rtk_drive_gnss_1934.pos", tmp_path / "gnss.pos")
    shutil.copy(data / PHONE / "iphone_car_trip2.csv", tmp_path / "other.csv")
    shutil.copy(mapping.READY / "rtklib_pos.toml", tmp_path / "session.toml")
    source = Source.of(tmp_path / "session.toml")
    assert table.sniff(source) == 1
    result = convert_table(tmp_path / "session.toml")
    assert len(result.recording["/gnss0/gnss/pvt"]) == 2197
    assert result.total == (tmp_path / "gnss.pos").stat().st_size
