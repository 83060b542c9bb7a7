"""What logs of the apps become, from drives that are known."""

import zipfile
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from spoofbench_converters import phone

from spoofbench.conversion import Block, Reject, Rejects, Source, SourceMetadata, Used
from spoofbench.errors import ConversionError
from spoofbench.recording import Recording
from spoofbench.table import Table

START_NS = 1_700_000_000_123_456_789
BOOT_NS = START_NS - 5_000_000_000_001
SECOND_NS = 1_000_000_000
GRAVITY_MPS2 = 9.80665
SPEED_OF_LIGHT_MPS = 299_792_458.0
FORCE, GYRO, LINEAR = (
    [f"{name}_{axis}_{unit}" for axis in "xyz"]
    for name, unit in (("accel", "mps2"), ("gyro", "radps"), ("linear_accel", "mps2"))
)


@dataclass(frozen=True)
class Result:
    """What a conversion yields."""

    recording: Recording
    used: int
    reasons: Counter[str]
    facts: Mapping[str, Mapping[str, str]]

    def __getitem__(self, topic: str) -> Table:
        return self.recording[topic]


def converted(path: Path, **options: Any) -> Result:
    parts: dict[str, list[Table]] = {}
    used, reasons, facts = 0, Counter[str](), {}
    for item in phone.convert(Source.of(path), phone.Options(**options)):
        if isinstance(item, Block):
            used += item.used
            if len(item.table):
                parts.setdefault(item.topic, []).append(item.table)
        elif isinstance(item, Used):
            used += item.units
        elif isinstance(item, Reject):
            reasons[item.reason] += item.length
        elif isinstance(item, Rejects):
            reasons[item.reason] += int(item.lengths.sum())
        elif isinstance(item, SourceMetadata):
            for name, record in item.metadata.items():
                facts.setdefault(name, {}).update(record)
    return Result(
        Recording({topic: Table.concat(tables) for topic, tables in parts.items()}),
        used,
        reasons,
        facts,
    )


def vectors(table: Table, names: list[str]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """The rows that have these fields, shape ``(n, 3)``."""
    rows = np.stack([table[name] for name in names], 1)
    return rows[~np.isnan(rows).any(axis=1)]


def saved(folder: Path, log: bytes, name: str = "log") -> Path:
    path = folder / name
    path.write_bytes(log)
    return path


# GnssLogger


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory, gnsslogger: Callable[..., bytes]) -> Result:
    return converted(saved(tmp_path_factory.mktemp("drive"), gnsslogger()))


def test_every_byte_of_a_clean_log_is_used(drive: Result, gnsslogger: Callable[..., bytes]) -> None:
    assert drive.used == len(gnsslogger())
    assert not drive.reasons


def test_sensors_keep_their_values_and_times(drive: Result) -> None:
    imu = drive["/imu0/imu"]
    force, rate = vectors(imu, FORCE), vectors(imu, GYRO)
    assert len(force) == len(rate) == 1400
    assert len(imu) == 2800  # accelerometer and gyroscope sample at times of their own
    np.testing.assert_array_equal(force[:, 2], GRAVITY_MPS2)
    np.testing.assert_array_equal(rate[:, 2], 0.1)
    assert set(np.diff(imu.time_ns[~np.isnan(imu["accel_x_mps2"])]).tolist()) == {50_000_000}
    assert (
        abs(int(imu.time_ns[0]) - START_NS) < 1_000_000
    )  # the log tells Unix time in milliseconds
    assert drive.facts["source/imu0"]["UncalAccel_last_bias"] == "0.01 0.02 0.03"


def test_gnss_and_sensors_are_aligned_by_elapsed_time(drive: Result) -> None:
    pvt, clock = drive["/gnss0/gnss/pvt"], drive["/gnss0/gnss/clock"]
    start = int(drive["/imu0/imu"].time_ns[0])
    np.testing.assert_array_equal(pvt.time_ns - start, np.arange(70) * SECOND_NS)
    np.testing.assert_allclose(clock["host_offset_s"], -0.98, atol=2e-3)
    assert drive.facts["recording"]["clock"] == "sensor"
    assert abs(int(drive.facts["recording"]["gnss_minus_clock_ns"]) + 980_000_000) < 2_000_000


