"""From file to file: where the window lies, and what is told of it."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from spoofbench.attacks.contract import attack_file, parameters_of
from spoofbench.attacks.synthetic import DragOff
from spoofbench.codec import read, write
from spoofbench.errors import NotApplicable, PluginError
from spoofbench.testing import drive


def test_a_window_lies_where_it_is_told_to(tmp_path: Path) -> None:
    clean, out = tmp_path / "clean.mcap", tmp_path / "variant.mcap"
    write(drive(0, 120.0, flaws=False), clean)
    (row,) = attack_file(
        clean, out, "drag-off", {"rate_mps": 2.0}, start_s=40.0, duration_s=30.0, seed=3
    )
    assert 40.0 <= row["start_s"] < 42.0
    assert 68.0 < row["end_s"] <= 70.0
    truth = read(out)["/truth/attack"]
    assert {name: row[name] for name in ("start_ns", "end_ns", "strength", "seed")} == {
        "start_ns": truth["start_ns"][0],
        "end_ns": truth["end_ns"][0],
        "strength": 2.0,
        "seed": 3,
    }


def test_a_window_without_a_start_is_drawn_by_the_seed(tmp_path: Path) -> None:
    clean, out = tmp_path / "clean.mcap", tmp_path / "variant.mcap"
    write(drive(0, 120.0, flaws=False), clean)
    starts_s = [
        attack_file(clean, out, "drag-off", {}, duration_s=20.0, seed=seed)[0]["start_s"]
        for seed in (0, *range(6))
    ]
    assert starts_s[0] == starts_s[1]
    assert len({*starts_s}) > 3  # two draws may meet


@pytest.mark.parametrize("delay_s", [119.5, 1e12, 1e300])
def test_a_delay_beyond_the_recording_is_refused(delay_s: float, tmp_path: Path) -> None:
    clean = tmp_path / "clean.mcap"
    write(drive(0, 60.0, flaws=False), clean)
    for start_s in (None, 30.0):
        with pytest.raises(NotApplicable, match="of history that the attack needs"):
            attack_file(
                clean,
                tmp_path / "variant.mcap",
                "replay",
                {"delay_s": delay_s},
                start_s=start_s,
                duration_s=10.0,
            )


def test_a_window_beyond_the_recording_is_refused(tmp_path: Path) -> None:
    clean = tmp_path / "clean.mcap"
    write(drive(0, 120.0), clean)
    with pytest.raises(NotApplicable, match=r"from 100.0 s for 30.0 s does not lie within"):
        attack_file(
            clean, tmp_path / "variant.mcap", "drag-off", {}, start_s=100.0, duration_s=30.0
        )
    assert not (tmp_path / "variant.mcap").exists()


def test_parameters_of_any_readable_sort_are_stated_in_the_truth() -> None:
    @dataclass(frozen=True)
    class Odd(DragOff):
        log: Path = Path("a/b")
        gain: np.float32 = np.float32(0.5)  # noqa: RUF009
        what: object = None

    stated = json.loads(parameters_of("odd", Odd()))
    assert (stated["log"], stated["gain"]) == ("a/b", 0.5)
    with pytest.raises(PluginError, match="a parameter that JSON cannot hold"):
        parameters_of("odd", Odd(what=object()))
