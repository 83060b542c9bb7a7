"""A suite file means what it says, or is refused with the key, the value and what to do."""

import math
from dataclasses import asdict
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spoofbench.errors import SuiteError
from spoofbench.suite import load_suite, packaged_suite

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