def test_each_provider_is_a_source(drive: Result) -> None:
    assert [len(drive[f"/gnss{number}/gnss/pvt"]) for number in range(3)] == [70, 70, 7]
    assert [drive.facts[f"source/gnss{number}"]["solution"] for number in range(3)] == [
        "gnss",
        "fused",
        "fused",
    ]
    pvt = drive["/gnss0/gnss/pvt"]
    assert np.flatnonzero(np.isnan(pvt["course_deg"])).tolist() == [3]
    np.testing.assert_array_equal(pvt["speed_mps"], 12.0)
    assert np.isnan(drive["/gnss2/gnss/pvt"]["speed_mps"]).all()
    claimed_ns = (
        pvt["gps_week"].astype(np.int64) * 604_800 - 18 + 315_964_800
    ) * SECOND_NS + np.rint(pvt["tow_s"] * 1e9).astype(np.int64)
    np.testing.assert_array_equal(
        claimed_ns, (START_NS + np.arange(70) * SECOND_NS - 980_000_000) // 1_000_000 * 1_000_000
    )


def test_measurements(drive: Result) -> None:
    rows = drive["/gnss0/gnss/observation"]
    second = np.repeat(np.arange(70), 2)
    flight_ns = 70_000_000 + 1000 * second + np.tile([0, 1], 70)
    np.testing.assert_allclose(
        rows["pseudorange_m"], (flight_ns - 0.25) * SPEED_OF_LIGHT_MPS * 1e-9, rtol=0, atol=1e-6
    )
    assert rows.texts("signal")[:2] == ["1C", "5Q"]
    assert rows["constellation"][:2].tolist() == [1, 3]
    wavelength = SPEED_OF_LIGHT_MPS / np.tile([1575420030.0, 1176450050.0], 70)
    np.testing.assert_allclose(rows["doppler_hz"], 123.25 / wavelength)
    np.testing.assert_allclose(rows["carrier_cycles"], (-500.0 - second) / wavelength)
    assert len(drive["/gnss0/gnss/clock"]) == 70
    assert drive["/gnss0/gnss/clock"]["bias_s"][0] == pytest.approx(0.25e-9)


def test_status_and_messages_bear_the_time_of_the_row_before_them(drive: Result) -> None:
    status, messages = drive["/gnss0/gnss/signal"], drive["/gnss0/gnss/navdata"]
    start = int(drive["/imu0/imu"].time_ns[0])
    late = status.time_ns - start - np.repeat(np.arange(70), 2) * SECOND_NS
    assert np.all((late > 250_000_000) & (late <= 300_000_000))
    assert len(messages) == 7
    assert messages.texts("subframe")[0] == bytes(range(128, 168))


def test_gain_control(drive: Result) -> None:
    assert set(drive["/gnss0/gnss/rf"].texts("band")) == {"L1"}
    np.testing.assert_array_equal(drive["/gnss0/gnss/rf"]["agc_db"], 20.5)


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (
            b"NMEA,$GPGGA,1*00,1700000000000\n",
            "NMEA sentences: not asked for, convert with --format nmea",
        ),
        (b"GnssAntennaInfo,1575.42,1.2\n", "GnssAntennaInfo: nothing in the schema"),
        (b"Fix,GPS,50.0\n", "the number of cells is not that of the header"),
        (
            b"UncalGyro,1700000000123,5000000000001,0.1,abc,0.1,0,0,0\n",
            "a cell that must be a number is none",
        ),
        (b"UncalGyro,,,0.1,0.1,0.1,0,0,0\n", "a row without a time"),
        (b"Fix,GPS,,,1,2,3,4,1700000000000,,,5000000000001,,0\n", "a fix without a position"),
        (
            b"Fix,XYZ,1,2,1,2,3,4,1700000000000,,,5000000000001,,0\n",
            "a fix of a provider that is not known",
        ),
        (b"\x00\x01\x02\n", "a line of no type that GnssLogger writes"),
        (b"UncalGyro" * 8000 + b"\n", "a line of more than 65,536 bytes"),
        (b"UncalGyro,17000", "cut off: the last line has no end"),
    ],
)
def test_what_cannot_be_used_is_counted_by_reason(
    tmp_path: Path, gnsslogger: Callable[..., bytes], drive: Result, line: bytes, reason: str
) -> None:
    log = gnsslogger() + line
    found = converted(saved(tmp_path, log))
    assert found.reasons == {reason: len(line)}
    assert found.used + len(line) == len(log)
    assert found.recording.digest() == drive.recording.digest()


