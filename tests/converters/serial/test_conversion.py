"""Logs of UBX frames and NMEA sentences become recordings; every byte is accounted for."""

import gzip
import random
import struct
import tracemalloc
from collections import Counter
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from spoofbench_converters import nmea, ubx
from spoofbench_converters.nmea.decoder import NmeaDecoder
from spoofbench_converters.serial import conversion, time_axis
from spoofbench_converters.serial.conversion import SerialConversion
from spoofbench_converters.serial.demux import RTCM
from spoofbench_converters.ubx.decoder import UbxDecoder

from spoofbench.conversion import Rejects, Source, Used
from spoofbench.errors import ConversionError, SpoofbenchError
from spoofbench.testing import run_converter_checks

LOGS = Path(__file__).parents[4] / "shared" / "data" / "nmea_ubx"
NS = 1_000_000_000


def write(folder: Path, log: bytes, name: str = "log") -> Path:
    path = folder / name
    path.write_bytes(log)
    return path


def converted(gathered: Any, converter: Any, path: Path, **options: Any) -> Any:
    return gathered(converter.convert(Source.of(path), converter.Options(**options)))


def in_pieces(gathered: Any, path: Path, piece_bytes: int, **options: Any) -> Any:
    chosen = ubx.Options(**options)
    with Source.of(path).open() as stream:
        return gathered(
            SerialConversion([UbxDecoder(), NmeaDecoder(chosen)], chosen).run(
                stream, path.name, piece_bytes
            )
        )


def same(one: Any, other: Any) -> bool:
    return bool(
        dict(one.recording.items()) == dict(other.recording.items())
        and one.recording.metadata == other.recording.metadata
        and (one.used, one.reasons) == (other.used, other.reasons)
    )


def test_a_mixed_log(gathered: Any, make: Any, tmp_path: Path) -> None:
    log = b"# header\n" + make.mixed(20)
    result = converted(gathered, ubx, write(tmp_path, log))
    recording = result.recording
    start = round(datetime.fromisoformat("2023-05-06T23:59:50Z").timestamp()) * NS
    expected = start + np.arange(20) * NS
    assert {topic: len(table) for topic, table in recording.items()} == {
        "/gnss0/gnss/pvt": 20,
        "/gnss1/gnss/pvt": 20,
        "/imu0/imu": 200,
    }
    for topic in ("/gnss0/gnss/pvt", "/gnss1/gnss/pvt"):
        assert recording[topic].time_ns.tolist() == expected.tolist()
    assert recording.metadata["primary"]["gnss/pvt"] == "gnss0"
    assert recording.metadata["recording"]["clock"] == "gnss"
    assert result.reasons.keys() == {RTCM, "comment line"}
    assert result.accounted == len(log)


def test_sentences_alone_leave_ubx_out(gathered: Any, make: Any, tmp_path: Path) -> None:
    log = make.mixed(20)
    result = converted(gathered, nmea, write(tmp_path, log))
    assert set(result.recording) == {"/gnss0/gnss/pvt"}
    assert result.reasons.keys() == {RTCM, conversion.UBX_NOT_ASKED_FOR}
    assert result.accounted == len(log)


def test_the_primary_receiver_tells_velocity(gathered: Any, make: Any, tmp_path: Path) -> None:
    times = [
        datetime.fromisoformat("2023-05-06T10:00:00Z") + timedelta(seconds=n) for n in range(10)
    ]
    tow_ms = [6 * 86_400_000 + 36_018_000 + n * 1000 for n in range(10)]
    position = [tow.to_bytes(4, "little") + bytes(24) for tow in tow_ms]
    log = b"".join(
        make.rmc(time) + make.ubx(payload, (0x01, 0x02))
        for time, payload in zip(times, position, strict=True)
    )
    recording = converted(gathered, ubx, write(tmp_path, log)).recording
    assert recording.metadata["primary"]["gnss/pvt"] == "gnss1"
    assert (
        recording["/gnss0/gnss/pvt"].time_ns.tolist()
        == recording["/gnss1/gnss/pvt"].time_ns.tolist()
    )


