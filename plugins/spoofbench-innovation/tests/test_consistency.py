"""The filter in a world that is as it models it: innovations of a simulated drive are chi-square,
with all sensors' errors drawn.
"""

import numpy as np
import pytest
from spoofbench_innovation import InnovationMonitor, filtering
from spoofbench_innovation.error_model import GRADES, GradeName

from spoofbench.navigation.gnss import EARTH_RATE_RADPS, normal_gravity_mps2
from spoofbench.recording import Recording
from spoofbench.table import Table
from spoofbench.testing.motion import STEP_S, body_from_ned, make_motion

NOISE = {"position_m": 1.5, "vertical_m": 3.0, "velocity_mps": 0.05, "climb_mps": 0.1}


def simulated(grade: GradeName, seed: int, duration_s: float = 400.0) -> Recording:
    """A drive over a flat, rotating Earth of normal gravity; white GNSS errors at 1 Hz, IMU of this
    grade at 100 Hz.
    """
    rng = np.random.default_rng(seed)
    motion, errors = make_motion(rng, duration_s), GRADES[grade]
    lat, height = np.radians(motion.position[0, 0]), motion.position[0, 2]
    middle = (motion.attitude_rad[1:] + motion.attitude_rad[:-1]) / 2
    to_body = body_from_ned(middle)
    force = np.matvec(
        to_body,
        np.diff(motion.velocity_mps, axis=0) / STEP_S - [0, 0, normal_gravity_mps2(lat, height)],
    )
    rate = motion.angular_rate_radps[1:] + to_body @ (
        EARTH_RATE_RADPS * np.array([np.cos(lat), 0, -np.sin(lat)])
    )
    for values, white, bias in (
        (force, errors.velocity_random_walk, errors.accel_bias_mps2),
        (rate, errors.angle_random_walk, errors.gyro_bias_radps),
    ):
        values += rng.normal(0, bias, 3) + rng.normal(0, white / np.sqrt(STEP_S), values.shape)
    time_ns = np.round(motion.time_s * 1e9).astype(np.int64)
    names = [
        f"{sensor}_{axis}_{unit}"
        for sensor, unit in (("accel", "mps2"), ("gyro", "radps"))
        for axis in "xyz"
    ]
    imu = Table("imu", time_ns[1:], dict(zip(names, np.column_stack([force, rate]).T, strict=True)))
    epochs = np.arange(100, motion.time_s.size, 100)
    deviations = [
        NOISE[name]
        for name in (
            "position_m",
            "position_m",
            "vertical_m",
            "velocity_mps",
            "velocity_mps",
            "climb_mps",
        )
    ]
    noise = rng.normal(0, 1, (epochs.size, 6)) * deviations
    metres = np.degrees(
        1 / 6.371e6
    )  # of a degree; which Earth does not matter for the size of noise
    fields = {
        "lat_deg": motion.position[epochs, 0] + noise[:, 0] * metres,
        "lon_deg": motion.position[epochs, 1] + noise[:, 1] * metres / np.cos(lat),
        "height_m": motion.position[epochs, 2] - noise[:, 2],
    }
    fields |= {
        f"vel_{axis}_mps": motion.velocity_mps[epochs, i] + noise[:, 3 + i]
        for i, axis in enumerate("ned")
    }
    return Recording(
        {"/imu0/imu": imu, "/gnss0/gnss/pvt": Table("gnss/pvt", time_ns[epochs], fields)}
    )


def mean_nis(grade: GradeName, seeds: range) -> float:
    """Mean of the squared innovations per measurement, from a minute after the alignment on."""
    squared, measured = 0.0, 0
    for seed in seeds:
        _, found = InnovationMonitor(grade=grade, **NOISE).filtered(simulated(grade, seed))
        settled = np.flatnonzero(found.run >= 0)[60:]
        squared, measured = (
            squared + found.squared[settled].sum(),
            measured + found.measured[settled].sum(),
        )
    assert measured > 1000
    return float(squared / measured)


@pytest.mark.parametrize("grade", ["consumer", "automotive", "tactical"])
def test_the_squared_innovations_have_the_mean_of_chi_square(grade: GradeName) -> None:
    """A few thousand values: 1 within 5 %, if alignment, motion, rotation of the Earth, gravity and
    covariances are right.
    """
    assert mean_nis(grade, range(4)) == pytest.approx(1.0, abs=0.05)


def test_a_navigation_grade_imu_is_better_than_a_filter_levelled_by_accelerometers() -> None:
    """A tilt of E leaves g E^2 / 2, a hundred times its accelerometers' bias for 3 deg: the mean is
    too large, by less than a quarter.
    """
    assert 1.0 < mean_nis("navigation", range(4)) < 1.25


def test_the_rotation_of_the_earth_is_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    right = mean_nis("navigation", range(2))
    monkeypatch.setattr(filtering, "EARTH_RATE_RADPS", -EARTH_RATE_RADPS)
    assert mean_nis("navigation", range(2)) > 1.5 * right
