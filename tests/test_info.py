"""A summary says what a recording holds."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spoofbench import info
from spoofbench.codec import write
from spoofbench.conversion import Ledger, Reject
from spoofbench.recording import Recording
from spoofbench.table import Table

START_NS = 1_700_000_000_000_000_000
SECOND_NS = 1_000_000_000


def drive(**metadata: Any) -> Recording:
    """100 epochs at 1 Hz: 40 s at rest, 60 s north at 10 m/s; epoch 20 is missing."""
    seconds = np.delete(np.arange(100), 20)
    speed = np.where(seconds < 40, 0.0, 10.0)
    north_m = np.maximum(seconds - 39, 0) * 10.0
    pvt = {
        "lat_deg": 48 + north_m / 111_194.9,
        "lon_deg": np.full(99, 11.0),
        "vel_n_mps": speed,
        "vel_e_mps": np.zeros(99),
    }
    imu = {"accel_z_mps2": np.full(1000, -9.8)}
    return Recording(
        {
            "/gnss0/gnss/pvt": Table("gnss/pvt", START_NS + seconds * SECOND_NS, pvt),
            "/imu0/imu": Table("imu", START_NS + np.arange(1000) * SECOND_NS // 10, imu),
        },
        {"primary": {"gnss/pvt": "gnss0"}, "recording": {"clock": "sensor"}, **metadata},
    )


def summarised(recording: Recording, folder: Path) -> info.Summary:
    write(recording, folder / "x.mcap")
    return info.summarise(folder / "x.mcap")


def test_topics_and_motion(tmp_path: Path) -> None:
    found = summarised(drive(), tmp_path)
    pvt, imu = found.topics
    assert (pvt.topic, pvt.primary, pvt.rows, pvt.rate_hz, pvt.gaps, pvt.longest_gap_s) == (
        "/gnss0/gnss/pvt",
        True,
        99,
        1.0,
        1,
        2.0,
    )
    assert (imu.primary, imu.rows, imu.rate_hz, imu.gaps, imu.longest_gap_s) == (
        False,
        1000,
        pytest.approx(10),
        0,
        None,
    )
    assert found.clock == "sensor"
    assert found.motion is not None
    assert found.motion.distance_m == pytest.approx(600, rel=0.003)
    assert found.motion.top_speed_mps == 10
    assert found.motion.stopped_share == pytest.approx(39 / 99)
    assert found.duration_s == pytest.approx(99.9)


def test_text_fits_80_columns_and_json_is_json(tmp_path: Path) -> None:
    ledger = Ledger("records", 1099)
    ledger.enter(Reject(3, 2, "a rather long reason " * 3))
    nasty = "\x1b[31m" + "word " * 40
    found = summarised(
        drive(ledger=ledger.as_metadata(), **{"source/gnss0": {"topic": nasty}}), tmp_path
    )
    text = info.as_text(found)
    assert max(map(len, text.splitlines())) <= 80
    assert "\x1b" not in text
    assert "0.60 km" in text
    assert "1,099 records used, 2 skipped" in text
    content = json.loads(json.dumps(info.as_dict(found), allow_nan=False))
    assert content["ledger"]["reasons"] == {"a rather long reason " * 3: 2}
    assert content["topics"][0]["rows"] == 99


def test_what_a_file_says_does_not_command_the_terminal(tmp_path: Path) -> None:
    topic, nasty = "/a\x1b[2J\nb/imu", "\x1b]0;title\x07"
    recording = Recording(
        {topic: Table("imu", START_NS + np.arange(3), {"accel_z_mps2": np.zeros(3)})},
        {"recording": {"clock": nasty}, nasty: {nasty: nasty}},
    )
    text = info.as_text(summarised(recording, tmp_path))
    assert all(line.isprintable() for line in text.split("\n"))
    assert "/a\N{REPLACEMENT CHARACTER}[2J\N{REPLACEMENT CHARACTER}b/imu" in text


@pytest.mark.parametrize("value", [np.inf, -np.inf, 1e308])
def test_values_beyond_measure_are_no_motion(tmp_path: Path, value: float) -> None:
    columns = {
        name: np.array([value, -value, value])
        for name in ("lat_deg", "lon_deg", "height_m", "vel_n_mps", "vel_e_mps", "speed_mps")
    }
    found = summarised(
        Recording(
            {"/gnss0/gnss/pvt": Table("gnss/pvt", START_NS + np.arange(3) * SECOND_NS, columns)}
        ),
        tmp_path,
    )
    json.dumps(info.as_dict(found), allow_nan=False)
    assert not {"nan", "inf"} & set(info.as_text(found).replace(",", " ").split())


def test_unknown_is_null(tmp_path: Path) -> None:
    times = START_NS + np.arange(3) * SECOND_NS
    found = summarised(
        Recording({"/gnss0/gnss/pvt": Table("gnss/pvt", times, {"num_sv": np.arange(3)})}), tmp_path
    )
    assert found.motion == info.MotionSummary(None, None, None)
    assert (found.clock, found.ledger) == (None, None)
    assert "motion" in info.as_text(found)
    empty = summarised(Recording({}), tmp_path)
    assert (empty.start_ns, empty.duration_s, empty.topics) == (None, None, ())
    assert "no rows" in info.as_text(empty)


def test_a_glance_says_where_it_is_from_and_what_to_look_at(tmp_path: Path) -> None:
    origin = {"file": "x.ubx", "size": "1234567", "converter": "ubx"}
    source = {"device": "ZED-F9R", "solution": "fused", "topic": "UBX-NAV-PVT"}
    about = {"clock": "gnss", "leap_seconds": "18", "clock_step_count": "3"}
    found = summarised(drive(origin=origin, recording=about, **{"source/gnss0": source}), tmp_path)
    lines = info.as_text(found).splitlines()
    assert "log        x.ubx, 1.23 MB, by the ubx converter" in lines
    assert "clock      gnss, leap seconds 18, 3 steps" in lines
    assert "gnss0      ZED-F9R, fused with inertial sensors, UBX-NAV-PVT" in lines
    doctor = " ".join(lines).partition("doctor")[2]
    assert "warnings: fused-primary, clock-step" in doctor
    assert {finding["code"] for finding in info.as_dict(found)["findings"]} >= {
        "fused-primary",
        "clock-step",
    }
