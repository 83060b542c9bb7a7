"""Scenarios from files: what is wrong is said in one sentence."""

from pathlib import Path

import pytest

from spoofbench.errors import ScenarioError
from spoofbench.integrity import load_scenario

GOOD = Path(__file__).parents[2] / "src/spoofbench/integrity/scenarios/tanil2018-C.toml"


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("rate_hz = 2.0", "rate_hz = 0", "rate_hz"),
        ("rate_hz = 2.0", "rate_hz = 'fast'", "must be a number"),
        ("rate_hz = 2.0", "rates_hz = 2.0", "rates_hz"),
        ("code_noise_m = 0.5\n", "", "incomplete"),
        ("[imu]", "[inertial]", "inertial"),
        ("period_s = 140.0", "period_s = nan", "period_s"),
        ("period_s = 140.0", "period_s =", "cannot be read"),
        ("[[15, 82],", "[[15],", "azimuth"),
    ],
)
def test_mistakes(tmp_path: Path, old: str, new: str, what: str) -> None:
    text = GOOD.read_text()
    assert old in text
    (tmp_path / "mine.toml").write_text(text.replace(old, new))
    with pytest.raises(ScenarioError, match=what):
        load_scenario(tmp_path / "mine.toml")
