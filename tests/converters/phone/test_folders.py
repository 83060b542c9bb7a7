"""Which folders are one recording: others are walked, so that nothing in them is passed over."""

import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from spoofbench_converters import phone

from spoofbench.conversion import Reject, Source
from spoofbench.errors import ConversionError


def _sure(path: Path) -> float:
    return phone.sniff(Source.of(path))


def _refusal(path: Path) -> str:
    with pytest.raises(ConversionError) as refused:
        list(phone.convert(Source.of(path), phone.Options()))
    return str(refused.value)


def _unpacked(archive: Path, folder: Path) -> Path:
    with zipfile.ZipFile(archive) as file:
        file.extractall(folder)
    return folder


def test_a_recordings_own_folder(
    tmp_path: Path, sensor_logger: Callable[..., Path], phyphox: Callable[..., Path]
) -> None:
    logger, experiment = (
        _unpacked(sensor_logger(), tmp_path / "a"),
        _unpacked(phyphox(), tmp_path / "b"),
    )
    assert (_sure(logger), _sure(logger / "2024-01-01")) == (0, 1)
    assert _sure(experiment) == 0.9
    assert _sure(tmp_path) == 0


def test_logs_that_are_one_file_each(
    tmp_path: Path, gnsslogger: Callable[..., bytes], sensorlog: Callable[..., bytes]
) -> None:
    (tmp_path / "walk.txt").write_bytes(gnsslogger())
    (tmp_path / "drive.ubx").write_bytes(b"\xb5b")
    assert _sure(tmp_path) == 0
    (tmp_path / "other.txt").write_bytes(gnsslogger())
    (tmp_path / "ride.csv").write_bytes(sensorlog())
    assert _sure(tmp_path) == 0
    assert _sure(tmp_path / "walk.txt") == _sure(tmp_path / "ride.csv") == 1
    assert "several logs, 'other.txt' and 'walk.txt'" in _refusal(tmp_path)


def test_what_lies_beside_a_log_in_an_archive_is_told(
    tmp_path: Path, gnsslogger: Callable[..., bytes]
) -> None:
    with zipfile.ZipFile(tmp_path / "walk.zip", "w") as archive:
        archive.writestr("walk.nmea", "$GPGGA")
        archive.writestr("walk.txt", gnsslogger())
    assert _sure(tmp_path / "walk.zip") == 1
    items = phone.convert(Source.of(tmp_path / "walk.zip"), phone.Options())
    (passed,) = [item for item in items if isinstance(item, Reject)]
    assert (passed.length, passed.reason) == (
        6,
        "another file beside the log: not read, convert it by itself",
    )


def test_several_recordings_tables_beside_each_other(
    tmp_path: Path, phyphox: Callable[..., Path]
) -> None:
    folder = _unpacked(phyphox(), tmp_path)
    (folder / "Accelerometer 2.csv").write_bytes((folder / "Accelerometer.csv").read_bytes())
    assert _sure(folder) == 0
    assert "'Accelerometer 2.csv' and 'Accelerometer.csv' tell the same" in _refusal(folder)


def test_tables_with_the_columns_and_no_sensors_name(tmp_path: Path) -> None:
    for name in ("one", "two"):
        (tmp_path / f"{name}.csv").write_text("time,seconds_elapsed,latitude,longitude\n1,2,3,4\n")
    assert _sure(tmp_path) == 0
    assert _sure(tmp_path / "one.csv") == 1


def test_the_challenges_tables_count_before_the_log_that_they_were_made_from(
    tmp_path: Path, gnsslogger: Callable[..., bytes]
) -> None:
    table = (
        "MessageType,utcTimeMillis,MeasurementX,MeasurementY,MeasurementZ\n"
        "UncalAccel,1700000000123,0.0,0.0,9.8\n"
    )
    (tmp_path / "supplemental").mkdir()
    (tmp_path / "supplemental" / "gnss_log.txt").write_bytes(gnsslogger())
    (tmp_path / "device_imu.csv").write_text(table)
    assert _sure(tmp_path) == 1
    topics = {
        item.topic
        for item in phone.convert(Source.of(tmp_path), phone.Options())
        if hasattr(item, "topic") and len(item.table)
    }
    assert topics == {"/imu0/imu"}
    (tmp_path / "second_imu.csv").write_text(table)
    assert _sure(tmp_path) == 0
    assert "several tables of sensors" in _refusal(tmp_path)
