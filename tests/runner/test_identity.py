"""Equal inputs have equal ids, any input that changes changes the id, and so does the code that
decides results, and no other.
"""

import ast
import json
import shutil
import sys
import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from spoofbench import plugins
from spoofbench.plugins import Plugin
from spoofbench.recording import Interval
from spoofbench.runner import identity
from spoofbench.runner.plan import ConfiguredPlugin, PlannedTask, RecordingInfo, plan
from spoofbench.suite import AttackEntry, DetectorEntry, RecordingEntry, Suite, TaskLimits

UNTIMED = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
DIGESTS = st.sampled_from("0123456789abcdef").map(lambda letter: letter * 64)
LABELS = st.text("abcxyz-", min_size=1, max_size=4).map(lambda text: f"n{text}")
PARAMETERS = st.dictionaries(
    LABELS,
    st.one_of(st.floats(allow_nan=False, allow_infinity=False), st.integers(), st.text(max_size=3)),
    max_size=3,
)


def configured(
    entry: AttackEntry | DetectorEntry, group: plugins.Group, code: str, version: str
) -> ConfiguredPlugin:
    plugin = Plugin(
        group, entry.plugin, "somebody", version, EntryPoint(entry.plugin, "module:Thing", group)
    )
    return ConfiguredPlugin(entry, plugin, entry.parameters, entry.parameters, code)


@st.composite
def inputs(draw: st.DrawFn) -> dict[str, Any]:
    """Everything that decides a result, by name."""
    start_ns = draw(st.integers(0, 10**18))
    return {
        "recording": draw(LABELS),
        "digest": draw(DIGESTS),
        "donor": draw(DIGESTS),
        "window": (start_ns, start_ns + draw(st.integers(1, 10**12))),
        "seed": draw(st.integers(0, 2**63 - 1)),
        **{f"attack {what}": draw(strategy) for what, strategy in PLUGIN.items()},
        **{f"detector {what}": draw(strategy) for what, strategy in PLUGIN.items()},
        "time_s": draw(st.floats(1.0, 100.0)),
        "memory_mb": draw(st.integers(256, 10_000)),
    }


PLUGIN = {
    "id": LABELS,
    "plugin": LABELS,
    "parameters": PARAMETERS,
    "code": DIGESTS,
    "version": LABELS,
}


def planned(given: dict[str, Any]) -> tuple[PlannedTask, PlannedTask]:
    """The unattacked and the attacked task of these inputs."""
    attack = configured(
        AttackEntry(given["attack id"], given["attack plugin"], given["attack parameters"]),
        plugins.ATTACKS,
        given["attack code"],
        given["attack version"],
    )
    detector = configured(
        DetectorEntry(given["detector id"], given["detector plugin"], given["detector parameters"]),
        plugins.DETECTORS,
        given["detector code"],
        given["detector version"],
    )
    recording = RecordingEntry(given["recording"], Path("any.mcap"), "any")
    limits = TaskLimits(given["time_s"], given["memory_mb"])
    entries: dict[str, Any] = {
        "recordings": (recording,),
        "attacks": (attack.entry,),
        "detectors": (detector.entry,),
    }
    suite = Suite("any", given["seed"], 1.0, 1.0, limits=limits, **entries)
    info = RecordingInfo(
        given["digest"],
        (given["donor"],),
        frozenset({"gnss/pvt"}),
        windows=(Interval(*given["window"]),),
    )
    clean, attacked = plan(suite, {recording.id: info}, [attack], [detector])
    return clean, attacked


@UNTIMED
@given(inputs())
def test_equal_inputs_have_equal_ids(given: dict[str, Any]) -> None:
    copy = json.loads(json.dumps(given))
    for one, other in zip(planned(given), planned(copy), strict=True):
        assert (one.id, one.variant.id, one.variant.number) == (
            other.id,
            other.variant.id,
            other.variant.number,
        )