def test_a_counter_is_laid_against_the_epochs(gathered: Any, make: Any, tmp_path: Path) -> None:
    """Also where it drifts by 100 ppm, some rows are delayed, and it starts anew."""
    log, truth = [], []
    chance = random.Random(1)
    begin = datetime.fromisoformat("2023-05-06T10:00:00Z")
    for second in range(400):
        late = chance.random() < 0.1
        time = begin + timedelta(seconds=second)
        ticks = [second + tick / 10 for tick in range(10)]
        counter = 5_000_000 if second < 200 else 77_000
        meas = [make.esf_meas(counter + round(tick * 1000 * (1 + 1e-4))) for tick in ticks]
        log += [meas[0], make.nav_pvt(time), *meas[1:]] if late else [make.nav_pvt(time), *meas]
        truth += ticks
    result = converted(gathered, ubx, write(tmp_path, b"".join(log)))
    imu = result.recording["/imu0/imu"]
    assert len(imu) == 4000
    error_s = (imu.time_ns - round(begin.timestamp()) * NS) / NS - np.array(truth)
    assert np.abs(error_s).max() < 0.012
    assert np.diff(imu.time_ns).min() > 0
    assert float(result.recording.metadata["source/imu0"]["counter_spread_s"]) < 0.1


def test_times_without_a_date_ask_for_one(gathered: Any, make: Any, tmp_path: Path) -> None:
    begin = datetime.fromisoformat("2023-05-06T23:59:57Z")
    path = write(tmp_path, b"".join(make.gga(begin + timedelta(seconds=n)) for n in range(6)))
    with pytest.raises(ConversionError, match="--date YYYY-MM-DD"):
        converted(gathered, nmea, path)
    result = converted(gathered, nmea, path, date="2023-05-06")
    assert result.recording["/gnss0/gnss/pvt"].time_ns.tolist() == [
        round(begin.timestamp() + n) * NS for n in range(6)
    ]
    assert result.recording.metadata["recording"]["reference_date"] == "2023-05-06"


def test_epochs_without_a_time_are_rejected_where_no_reject_is(
    gathered: Any, make: Any, tmp_path: Path
) -> None:
    begin = datetime.fromisoformat("2023-05-06T10:00:00Z")
    early = [
        part
        for n in range(5)
        for part in (make.gga(begin + timedelta(seconds=n)), b"junk", make.rtcm3(b"station"))
    ]
    log = b"".join(early) + make.rmc(begin + timedelta(seconds=5))
    result = converted(gathered, nmea, write(tmp_path, log))
    assert result.reasons["time without a date"] == 5 * len(early[0])
    assert result.accounted == len(log)
    ends = [offset + length for offset, length, _ in result.rejects]
    assert all(offset >= end for (offset, _, _), end in zip(result.rejects[1:], ends, strict=False))


@pytest.mark.parametrize(
    ("option", "rows"), [("required", 0), ("missing-allowed", 10), ("ignored", 10)]
)
def test_the_policy_for_checksums_is_declared(
    gathered: Any, make: Any, tmp_path: Path, option: Any, rows: int
) -> None:
    begin = datetime.fromisoformat("2023-05-06T10:00:00Z")
    log = b"".join(
        make.rmc(begin + timedelta(seconds=n)).partition(b"*")[0] + b"\n" for n in range(10)
    )
    result = converted(gathered, nmea, write(tmp_path, log), checksum=option)
    assert len(result.recording.get("/gnss0/gnss/pvt", ())) == rows
    assert result.accounted == len(log)


@given(
    seed=st.integers(0, 2**32),
    cuts=st.lists(
        st.tuples(st.integers(0, 10**6), st.integers(0, 40), st.binary(max_size=30)), max_size=15
    ),
)
@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_damage_is_accounted_for(
    gathered: Any, make: Any, tmp_path: Path, seed: int, cuts: list[tuple[int, int, bytes]]
) -> None:
    log = bytearray(make.mixed(12))
    for place, length, instead in cuts:
        at = place % len(log)
        log[at : at + length] = instead
    path = write(tmp_path, bytes(log))
    for converter in (ubx, nmea):
        try:
            result = converted(gathered, converter, path, date="2023-05-06")
        except SpoofbenchError:
            continue
        assert result.accounted == len(log)
        end = 0
        for offset, length, _ in result.rejects:
            assert length == 0 or offset >= end
            end = max(end, offset + length)
        assert end <= len(log)


@given(st.binary(max_size=2000))
@settings(
    max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_random_bytes_are_no_log(gathered: Any, tmp_path: Path, log: bytes) -> None:
    log = b"no archive" + log
    path = write(tmp_path, log)
    assert nmea.sniff(Source.of(path)) == ubx.sniff(Source.of(path)) == 0
    assert converted(gathered, ubx, path).accounted == len(log)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["nmea", "ubx"])
