"""The conformance kit refuses what it must refuse, and names the law that is broken."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from spoofbench.detecting import Detector
from spoofbench.errors import PluginError
from spoofbench.testing import CheckFailed, detector_checks, run_checks
from spoofbench.testing.detectors import LAWS


def _module() -> ModuleType:
    """The detectors' module, which is on no path: as with a test's own, the kit must take it from its file."""
    spec = importlib.util.spec_from_file_location("bad_detectors", Path(__file__).with_name("bad_detectors.py"))
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


bad: Any = _module()

BROKEN = {
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
    bad.StumblesOverRepeatedTimes: "survives_poor_recordings",
    bad.StumblesOverEmptiness: "survives_poor_recordings",
    bad.NeedsWhatItOnlyUses: "does_without_what_it_does_not_require",
    bad.FailsWithoutItsKinds: "says_what_is_missing",
    bad.NeverKnows: "decides",
    bad.ScoresMinusInfinity: "decides",
    bad.IsNotFrozen: "is_a_frozen_dataclass",
    bad.TakesAnyParameter: "is_a_frozen_dataclass",
    bad.RequiresAnUnknownKind: "declares_its_needs",
    bad.HasEndlessMemory: "declares_its_needs",
    bad.CannotBePickled: "pickles",
}


@detector_checks(bad.Honest())
def test_an_honest_detector_passes(check: Any) -> None:
    check()


@pytest.mark.parametrize(("detector", "law"), [pytest.param(*pair, id=pair[0].__name__) for pair in BROKEN.items()])
def test_a_broken_law_is_named(detector: type[Detector], law: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(bad.ATTACKED, "from_ns", 1_700_000_000_000_000_000 + 120 * 10**9)
    failed = {result.name: result.reason for result in run_checks(detector()) if not result.passed}
    assert law in failed
    assert failed[law]


def test_every_law_has_a_detector_that_breaks_it() -> None:
    assert {law.__name__ for law in LAWS} == set(BROKEN.values())


def test_looking_one_epoch_ahead_is_refused_with_the_reason() -> None:
    checks = detector_checks(bad.LooksOneEpochAhead()).args[1]
    with pytest.raises(CheckFailed, match=r"with the rows after \d+ cut off, an earlier decision changes: the score at \d+ is"):
        next(check for check in checks if str(check) == "keeps_causality")()


def test_a_missing_plugin_is_an_error_not_a_result() -> None:
    with pytest.raises(PluginError, match="no detector is called 'no-such'"):
        run_checks("no-such")
    with pytest.raises(PluginError, match="no detector is called 'no-such'"):
        detector_checks("no-such", level=3).args[1][0]()
