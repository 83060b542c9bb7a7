"""Messages become rows: values, order, joining, and an account of every message."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from spoofbench_converters.rosbag import aspn23, rows, sqlite_log

from spoofbench.conversion import RowBatch

START_NS = 1_700_000_000_000_000_000
SECOND_NS = 1_000_000_000
EPOCHS = "/gnss0/gnss/pvt"


def test_values_are_those_of_the_messages(maker: Any, convert_bag: Callable[..., Any]) -> None:
    session = maker.session()
    result = convert_bag(maker.bag(session))
    assert result.used == len(session)
    assert not result.rejects
    by_topic = {
        topic: [message for name, _, _, message in session if name == topic]
        for topic in {row[0] for row in session}
    }
    imu, pvt, pva = (result.recording[topic] for topic in ("/imu0/imu", EPOCHS, "/reference/pva"))
    accel = np.array([message.meas_accel for message in by_topic[maker.imu]])
    order = np.argsort(
        [message.time_of_validity.elapsed_nsec for message in by_topic[maker.imu]], kind="stable"
    )
    assert np.array_equal(imu["accel_y_mps2"], accel[order, 1] / 0.02)
    assert set(imu["interval_s"].tolist()) == {0.02}
    positions, velocities = by_topic[maker.position], by_topic[maker.velocity]
    assert pvt["lat_deg"] == pytest.approx(
        [np.degrees(message.term1) for message in positions], rel=1e-15
    )
    assert pvt["vel_e_mps"].tolist() == [message.y for message in velocities]
    assert pvt["cov_nd_m2"].tolist() == [-message.covariance[2] for message in positions]
    assert pvt["cov_dd_m2"].tolist() == [message.covariance[8] for message in positions]
    assert pvt["cov_vel_nd_m2ps2"].tolist() == [message.covariance[2] for message in velocities]
    assert not pvt.has("h_acc_m")
    assert pva["vel_d_mps"].tolist() == [message.v3 for message in by_topic[maker.pva]]
    assert pva["receive_time_ns"].tolist() == [
        stamp for topic, _, stamp, _ in session if topic == maker.pva
    ]


def test_batches_do_not_matter(
    maker: Any, convert_bag: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = maker.bag(maker.session())
    whole = convert_bag(path)
    for batch, fetched in ((1, 1), (37, 5), (400, 512)):
        monkeypatch.setattr(sqlite_log, "BATCH_MESSAGES", batch)
        monkeypatch.setattr(sqlite_log, "FETCHED_MESSAGES", fetched)
        cut = convert_bag(path)
        assert dict(cut.recording) == dict(whole.recording)
        assert cut.recording.metadata == whole.recording.metadata


def test_half_epochs_become_rows_of_their_own(maker: Any, convert_bag: Callable[..., Any]) -> None:
    times = [START_NS + i * SECOND_NS for i in range(40)]
    messages = [
        maker.message(kind, t)
        for i, t in enumerate(times)
        for kind, missing in (("position", 5), ("velocity", 30))
        if i != missing
    ]
    result = convert_bag(maker.bag(messages))
    pvt = result.recording[EPOCHS]
    assert pvt.time_ns.tolist() == times
    assert np.flatnonzero(~pvt.valid("lat_deg")).tolist() == [5]
    assert np.flatnonzero(~pvt.valid("vel_n_mps")).tolist() == [30]
    assert result.used == len(messages)


def test_a_lone_side_is_kept(maker: Any, convert_bag: Callable[..., Any]) -> None:
    messages = [maker.message("velocity", START_NS + i * SECOND_NS) for i in range(5)]
    result = convert_bag(maker.bag(messages))
    assert len(result.recording[EPOCHS]) == 5
    assert not result.recording[EPOCHS].has("lat_deg")


def test_rows_of_equal_time_pair_by_their_order() -> None:
    def side(name: str, times: list[int]) -> RowBatch:
        columns = {
            "time_ns": np.array(times),
            "receive_time_ns": np.array(times) + 5,
            "record": np.arange(len(times)),
            name: np.array(times) * 1.0,
        }
        return rows.row_batch("gnss/pvt", columns)

    joined = rows.outer_join(side("lat_deg", [1, 2, 2, 3]), side("vel_n_mps", [2, 2, 4]))
    assert joined.time_ns.tolist() == [1, 2, 2, 3, 4]
    absent = {name: np.isnan(column.values).tolist() for name, column in joined.columns.items()}
    assert absent["lat_deg"] == [False, False, False, False, True]
    assert absent["vel_n_mps"] == [True, False, False, True, False]
    assert joined.units.tolist() == [1, 2, 2, 1, 1]


def test_sampled_rows_stay_as_they_are(maker: Any, convert_bag: Callable[..., Any]) -> None:
    messages = [maker.message("imu", START_NS + i * 10_000_000, imu_type=1) for i in range(10)]
    imu = convert_bag(maker.bag(messages)).recording["/imu0/imu"]
    assert imu["accel_x_mps2"].tolist() == [message.meas_accel[0] for *_, message in messages]
    assert set(imu["interval_s"].tolist()) == {0.0}


def test_a_lone_integrated_row_has_no_interval(maker: Any, convert_bag: Callable[..., Any]) -> None:
    path = maker.bag([maker.message("imu", START_NS), maker.message("velocity", START_NS)])
    assert [reject.reason for reject in convert_bag(path).rejects] == [
        f"{maker.imu}: a lone integrated row has no interval"
    ]
    assert len(convert_bag(path, imu_interval_s=0.01).recording["/imu0/imu"]) == 1


@pytest.mark.parametrize(
    ("rate_hz", "nominal_s"),
    [(100, 0.01), (99.7, 0.01), (1 / 2.56, 2.56), (200.4, 0.005), (12.5, 0.08)],
)
def test_nominal_interval(rate_hz: float, nominal_s: float) -> None:
    rng = np.random.default_rng(2)
    times = np.arange(1000) * 1e9 / rate_hz + rng.normal(0, 0.02e9 / rate_hz, 1000)
    assert rows.nominal_interval_s(times.astype(np.int64)) == pytest.approx(nominal_s, rel=2e-3)


@pytest.mark.parametrize(
    ("kind", "changes", "reason"),
    [
        ("position", {"reference_frame": 0}, "the frame is not geodetic"),
        ("velocity", {"reference_frame": 3}, "the frame is not NED"),
        ("pva", {"reference_frame": 0}, "the frame is not geodetic"),
        ("imu", {"imu_type": 2}, "the IMU type is neither integrated nor sampled"),
        ("position", {"term1": 1.6}, "the position is not on the globe"),
    ],
)
def test_what_cannot_be_used_is_refused_with_a_reason(
    maker: Any, convert_bag: Callable[..., Any], kind: str, changes: dict[str, Any], reason: str
) -> None:
    messages = [
        maker.message(kind, START_NS + i * SECOND_NS, **(changes if i == 3 else {}))
        for i in range(6)
    ]
    result = convert_bag(maker.bag(messages))
    assert [(reject.offset, reject.length) for reject in result.rejects] == [(3, 1)]
    assert reason in result.rejects[0].reason
    assert result.used == 5


def test_awkward_layouts_and_byte_orders_give_the_same_rows(
    maker: Any, convert_bag: Callable[..., Any], tmp_path: Path
) -> None:
    inner = maker.store.types[f"{aspn23.IMU.rpartition('/')[0]}/TypeIntegrity"](
        integrity_method=17, integrity_value=0.5
    )
    plain = [maker.message("position", START_NS + i * SECOND_NS) for i in range(30)]
    awkward = []
    for i, (topic, kind, stamp, message) in enumerate(plain):
        changed = type(message)(
            **{**vars(message), "integrity": [inner] * (i % 3), "num_integrity": i % 3}
        )
        awkward.append(
            (
                topic,
                kind,
                stamp,
                bytes(maker.store.serialize_cdr(changed, kind, little_endian=bool(i % 2))),
            )
        )
    one, two = (
        convert_bag(maker.bag(messages, name))
        for messages, name in ((plain, "plain"), (awkward, "awkward"))
    )
    assert one.recording[EPOCHS] == two.recording[EPOCHS]


def test_jitter_is_sorted_and_a_step_back_is_refused(
    maker: Any, convert_bag: Callable[..., Any]
) -> None:
    times = [START_NS + int(s * SECOND_NS) for s in (0, 1, 0.8, 2, 3, 1.9, 4, 5)]
    result = convert_bag(
        maker.bag([maker.message("pva", t, stamp_ns=START_NS + i) for i, t in enumerate(times)])
    )
    assert result.recording["/reference/pva"].time_ns.tolist() == sorted(times[:5] + times[6:])
    assert [(reject.offset, reject.reason) for reject in result.rejects] == [
        (5, f"time runs backwards in {maker.pva}")
    ]


def test_reference_is_a_device_of_its_own_or_as_told(
    maker: Any, convert_bag: Callable[..., Any]
) -> None:
    own, foreign = "/sensor/receiver/pva", "/sensor/ins/pva"
    messages = [
        maker.message("pva", START_NS + i * SECOND_NS, topic=topic)
        for i in range(3)
        for topic in (own, foreign)
    ]
    messages += [maker.message("position", START_NS + i * SECOND_NS) for i in range(3)]
    path = maker.bag(messages)
    chosen = convert_bag(path).recording
    assert chosen.metadata["source/reference"]["topic"] == foreign
    assert chosen.metadata["source/ins0"] == {"topic": own, "solution": "fused"}
    assert convert_bag(path, reference=own).recording.metadata["source/reference"]["topic"] == own
    assert "/reference/pva" not in convert_bag(path, reference="none").recording


def test_recorder_time(maker: Any, convert_bag: Callable[..., Any]) -> None:
    messages = [maker.message("pva", START_NS + i * SECOND_NS) for i in range(3)]
    recording = convert_bag(maker.bag(messages), time="recorder").recording
    assert recording["/reference/pva"].time_ns.tolist() == [stamp for _, _, stamp, _ in messages]
    assert recording.metadata["recording"]["clock"] == "recorder"


def test_roll_pitch_yaw_against_rotation_matrices() -> None:
    from scipy.spatial.transform import Rotation

    rotation = Rotation.random(200, rng=3)
    angles = aspn23.roll_pitch_yaw(np.roll(rotation.as_quat(), 1, axis=1))
    yaw, pitch, roll = rotation.as_euler("ZYX", degrees=True).T
    assert angles["roll_deg"] == pytest.approx(roll)
    assert angles["pitch_deg"] == pytest.approx(pitch)
    assert angles["yaw_deg"] == pytest.approx(yaw % 360)
    swap = Rotation.from_matrix([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    turned = aspn23.roll_pitch_yaw(
        aspn23.enu_to_ned(np.roll((swap * rotation * swap.inv()).as_quat(), 1, axis=1))
    )
    assert turned["yaw_deg"] == pytest.approx(yaw % 360)
    assert turned["roll_deg"] == pytest.approx(roll)


@pytest.mark.parametrize("decimals", [7, 9])
def test_degrees_undo_a_recorders_radians(decimals: int) -> None:
    decoded = np.round(np.random.default_rng(4).uniform(-180, 180, 10_000), decimals)
    assert np.array_equal(aspn23.degrees(np.deg2rad(decoded)), decoded)
    other = np.random.default_rng(5).uniform(-np.pi, np.pi, 10_000)
    assert aspn23.degrees(other) == pytest.approx(np.rad2deg(other), rel=1e-15)