@UNTIMED
@given(inputs(), inputs(), st.data())
def test_any_changed_input_changes_the_id_and_only_where_it_matters(
    one: dict[str, Any], other: dict[str, Any], data: st.DataObject
) -> None:
    name = data.draw(st.sampled_from(sorted(one)))
    changed = one | {name: other[name]}
    if identity.canonical(changed) == identity.canonical(one):
        return
    (clean, attacked), (clean_changed, attacked_changed) = planned(one), planned(changed)
    assert attacked.id != attacked_changed.id
    of_the_detector = name.startswith("detector ") or name in ("time_s", "memory_mb")
    assert (attacked.variant.id == attacked_changed.variant.id) == of_the_detector
    of_the_attack = name.startswith("attack ") or name in ("donor", "window", "seed")
    assert (clean.id == clean_changed.id) == of_the_attack


def test_versions_of_what_computes_are_inputs(monkeypatch: pytest.MonkeyPatch) -> None:
    given: dict[str, Any] = {
        "recording": "r",
        "digest": "0",
        "donor": "1",
        "window": (0, 1),
        "seed": 1,
        "time_s": 1.0,
        "memory_mb": 256,
    }
    given |= {
        f"{what} {name}": {} if name == "parameters" else "n"
        for what in ("attack", "detector")
        for name in PLUGIN
    }
    before, known = planned(given), identity.versions()
    for name in known:
        changed = known | {name: "another"}
        with monkeypatch.context() as patch:
            patch.setattr(identity, "versions", lambda changed=changed: changed)
            assert not {task.id for task in before} & {task.id for task in planned(given)}


def test_the_code_of_a_plugin_is_its_package_wherever_it_lies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def code(folder: str, text: str, extra: str | None = None) -> str:
        package = tmp_path / folder / "somebodys_plugin"
        (package / "__pycache__").mkdir(parents=True)
        (package / "__init__.py").write_text(text)
        (package / "__pycache__" / "x.pyc").write_text(folder)
        if extra is not None:
            (package / "table.csv").write_text(extra)
        with monkeypatch.context() as patch:
            patch.syspath_prepend(str(tmp_path / folder))
            entry = EntryPoint("x", "somebodys_plugin:X", plugins.DETECTORS)
            return identity.code_of(Plugin(plugins.DETECTORS, "x", "somebody", "1", entry))

    first = code("a", "X = 1")
    assert code("b", "X = 1") == first
    assert code("c", "X = 2") != first
    assert code("d", "X = 1", "1,2") != first
    assert code("e", "X = 1", "1,3") != code("f", "X = 1", "1,2")
    assert "somebodys_plugin" not in sys.modules, "the main process never imports a plugin"


def test_a_plugin_of_the_core_has_the_core_s_code() -> None:
    assert identity.code_of(plugins.find(plugins.ATTACKS, "replay")) == identity.core()


def test_why_a_recording_is_unreadable_is_an_input() -> None:
    suite = Suite(
        "any", 1, 1.0, 1.0, (RecordingEntry("r", Path("any"), "r"),), (DetectorEntry("d", "d"),)
    )
    detector = configured(suite.detectors[0], plugins.DETECTORS, "0", "1")
    lost = RecordingInfo(None, failure=("failed", "lost"))
    (one,) = plan(suite, {"r": lost}, [], [detector])
    (other,) = plan(suite, {"r": replace(lost, failure=("failed", "damaged"))}, [], [detector])
    assert one.id != other.id


ROOT = Path(__file__).parents[2]
SOURCES = [ROOT / "src", *sorted((ROOT / "plugins").glob("*/src"))]

COMPUTES = ("spoofbench.runner.jobs", "spoofbench.scoring.grid")
"""What the workers of a run do; with the attacks and detectors, all that decides a task's files."""