def test_one_provider_alone(tmp_path: Path, gnsslogger: Callable[..., bytes]) -> None:
    found = converted(saved(tmp_path, gnsslogger()), source="GPS")
    assert set(found.reasons) == {"fixes of another provider: not asked for"}
    assert [topic for topic in found.recording if topic.endswith("pvt")] == ["/gnss0/gnss/pvt"]


def test_an_accuracy_of_zero_is_none(
    tmp_path: Path, gnsslogger: Callable[..., bytes], drive: Result
) -> None:
    found = converted(saved(tmp_path, gnsslogger().replace(b",3.5,", b",0.0,")))
    assert drive["/gnss0/gnss/pvt"].has("h_acc_m")
    assert not found["/gnss0/gnss/pvt"].has("h_acc_m")
    assert found["/gnss0/gnss/pvt"].has("v_acc_m", "speed_mps")


def test_a_satellite_not_received_has_no_cn0(
    tmp_path: Path, gnsslogger: Callable[..., bytes], drive: Result
) -> None:
    found = converted(saved(tmp_path, gnsslogger().replace(b",41.5,", b",0.0,")))
    for topic in ("/gnss0/gnss/signal", "/gnss0/gnss/observation"):
        assert drive[topic].has("cn0_dbhz")
        assert not found[topic].has("cn0_dbhz")
        assert len(found[topic]) == len(drive[topic])


def test_the_phones_clock_may_step(
    tmp_path: Path, gnsslogger: Callable[..., bytes], drive: Result
) -> None:
    log = gnsslogger().splitlines(keepends=True)
    for number, line in enumerate(log):
        cells = line.split(b",")
        if cells[0].startswith(b"Uncal") and int(cells[2]) > 5_000_000_000_001 + 30 * SECOND_NS:
            log[number] = b",".join([cells[0], b"%d" % (int(cells[1]) + 7000), *cells[2:]])
    found = converted(saved(tmp_path, b"".join(log)))
    np.testing.assert_array_equal(found["/imu0/imu"].time_ns, drive["/imu0/imu"].time_ns)
    assert int(found.facts["recording"]["clock_step_count"]) > 0


def test_a_clock_that_jumps_back_is_appended_if_asked(
    tmp_path: Path, gnsslogger: Callable[..., bytes], drive: Result
) -> None:
    path = saved(tmp_path, gnsslogger() + gnsslogger())
    refused, appended = converted(path), converted(path, append_clock=True)
    assert refused.used < appended.used == 2 * len(gnsslogger())
    for topic in ("/imu0/imu", "/gnss0/gnss/pvt", "/gnss0/gnss/observation"):
        once, twice = drive[topic], appended[topic]
        assert len(twice) == 2 * len(once)
        np.testing.assert_array_equal(
            np.diff(twice.time_ns)[: len(once) - 1], np.diff(once.time_ns)
        )
        np.testing.assert_array_equal(np.diff(twice.time_ns)[len(once) :], np.diff(once.time_ns))
    behind = appended["/imu0/imu"].time_ns[2800] - appended["/gnss0/gnss/pvt"].time_ns[70]
    assert behind == drive["/imu0/imu"].time_ns[0] - drive["/gnss0/gnss/pvt"].time_ns[0]


