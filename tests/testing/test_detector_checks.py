"""The conformance kit refuses what it must refuse, and names the law that is broken."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from spoofbench.detector import Decisions, Detector
from spoofbench.errors import PluginError
from spoofbench.testing import CheckFailed, check_detector, run_detector_checks
from spoofbench.testing.detector_cases import difference
from spoofbench.testing.detectors import LAWS


def _module() -> ModuleType:
    """The detectors' module, which is on no path: as with a test's own, the kit must take it from
    its file.
    """
    spec = importlib.util.spec_from_file_location(
        "bad_detectors", Path(__file__).with_name("bad_detectors.py")
    )
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


bad: Any = _module()

BROKEN = {
    bad.DecidesLate: "warms_up_in_time",
    bad.LooksOneEpochAhead: "keeps_causality",
    bad.LooksOneSampleAhead: "keeps_causality",
    bad.DividesByTheWholeFilesMaximum: "keeps_causality",
    bad.ChoosesFieldsByTheWholeFile: "keeps_causality",
    bad.RemembersInItself: "keeps_no_state",
    bad.RemembersInItsClass: "needs_nothing_but_the_blind_recording",
    bad.AltersTheRecording: "leaves_the_recording",
    bad.WritesIntoColumns: "leaves_the_recording",
    bad.DrawsFromTheGlobalGenerator: "is_deterministic",
    bad.SeedsTheGlobalGenerator: "leaves_the_process",
    bad.DependsOnHashes: "needs_nothing_but_the_blind_recording",
    bad.PeeksAtItsCallers: "needs_nothing_but_the_blind_recording",
    bad.ReadsAFile: "needs_nothing_but_the_blind_recording",
    bad.ReadsAGlobal: "needs_nothing_but_the_blind_recording",
    bad.StumblesOverRepeatedTimes: "survives_degraded_recordings",
    bad.StumblesOverEmptiness: "survives_degraded_recordings",
    bad.NeedsWhatItOnlyUses: "does_without_what_it_does_not_require",
    bad.FailsWithoutItsKinds: "says_what_is_missing",
    bad.NeverKnows: "decides",
    bad.ScoresMinusInfinity: "decides",
    bad.IsNotFrozen: "is_a_frozen_dataclass",
    bad.TakesAnyParameter: "is_a_frozen_dataclass",
    bad.RequiresAnUnknownKind: "declares_its_needs",
    bad.HasEndlessMemory: "declares_its_needs",
    bad.CannotBePickled: "pickles",
    bad.LearnsInPlace: "fits_a_copy",
    bad.BecomesAnother: "fits_a_copy",
    bad.LearnsByChance: "fits_alike_twice",
    bad.LearnsInSecretFromAttacks: "learns_only_what_it_declares",
    bad.LooksAheadOnceFitted: "keeps_the_laws_when_fitted",
}


@check_detector(bad.Honest())
def test_an_honest_detector_passes(check: Any) -> None:
    check()


@pytest.mark.parametrize("learner", [bad.HonestLearner, bad.RefusesToLearn])
def test_an_honest_learner_passes(learner: type[Detector]) -> None:
    assert [one.reason for one in run_detector_checks(learner()) if not one.passed] == []


@pytest.mark.parametrize(
    ("detector", "law"), [pytest.param(*pair, id=pair[0].__name__) for pair in BROKEN.items()]
)
def test_a_broken_law_is_named(
    detector: type[Detector], law: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(bad.ATTACKED, "from_ns", 1_700_000_000_000_000_000 + 120 * 10**9)
    failed = {
        result.name: result.reason
        for result in run_detector_checks(detector())
        if not result.passed
    }
    assert law in failed
    assert failed[law]


def test_every_law_has_a_detector_that_breaks_it() -> None:
    assert {law.__name__ for law in LAWS} == set(BROKEN.values())


def test_looking_one_epoch_ahead_is_refused_with_the_reason() -> None:
    checks = check_detector(bad.LooksOneEpochAhead()).args[1]
    with pytest.raises(
        CheckFailed,
        match=r"with the rows after \d+ cut off, an earlier decision changes: the score at \d+ is",
    ):
        next(check for check in checks if str(check) == "keeps_causality")()


def decisions(*scores: float | None) -> Decisions:
    score = np.array([np.nan if value is None else value for value in scores], float)
    return Decisions(np.arange(len(scores)), score, ~np.isnan(score))


@pytest.mark.parametrize(
    ("left", "right", "until", "reason"),
    [
        (decisions(0.5, 2.0), decisions(0.5, 2.0), None, None),
        (decisions(0.5, 2.0), decisions(0.5, 2.0 + 1e-9), None, None),
        (decisions(0.5, 2.0), decisions(0.5, 2.0 + 1e-8), None, "the score at 1 is"),
        (decisions(0.5, 2.0), decisions(0.5, 9.0), 0, None),
        (decisions(0.0), decisions(1e-300), None, "the score at 0 is"),
        (decisions(1 - 5e-10), decisions(1 + 4e-10), None, None),
        (decisions(1 - 1e-6), decisions(1 + 1e-6), None, "the score at 0 is"),
        (decisions(np.inf), decisions(np.inf), None, None),
        (decisions(np.inf), decisions(9.0), None, "the score at 0 is"),
        (decisions(None, 0.1), decisions(0.1, 0.1), None, "availability differs at 0"),
        (decisions(0.1), decisions(0.1, 0.1), None, "1 decisions against 2"),
        (decisions(0.1), decisions(0.1, 0.1), 0, None),
        (decisions(None, None), None, None, None),
        (decisions(None, 0.1), None, None, "1 available decisions against a refusal"),
        (decisions(None, 0.1), None, 0, None),
        (None, None, None, None),
    ],
)
def test_difference(
    left: Decisions | None, right: Decisions | None, until: int | None, reason: str | None
) -> None:
    for one, other in ((left, right), (right, left)):
        found = difference(one, other, until)
        assert (found is None) == (reason is None)
    assert reason is None or reason in str(difference(left, right, until))


def test_a_missing_plugin_is_an_error_not_a_result() -> None:
    with pytest.raises(PluginError, match="no detector is called 'no-such'"):
        run_detector_checks("no-such")
    with pytest.raises(PluginError, match="no detector is called 'no-such'"):
        check_detector("no-such", level=3).args[1][0]()
