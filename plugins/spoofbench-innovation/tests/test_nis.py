"""The numbers on how well the filter fits: right on innovations that are as modelled, and on
correlated ones.
"""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from spoofbench_innovation import InnovationMonitor, nis

from spoofbench import codec
from spoofbench.errors import RecordingError
from spoofbench.testing import drive


@pytest.fixture(scope="module")
def numbers() -> dict[str, Any]:
    return nis.measure(drive(1, 600.0, 2.0), InnovationMonitor(), 200.0)


def test_the_parts_make_the_whole(numbers: dict[str, Any]) -> None:
    raw, inflated = numbers["raw"], numbers["inflated"]
    inflation = numbers["calibration"]["inflation"]
    assert raw["epochs"] + numbers["calibration"]["epochs"] < 1200
    for part, value in raw["mean_per_measurement"].items():
        assert inflated["mean_per_measurement"][part] == pytest.approx(value / inflation)
    assert raw["quantiles"]["0.99"]["chi_square"] == pytest.approx(16.81, abs=0.01)


def test_sums_of_independent_chi_squares_have_the_nominal_probability() -> None:
    rng = np.random.default_rng(0)
    white = nis._of_sums(rng.chisquare(6, 20_000), 1.0, 1e-3)
    assert white["variance_factor"] < 1.3
    assert white["raw_p_fa"] == pytest.approx(1e-3, rel=0.9)


def test_correlated_epochs_make_a_sum_exceed_more_often() -> None:
    """Epochs repeated ten times over: the variance of the sum grows tenfold."""
    repeated = np.repeat(np.random.default_rng(1).chisquare(6, 4000), 10)
    found = nis._of_sums(repeated, 1.0, 1e-6)
    assert found["variance_factor"] == pytest.approx(10, rel=0.2)
    assert found["raw_p_fa"] > 1e-3


def test_too_short_a_recording_is_refused() -> None:
    with pytest.raises(RecordingError, match="at least 100"):
        nis.measure(drive(1, 120.0), InnovationMonitor(), 60.0)


def test_command(tmp_path: Path, numbers: dict[str, Any]) -> None:
    codec.write(drive(1, 600.0, 2.0), tmp_path / "drive.mcap")
    command = [
        sys.executable,
        "-m",
        "spoofbench_innovation.nis",
        str(tmp_path / "drive.mcap"),
        "--calibration-s",
        "200",
    ]
    answer = subprocess.run(
        [*command, "--json", "--picture", str(tmp_path / "nis")],
        check=True,
        capture_output=True,
        text=True,
    )
    told = json.loads(answer.stdout)
    assert told.keys() == numbers.keys()
    for block, key in (("calibration", "inflation"), ("cumulative", "variance_factor")):
        assert told[block][key] == pytest.approx(numbers[block][key])
    assert told["raw"]["mean_per_measurement"] == pytest.approx(
        numbers["raw"]["mean_per_measurement"]
    )
    assert (tmp_path / "nis.png").exists()
    assert (tmp_path / "nis.svg").exists()
    text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    assert max(map(len, text.splitlines())) <= 110
    refused = subprocess.run([*command[:-1], "5"], check=False, capture_output=True, text=True)
    assert refused.returncode == 1
    assert refused.stderr.count("\n") == 1
