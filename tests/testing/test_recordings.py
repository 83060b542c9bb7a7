"""The kit's drives are realistic where it matters: sensors that saw one motion, flaws, every kind
of the schema.
"""

import numpy as np
import pymap3d
import pytest

from spoofbench.recording import Recording
from spoofbench.schema import SENSOR_KINDS
from spoofbench.testing import drive, spoofed_drive
from spoofbench.testing.detector_cases import cuts, futures
from spoofbench.testing.motion import GRAVITY_MPS2, STEP_S, body_from_ned, make_motion


def test_the_same_arguments_give_the_same_rows() -> None:
    assert drive(3, 60.0).digest() == drive(3, 60.0).digest()
    assert drive(3, 60.0).digest() != drive(4, 60.0).digest()


def test_every_kind_is_there_and_has_a_primary_source() -> None:
    recording = drive(0, 60.0, second_sources=True)
    assert recording.kinds == SENSOR_KINDS | {"reference/pva"}
    assert set(recording.metadata["primary"]) == SENSOR_KINDS
    assert recording.topics("gnss/pvt") == ("/gnss0/gnss/pvt", "/gnss1/gnss/pvt")
    assert recording.topics("imu") == ("/imu0/imu", "/imu1/imu")


@pytest.mark.parametrize("seed", range(5))
def test_a_strapdown_of_the_true_inertial_data_gives_the_true_motion(seed: int) -> None:
    """Attitude from the angular rates, velocity from the specific force turned by it, position from
    that.
    """
    motion = make_motion(np.random.default_rng(seed), 120.0)
    roll_pitch_yaw = motion.attitude_rad[0].copy()
    velocity = motion.velocity_mps[0].copy()
    for k in range(1, motion.time_s.size):
        wx, wy, wz = motion.angular_rate_radps[k]
        pitch = roll_pitch_yaw[1] + wy * STEP_S / 2
        step = np.array([wx + wz * np.tan(pitch), wy, wz / np.cos(pitch)]) * STEP_S
        turn = body_from_ned((roll_pitch_yaw + step / 2)[None])[0].T
        velocity += (turn @ motion.specific_force_mps2[k] + [0, 0, GRAVITY_MPS2]) * STEP_S
        roll_pitch_yaw += step
    np.testing.assert_allclose(roll_pitch_yaw, motion.attitude_rad[-1], atol=1e-6)
    np.testing.assert_allclose(velocity, motion.velocity_mps[-1], atol=1e-3)


@pytest.mark.parametrize("seed", range(5))
def test_it_is_a_car(seed: int) -> None:
    motion = make_motion(np.random.default_rng(seed), 240.0)
    speed = np.linalg.norm(motion.velocity_mps, axis=1)
    assert 6 < speed.max() < 20
    assert 0.1 < (speed < 0.3).mean() < 0.6
    assert np.abs(motion.specific_force_mps2[:, :2]).max() < 6
    assert np.degrees(np.abs(motion.attitude_rad[:, 1])).max() < 4
    assert np.ptp(motion.attitude_rad[:, 2]) > 0.5


def test_positions_are_the_integral_of_the_velocities() -> None:
    motion = make_motion(np.random.default_rng(0), 120.0)
    travelled = np.sum((motion.velocity_mps[1:] + motion.velocity_mps[:-1]) * STEP_S / 2, axis=0)
    ned = pymap3d.geodetic2ned(*motion.position[-1], *motion.position[0])
    np.testing.assert_allclose(ned, travelled, atol=0.3)


def test_the_flaws_are_there_and_can_be_left_out() -> None:
    flawed, clean = drive(1, 120.0), drive(1, 120.0, flaws=False)
    longest = {
        name: np.diff(r["/gnss0/gnss/pvt"].time_ns).max() / 1e9
        for name, r in (("flawed", flawed), ("clean", clean))
    }
    assert longest["flawed"] > 8
    assert longest["clean"] == pytest.approx(1.0)
    assert np.isnan(flawed["/gnss0/gnss/pvt"]["vel_n_mps"]).sum() == 1
    assert not np.isnan(clean["/gnss0/gnss/pvt"]["vel_n_mps"]).any()
    assert np.diff(flawed["/imu0/imu"].time_ns).max() / 1e9 > 1.4


def test_a_spoofed_drive_is_the_clean_one_until_the_attack() -> None:
    clean, spoofed = drive(2, 120.0), spoofed_drive(2, 120.0)
    truth = spoofed["/truth/attack"]
    start, end = int(truth["start_ns"][0]), int(truth["end_ns"][0])
    assert clean.until(start - 1) == _without_truth(spoofed).until(start - 1)
    attacked = spoofed["/gnss0/gnss/pvt"].time_ns >= start
    assert attacked.any()
    assert spoofed.span.end_ns >= end
    assert not np.array_equal(
        spoofed["/gnss0/gnss/pvt"]["vel_n_mps"][attacked],
        clean["/gnss0/gnss/pvt"]["vel_n_mps"][attacked],
    )


def _without_truth(recording: Recording) -> Recording:
    return recording.replace({"/truth/attack": None})


def test_futures_keep_the_past_and_change_the_rest() -> None:
    blind = drive(5, 60.0).blind()
    for time_ns in cuts(blind.primary("gnss/pvt").time_ns, thorough=True):
        others = dict(futures(blind, time_ns))
        assert list(others) == ["cut off", "scrambled", "altered"]
        for other in others.values():
            assert other.until(time_ns) == blind.until(time_ns)
            assert other == blind or time_ns < blind.span.end_ns - 1
        assert (
            not any(others[name] == blind for name in others)
            or time_ns >= blind.primary("gnss/pvt").time_ns[-1]
        )