DECIDES_NOTHING = {
    "spoofbench": "has the version, which is an input",
    "spoofbench.codec": "reads recordings: the digest of the rows that it gives is an input",
    "spoofbench.errors": "has names alone",
    "spoofbench.plugins": "finds plugins: their code and parameters are inputs",
    "spoofbench.runner": "asks the workers",
    "spoofbench.sandbox": "limits, which are inputs, measures, and carries what was decided",
    "spoofbench.suite": "reads the suite: what it says is an input",
}


def source(module: str) -> Path | None:
    """The file of one of our modules."""
    for folder in SOURCES:
        path = folder / module.replace(".", "/")
        for file in (path / "__init__.py", path.with_suffix(".py")):
            if file.is_file():
                return file
    return None


def imported(file: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module or ""
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def plugin_modules() -> set[str]:
    """The modules of the attacks and detectors that this repository ships."""
    projects = [ROOT / "pyproject.toml", *(ROOT / "plugins").glob("*/pyproject.toml")]
    groups = [
        entries
        for project in projects
        for group, entries in tomllib.loads(project.read_text())["project"]["entry-points"].items()
        if group in (plugins.ATTACKS, plugins.DETECTORS)
    ]
    return {entry.partition(":")[0] for entries in groups for entry in entries.values()}


def reached(modules: Iterable[str], without: Iterable[str]) -> set[str]:
    """Modules of the core that these import, directly or through others but ``without``."""
    waiting, seen = list(modules), set(without)
    while waiting:
        module = waiting.pop()
        file = source(module)
        if module not in seen and file is not None:
            seen.add(module)
            waiting += imported(file)
    return {module for module in seen if module.partition(".")[0] == "spoofbench"} - {*without}


def is_listed(module: str, listed: Iterable[str]) -> bool:
    return any(f"{module}.".startswith(f"spoofbench.{entry}.") for entry in listed)


def unlisted(listed: Iterable[str]) -> set[str]:
    """The modules that decide results and are not listed."""
    found = reached({*COMPUTES, *plugin_modules()}, DECIDES_NOTHING)
    return {module for module in found if not is_listed(module, listed)}


def test_every_module_that_decides_results_is_listed() -> None:
    assert plugin_modules() >= {"spoofbench.attacks.replay", "spoofbench_correlation"}
    assert unlisted(identity.DECISIVE) == set()


TOOLBOX = {"arrays", "gnss_time"}
"""Modules that are listed whether or not our own plugins import them: a stranger's may."""


@pytest.mark.parametrize("entry", sorted({*identity.DECISIVE} - TOOLBOX))
def test_a_stale_list_is_seen(entry: str) -> None:
    assert unlisted({*identity.DECISIVE} - {entry}), f"nothing that decides imports {entry!r}"


def test_what_decides_nothing_is_there_and_not_listed() -> None:
    for module in DECIDES_NOTHING:
        assert source(module)
        assert not is_listed(module, identity.DECISIVE)


def test_edits_elsewhere_leave_the_code_s_digest_alone(tmp_path: Path) -> None:
    copy = tmp_path / "spoofbench"
    shutil.copytree(ROOT / "src" / "spoofbench", copy)
    before = identity.digest_of(copy, identity.DECISIVE)
    assert before == identity.core()
    for path in sorted(copy.rglob("*.py")):
        module = ".".join(path.relative_to(tmp_path).with_suffix("").parts)
        text = path.read_text()
        path.write_text(text + "# a comment\n")
        changed = identity.digest_of(copy, identity.DECISIVE) != before
        assert changed == is_listed(module, identity.DECISIVE), module
        path.write_text(text)
    for elsewhere in ("doctor", "report", "cli", "testing", "conversion"):
        assert not is_listed(f"spoofbench.{elsewhere}", identity.DECISIVE)
    for decisive in ("attacks.contract", "detector", "recording", "scoring.grid"):
        assert is_listed(f"spoofbench.{decisive}", identity.DECISIVE)


def test_a_listed_module_that_is_gone_is_an_error() -> None:
    with pytest.raises(FileNotFoundError):
        identity.digest_of(ROOT / "src" / "spoofbench", ["no_such_module"])
