"""Scenarios from files: what is wrong is said in one sentence."""

from pathlib import Path

import pytest
from spoofbench_papers.integrity import load_scenario
from spoofbench_papers.integrity.scenario import ScenarioError

GOOD = Path(__file__).parents[2] / "src/spoofbench_papers/integrity/scenarios/tanil2018-C.toml"


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("rate_hz = 2.0", "rate_hz = 0", "rate_hz"),
        ("rate_hz = 2.0", "rate_hz = 'fast'", "must be a number"),
        ("rate_hz = 2.0", "rates_hz = 2.0", "rates_hz"),
        ("code_noise_m = 0.5\n", "", "lacks the key 'code_noise_m'"),
        ("[imu]", "[inertial]", "inertial"),
        ("period_s = 140.0", "period_s = nan", "period_s"),
        ("period_s = 140.0", "period_s =", "is not TOML"),
        ("[[15, 82],", "[[15],", "a list of 2 values"),
        ("[[15, 82],", "[['north', 82],", "'north' must be a number"),
        ("[[15, 82],", "[[nan, 82],", "a finite number"),
        ("[[15, 82],", "[[15, 100],", "elevation"),
        ("rate_hz = 2.0", "rate_hz = 2.0\nreference = 6", "reference"),
        ("rate_hz = 2.0", "rate_hz = 2.0\nreference = -1", "reference"),
        ("rate_hz = 2.0", "rate_hz = 2.0\nreference = 0.5", "reference"),
        ("rate_hz = 2.0", "rate_hz = 2.0\nname = 5", "name"),
        ("rate_hz = 2.0", "rate_hz = 1e-5", "code_multipath_s"),
        ("code_noise_m = 0.5", "code_noise_m = 0", "code_noise_m"),
        ("carrier_noise_m = 0.002", "carrier_noise_m = -0.002", "carrier_noise_m"),
        ("code_multipath_m = 0.3", "code_multipath_m = nan", "code_multipath_m"),
        ("code_multipath_s = 100.0", "code_multipath_s = 1e-6", "code_multipath_s"),
        ("accel_bias_s = 3600.0", "accel_bias_s = 0.0", "accel_bias_s"),
        ("accel_bias_mps2 = 9.80665e-5", "accel_bias_mps2 = inf", "accel_bias_mps2"),
        ("alert_limit_m = 10.0", "alert_limit_m = 1" + 400 * "0", "alert_limit_m"),
        ("warm_up_s = 9000.0", "warm_up_s = 1e12", "warm_up_s"),
        ("period_s = 140.0", "period_s = 1e9", "period_s"),
        ("[imu]", "[initial]\nposition_m = nan\n[imu]", "position_m"),
    ],
)
def test_mistakes(tmp_path: Path, old: str, new: str, what: str) -> None:
    text = GOOD.read_text()
    assert old in text
    (tmp_path / "mine.toml").write_text(text.replace(old, new))
    with pytest.raises(ScenarioError, match=what):
        load_scenario(tmp_path / "mine.toml")


def test_altitude_needs_unlike_elevations(tmp_path: Path) -> None:
    level = "satellites_deg = [[15, 40], [95, 40], [215, 40]]"
    (tmp_path / "mine.toml").write_text("\n".join([level, *GOOD.read_text().split("\n")[3:]]))
    with pytest.raises(ScenarioError, match="elevation"):
        load_scenario(tmp_path / "mine.toml")
