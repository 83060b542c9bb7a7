"""Plugins are found without import, loaded when used, blamed by name."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from spoofbench import plugins
from spoofbench.config import Text, plain
from spoofbench.errors import PluginError
from spoofbench.plugins import DETECTORS, find, found, make

Install = Callable[[str, str, str], None]

DETECTOR = """
from dataclasses import dataclass

@dataclass(frozen=True)
class Detector:
    level: float = 1.0
    def __post_init__(self):
        if self.level < 0:
            raise ValueError("level must be at least 0")
"""

TYPED = """
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
import numpy as np

class Mode(Enum):
    SLOW = "slow"
    FAST = "fast"

@dataclass(frozen=True)
class Noise:
    sigma_m: float = 1.0

@dataclass(frozen=True)
class Detector:
    level: float
    mode: Mode = Mode.SLOW
    taps: tuple[float, ...] = ()
    noise: "Noise | None" = None
    gain: np.float32 = np.float32(1)
    log: Path | None = None
"""


@pytest.fixture(autouse=True)
def _found_afresh() -> Iterator[None]:
    plugins.found.cache_clear()
    yield
    plugins.found.cache_clear()


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Install:
    """Return a function that installs a distribution of one module and one detector: its name, the
    detector's, the source.
    """
    monkeypatch.syspath_prepend(str(tmp_path))

    def install(distribution: str, detector: str, source: str) -> None:
        module = distribution.replace("-", "_")
        (tmp_path / f"{module}.py").write_text(source)
        info = tmp_path / f"{module}-1.2.3.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1.2.3\n"
        )
        (info / "entry_points.txt").write_text(f"[{DETECTORS}]\n{detector} = {module}:Detector\n")
        monkeypatch.delitem(sys.modules, module, raising=False)

    return install


def test_a_plugin_is_found_without_import(install: Install) -> None:
    install("stranger-a", "curious", "raise RuntimeError('imported')")
    plugin = found(DETECTORS)["curious"]
    assert (plugin.distribution, plugin.version) == ("stranger-a", "1.2.3")
    assert str(plugin) == "detector 'curious' of stranger-a 1.2.3"
    assert "stranger_a" not in sys.modules


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        ("raise RuntimeError('no licence')", "RuntimeError: no licence"),
        ("import no_such_library", "ModuleNotFoundError: No module named 'no_such_library'"),
        ("Other = 1", "AttributeError: module 'stranger_b' has no attribute 'Detector'"),
        ("class Broken(", "SyntaxError"),
    ],
)
def test_a_plugin_that_cannot_be_loaded_is_blamed(
    install: Install, source: str, reason: str
) -> None:
    install("stranger-b", "broken", source)
    with pytest.raises(PluginError) as caught:
        find(DETECTORS, "broken").load()
    text = str(caught.value)
    assert (
        "detector 'broken' of stranger-b 1.2.3 cannot be loaded from 'stranger_b:Detector'" in text
    )
    assert reason in text
    assert text.endswith("reinstall or remove the distribution 'stranger-b'")


def test_two_claims_to_one_name_name_both(install: Install) -> None:
    install("stranger-c", "twin", DETECTOR)
    install("stranger-d", "twin", DETECTOR)
    with pytest.raises(
        PluginError, match=r"'twin' of stranger-. 1.2.3 and .* claim one name"
    ) as caught:
        found(DETECTORS)
    assert "stranger-c" in str(caught.value)
    assert "stranger-d" in str(caught.value)


def test_an_unknown_name_gets_a_hint(install: Install) -> None:
    install("stranger-e", "sentinel", DETECTOR)
    with pytest.raises(
        PluginError, match="no detector is called 'sentinal'; did you mean 'sentinel'"
    ):
        find(DETECTORS, "sentinal")
    with pytest.raises(PluginError, match=r"no detector is called 'zzz'; there are \["):
        find(DETECTORS, "zzz")


def test_parameters_are_named_and_refusals_blamed(install: Install) -> None:
    install("stranger-f", "levelled", DETECTOR)
    assert make(DETECTORS, "levelled", {"level": 2.0}).level == 2.0
    with pytest.raises(
        PluginError, match=r"stranger-f 1.2.3 has no parameter 'depth'; there are \['level'\]"
    ):
        make(DETECTORS, "levelled", {"depth": 2.0})
    with pytest.raises(
        PluginError,
        match=r"refuses its parameters \{'level': -1.0\}: level must be at least 0",
    ):
        make(DETECTORS, "levelled", {"level": -1})


def test_what_is_no_dataclass_has_no_parameters(install: Install) -> None:
    install("stranger-g", "plain", "class Detector: pass")
    with pytest.raises(PluginError, match=r"stranger-g 1.2.3 is not a dataclass"):
        make(DETECTORS, "plain")


def test_a_strangers_parameters_are_read_as_they_are_annotated(install: Install) -> None:
    install("stranger-h", "typed", TYPED)
    made = make(
        DETECTORS,
        "typed",
        {
            "level": 2,
            "mode": Text("fast"),
            "taps": Text("[1, 2]"),
            "noise": {"sigma_m": 0.5},
            "gain": Text("0.25"),
            "log": Text("a/b.csv"),
        },
    )
    assert plain(made) == {
        "level": 2.0,
        "mode": "fast",
        "taps": [1.0, 2.0],
        "noise": {"sigma_m": 0.5},
        "gain": 0.25,
        "log": "a/b.csv",
    }
    assert make(DETECTORS, "typed", plain(made)) == made
    for parameters, sentence in (
        ({}, "lacks the parameter 'level'; add it"),
        ({"level": "1"}, "parameter level = '1' must be a number"),
        ({"level": 1, "mode": Text("fats")}, "must be one of 'slow', 'fast', 'SLOW', 'FAST'; did"),
        ({"level": 1, "taps": ["x"]}, "parameter taps[0] = 'x' must be a number"),
        ({"level": 1, "noise": {"sigma": 1}}, "[noise] has no parameter 'sigma'; did you mean"),
    ):
        with pytest.raises(PluginError) as caught:
            make(DETECTORS, "typed", parameters)
        assert str(caught.value).startswith("detector 'typed' of stranger-h 1.2.3")
        assert sentence in str(caught.value)