def test_the_conformance_kit(name: str, make: Any, tmp_path: Path) -> None:
    begin = datetime.fromisoformat("2023-05-06T23:59:50Z")
    sentences = b"".join(
        make.rmc(begin + timedelta(seconds=n)) + make.gga(begin + timedelta(seconds=n))
        for n in range(30)
    )
    sample = write(tmp_path, make.mixed(30) if name == "ubx" else sentences, "sample")
    results = run_converter_checks(name, [sample])
    assert [(result.name, result.reason) for result in results if not result.passed] == []


def test_what_is_recognised(make: Any, tmp_path: Path) -> None:
    log, sentences = make.mixed(5), make.rmc(datetime.fromisoformat("2023-05-06T10:00:00Z")) * 20
    frame, chance = make.ubx(b"payload"), random.Random(3)
    table = b"".join(
        b'%d,51.0,13.0,"%s",\n' % (n, sentences.partition(b"\r")[0]) for n in range(50)
    )
    cases = {
        log: ("ubx", 0.6, 0.95),
        sentences: ("nmea", 0.94, 0.95),
        b"# header\n" * 10_000 + log: ("ubx", 0.5, 0.9),
        chance.randbytes(100_000) + sentences: ("nmea", 0.5, 0.9),
        sentences + b"\xb5\x62" + sentences: ("nmea", 0.9, 0.95),
        frame + bytes(5000): ("ubx", 0.5, 0.6),
        table: ("nmea", 0.5, 0.9),
        gzip.compress(sentences): ("nmea", 0.94, 0.95),
        make.rtcm3(b"message") * 50: ("none", 0, 0),
        b"time,lat,lon\n1,2,3\n": ("none", 0, 0),
        b"PK\x03\x04" + sentences: ("none", 0, 0),
        b"": ("none", 0, 0),
    }
    for number, (content, (whose, least, most)) in enumerate(cases.items()):
        source = Source.of(write(tmp_path, content, f"{number}.csv"))
        scores = {"nmea": nmea.sniff(source), "ubx": ubx.sniff(source)}
        assert [name for name, score in scores.items() if score] == (
            [whose] if whose != "none" else []
        )
        assert least <= max(scores.values()) <= most
    assert nmea.sniff(Source.of(tmp_path)) == ubx.sniff(Source.of(tmp_path)) == 0


def real(*names: str) -> list[Any]:
    why = f"needs the field logs in {LOGS.parent.name}/{LOGS.name} beside the repository"
    return [
        pytest.param(
            LOGS / name, marks=pytest.mark.skipif(not (LOGS / name).exists(), reason=why), id=name
        )
        for name in names
    ]


def all_logs() -> list[Path]:
    return sorted(
        path
        for path in LOGS.glob("*")
        if path.suffix not in (".chk", ".csv", ".pos") and not path.name.endswith(".csv.gz")
    )


@pytest.mark.skipif(not LOGS.exists(), reason="needs the field logs beside the repository")
def test_every_byte_of_every_real_log_is_accounted_for(gathered: Any) -> None:
    outcomes: Counter[str] = Counter()
    for path in all_logs():
        source = Source.of(path)
        converter = ubx if ubx.sniff(source) > nmea.sniff(source) else nmea
        result = converted(gathered, converter, path, date="2025-01-01")
        assert result.accounted == source.size(), path.name
        outcomes["rows" if len(result.recording) else "none"] += 1
    assert outcomes["rows"] >= 85


@pytest.mark.parametrize(
    "path",
    real(
        "rtkexp_walk_0827.ubx",
        "las_220111_2035_esfmeas_static.ubx",
        "ericzoop_ji_test_moving.ubx",
        "pygnssutils_base_rtcm3.log",
    ),
)
def test_real_logs_do_not_depend_on_pieces(
    gathered: Any, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = in_pieces(gathered, path, 10**8)
    for module in (time_axis, conversion):
        monkeypatch.setattr(module, "HORIZON", 250_000)
    assert same(in_pieces(gathered, path, 50_000), whole)


def test_a_frame_without_end_costs_bounded_memory(make: Any, tmp_path: Path) -> None:
    """Frames of one epoch are held until it is complete; one that never is must not hold the
    log.
    """
    log = make.ubx(struct.pack("<I2H", 5, 0, 0) + bytes(84)) * 200_000
    path = write(tmp_path, log)
    tracemalloc.start()
    accounted = 0
    for item in ubx.convert(Source.of(path), ubx.Options()):
        accounted += (
            item.units
            if isinstance(item, Used)
            else int(item.lengths.sum())
            if isinstance(item, Rejects)
            else 0
        )
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert accounted == len(log)
    assert peak < 250e6
