"""Contradictions on standstill: counted by hand, and on drives."""

import math
from typing import Any

import numpy as np
import pytest
from spoofbench_correlation import ZeroVelocity

from spoofbench.detector import detect
from spoofbench.recording import Recording
from spoofbench.table import Table
from spoofbench.testing import drive, spoofed_drive

SECOND = 1_000_000_000


def staged(gnss_moves: list[int], imu_moves: list[int]) -> Recording:
    """One epoch per second; the IMU turns, or does not, in the second that ends at the epoch."""
    n = len(gnss_moves)
    time_ns = np.arange(1, n * 100 + 1) * (SECOND // 100)
    rate = 0.1 * np.repeat(imu_moves, 100)
    columns = {
        **{f"accel_{axis}_mps2": np.zeros(time_ns.size) for axis in "xyz"},
        "interval_s": np.full(time_ns.size, 0.01),
    }
    columns |= {
        "gyro_x_radps": np.zeros(time_ns.size),
        "gyro_y_radps": np.zeros(time_ns.size),
        "gyro_z_radps": rate,
    }
    pvt = {
        "vel_n_mps": 5.0 * np.array(gnss_moves),
        "vel_e_mps": np.zeros(n),
        "vel_d_mps": np.zeros(n),
    }
    return Recording(
        {
            "/i/imu": Table("imu", time_ns, columns),
            "/g/gnss/pvt": Table("gnss/pvt", np.arange(1, n + 1) * SECOND, pvt),
        },
        {"primary": {"imu": "i", "gnss/pvt": "g"}},
    )


@pytest.mark.parametrize(
    ("contradiction", "counts"),
    [
        ("either", [0, 1, 1, 2, 3, 2]),
        ("gnss_still", [0, 1, 1, 1, 1, 0]),
        ("imu_still", [0, 0, 0, 1, 2, 2]),
    ],
)
def test_counts_seconds_of_contradiction(contradiction: Any, counts: list[int]) -> None:
    """GNSS stands still over the first two pairs, starts in the third, which is none, and moves
    over the rest.
    """
    recording = staged([0, 0, 0, 1, 1, 1, 1], [0, 0, 1, 1, 0, 0, 1])
    found = detect(
        ZeroVelocity(contradiction, window_s=4, threshold_per_min=15, min_share=0.25), recording
    )
    seconds = [1, 2, 3, 4, 4, 4]
    assert found.available.tolist() == [False, *([True] * 6)]
    assert found.score[1:] == pytest.approx(
        [60 * count / known / 15 for count, known in zip(counts, seconds, strict=True)]
    )


def test_unknown_motion_is_no_contradiction_and_too_much_of_it_no_statistic() -> None:
    recording = staged([0] * 10, [1] * 10)
    table = recording["/g/gnss/pvt"]
    lost = recording.replace(
        {"/g/gnss/pvt": table.replace(vel_e_mps=np.where(np.arange(10) == 5, np.nan, 0.0))}
    )
    found = detect(ZeroVelocity(window_s=4, min_share=0.75), lost)
    assert found.available.tolist() == [
        False,
        False,
        False,
        True,
        True,
        True,
        False,
        False,
        False,
        True,
    ]


def test_the_lag_shifts_the_imu() -> None:
    moves = [0, 0, 0, 1, 1, 1, 1, 0, 0, 0, 0, 1, 1, 1]
    late = staged([0, 0, *moves[:-2]], moves)
    raw, corrected = (
        detect(ZeroVelocity(window_s=12, min_share=0.5, lag_s=lag), late) for lag in (0.0, 2.0)
    )
    assert np.nanmax(raw.score) > 1
    assert np.nanmax(corrected.score) == 0


@pytest.mark.parametrize("seed", range(3))
def test_a_drive_does_not_contradict_itself_and_its_replay_does(seed: int) -> None:
    """The roads of these drives are so smooth that an IMU may stand still on them: one kind alone
    is counted.
    """
    genuine, replay = (
        detect(ZeroVelocity("gnss_still", window_s=60), r)
        for r in (drive(seed, 400.0), spoofed_drive(seed, 400.0))
    )
    assert np.nanmax(genuine.score) <= 1
    assert np.nanmax(replay.score) > 1


@pytest.mark.parametrize(
    "parameters",
    [
        {"contradiction": "both"},
        {"lag_s": -1},
        {"min_share": 1.1},
        {"smooth_s": 0.6},
        {"speed_mps": 0},
        {"force_std_mps2": math.nan},
        {"rate_rms_radps": 0},
        {"window_s": math.inf},
        {"threshold_per_min": 0},
    ],
    ids=str,
)
def test_refuses_parameters_that_make_no_sense(parameters: dict[str, Any]) -> None:
    (name, value), *_ = parameters.items()
    with pytest.raises(ValueError, match=f"{name} must be .*{value!r}"):
        ZeroVelocity(**parameters)
