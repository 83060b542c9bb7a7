"""What is judged sets no threshold and teaches no state: neither itself, nor through a donor."""

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from spoofbench.results import read_tasks
from spoofbench.runner import run
from spoofbench.suite import AttackEntry, DetectorEntry
from tests.runner.sessions import (
    LENGTH_S,
    factors,
    judged,
    lessons,
    noise,
    session_suite,
    taught_sessions,
    write_sessions,
)

pytestmark = pytest.mark.usefixtures("fakes")

CLEAN = {number: noise(number) for number in range(1, 6)}
STEADY = DetectorEntry("steady", "steady", {"scale": 1.0}, "by hand")
CALIBRATING = (1, 2, 3)
SPLITS = (
    "first-part",
    "sides",
    pytest.param("leave-one-session-out", marks=pytest.mark.slow),
)

Scores = Mapping[int, Any]


def run_sessions(folder: Path, scores: Scores, split: str, **about: Any) -> Path:
    write_sessions(folder, scores)
    calibrating = CALIBRATING if split == "sides" else ()
    detectors = about.pop("detectors", [STEADY])
    suite = session_suite(folder, split, detectors, calibrating=calibrating, **about)
    run(suite, folder / "results")
    return folder / "results"


def with_other(part: slice, *sessions: int) -> dict[int, Any]:
    """The scores, but others in this part of these sessions."""
    changed = {number: score.copy() for number, score in CLEAN.items()}
    for number in sessions:
        changed[number][part] = 3 * noise(100 + number)[part]
    return changed


