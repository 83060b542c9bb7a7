"""Equal inputs have equal ids, and any input that changes changes the id."""

import json
import sys
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
from spoofbench.runner.planning import Part, PlannedTask, Survey, plan
from spoofbench.suite import AttackEntry, DetectorEntry, Limits, RecordingEntry, Suite

UNTIMED = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
DIGESTS = st.sampled_from("0123456789abcdef").map(lambda letter: letter * 64)
LABELS = st.text("abcxyz-", min_size=1, max_size=4).map(lambda text: f"n{text}")
PARAMETERS = st.dictionaries(
    LABELS,
    st.one_of(st.floats(allow_nan=False, allow_infinity=False), st.integers(), st.text(max_size=3)),
    max_size=3,
)


def part(entry: AttackEntry | DetectorEntry, group: plugins.Group, code: str, version: str) -> Part:
    plugin = Plugin(
        group, entry.plugin, "somebody", version, EntryPoint(entry.plugin, "module:Thing", group)
    )
    return Part(entry, plugin, entry.parameters, entry.parameters, code)


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
        **{f"attack {what}": draw(strategy) for what, strategy in PART.items()},
        **{f"detector {what}": draw(strategy) for what, strategy in PART.items()},
        "time_s": draw(st.floats(1.0, 100.0)),
        "memory_mb": draw(st.integers(256, 10_000)),
    }


PART = {
    "id": LABELS,
    "plugin": LABELS,
    "parameters": PARAMETERS,
    "code": DIGESTS,
    "version": LABELS,
}


def planned(given: dict[str, Any]) -> tuple[PlannedTask, PlannedTask]:
    """The unattacked and the attacked task of these inputs."""
    attack = part(
        AttackEntry(given["attack id"], given["attack plugin"], given["attack parameters"]),
        plugins.ATTACKS,
        given["attack code"],
        given["attack version"],
    )
    detector = part(
        DetectorEntry(given["detector id"], given["detector plugin"], given["detector parameters"]),
        plugins.DETECTORS,
        given["detector code"],
        given["detector version"],
    )
    recording = RecordingEntry(given["recording"], Path("any.mcap"), "any")
    limits = Limits(given["time_s"], given["memory_mb"])
    entries: dict[str, Any] = {
        "recordings": (recording,),
        "attacks": (attack.entry,),
        "detectors": (detector.entry,),
    }
    suite = Suite("any", 1, (given["seed"],), 0.0, 1.0, 1.0, limits, **entries)
    survey = Survey(
        given["digest"],
        (given["donor"],),
        frozenset({"gnss/pvt"}),
        {given["seed"]: Interval(*given["window"])},
        {},
    )
    clean, attacked = plan(suite, recording, survey, [attack], [detector])
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
        for name in PART
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


def test_the_problem_of_an_unreadable_recording_is_an_input() -> None:
    suite = Suite(
        "any",
        1,
        (1,),
        0.0,
        1.0,
        1.0,
        Limits(),
        (RecordingEntry("r", Path("any"), "r"),),
        (),
        (DetectorEntry("d", "d"),),
    )
    detector = part(suite.detectors[0], plugins.DETECTORS, "0", "1")
    lost = Survey(None, problem=("failed", "lost"))
    (one,) = plan(suite, suite.recordings[0], lost, [], [detector])
    (other,) = plan(
        suite, suite.recordings[0], replace(lost, problem=("failed", "damaged")), [], [detector]
    )
    assert one.id != other.id
