"""The conformance kit of converters refuses what it must refuse, and names the law that is
broken.
"""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from spoofbench.errors import PluginError
from spoofbench.testing import check_converter, run_converter_checks
from spoofbench.testing.converters import LAWS


def _module() -> ModuleType:
    """The converters' module, which is on no path: as with a test's own, the kit must take it from
    its file.
    """
    spec = importlib.util.spec_from_file_location(
        "bad_converters", Path(__file__).with_name("bad_converters.py")
    )
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


bad: Any = _module()

BROKEN = {
    bad.HasNoVersion: "declares_itself",
    bad.CountsSentences: "declares_itself",
    bad.HasOptionsThatAreNotFrozen: "declares_itself",
    bad.HasAnOptionWithoutDefault: "declares_itself",
    bad.JudgesByName: "recognises_by_content",
    bad.ClaimsAnyText: "recognises_by_content",
    bad.SniffsWithAnException: "recognises_by_content",
    bad.IsTooSure: "recognises_by_content",
    bad.GivesNothing: "converts",
    bad.YieldsTables: "converts",
    bad.RunsBackwards: "gives_rows_in_order",
    bad.CountsFromTheStart: "gives_rows_in_order",
    bad.SwapsLatitudeAndScale: "says_what_can_be",
    bad.FillsWithInfinity: "says_what_can_be",
    bad.InventsAnEnum: "says_what_can_be",
    bad.DoesNotSayWhatItsSourcesAre: "says_what_can_be",
    bad.ForgetsNoise: "accounts_for_every_unit",
    bad.RejectsBeyondTheEnd: "accounts_for_every_unit",
    bad.RejectsTwice: "accounts_for_every_unit",
    bad.Remembers: "is_deterministic",
    bad.TellsTheFilesName: "depends_on_content_alone",
    bad.TakesLocalTime: "depends_on_content_alone",
    bad.DependsOnHashes: "depends_on_content_alone",
    bad.ReadsNumbersByLocale: "depends_on_content_alone",
    bad.LeavesATemporaryFile: "depends_on_content_alone",
    bad.WritesBesideTheLog: "leaves_log_and_process",
    bad.SetsTheTimeZone: "leaves_log_and_process",
    bad.DropsLinesAtPieceBorders: "reads_in_any_pieces",
    bad.WantsAnEnd: "keeps_what_stands_before_a_cut",
    bad.LooksBack: "keeps_what_stands_before_a_cut",
    bad.StopsAtDamage: "keeps_what_stands_around_damage",
    bad.RefusesGarbage: "survives_garbage",
    bad.FailsOnOtherBytes: "raises_only_its_errors",
    bad.RaisesAParagraph: "raises_only_its_errors",
    bad.ReadsItWhole: "keeps_memory_bounded",
    bad.WaitsForALineEnd: "keeps_memory_bounded",
}
_SLOW = ("keeps_memory_bounded", "depends_on_content_alone")


@pytest.fixture(scope="module")
def sample(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("logs") / "honest.fix"
    path.write_bytes(bad.log())
    return path


@pytest.mark.parametrize("law", [law.__name__ for law in LAWS])
def test_an_honest_converter_passes(law: str, sample: Path) -> None:
    check = next(
        check for check in check_converter(bad.Honest(), [sample]).args[1] if str(check) == law
    )
    check()


@pytest.mark.parametrize(
    ("converter", "law"), [pytest.param(*pair, id=pair[0].__name__) for pair in BROKEN.items()]
)
def test_a_broken_law_is_named(
    converter: type[Any], law: str, sample: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TZ", "UTC")
    monkeypatch.setenv("LC_ALL", "C.UTF-8")
    check = next(
        check for check in check_converter(converter(), [sample]).args[1] if str(check) == law
    )
    result = check.result()
    assert not result.passed
    assert result.reason


def test_every_law_has_a_converter_that_breaks_it() -> None:
    assert {law.__name__ for law in LAWS} == set(BROKEN.values())


def test_without_pytest_the_same_checks_give_results(sample: Path) -> None:
    results = run_converter_checks(bad.HasNoVersion(), [sample], streamed=False)
    assert [result.name for result in results] == [law.__name__ for law in LAWS]
    assert [result.name for result in results if not result.passed] == ["declares_itself"]


def test_a_missing_plugin_is_an_error_not_a_result(sample: Path) -> None:
    with pytest.raises(PluginError, match="no converter is called 'no-such'"):
        run_converter_checks("no-such", [sample])