@pytest.fixture(scope="module")
def unchanged(fakes: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Results of each split."""
    made: dict[str, Path] = {}

    def results(split: str) -> Path:
        if split not in made:
            made[split] = run_sessions(tmp_path_factory.mktemp(split), CLEAN, split)
        return made[split]

    return results


@pytest.mark.slow
def test_what_comes_after_the_first_part_sets_no_threshold(
    unchanged: Callable[[str], Path], tmp_path: Path
) -> None:
    before = factors(unchanged("first-part"))
    later = with_other(slice(LENGTH_S // 2, None), *CLEAN)
    earlier = with_other(slice(LENGTH_S // 2 - 30, LENGTH_S // 2), *CLEAN)
    assert factors(run_sessions(tmp_path / "later", later, "first-part")) == before
    assert factors(run_sessions(tmp_path / "earlier", earlier, "first-part")) != before
    assert set(before) == {("steady", "[]")}


@pytest.mark.slow
def test_the_judged_side_sets_no_threshold(
    unchanged: Callable[[str], Path], tmp_path: Path
) -> None:
    before = factors(unchanged("sides"))
    own, other = with_other(slice(None), 4, 5), with_other(slice(None), 2)
    assert factors(run_sessions(tmp_path / "judged", own, "sides")) == before
    assert factors(run_sessions(tmp_path / "calibration", other, "sides")) != before
    assert {task.recording for task in judged(unchanged("sides"), "steady")} == {"r4", "r5"}


@pytest.mark.slow
def test_a_session_that_is_left_out_sets_the_thresholds_of_all_others_but_not_its_own(
    unchanged: Callable[[str], Path], tmp_path: Path
) -> None:
    split = "leave-one-session-out"
    before = factors(unchanged(split))
    after = factors(run_sessions(tmp_path / "sessions", with_other(slice(None), 3), split))
    assert before.keys() == after.keys() == {("steady", f'["s{n}"]') for n in CLEAN}
    differing = {
        held_out for (_, held_out), factor in after.items() if factor != before["steady", held_out]
    }
    assert differing == {'["s1"]', '["s2"]', '["s4"]', '["s5"]'}


@pytest.mark.slow
@pytest.mark.parametrize("split", SPLITS)
def test_a_variant_is_judged_with_a_threshold_made_without_its_donor(
    tmp_path: Path, split: str
) -> None:
    """Recording 4 takes its signals from 2, which sets the threshold of all but its variants."""
    lent = {"attacks": ["borrow"], "donors": {4: [2]}}
    before = run_sessions(tmp_path / "before", CLEAN, split, **lent)
    after = run_sessions(tmp_path / "after", with_other(slice(None), 2), split, **lent)
    (variant,) = (task for task in judged(before, "steady") if task.attack and task.status == "ok")
    held_out = variant.held_out
    assert "s2" in json.loads(held_out)
    assert factors(after)["steady", held_out] == factors(before)["steady", held_out]
    (unattacked,) = (
        task for task in judged(before, "steady") if not task.attack and task.recording == "r4"
    )
    key = "steady", unattacked.held_out
    assert factors(after)[key] != factors(before)[key]
    scored = {
        row["task_id"]: row["factor"]
        for row in pq.read_table(before / "scores.parquet").to_pylist()
        if row["point"] == "calibrated"
    }
    assert scored[variant.task_id] == factors(before)["steady", held_out]
    assert scored[unattacked.task_id] == factors(before)[key]


PUPILS = ("pupil", "attack-pupil")
LENT = {4: [2], 1: [5]}
SESSION = {f"r{number}": number for number in CLEAN}


@pytest.fixture(scope="module")
def taught(fakes: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Results of each split with detectors that learn, and attacks that borrow."""
    made: dict[str, Path] = {}

    def results(split: str) -> Path:
        if split not in made:
            folder = tmp_path_factory.mktemp(split)
            attacks = ["boost", "borrow"]
            made[split] = run_sessions(
                folder, CLEAN, split, detectors=PUPILS, attacks=attacks, donors=LENT
            )
        return made[split]

    return results


@pytest.mark.parametrize("detector", PUPILS)
@pytest.mark.parametrize("split", SPLITS)
def test_no_state_has_seen_what_it_is_judged_on(
    taught: Callable[[str], Path], split: str, detector: str
) -> None:
    folder = taught(split)
    ran = [task for task in judged(folder, detector) if task.status == "ok"]
    assert {task.attack for task in ran} == {None, "boost", "borrow"}
    for task in ran:
        number = SESSION[task.recording]
        seen = taught_sessions(folder, task)
        assert seen, "it has learned from something"
        assert not seen & {int(name[1:]) for name in json.loads(task.held_out)}
        if task.attack is not None and number in LENT:
            assert not seen & set(LENT[number])
        if split == "first-part":
            for lesson in lessons(folder, task):
                assert lesson["times"][1] < (task.judged_start_ns or 0), "one clock for all"
        else:
            assert number not in seen
        if split == "sides" and task.attack is None:
            assert seen == {*CALIBRATING}, "whoever is judged has nothing to teach"


@pytest.mark.parametrize("detector", PUPILS)
@pytest.mark.parametrize("split", SPLITS)
def test_no_state_sets_a_threshold_on_what_it_has_seen(
    taught: Callable[[str], Path], split: str, detector: str
) -> None:
    folder = taught(split)
    setting = [t for t in read_tasks(folder) if t.detector == detector and t.calibrates]
    assert setting
    for task in setting:
        assert not taught_sessions(folder, task) & {
            int(name[1:]) for name in json.loads(task.held_out)
        }
        if split == "first-part":
            for lesson in lessons(folder, task):
                assert lesson["times"][1] < (task.calibration_start_ns or 0)
        else:
            assert SESSION[task.recording] not in taught_sessions(folder, task)
    by_use: dict[tuple[str, str | None], set[str]] = {}
    for task in setting:
        by_use.setdefault((task.held_out, task.left_out), set()).add(task.recording)
    for (held_out, _), recordings in by_use.items():
        may = {*CALIBRATING} if split == "sides" else {*CLEAN}
        may -= {int(name[1:]) for name in json.loads(held_out)}
        assert {SESSION[name] for name in recordings} == may, "all that may set it do"


@pytest.mark.parametrize("split", SPLITS[1:])
def test_who_learns_from_attacks_is_also_judged_without_the_attack_s_plugin(
    taught: Callable[[str], Path], split: str
) -> None:
    folder = taught(split)
    left_out = [t for t in judged(folder, "attack-pupil") if t.role == "family left out"]
    assert {task.attack for task in left_out if task.status == "ok"} == {"boost", "borrow"}
    marks = {"boost": 1, "borrow": 2}
    for task in left_out:
        if task.status == "ok":
            assert task.attack == task.left_out
            known = {mark for one in lessons(folder, task) for mark in one["attack"]}
            assert marks[task.left_out or ""] not in known
    whole = [t for t in judged(folder, "attack-pupil") if t.role == "judged" and t.status == "ok"]
    assert any(
        mark for task in whole for one in lessons(folder, task) for mark in one["attack"] if mark
    )
    assert all(
        one["marked"] for task in whole for one in lessons(folder, task) if "marked" in one
    ), "it is told when its material is attacked"
    assert not [t for t in read_tasks(folder) if t.detector == "pupil" and t.left_out]


def test_where_parts_of_a_session_are_judged_its_attacks_teach_nothing(
    taught: Callable[[str], Path],
) -> None:
    folder = taught("first-part")
    for task in judged(folder, "attack-pupil"):
        if task.fit_id:
            assert {mark for one in lessons(folder, task) for mark in one["attack"]} == {0}


def test_an_attack_that_teaches_borrows_nothing_of_who_is_judged(tmp_path: Path) -> None:
    """Recording 1 calibrates and takes its signals from 4, which is judged."""
    folder = run_sessions(
        tmp_path / "sessions",
        CLEAN,
        "sides",
        detectors=["attack-pupil"],
        attacks=["boost", "borrow"],
        donors={1: [4], 2: [3]},
    )
    for task in judged(folder, "attack-pupil"):
        if task.fit_id and task.left_out is None:
            assert taught_sessions(folder, task) == {*CALIBRATING}
            marks = {mark for one in lessons(folder, task) for mark in one["attack"]}
            assert marks == {0, 1, 2}, "what recording 2 borrows of 3 may teach"


def test_windows_lie_after_the_first_part(unchanged: Callable[[str], Path]) -> None:
    for task in judged(unchanged("first-part"), "steady"):
        assert task.judged_start_ns is not None
        if task.window_start_ns is not None:
            assert task.window_start_ns >= task.judged_start_ns


def drawn(folder: Path) -> dict[str, set[tuple[int | None, int | None]]]:
    windows: dict[str, set[tuple[int | None, int | None]]] = {}
    for task in read_tasks(folder):
        if task.attack:
            window = task.window_start_ns, task.window_end_ns
            windows.setdefault(task.recording, set()).add(window)
    return windows


@pytest.mark.slow
def test_windows_are_drawn_by_the_seed_whoever_attacks_and_detects(tmp_path: Path) -> None:
    write_sessions(tmp_path, {1: CLEAN[1], 2: CLEAN[2]})
    suite = session_suite(tmp_path, None, [STEADY], ["boost"])
    more = replace(
        suite,
        attacks=(AttackEntry("nudge", "nudge"), *suite.attacks),
        detectors=(*suite.detectors, DetectorEntry("pupil", "pupil")),
    )
    for name, each in (("one", suite), ("more", more), ("other", replace(suite, seed=2))):
        run(each, tmp_path / name)
    first, second = drawn(tmp_path / "one"), drawn(tmp_path / "other")
    assert first == drawn(tmp_path / "more")
    assert all(len(windows) == 1 for windows in first.values())
    assert first["r1"] != first["r2"], "recordings have windows of their own"
    assert first["r1"] != second["r1"]


def test_windows_wait_for_the_longest_warm_up_of_the_detectors_of_their_class(
    tmp_path: Path,
) -> None:
    write_sessions(tmp_path, {1: CLEAN[1], 2: CLEAN[2]})
    slow, slower = (
        DetectorEntry(f"warm-{seconds:g}", "patient", {"warm_up_s": seconds}, "by hand", classes=of)
        for seconds, of in ((400.0, None), (520.0, ("phone",)))
    )
    suite = session_suite(tmp_path, None, [STEADY], warm_up_s=None)
    car, phone = suite.recordings
    suite = replace(
        suite,
        recordings=(car, replace(phone, sensor_class="phone")),
        detectors=(STEADY, slow, slower),
    )
    run(suite, tmp_path / "results")
    starts = {
        task.recording: (task.window_start_ns or 0) / 1e9 - 1.7e9
        for task in read_tasks(tmp_path / "results")
        if task.attack
    }
    assert 400 <= starts["r1"] < 540
    assert 520 <= starts["r2"] <= 540


def test_leave_one_session_out_without_another_session_calibrates_nothing(tmp_path: Path) -> None:
    folder = tmp_path / "sessions"
    run_sessions(folder, {1: CLEAN[1]}, "leave-one-session-out", detectors=[STEADY, "pupil"])
    (row,) = (
        row
        for row in pq.read_table(folder / "results" / "calibration.parquet").to_pylist()
        if row["detector"] == "steady"
    )
    assert (row["how"], row["factor"]) == ("no session", None)
    statuses = {(task.status, task.reason) for task in judged(folder / "results", "pupil")}
    assert statuses == {("skipped", "no session is left to fit the detector on")}
