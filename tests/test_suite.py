"""A suite file means what it says, or is refused with the key, the value and what to do."""

import json
import re
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spoofbench.config import plain
from spoofbench.errors import SuiteError
from spoofbench.shipped import shipped
from spoofbench.suite import (
    AttackEntry,
    Calibration,
    DetectorEntry,
    RecordingEntry,
    Suite,
    TaskLimits,
    find_suite,
    load_suite,
)

SHIPPED = sorted(shipped("suites").glob("*.toml"))

WHOLE = """
name = "whole"
seed = 7
windows = 3
warm_up_s = 30
duration_s = 60.0
memory_cap_s = 90
target_far_per_hour = 2.5
alert_limit_m = 40
time_to_alert_s = 6
ranks_fused = ["car"]

[calibration]
split = "sides"
classes = ["car"]

[limits]
time_s = 5
memory_mb = 300

[[recordings]]
id = "a"
path = "logs/a.mcap"
session = "monday"
class = "car"
side = "judged"
donors = ["b"]

[[recordings]]
id = "b"
path = "/elsewhere/b.mcap"
class = "car"
side = "calibration"
simulated = true

[[attacks]]
name = "replay"
id = "replay-60s"
parameters = { delay_s = 60.0, sources = ["gnss0", "gnss1"] }
recordings = ["a"]

[[attacks]]
name = "drag-off"
parameters = { rate_mps = [0.3, 1] }

[[detectors]]
name = "correlation"
id = "H_ag"
parameters = { statistic = "H_ag", lag_s = 0.1, window_s = 30.0 }
source = "published"
sources = { lag_s = "by hand", window_s = "session b" }
fit = false
classes = ["car"]
hold_s = 1.5

[[detectors]]
name = "never"
"""


