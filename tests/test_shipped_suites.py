"""The suites that come with spoofbench say what they mean, and the smallest of them runs whole."""

from dataclasses import replace
from pathlib import Path

import pyarrow.parquet as pq
import pytest
import typer.testing

from spoofbench import cli, fetch, plugins, runner
from spoofbench.errors import SuiteError
from spoofbench.fetch import CACHE_VARIABLE, cached_path, names_of, recipe
from spoofbench.results import read_tasks
from spoofbench.runner import run
from spoofbench.scoring.leaderboard import leaderboard
from spoofbench.shipped import shipped
from spoofbench.suite import Suite, find_suite, load_suite

NAMES = sorted(path.stem for path in shipped("suites").glob("*.toml"))
INSTALLATION = ("lag", "mounting", "sigma", "bias", "noise", "inflation", "random_walk", "axes")
"""What depends on one vehicle's sensors: a run fits it, or judges without."""


@pytest.fixture
def no_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache, and no mirror."""
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    monkeypatch.delenv(fetch.MIRROR_VARIABLE, raising=False)
    return tmp_path / "cache"


def _suite(name: str) -> Suite:
    return load_suite(find_suite(Path(name)))


def test_the_suites_that_were_promised_are_there() -> None:
    promised = [
        "drive",
        "field-airliner",
        "field-cars",
        "field-phones",
        "papers",
        "severity",
        "smoke",
    ]
    assert promised == NAMES


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.usefixtures("no_cache")
def test_a_shipped_suite_is_read_without_its_recordings(name: str) -> None:
    suite = _suite(name)
    assert suite.name == name
    assert [entry.recipe for entry in suite.recordings] == list(names_of([name]))
    classes: dict[str, set[str]] = {}
    for entry in suite.recordings:
        assert entry.path == cached_path(str(entry.recipe))
        assert not entry.path.exists()
        assert entry.session == recipe(str(entry.recipe)).session
        classes.setdefault(entry.session, set()).add(entry.sensor_class)
    assert all(len(found) == 1 for found in classes.values())


@pytest.mark.parametrize("name", NAMES)
def test_its_plugins_take_its_parameters_and_all_have_a_source(name: str) -> None:
    suite = _suite(name)
    for attack in suite.attacks:
        plugins.make(plugins.ATTACKS, attack.plugin, dict(attack.parameters))
    for detector in suite.detectors:
        given = dict(detector.parameters)
        if detector.plugin in ("periodic", "random", "bursts"):
            given["rate_per_hour"] = suite.target_far_per_hour
        plugins.make(plugins.DETECTORS, detector.plugin, given)
        assert all(detector.source_of(parameter) for parameter in detector.parameters)


@pytest.mark.parametrize("name", NAMES)
def test_nothing_that_was_measured_on_a_vehicle_is_a_parameter(name: str) -> None:
    for detector in _suite(name).detectors:
        found = [p for p in detector.parameters if any(word in p for word in INSTALLATION)]
        assert found == []


@pytest.mark.usefixtures("no_cache")
def test_what_is_not_fetched_is_said_before_anything_runs(tmp_path: Path) -> None:
    with pytest.raises(SuiteError, match="fetch it with: spoofbench fetch simulated-car-1"):
        run(_suite("smoke"), tmp_path / "results")
    assert not (tmp_path / "results").exists()


@pytest.mark.usefixtures("no_cache")
def test_the_command_fetches_what_is_missing_and_that_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    suite = _suite("smoke")
    ran: list[Suite] = []
    monkeypatch.setattr(runner, "run", lambda suite, *_, **__: ran.append(suite))
    monkeypatch.setattr("spoofbench.results.read_tasks", lambda _: [])
    monkeypatch.setattr(cli, "_leaderboard", lambda _: None)
    command = ["run", "smoke", "-o", str(tmp_path / "results")]
    for _ in range(2):
        assert typer.testing.CliRunner().invoke(cli.app, command).exit_code == 0
    assert ran == [suite, suite]
    made = {entry.path: entry.path.stat().st_mtime_ns for entry in suite.recordings}
    assert typer.testing.CliRunner().invoke(cli.app, command).exit_code == 0
    assert made == {path: path.stat().st_mtime_ns for path in made}


def test_the_smallest_suite_runs_through_every_stage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # workers are elsewhere, and find a folder that is named from here
    suite = _suite("smoke")
    for name in names_of(["smoke"]):
        fetch.fetch(name)
    results = Path("results")
    run(replace(suite, seed=2), results)
    tasks = read_tasks(results)
    assert {task.status for task in tasks} == {"ok"}
    assert {task.provenance for task in tasks} == {"simulated"}
    assert any(task.fit_id for task in tasks)
    assert {task.role for task in tasks} == {"judged", "calibration"}
    board = leaderboard(results)
    assert {table.provenance for table in board.tables} == {"simulated"}
    assert {table.point for table in board.tables} == {"calibrated"}
    assert [table.input_class for table in board.tables] == ["gnss", "gnss+imu"]
    for table in board.tables:
        assert table.sessions == table.clean_sessions == 5
        assert table.windows == 15
    assert {row.attack for row in board.severity} == {"drag-off"}
    for row in board.severity:
        assert row.curve.strength.tolist() == [0.3, 3.0]
    held_out = pq.read_table(results / "calibration.parquet")["held_out"].to_pylist()
    assert len(set(held_out)) == 5
