"""All sources of a recording are on one clock, whatever clocks their headers bear, and the metadata
say how.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from spoofbench_converters.rosbag.batches import TopicMessages
from spoofbench_converters.rosbag.clocks import AGREE_NS, DAY_NS, OffsetMeter, RecorderJumps, decide

Convert = Callable[..., Any]

SECOND_NS = 1_000_000_000
START_NS = 1_700_000_000 * SECOND_NS
RECEIVED = START_NS + np.arange(300) * 20_000_000
NONE = np.empty(0, np.int64)


def seen(**off_s: float) -> dict[str, tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]]:
    return {name: (RECEIVED + round(off * SECOND_NS), RECEIVED) for name, off in off_s.items()}


@given(
    st.dictionaries(st.sampled_from("abcd"), st.floats(-80_000, 80_000), min_size=1),
    st.floats(-0.5, 0.5),
)
def test_devices_are_brought_together(off_s: dict[str, float], near: float) -> None:
    clocks, ahead_ns = decide(seen(near=near, **off_s))
    assert ahead_ns == 0
    for name, (stamps, received) in seen(near=near, **off_s).items():
        assert clocks[name].by_header
        assert np.abs(clocks[name].time_ns(stamps, received) - received).max() <= AGREE_NS


def test_devices_that_agree_keep_their_clock_in_a_bag_recorded_again() -> None:
    clocks, ahead_ns = decide(
        {
            **seen(a=-1e7, b=-1e7 + 0.3),
            "c": (NONE, NONE),
            "d": (np.zeros(9, np.int64), RECEIVED[:9]),
        }
    )
    assert ahead_ns == pytest.approx(-1e16, abs=SECOND_NS)
    assert [clocks[name].by_header for name in "abcd"] == [True, True, False, False]
    assert clocks["a"].shift_ns == clocks["b"].shift_ns == 0
    assert clocks["c"].shift_ns == clocks["d"].shift_ns == ahead_ns


@pytest.mark.parametrize(
    ("stamps", "why"),
    [
        (NONE, "have none"),
        (np.zeros(300, np.int64), "are zero"),
        (np.full(300, START_NS), "never change"),
        (RECEIVED % DAY_NS, "do not count from 1970"),
        (RECEIVED[::-1] + np.arange(300) % 2 * 5 * SECOND_NS, "run backwards"),
        (START_NS + np.arange(300) * SECOND_NS, "wander"),
        (RECEIVED + 2 * DAY_NS, "more than a day"),
    ],
)
def test_stamps_that_cannot_be_used(stamps: np.ndarray[Any, Any], why: str) -> None:
    clocks, _ = decide({"a": (stamps, RECEIVED[: stamps.size]), **seen(b=0.0)})
    assert not clocks["a"].by_header
    assert why in clocks["a"].basis
    assert (
        clocks["a"].time_ns(stamps, RECEIVED[: stamps.size]).tolist()
        == RECEIVED[: stamps.size].tolist()
    )


def test_a_bag_with_three_clocks(sessions: Any, convert_bag: Convert, tmp_path: Path) -> None:
    off = {
        "/gps/fix": 880 * SECOND_NS,
        "/gps/vel": 880 * SECOND_NS,
        "/imu/mag": -1_699_999_000 * SECOND_NS,
    }
    plain = convert_bag(sessions.write_ros2(tmp_path / "plain", sessions.drive(20)))
    result = convert_bag(sessions.write_ros2(tmp_path / "bag", sessions.drive(20, off)))
    recording, about = result.recording, result.recording.metadata
    assert recording["/imu0/imu"] == plain.recording["/imu0/imu"]
    assert (
        np.abs(recording["/mag0/mag"].time_ns - plain.recording["/mag0/mag"].time_ns).max()
        < 20_000_000
    )
    pvt, expected = recording["/gnss0/gnss/pvt"], plain.recording["/gnss0/gnss/pvt"]
    assert (
        pvt["vel_n_mps"].tolist() == expected["vel_n_mps"].tolist()
    )  # still joined by equal stamps
    assert np.ptp(pvt.time_ns - expected.time_ns) == 0
    assert np.abs(pvt.time_ns - expected.time_ns).max() < 20_000_000
    assert float(about["source/gnss0"]["header_offset_s"]) == pytest.approx(880, abs=0.02)
    assert "less 879.9" in about["source/gnss0"]["time"]
    assert "recorder's stamps" in about["source/mag0"]["time"]
    assert about["recording"]["clock"] == "sensor"


def test_the_recorder_asked_for(sessions: Any, convert_bag: Convert, tmp_path: Path) -> None:
    session = sessions.drive(10)
    recording = convert_bag(
        sessions.write_ros2(tmp_path / "bag", session), time="recorder"
    ).recording
    assert recording["/imu0/imu"].time_ns.tolist() == sorted(
        message.stamp_ns for message in session if message.topic == "/imu/data"
    )
    assert recording.metadata["recording"]["clock"] == "recorder"


def test_offset_spread_and_drift_are_measured() -> None:
    rng = np.random.default_rng(5)
    received = START_NS + np.arange(200_000) * 10_000_000
    noise = rng.uniform(-0.01, 0.01, received.size)
    off_s = 0.25 + 20e-6 * (received - received[0]) / 1e9 + noise
    whole, pieces = OffsetMeter(), OffsetMeter()
    stamps = received + np.rint(off_s * 1e9).astype(np.int64)
    whole.add(stamps, received)
    for part in np.array_split(np.arange(received.size), 37):
        pieces.add(stamps[part], received[part])
    for meter in (whole, pieces):
        about = {name: float(value) for name, value in meter.about().items()}
        assert about["header_offset_s"] == pytest.approx(0.27, abs=2e-3)
        assert about["header_offset_spread_s"] == pytest.approx(
            np.ptp(np.percentile(off_s, (5, 95))), rel=0.02
        )
        assert about["header_drift_ppm"] == pytest.approx(20, abs=1)


def test_a_host_clock_that_jumps_back(sessions: Any, convert_bag: Convert, tmp_path: Path) -> None:
    """Appended on request, the bag gives what it would have given had the clock gone on; else the
    jump is noted.
    """
    session = sessions.drive(20)
    middle, back_ns = 700, 5 * SECOND_NS
    stepped = session[:middle] + [sessions.moved(message, -back_ns) for message in session[middle:]]
    for writer in ("sqlite", "mcap", "ros1"):
        path = sessions.WRITERS[writer](tmp_path / writer, stepped)
        left, appended = convert_bag(path), convert_bag(path, append_clock=True)
        plain = convert_bag(sessions.WRITERS[writer](tmp_path / f"{writer}-plain", session))
        noted = {
            name: appended.recording.metadata["recording"][name]
            for name in ("clock_steps", "clock_step_count")
        }
        assert noted.items() <= left.recording.metadata["recording"].items()
        assert json.loads(noted["clock_steps"])[0]["record"] == middle
        assert (left.skipped > 0, appended.skipped) == (True, 0)
        for topic in plain.recording:
            times, expected = appended.recording[topic].time_ns, plain.recording[topic].time_ns
            assert len(times) == len(expected)
            assert (
                np.ptp(times - expected) <= 20_000_000
            )  # what the interval at the jump is not known by
            assert np.abs(times - expected).max() <= 20_000_000


def test_jumps_do_not_depend_on_pieces() -> None:
    rng = np.random.default_rng(4)
    stamps = START_NS + np.cumsum(
        rng.choice(
            [10**7, 2 * 10**7, -3 * SECOND_NS, 5 * SECOND_NS], 400, p=[0.5, 0.48, 0.01, 0.01]
        )
    )
    stamps[50] += 100 * SECOND_NS  # a lone leap is no jump
    numbers, records = rng.integers(0, 3, 400), np.arange(400)

    def joined(cuts: list[int]) -> tuple[list[int], dict[str, str]]:
        steps, told = RecorderJumps(append=True), np.zeros(400, np.int64)
        for part in np.split(records, cuts):
            empty = np.empty(0, np.int64)
            wanted = {
                n: TopicMessages(
                    empty, empty, empty, part[numbers[part] == n], stamps[part[numbers[part] == n]]
                )
                for n in range(3)
            }
            for messages in steps.take(wanted).values():
                told[messages.records] = messages.stamps_ns
        return told.tolist(), steps.about()

    whole = joined([])
    assert (np.delete(np.diff(np.delete(whole[0], 50)), 49) >= -SECOND_NS).all()
    assert joined([7, 49, 50, 51, 52, 200, 201]) == joined(list(range(1, 400))) == whole
    assert int(whole[1]["clock_step_count"]) == (np.diff(np.delete(stamps, 50)) < -SECOND_NS).sum()
