"""Detectors that learn with scikit-learn keep the contract, as a stranger's would."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spoofbench import plugins
from spoofbench.detector import Labelled, Trainable, detect, learns_from_attacks
from spoofbench.errors import NotApplicable
from spoofbench.recording import attacked_intervals
from spoofbench.testing import drive, run_detector_checks, spoofed_drive

pytest.importorskip("sklearn", reason="scikit-learn is not installed")
pytestmark = pytest.mark.usefixtures("fakes")

NAMES = ("isolation-trees", "attack-trees")


def made(name: str, **parameters: Any) -> Trainable:
    detector = plugins.make(plugins.DETECTORS, name, parameters)
    assert isinstance(detector, Trainable)
    return detector


@pytest.mark.parametrize("name", NAMES)
def test_conformance(name: str, fakes: Path) -> None:
    assert [one for one in run_detector_checks(name) if not one.passed] == []


def test_chance_comes_from_the_seed() -> None:
    clean = [drive(seed, 120.0).blind() for seed in (1, 2)]
    models = [made("isolation-trees", seed=seed).fit(clean, []).model for seed in (0, 0, 1)]
    assert models[0] == models[1] != models[2]


def test_one_learns_from_attacks_and_memorises_them() -> None:
    """In sample it knows every epoch: a threshold from the same recordings would mean nothing."""
    detector = made("attack-trees")
    assert learns_from_attacks(detector)
    assert not learns_from_attacks(made("isolation-trees"))
    clean, spoofed = drive(3, 240.0), spoofed_drive(4, 240.0)
    labelled = Labelled(spoofed.blind(), attacked_intervals(spoofed))
    fitted = detector.fit([clean.blind()], [labelled])
    seen, unseen = (detect(fitted, one).alert.mean() for one in (clean, drive(5, 240.0)))
    assert seen == 0
    assert unseen > 0.02
    with pytest.raises(NotApplicable, match="no attacked recording"):
        detector.fit([clean.blind()], [])


def test_nothing_is_available_before_fitting() -> None:
    for name in NAMES:
        decisions = detect(made(name), drive(1, 60.0))
        assert decisions.time_ns.size
        assert not np.any(decisions.available)
