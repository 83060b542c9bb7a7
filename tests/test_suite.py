"""A suite file means what it says, or is refused with the key, the value and what to do."""

import json
import math
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spoofbench.config import plain
from spoofbench.errors import SuiteError
from spoofbench.suite import (
    AttackEntry,
    DetectorEntry,
    RecordingEntry,
    Suite,
    TaskLimits,
    load_suite,
    packaged_suite,
)

ROOT = Path(__file__).parents[1]

WHOLE = """
name = "whole"
seed = 7
seeds = [1, 2]
warm_up_s = 30
duration_s = 60.0
target_far_per_hour = 2.5

[limits]
time_s = 5
memory_mb = 300

[[recordings]]
id = "a"
path = "logs/a.mcap"
session = "monday"
donors = ["b"]

[[recordings]]
id = "b"
path = "/elsewhere/b.mcap"

[[attacks]]
name = "replay"
id = "replay-60s"
parameters = { delay_s = 60.0, sources = ["gnss0", "gnss1"] }
recordings = ["a"]

[[attacks]]
name = "drag-off"

[[detectors]]
name = "correlation"
id = "H_ag"
parameters = { statistic = "H_ag" }
hold_s = 1.5

[[detectors]]
name = "never"
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "suite.toml"
    path.write_text(text)
    return path


def test_every_key_arrives(tmp_path: Path) -> None:
    suite = load_suite(write(tmp_path, WHOLE))
    assert (suite.name, suite.seed, suite.seeds, suite.warm_up_s, suite.duration_s) == (
        "whole",
        7,
        (1, 2),
        30.0,
        60.0,
    )
    assert suite.target_far_per_hour == 2.5
    assert asdict(suite.limits) == {"time_s": 5.0, "memory_mb": 300}
    a, b = suite.recordings
    assert (a.id, a.path, a.session, a.donors) == ("a", tmp_path / "logs/a.mcap", "monday", ("b",))
    assert (b.id, b.path, b.session, b.donors) == ("b", Path("/elsewhere/b.mcap"), "b", ())
    replay, drag_off = suite.attacks
    assert (replay.id, replay.plugin, replay.recordings) == ("replay-60s", "replay", ("a",))
    assert replay.parameters == {"delay_s": 60.0, "sources": ("gnss0", "gnss1")}
    assert (drag_off.id, drag_off.plugin, drag_off.parameters, drag_off.recordings) == (
        "drag-off",
        "drag-off",
        {},
        None,
    )
    assert [attack.id for attack in suite.attacks_on("a")] == ["replay-60s", "drag-off"]
    assert [attack.id for attack in suite.attacks_on("b")] == ["drag-off"]
    first, second = suite.detectors
    assert (first.id, first.plugin, first.parameters, first.hold_s) == (
        "H_ag",
        "correlation",
        {"statistic": "H_ag"},
        1.5,
    )
    assert (second.id, second.hold_s) == ("never", None)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("seed = 7", "", ["lacks", "'seed'"]),
        ("seed = 7", "seed = 7.5", ["seed = 7.5", "whole number"]),
        ("seed = 7", "seed = true", ["seed = true"]),
        ("seeds = [1, 2]", "seeds = []", ["seeds = []"]),
        ("seeds = [1, 2]", "seeds = [1, 1]", ["seeds = [1, 1]", "different"]),
        ("seeds = [1, 2]", "seeds = [-1]", ["seeds = [-1]"]),
        ("warm_up_s = 30", "warmup_s = 30", ["'warm_up_s'"]),
        (
            "warm_up_s = 30",
            "warm_up_s = 30\nwarm_up = 3",
            ["'warm_up'", "did you mean 'warm_up_s'?"],
        ),
        ("warm_up_s = 30", "warm_up_s = -1", ["warm_up_s = -1", "at least 0"]),
        ("warm_up_s = 30", "warm_up_s = nan", ["warm_up_s = nan"]),
        ("duration_s = 60.0", "duration_s = 0", ["duration_s = 0", "above 0"]),
        ("duration_s = 60.0", "duration_s = inf", ["duration_s = inf"]),
        ("target_far_per_hour = 2.5", 'target_far_per_hour = "1"', ["target_far_per_hour = '1'"]),
        ("memory_mb = 300", "memory_mb = 100", ["memory_mb = 100", "256"]),
        ("time_s = 5", "times_s = 5", ["[limits]", "'times_s'", "did you mean 'time_s'?"]),
        ('id = "b"', 'id = "a"', ["[[recordings]]", "'a'", "duplicated"]),
        ('id = "b"', 'id = "../b"', ["id = '../b'"]),
        ('id = "b"', 'id = "b\\n"', ["id = 'b\\n'"]),
        ('path = "logs/a.mcap"', 'path = ""', ["path = ''"]),
        ('donors = ["b"]', 'donors = ["c"]', ["donors", "'c'"]),
        ('donors = ["b"]', 'donors = ["a"]', ["'a'", "its own donor"]),
        ('donors = ["b"]', 'donors = "b"', ["donors = 'b'"]),
        (
            'recordings = ["a"]',
            'recordings = ["aa"]',
            ["'replay-60s'", "'aa'", "did you mean 'a'?"],
        ),
        (
            'name = "drag-off"',
            'name = "drag-off"\nid = "replay-60s"',
            ["[[attacks]]", "'replay-60s'", "duplicated"],
        ),
        (
            'name = "never"',
            'name = "never"\nhold = 1',
            ["[[detectors]] number 2", "'hold'", "did you mean 'hold_s'?"],
        ),
        ('name = "never"', 'name = "never"\nparameters = 3', ["parameters = 3"]),
        (
            'name = "never"',
            'name = "never"\nparameters = { since = 2020-01-01 }',
            ["since", "dates as strings"],
        ),
        ('name = "never"', 'name = "never"\nparameters = { most = inf }', ["most", "finite"]),
        ("duration_s = 60.0", "duration_s = 1e300", ["duration_s = 1e+300", "at most 1e+09"]),
        ("time_s = 5", "time_s = 1e12", ["[limits]", "time_s = 1000000000000.0", "at most"]),
        ("hold_s = 1.5", "hold_s = 1e300", ["hold_s = 1e+300", "at most"]),
        ("warm_up_s = 30", "warm_up_s = " + "9" * 400, ["warm_up_s = 999", "finite"]),
        (
            'name = "never"',
            'name = "never"\nparameters = { most = ' + "9" * 400 + " }",
            ["most", "finite"],
        ),
        ('name = "never"', 'name = "never"\nparameters' + ".a" * 500 + " = 1", ["nests"]),
        ("[limits]", "[[limits]]", ["[limits]"]),
        ("[[detectors]]", "[[detector]]", ["'detector'", "did you mean 'detectors'?"]),
        ('name = "whole"', "name = whole", ["TOML"]),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, old: str, new: str, words: list[str]) -> None:
    assert old in WHOLE
    with pytest.raises(SuiteError) as error:
        load_suite(write(tmp_path, WHOLE.replace(old, new)))
    for word in words:
        assert word in str(error.value)
    assert "\n" not in str(error.value)


def test_a_missing_file_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(SuiteError, match="cannot be read"):
        load_suite(tmp_path / "none.toml")


def test_bytes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "suite.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(SuiteError, match="TOML"):
        load_suite(path)


@settings(deadline=None)
@given(st.text(max_size=20))
def test_an_id_is_safe_as_a_file_name_or_refused(
    tmp_path_factory: pytest.TempPathFactory, name: str
) -> None:
    quoted = "".join(
        f"\\U{ord(letter):08x}" for letter in name if not 0xD800 <= ord(letter) <= 0xDFFF
    )
    path = write(tmp_path_factory.mktemp("suite"), WHOLE.replace('id = "H_ag"', f'id = "{quoted}"'))
    try:
        label = load_suite(path).detectors[0].id
    except SuiteError:
        return
    assert label.isascii()
    assert label == Path(label).name
    assert not label.startswith((".", "-"))
    assert label.translate(str.maketrans("", "", "._-")).isalnum()


@pytest.mark.parametrize(
    "path", sorted((ROOT / "benchmarks" / "suites").glob("*.toml")), ids=lambda path: path.stem
)
def test_suites_of_the_repository_are_sound(path: Path) -> None:
    assert load_suite(path).name == path.stem


def test_the_packaged_drive_is_as_large_as_promised(tmp_path: Path) -> None:
    suite = load_suite(write(tmp_path, packaged_suite("drive")))
    assert suite.recordings[0].path == tmp_path / "drive.mcap"
    assert len(suite.attacks) >= 7
    assert len(suite.seeds) >= 3
    assert len(suite.detectors) >= 10
    assert {"never", "always", "periodic", "random", "receiver-flag"} <= {
        entry.plugin for entry in suite.detectors
    }
    assert math.isfinite(suite.duration_s)


def test_an_unknown_packaged_suite_is_an_error() -> None:
    with pytest.raises(SuiteError, match="did you mean 'drive'"):
        packaged_suite("drives")


labels = st.from_regex(r"[A-Za-z0-9][A-Za-z0-9._-]{0,9}", fullmatch=True)
seconds = st.floats(0, 1e9)
durations = st.floats(0, 1e9, exclude_min=True)
parameters = st.dictionaries(
    labels,
    st.recursive(
        st.booleans() | st.integers(-(2**63), 2**63 - 1) | labels | seconds,
        lambda inner: st.lists(inner).map(tuple) | st.dictionaries(labels, inner),
        max_leaves=3,
    ),
)


def _subsets(names: list[str]) -> st.SearchStrategy[tuple[str, ...]]:
    return st.lists(st.sampled_from(names), unique=True).map(tuple) if names else st.just(())


@st.composite
def suites(draw: Callable[..., Any]) -> Suite:
    recordings, attacks, detectors = (
        draw(st.lists(labels, unique=True, min_size=least, max_size=3)) for least in (1, 0, 1)
    )
    return Suite(
        draw(labels),
        draw(st.integers(0, 2**63 - 1)),
        tuple(draw(st.lists(st.integers(0, 2**63 - 1), unique=True, min_size=1, max_size=4))),
        draw(seconds),
        draw(durations),
        draw(seconds),
        TaskLimits(draw(durations), draw(st.integers(256, 2**40))),
        tuple(
            RecordingEntry(
                name,
                Path("/", draw(labels)),
                draw(labels),
                draw(_subsets([other for other in recordings if other != name])),
            )
            for name in recordings
        ),
        tuple(
            AttackEntry(
                name, draw(labels), draw(parameters), draw(st.none() | _subsets(recordings))
            )
            for name in attacks
        ),
        tuple(
            DetectorEntry(name, draw(labels), draw(parameters), draw(st.none() | durations))
            for name in detectors
        ),
    )


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        pairs = (f"{_toml(key)} = {_toml(item)}" for key, item in value.items() if item is not None)
        return f"{{ {', '.join(pairs)} }}"
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    return json.dumps(value)


@settings(deadline=None, max_examples=50)
@given(suites())
def test_what_a_suite_says_reads_back_equal(
    tmp_path_factory: pytest.TempPathFactory, suite: Suite
) -> None:
    text = "\n".join(f"{key} = {_toml(value)}" for key, value in plain(suite).items())
    assert load_suite(write(tmp_path_factory.mktemp("suite"), text)) == suite