def test_a_log_of_an_old_version(
    tmp_path: Path, gnsslogger: Callable[..., bytes], drive: Result
) -> None:
    def old(line: str) -> str | None:
        header, cells = line.startswith("#"), line.removeprefix("# ").split(",")
        if cells[0] == "Raw":
            if header:
                return line.replace("utcTimeMillis", "ElapsedRealtimeMillis").replace(
                    ",ChipsetElapsedRealtimeNanos", ""
                )
            return ",".join(["Raw", str(int(cells[-1]) // 1_000_000), *cells[2:-1]])
        if cells[0] == "Fix":
            names = "# Fix,Provider,Latitude,Longitude,Altitude,Speed,Accuracy,(UTC)TimeInMs"
            return names if header else ",".join([*cells[:7], cells[8]])
        return line if header else None

    log = (
        "\n".join(
            text for line in gnsslogger().decode().splitlines() if (text := old(line)) is not None
        )
        + "\n"
    )
    found = converted(saved(tmp_path, log.encode()))
    assert not found.reasons
    np.testing.assert_array_equal(
        found["/gnss0/gnss/pvt"]["lat_deg"], drive["/gnss0/gnss/pvt"]["lat_deg"]
    )
    np.testing.assert_allclose(
        found["/gnss0/gnss/observation"]["pseudorange_m"],
        drive["/gnss0/gnss/observation"]["pseudorange_m"],
    )
    behind = found["/gnss0/gnss/observation"].time_ns[::2] - found["/gnss0/gnss/pvt"].time_ns
    assert np.abs(behind).max() < 2_000_000


def test_a_log_appended_with_another_header(
    tmp_path: Path, gnsslogger: Callable[..., bytes], drive: Result
) -> None:
    clocks = b"utcTimeMillis,elapsedRealtimeNanos", b"elapsedRealtimeNanos,utcTimeMillis"
    headers = [
        line.replace(*clocks)
        for line in gnsslogger().splitlines(keepends=True)
        if line.startswith(b"#") and clocks[0] in line
    ]
    found = converted(
        saved(
            tmp_path,
            gnsslogger()
            + b"".join(headers)
            + b"UncalAccel,5080000000001,1700000080123,1.0,2.0,3.0,0,0,0\n",
        )
    )
    assert not found.reasons
    imu = found["/imu0/imu"]
    np.testing.assert_array_equal(imu.time_ns[:-1], drive["/imu0/imu"].time_ns)
    assert imu.time_ns[-1] - imu.time_ns[0] == 80 * SECOND_NS
    assert [imu[name][-1] for name in FORCE] == [1.0, 2.0, 3.0]


def test_sources_say_which_rows_they_are_made_of(
    tmp_path: Path, gnsslogger: Callable[..., bytes], drive: Result
) -> None:
    assert drive.facts["source/gnss0"]["topic"] == "Fix,GPS Raw Agc Status Nav"
    rows = [
        line
        for line in gnsslogger().splitlines(keepends=True)
        if not line.startswith((b"Agc", b"Nav"))
    ]
    assert (
        converted(saved(tmp_path, b"".join(rows))).facts["source/gnss0"]["topic"]
        == "Fix,GPS Raw Status"
    )


def test_a_file_of_sentences_alone_is_the_nmea_converters(
    tmp_path: Path, gnsslogger: Callable[..., bytes]
) -> None:
    header = b"".join(
        line for line in gnsslogger().splitlines(keepends=True) if line.startswith(b"#")
    )
    assert (
        phone.sniff(Source.of(saved(tmp_path, header + b"NMEA,$GPGGA,1*00,1700000000000\n" * 9)))
        == 0.0
    )
    assert phone.sniff(Source.of(saved(tmp_path, header))) == 1.0


# Sensor Logger


def test_a_drive_is_the_same_on_every_phone(sensor_logger: Callable[..., Path]) -> None:
    ios, standard, android = (
        converted(sensor_logger(*form)) for form in (("ios",), ("ios", True), ("android",))
    )
    for topic in ("/imu0/imu", "/imu1/imu", "/gnss0/gnss/pvt"):
        for name in ios[topic]:
            np.testing.assert_allclose(
                ios[topic][name], android[topic][name], rtol=1e-12, atol=1e-12, err_msg=name
            )
            np.testing.assert_allclose(
                ios[topic][name], standard[topic][name], rtol=1e-12, atol=1e-12, err_msg=name
            )
    np.testing.assert_allclose(vectors(ios["/imu0/imu"], FORCE)[:, 2], GRAVITY_MPS2)
    np.testing.assert_allclose(vectors(ios["/imu0/imu"], LINEAR)[:, 2], 0, atol=1e-12)
    np.testing.assert_allclose(vectors(ios["/imu1/imu"], FORCE)[:, 0], -1.2)
    np.testing.assert_array_equal(vectors(ios["/imu0/imu"], GYRO)[:, 2], 0.1)


def test_rows_of_one_time_are_one(sensor_logger: Callable[..., Path]) -> None:
    imu = converted(sensor_logger("ios"))["/imu0/imu"]
    assert len(imu) == 1400
    np.testing.assert_array_equal(imu.time_ns, START_NS + np.arange(1400) * 50_000_000)


def test_a_cached_fix_and_unknown_values(sensor_logger: Callable[..., Path]) -> None:
    found = converted(sensor_logger("ios"))
    assert set(found.reasons) == {"a fix older than the log", "a file of no kind in the schema"}
    pvt = found["/gnss0/gnss/pvt"]
    assert len(pvt) == 70
    assert np.flatnonzero(np.isnan(pvt["course_deg"])).tolist() == [3]
    assert "solution" not in found.facts["source/gnss0"]
    assert converted(sensor_logger("android")).facts["source/gnss0"]["solution"] == "fused"


def test_without_the_platform_the_sign_is_unknown(
    tmp_path: Path, sensor_logger: Callable[..., Path]
) -> None:
    with zipfile.ZipFile(sensor_logger("ios")) as archive:
        archive.extractall(tmp_path)
    (tmp_path / "2024-01-01" / "Metadata.csv").unlink()
    found = converted(tmp_path)
    assert (
        "nothing says whether the phone is iOS or Android, so the sign is unknown" in found.reasons
    )
    assert not found["/imu0/imu"].has(*FORCE)
    assert found["/imu0/imu"].has(*GYRO)


def test_a_folder_is_as_an_archive(tmp_path: Path, sensor_logger: Callable[..., Path]) -> None:
    with zipfile.ZipFile(sensor_logger("ios")) as archive:
        archive.extractall(tmp_path)
    folder, archived = converted(tmp_path), converted(sensor_logger("ios"))
    assert folder.recording.digest() == archived.recording.digest()
    assert folder.reasons == archived.reasons


def test_a_table_that_does_not_say_what_it_is(tmp_path: Path) -> None:
    with pytest.raises(ConversionError, match="does not say of which sensor"):
        converted(saved(tmp_path, b"time,seconds_elapsed,z,y,x\n1700000000000000000,0.1,1,2,3\n"))


# phyphox


def test_the_file_that_names_the_phone_is_used(
    tmp_path: Path, phyphox: Callable[..., Path]
) -> None:
    with zipfile.ZipFile(phyphox()) as archive:
        archive.extractall(tmp_path)
    (tmp_path / "meta" / "device.csv").write_text(
        '"property","value"\n"deviceModel","One"\n"deviceBrand","Acme"\n'
    )
    found = converted(tmp_path)
    assert not found.reasons
    assert found.facts["source/imu0"]["device"] == "Acme One"


def test_a_pause_is_a_gap(phyphox: Callable[..., Path]) -> None:
    pvt = converted(phyphox())["/gnss0/gnss/pvt"]
    steps = np.diff(pvt.time_ns)
    assert steps[:19].tolist() == [SECOND_NS] * 19
    assert steps[19] == 1001 * SECOND_NS
    assert pvt.time_ns[0] == START_NS // 1_000_000 * 1_000_000


@pytest.mark.parametrize(
    ("delimiter", "comma"), [(";", False), (";", True), ("\t", False), ("\t", True)]
)
def test_every_form_of_table_is_the_same(
    phyphox: Callable[..., Path], delimiter: str, comma: bool
) -> None:
    one, other = converted(phyphox()), converted(phyphox(delimiter, comma))
    assert one.recording.digest() == other.recording.digest()
    assert not other.reasons


def test_an_experiment_without_time_needs_a_date(
    tmp_path: Path, phyphox: Callable[..., Path]
) -> None:
    with zipfile.ZipFile(phyphox()) as archive:
        archive.extractall(tmp_path)
    (tmp_path / "meta" / "time.csv").unlink()
    with pytest.raises(ConversionError, match="--date"):
        converted(tmp_path)
    with pytest.raises(ConversionError, match="is invalid"):
        converted(tmp_path, date="yesterday")
    found = converted(tmp_path, date="2023-11-14T22:13:20+00:00")
    assert found["/imu0/imu"].time_ns[0] == 1_700_000_000 * SECOND_NS
    assert found.facts["recording"]["reference_date"] == "2023-11-14T22:13:20+00:00"


# SensorLog


def test_sparse_and_held_values_are_the_same(
    tmp_path: Path, sensorlog: Callable[..., bytes]
) -> None:
    sparse, held = (converted(saved(tmp_path, sensorlog(form))) for form in (False, True))
    assert sparse.recording.digest() == held.recording.digest()
    imu, pvt = sparse["/imu0/imu"], sparse["/gnss0/gnss/pvt"]
    np.testing.assert_allclose(vectors(imu, FORCE)[:, 2], GRAVITY_MPS2)
    np.testing.assert_allclose(vectors(imu, FORCE)[:, 0], -1.2)
    assert len(pvt) == 70
    assert np.flatnonzero(np.isnan(pvt["course_deg"])).tolist() == [3]
    assert abs(int(imu.time_ns[0]) - START_NS) < 2_000_000
    assert abs(int(pvt.time_ns[0]) - START_NS) < 1_000


def test_a_repeated_line_is_counted(tmp_path: Path, sensorlog: Callable[..., bytes]) -> None:
    log = sensorlog()
    line = log.splitlines(keepends=True)[-1]
    found, once = converted(saved(tmp_path, log + line, "twice")), converted(saved(tmp_path, log))
    assert found.reasons == {"repeated row": len(line)}
    assert found.recording.digest() == once.recording.digest()


# Smartphone Decimeter Challenge


def test_the_challenges_tables_are_as_the_log_they_were_made_from(
    tmp_path: Path, gnsslogger: Callable[..., bytes], drive: Result
) -> None:
    log = gnsslogger().decode().splitlines()
    raw = next(line[2:] for line in log if line.startswith("# Raw,")).replace(
        "Raw,", "MessageType,", 1
    )
    position = ",WlsPositionXEcefMeters,WlsPositionYEcefMeters,WlsPositionZEcefMeters"
    gnss = [
        raw + position,
        *(f"{line},4068000.0,572000.0,4863000.0" for line in log if line.startswith("Raw,")),
    ]
    axes = ",".join(f"{name}{axis}" for name in ("Measurement", "Bias") for axis in "XYZ")
    imu = [
        f"MessageType,utcTimeMillis,elapsedRealtimeNanos,{axes}",
        *(line for line in log if line.startswith("Uncal")),
    ]
    truth = ["MessageType,Provider,LatitudeDegrees,LongitudeDegrees,AltitudeMeters,UnixTimeMillis"]
    truth += [
        f"Fix,GT,{cells[2]},{cells[3]},{cells[4]},{cells[8]}"
        for line in log
        if (cells := line.split(","))[:2] == ["Fix", "GPS"]
    ]
    for name, lines in (
        ("device_gnss.csv", gnss),
        ("device_imu.csv", imu),
        ("ground_truth.csv", truth),
    ):
        (tmp_path / name).write_text("\n".join(lines) + "\n")
    found = converted(tmp_path)
    assert not found.reasons
    assert found["/imu0/imu"] == drive["/imu0/imu"]
    assert found["/gnss0/gnss/observation"] == drive["/gnss0/gnss/observation"]
    assert found["/gnss0/gnss/clock"] == drive["/gnss0/gnss/clock"]
    assert len(found["/wls0/gnss/pvt"]) == 70
    assert found["/wls0/gnss/pvt"]["lat_deg"][0] == pytest.approx(50.0, abs=0.1)
    assert (
        np.abs(found["/reference/pva"].time_ns - drive["/gnss0/gnss/pvt"].time_ns).max() < 2_000_000
    )
