"""Recipes say what they must, and those that are shipped are whole."""

from pathlib import Path

import pytest

from spoofbench import plugins
from spoofbench.errors import ConfigError
from spoofbench.fetch import recipes
from spoofbench.fetch.recipe_file import read_recipes
from spoofbench.labels import read_labels
from spoofbench.shipped import shipped

FILE = f"{{ url = 'https://example.org/a.csv', size = 3, sha256 = '{'0' * 64}' }}"
SIMULATION = "{ seed = 1, duration_s = 90.0 }"
WHOLE = (
    "title = 'A'\nclass = 'phone-1hz'\nlicence = 'MIT'\ncredit = 'N. N.'\nvehicle = 'car'\n"
    f"files = [{FILE}]\n"
)


def _read(text: str) -> None:
    read_recipes(text.encode())


def test_defaults_fill_what_a_recipe_leaves_out_and_it_may_differ() -> None:
    found, _ = read_recipes(
        b"[defaults.x]\nlicence = 'MIT'\nvehicle = 'bus'\n[recordings.a]\ndefaults = 'x'\n"
        + WHOLE.encode()
    )
    assert found["a"].vehicle == "car"
    assert found["a"].session == "a"
    assert found["a"].simulation is None


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (f"[recordings.a]\ndefaults = 'y'\n{WHOLE}", "there are no defaults 'y'"),
        (f"[recordings.a]\n{WHOLE}sizes = 1\n", "unknown key 'sizes'"),
        (f"[recordings.a]\n{WHOLE}".replace("sha256 = '0", "sha256 = 'z"), "sha256"),
        (f"[recordings.a]\n{WHOLE}".replace("title = 'A'\n", ""), "title"),
        (f"[recordings.a]\n{WHOLE}".replace(FILE, f"{FILE}, {FILE}"), "have one name"),
        (
            f"[recordings.a]\n{WHOLE}".replace("url = 'https://example.org/a.csv'", "wheel = 'w'"),
            "either a 'url', or a 'wheel'",
        ),
        (
            f"[recordings.a]\n{WHOLE}".replace(
                "url = 'https://example.org/a.csv'", "wheel = 'w', member = 'a/b'"
            ),
            "no wheel 'w'",
        ),
        (f"[recordings.a]\n{WHOLE}".replace("a.csv", "..%2Fa"), "cannot be the name of a file"),
        (f"[recordings.a]\n{WHOLE}".replace(f"[{FILE}]", "[]"), "'files' or a 'simulation'"),
        (f"[recordings.a]\n{WHOLE}simulation = {SIMULATION}\n", "'files' or a 'simulation'"),
        (
            f"[recordings.a]\n{WHOLE}".replace(
                f"files = [{FILE}]", "simulation = { seed = 1, duration_s = 9.0 }"
            ),
            "duration_s",
        ),
    ],
)
def test_what_is_wrong_with_a_recipe_is_said(text: str, sentence: str) -> None:
    with pytest.raises(ConfigError, match=sentence):
        _read(text)


@pytest.mark.parametrize("name", sorted(recipes()))
def test_a_shipped_recipe_can_be_followed(name: str) -> None:
    recipe = recipes()[name]
    assert recipe.format is None or recipe.format in plugins.found(plugins.CONVERTERS)
    assert all(file.url.startswith("https://") for file in recipe.files if file.url)
    assert recipe.labels is None or (shipped("labels") / recipe.labels).is_file()


def test_one_file_is_one_recording_unless_options_tell_apart() -> None:
    seen: dict[object, str] = {}
    for each in recipes().values():
        key = (each.files, each.simulation, tuple(sorted(each.options.items())))
        assert key not in seen, (each.name, seen[key])
        seen[key] = each.name


def test_what_is_shipped_lies_where_it_is_looked_for() -> None:
    assert shipped("recordings.toml").is_file()
    assert list(shipped("suites").glob("*.toml"))
    assert isinstance(shipped("labels"), Path)


def test_the_shipped_labels_say_attacked_and_clean() -> None:
    labels = [each.labels for each in recipes().values() if each.labels]
    assert labels == ["airliner-spoofed.toml"]
    states = [label.state for _, label in read_labels(shipped("labels") / labels[0])]
    assert sorted(states) == ["attacked", "clean", "clean"]