LEAST = """
name = "least"
seed = 1
duration_s = 60.0
target_far_per_hour = 1.0

[[recordings]]
id = "a"
path = "a.mcap"

[[detectors]]
name = "never"
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "suite.toml"
    path.write_text(text)
    return path


def test_every_key_arrives(tmp_path: Path) -> None:
    suite = load_suite(write(tmp_path, WHOLE))
    assert (suite.name, suite.seed, suite.windows) == ("whole", 7, 3)
    assert (suite.warm_up_s, suite.duration_s, suite.memory_cap_s) == (30.0, 60.0, 90.0)
    assert (suite.target_far_per_hour, suite.alert_limit_m, suite.time_to_alert_s) == (2.5, 40, 6)
    assert suite.ranks_fused == ("car",)
    assert suite.calibration == Calibration("sides", None, ("car",))
    assert asdict(suite.limits) == {"time_s": 5.0, "memory_mb": 300}
    assert suite.recordings == (
        RecordingEntry("a", tmp_path / "logs/a.mcap", "monday", "car", "judged", donors=("b",)),
        RecordingEntry("b", Path("/elsewhere/b.mcap"), "b", "car", "calibration", simulated=True),
    )
    parameters = {"delay_s": 60.0, "sources": ("gnss0", "gnss1")}
    assert suite.attacks == (
        AttackEntry("replay-60s", "replay", parameters, ("a",)),
        AttackEntry("drag-off-0.3", "drag-off", {"rate_mps": 0.3}, group="drag-off"),
        AttackEntry("drag-off-1", "drag-off", {"rate_mps": 1}, group="drag-off"),
    )
    assert [attack.id for attack in suite.attacks_on("b")] == ["drag-off-0.3", "drag-off-1"]
    first, second = suite.detectors
    assert first == DetectorEntry(
        "H_ag",
        "correlation",
        {"statistic": "H_ag", "lag_s": 0.1, "window_s": 30.0},
        "published",
        {"lag_s": "by hand", "window_s": "session b"},
        fit=False,
        classes=("car",),
        hold_s=1.5,
    )
    assert [first.source_of(name) for name in ("statistic", "lag_s")] == ["published", "by hand"]
    assert second == DetectorEntry("never", "never")


def test_what_is_left_out_has_the_documented_default(tmp_path: Path) -> None:
    suite = load_suite(write(tmp_path, LEAST))
    assert (suite.windows, suite.warm_up_s, suite.memory_cap_s) == (None, None, 130.0)
    assert (suite.alert_limit_m, suite.calibration, suite.attacks) == (None, None, ())
    assert suite.limits == TaskLimits(60.0, 512)
    assert suite.recordings == (RecordingEntry("a", tmp_path / "a.mcap", "a", "default"),)
    assert not suite.is_calibrated(suite.recordings[0])


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("seed = 7", "", ["lacks", "'seed'"]),
        ("seed = 7", "seed = 7.5", ["seed = 7.5", "whole number"]),
        ("seed = 7", "seed = true", ["seed = true"]),
        ("windows = 3", "windows = 0", ["windows = 0", "at least 1"]),
        ("windows = 3", "windows = 2.5", ["windows = 2.5", "whole number"]),
        ("windows = 3", "seeds = [1, 2]", ["'seeds'"]),
        ("warm_up_s = 30", "warmup_s = 30", ["'warm_up_s'"]),
        ("memory_cap_s = 90", "memory_cap_s = -1", ["memory_cap_s = -1", "at least 0"]),
        ("alert_limit_m = 40", "alert_limit_m = 0", ["alert_limit_m = 0", "above 0"]),
        ("time_to_alert_s = 6", "time_to_alert_s = -6", ["time_to_alert_s = -6"]),
        ('ranks_fused = ["car"]', 'ranks_fused = ["cat"]', ["'cat'", "did you mean 'car'?"]),
        ('classes = ["car"]', 'classes = ["cat"]', ["'cat'", "did you mean 'car'?"]),
        ('split = "sides"', 'split = "halves"', ["split = 'halves'"]),
        ('split = "sides"', 'split = "first-part"', ["until_s"]),
        ('split = "sides"', 'split = "sides"\nuntil_s = 900.0', ["until_s", "'sides'"]),
        ('split = "sides"', 'split = "leave-one-session-out"', ["'a'", "side"]),
        ('side = "judged"\n', "", ["'a'", "no side"]),
        ('side = "judged"', 'side = "both"', ["side = 'both'"]),
        ('id = "b"', 'id = "b"\nsession = "monday"', ["'monday'", "both sides"]),
        ('class = "car"\nside = "judged"', 'class = "a b"\nside = "judged"', ["class = 'a b'"]),
        ('source = "published"', 'source = "measured"', ["source = 'measured'", "'by hand'"]),
        ('source = "published"', 'source = "session monday"', ["'H_ag'", "session monday"]),
        ('lag_s = "by hand"', 'lag_s = "session monday"', ["'H_ag'", "session monday", "judged"]),
        ('lag_s = "by hand"', 'lag_s = "session a b"', ["session a b"]),
        ("rate_mps = [0.3, 1]", "rate_mps = [0.3, 0.3]", ["'drag-off-0.3'", "duplicated"]),
        (
            "rate_mps = [0.3, 1]",
            "rate_mps = [0.3, 1], ramp_s = [1.0]",
            ["'drag-off'", "'rate_mps'", "'ramp_s'"],
        ),
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
            'id = "replay-60s"',
            'id = "drag-off"',
            ["[[attacks]]", "'drag-off'", "duplicated"],
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


def test_a_suite_is_found_by_path_or_by_name() -> None:
    assert [find_suite(Path(path.stem)) for path in SHIPPED] == SHIPPED
    assert find_suite(Path("any/where.toml")) == Path("any/where.toml")
    with pytest.raises(SuiteError, match="no suite called 'drives' comes with spoofbench"):
        find_suite(Path("drives"))


def test_every_split_says_which_parts_it_calibrates(tmp_path: Path) -> None:
    def calibrated(text: str) -> list[bool]:
        suite = load_suite(write(tmp_path, LEAST + TWO_CLASSES + text))
        return [suite.is_calibrated(recording) for recording in suite.recordings]

    assert calibrated("") == [False, False]
    assert calibrated('[calibration]\nsplit = "leave-one-session-out"\n') == [True, True]
    assert calibrated(
        '[calibration]\nsplit = "first-part"\nuntil_s = 900.0\nclasses = ["phone"]\n'
    ) == [False, True]


TWO_CLASSES = """
[[recordings]]
id = "b"
path = "b.mcap"
class = "phone"
"""


@pytest.mark.parametrize(
    "split", ['"leave-one-session-out"', '"first-part"\nuntil_s = 900.0', None]
)
def test_parameters_measured_on_a_judged_session_are_refused(
    tmp_path: Path, split: str | None
) -> None:
    text = LEAST + 'parameters = { most = 1 }\nsource = "session a"\n'
    if split:
        text += f"[calibration]\nsplit = {split}\n"
    with pytest.raises(SuiteError, match="comes from the session a, which is judged"):
        load_suite(write(tmp_path, text))
    elsewhere = text.replace("session a", "session elsewhere")
    assert load_suite(write(tmp_path, elsewhere)).detectors[0].source == "session elsewhere"


@settings(deadline=None)
@given(
    st.lists(
        st.floats(1e-9, 1e9).map(lambda value: float(f"{value:g}")) | st.integers(-999, 999),
        min_size=1,
        max_size=4,
        unique=True,
    )
)
def test_each_strength_is_an_attack_with_an_id_of_its_own(
    tmp_path_factory: pytest.TempPathFactory, strengths: list[float]
) -> None:
    text = f'[[attacks]]\nname = "drag-off"\nparameters = {{ rate_mps = {strengths} }}\n'
    suite = load_suite(write(tmp_path_factory.mktemp("suite"), LEAST + text))
    assert [attack.parameters["rate_mps"] for attack in suite.attacks] == strengths
    assert {attack.group for attack in suite.attacks} == {"drag-off"}
    assert len({attack.id for attack in suite.attacks}) == len(strengths)
    for attack in suite.attacks:
        assert re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", attack.id)


labels = st.from_regex(r"[A-Za-z0-9][A-Za-z0-9._-]{0,9}", fullmatch=True)
seconds = st.floats(0, 1e9)
durations = st.floats(0, 1e9, exclude_min=True)
values = st.booleans() | st.integers(-(2**63), 2**63 - 1) | labels | seconds
parameters = st.dictionaries(
    labels,
    st.recursive(
        values,
        lambda inner: (
            st.lists(inner).map(tuple)
            | st.dictionaries(labels, inner)  # of an attack, a list of numbers is of strengths
        ),
        max_leaves=3,
    ),
)
attack_parameters = parameters.map(
    lambda given: {
        name: value
        for name, value in given.items()
        if not isinstance(value, tuple) or any(isinstance(item, str | bool) for item in value)
    }
)
sources = st.sampled_from(["published", "data sheet", "by hand", "session nobodys"])


def _subsets(names: list[str]) -> st.SearchStrategy[tuple[str, ...]]:
    return st.lists(st.sampled_from(names), unique=True).map(tuple) if names else st.just(())


@st.composite
def suites(draw: Callable[..., Any]) -> Suite:
    recordings, attacks, detectors = (
        draw(st.lists(labels, unique=True, min_size=least, max_size=3)) for least in (1, 0, 1)
    )
    classes = draw(st.lists(labels, min_size=1, max_size=2, unique=True))
    of_class = [draw(st.sampled_from(classes)) for _ in recordings]
    used = sorted(set(of_class))
    some = st.none() | _subsets(used)
    calibration = draw(
        st.none()
        | st.builds(Calibration, st.just("leave-one-session-out"), classes=some)
        | st.builds(Calibration, st.just("sides"), classes=some)
        | st.builds(Calibration, st.just("first-part"), durations, some)
    )
    sides = calibration is not None and calibration.split == "sides"
    side = draw(st.sampled_from(["judged", "calibration"])) if sides else None
    return Suite(
        name=draw(labels),
        seed=draw(st.integers(0, 2**63 - 1)),
        windows=draw(st.none() | st.integers(1, 2**63 - 1)),
        warm_up_s=draw(st.none() | seconds),
        memory_cap_s=draw(seconds),
        duration_s=draw(durations),
        target_far_per_hour=draw(seconds),
        alert_limit_m=draw(st.none() | durations),
        time_to_alert_s=draw(seconds),
        ranks_fused=draw(_subsets(used)),
        calibration=calibration,
        limits=TaskLimits(draw(durations), draw(st.integers(256, 2**40))),
        recordings=tuple(
            RecordingEntry(
                name,
                Path("/", draw(labels)),
                draw(labels),
                sensor_class,
                side,
                draw(st.booleans()),
                draw(_subsets([other for other in recordings if other != name])),
            )
            for name, sensor_class in zip(recordings, of_class, strict=True)
        ),
        attacks=tuple(
            AttackEntry(
                name,
                draw(labels),
                draw(attack_parameters),
                draw(st.none() | _subsets(recordings)),
                draw(st.none() | labels),
            )
            for name in attacks
        ),
        detectors=tuple(
            DetectorEntry(
                name,
                draw(labels),
                draw(parameters),
                draw(st.none() | sources.filter(lambda source: source != "session nobodys")),
                draw(st.dictionaries(labels, sources.filter(lambda text: "session" not in text))),
                draw(st.booleans()),
                draw(some),
                draw(st.none() | durations),
            )
            for name in detectors
        ),
    )


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        value = {key: item for key, item in value.items() if item is not None}
        pairs = (f"{_toml(key)} = {_toml(item)}" for key, item in value.items())
        return f"{{ {', '.join(pairs)} }}"
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    return json.dumps(value)


@settings(deadline=None, max_examples=30)
@given(suites())
def test_what_a_suite_says_reads_back_equal(
    tmp_path_factory: pytest.TempPathFactory, suite: Suite
) -> None:
    said = {key: value for key, value in plain(suite).items() if value is not None}
    text = "\n".join(f"{key} = {_toml(value)}" for key, value in said.items())
    assert load_suite(write(tmp_path_factory.mktemp("suite"), text)) == suite
