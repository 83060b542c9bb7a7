"""Two results folders compared: what differs is seen, and nothing else."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from io import StringIO
from pathlib import Path
from random import Random
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rich.console import Console

from spoofbench.errors import ResultsError
from spoofbench.report.comparison_table import print_differences
from spoofbench.results import read_run, write_run
from spoofbench.scoring.differences import (
    DetectorDifferences,
    Differences,
    FigureDifference,
    differences,
)

FIGURES = ("far_per_hour", "detected_share", "restricted_mean_ttfd_s")

Outing = tuple[int, int | None]
"""Of one session: number of false alerts, and seconds to the detection of a 60 s attack."""

OUTINGS = st.tuples(st.integers(0, 3), st.none() | st.integers(0, 59))
RUNS = st.lists(st.tuples(OUTINGS, OUTINGS), min_size=1, max_size=6)
"""Sessions of two detectors."""

folders = settings(
    max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def make(bench: Any, path: Path, *runs: Mapping[str, Sequence[Outing]], **about: Any) -> Any:
    """A folder not yet written: of each detector its outings, a session each."""
    made = type(bench)(path)
    for sessions in runs:
        for detector, outings in sessions.items():
            for number, (false, delay_s) in enumerate(outings):
                named = {"recording": f"r{number}", "session": f"s{number}", **about}
                made.add(detector, alerts=range(10, 10 + 30 * false, 30), **named)
                hits = [] if delay_s is None else range(100 + delay_s, 160)
                made.add(detector, "replay", alerts=hits, **named)
    return made


def scored(made: Any) -> Path:
    made.score()
    path: Path = made.path
    return path


def two(bench: Any, path: Path, sessions: Sequence[Sequence[Outing]]) -> Path:
    one, other = zip(*sessions, strict=True)
    return scored(make(bench, path, {"one": one, "other": other}))


def named(found: Differences) -> dict[str, FigureDifference]:
    return {
        f"{table.input_class} {row.detector} {name}": getattr(row, name)
        for table in found.tables
        for row in table.rows
        for name in FIGURES
    }


def only_row(found: Differences) -> DetectorDifferences:
    ((row,),) = (table.rows for table in found.tables)
    return row


def printed(found: Differences) -> str:
    out = StringIO()
    print_differences(found, Console(file=out, width=120))
    return out.getvalue()


@folders
@given(RUNS)
def test_a_folder_does_not_differ_from_itself(
    bench: Any, tmp_path_factory: pytest.TempPathFactory, sessions: Any
) -> None:
    folder = two(bench, tmp_path_factory.mktemp("a"), sessions)
    found = differences(folder, folder)
    assert found.changes == ()
    for each in named(found).values():
        assert (each.difference, each.p, each.told_apart) == (0, 1, False)
        assert each.a == each.b
        if each.lo is not None and each.hi is not None:
            assert each.lo < 0 < each.hi
    (table,) = found.tables
    assert (table.windows.both, table.windows.only_a, table.windows.only_b) == (len(sessions), 0, 0)
    assert table.moved == 0
    assert "Nothing changed" in printed(found)


@folders
@given(RUNS, RUNS)
def test_the_other_way_round_signs_turn(
    bench: Any, tmp_path_factory: pytest.TempPathFactory, some: Any, others: Any
) -> None:
    a, b = (
        two(bench, tmp_path_factory.mktemp("a"), some),
        two(bench, tmp_path_factory.mktemp("b"), others),
    )
    there, back = named(differences(a, b)), named(differences(b, a))
    assert there.keys() == back.keys()
    for name, each in there.items():
        other = back[name]
        assert (each.a, each.b, each.p) == (other.b, other.a, other.p)
        assert each.difference == -other.difference
        assert (each.lo is None) == (each.sessions < 5 or "far" in name)
        if each.lo is not None and each.hi is not None:
            assert (-each.hi, -each.lo) == pytest.approx((other.lo, other.hi))
            assert each.lo <= each.difference <= each.hi


@folders
@given(RUNS, RUNS, st.randoms(use_true_random=False))
def test_the_order_of_tasks_changes_nothing(
    bench: Any, tmp_path_factory: pytest.TempPathFactory, some: Any, others: Any, chance: Random
) -> None:
    a, b = (
        two(bench, tmp_path_factory.mktemp("a"), some),
        two(bench, tmp_path_factory.mktemp("b"), others),
    )
    before = differences(a, b)
    one, other = zip(*others, strict=True)
    made = make(bench, b, {"one": one, "other": other})
    chance.shuffle(made.tasks)
    assert differences(a, scored(made)) == before


def test_one_detector_that_got_better_is_seen(bench: Any, tmp_path: Path) -> None:
    late, early = [(1, 50), (1, None)] * 4, [(0, 5), (1, 20)] * 4
    a = scored(make(bench, tmp_path / "a", {"changed": late, "kept": late}))
    b = scored(make(bench, tmp_path / "b", {"changed": early, "kept": late}))
    changed, kept = (row for table in differences(a, b).tables for row in table.rows)
    assert changed.far_per_hour.difference == pytest.approx(-4 / (8 * 200 / 3600))
    assert changed.detected_share.difference == 0.5
    assert changed.restricted_mean_ttfd_s.difference == pytest.approx((5 - 50 + 20 - 60) / 2)
    assert changed.restricted_mean_ttfd_s.p == pytest.approx(2 * 2 / 2**8), "of two rows"
    assert changed.restricted_mean_ttfd_s.told_apart
    assert [getattr(kept, name).difference for name in FIGURES] == [0, 0, 0]
    assert [getattr(kept, name).told_apart for name in FIGURES] == [False] * 3


def test_false_alerts_are_pooled_by_time(bench: Any, tmp_path: Path) -> None:
    folders = []
    for name, false in (("a", (3, 0)), ("b", (0, 2))):
        made = make(bench, tmp_path / name, {"d": [(false[0], 5)]})
        made.add("d", alerts=range(0, 60 * false[1], 60), epochs=600, recording="long", session="l")
        folders.append(scored(made))
    far = only_row(differences(*folders)).far_per_hour
    assert (far.a, far.b) == pytest.approx((3 / (800 / 3600), 2 / (800 / 3600)))
    assert far.difference == pytest.approx(-1 / (800 / 3600))
    assert far.p == 1, "one of two sessions went up"


def test_only_what_both_have_is_compared(bench: Any, tmp_path: Path) -> None:
    outings: list[Outing] = [(1, 20), (0, None), (2, 3)]
    a = scored(make(bench, tmp_path / "a", {"d": outings, "gone": outings}))
    more = make(bench, tmp_path / "b", {"d": [*outings, (3, 59)], "new": outings[:1]})
    more.add("d", "meacon", alerts=[], recording="r0", session="s0")
    found = differences(a, scored(more))
    assert [getattr(only_row(found), name).difference for name in FIGURES] == [0, 0, 0]
    (table,) = found.tables
    assert (table.windows.both, table.windows.only_a, table.windows.only_b) == (3, 0, 2)
    assert (table.recordings.both, table.recordings.only_b) == (3, 1)
    assert (table.detectors.both, table.detectors.only_a, table.detectors.only_b) == (1, 1, 1)
    text = printed(found)
    assert "Only in A, and not compared: 1 detector." in text
    assert "Only in B, and not compared: 2 attack intervals, 1 clean recording, 1 detector." in text


def test_windows_that_moved_are_said(bench: Any, tmp_path: Path) -> None:
    a, b = (type(bench)(tmp_path / name) for name in "ab")
    for made, start in ((a, 100), (b, 110)):
        made.add("d", "replay", window=(start, start + 60), alerts=range(120, 150))
    found = differences(scored(a), scored(b))
    assert found.tables[0].moved == 1
    assert "1 attack interval that both have lie elsewhere in B" in printed(found)


def test_folders_that_share_nothing_are_refused_in_one_sentence(bench: Any, tmp_path: Path) -> None:
    a = scored(make(bench, tmp_path / "a", {"d": [(0, 5)]}))
    for name, detector, about in (
        ("b", "other", {}),
        ("c", "d", {"recording": "elsewhere"}),
        ("d", "d", {"provenance": "simulated"}),
    ):
        b = scored(make(bench, tmp_path / name, {detector: [(0, 5)]}, **about))
        with pytest.raises(ResultsError, match="cannot be compared: no detector is judged on"):
            differences(a, b)


@pytest.mark.parametrize(("sessions", "known"), [(4, False), (5, True)])
def test_intervals_take_five_sessions_and_their_lack_is_said(
    bench: Any, tmp_path: Path, sessions: int, known: bool
) -> None:
    a, b = (
        scored(make(bench, tmp_path / name, {"d": [(0, delay)] * sessions}))
        for name, delay in (("a", 5), ("b", None))
    )
    found = differences(a, b)
    row = only_row(found)
    assert (row.detected_share.lo is not None) == known
    assert (row.restricted_mean_ttfd_s.hi is not None) == known
    assert row.far_per_hour.lo is None
    assert ("No intervals: they take 5 sessions or more" in printed(found)) != known


def test_a_detector_without_the_operating_point_is_unknown(bench: Any, tmp_path: Path) -> None:
    def folder(name: str, level: float) -> Path:
        made = type(bench)(tmp_path / name)
        part = {"calibration_start_ns": 0, "calibration_end_ns": 200_000_000_000}
        for detector, own in (("d", 2.0), ("e", level)):
            made.add(detector, alerts=[20], level=own, **part)
            made.add(detector, "replay", alerts=range(110, 160), level=9.0)
        return scored(made)

    found = differences(folder("a", 2.0), folder("b", float("inf")))
    (table,) = found.tables
    assert table.point == "calibrated"
    calibrated, lost = table.rows
    assert calibrated.detected_share.difference == 0
    assert [getattr(lost, name).difference for name in FIGURES] == [None] * 3
    assert [(change.name, change.a, change.b) for change in found.changes] == [
        ("e on car", "2 (raised only)", "uncalibratable")
    ]


RUN: dict[str, Any] = {
    "versions": {"spoofbench": "1.0", "code": "a" * 64},
    "plugins": {"detector 'd' of a-distribution 1.0": "b" * 64},
    "inputs": {"r0": "c" * 64},
}


@pytest.mark.parametrize(
    ("path", "value", "change"),
    [
        (("versions", "spoofbench"), "1.1", ("version", "spoofbench", "1.0", "1.1")),
        (("versions", "code"), "d" * 64, ("version", "code", "a" * 12, "d" * 12)),
        (
            ("plugins", "detector 'd' of a-distribution 1.0"),
            "d" * 64,
            (
                "plugin",
                "detector 'd' of a-distribution",
                f"1.0, code {'b' * 12}",
                f"1.0, code {'d' * 12}",
            ),
        ),
        (("inputs", "r0"), "d" * 64, ("recording", "r0", "c" * 12, "d" * 12)),
        (("suite", "warm_up_s"), 60.0, ("suite", "warm_up_s", "null", "60.0")),
        (
            ("suite", "calibration"),
            {"split": "sides"},
            ("suite", "calibration.split", None, "sides"),
        ),
    ],
)
def test_what_changed_is_named(
    bench: Any, tmp_path: Path, path: tuple[str, str], value: Any, change: tuple[str, ...]
) -> None:
    a, b = (make(bench, tmp_path / name, {"d": [(0, 5)]}) for name in "ab")
    for made in (a, b):
        scored(made)
        write_run(made.path, {**RUN, "suite": made.suite})
    run = read_run(b.path)
    run[path[0]][path[1]] = value
    write_run(b.path, run)
    found = differences(a.path, b.path).changes
    assert (change[0], change[1], change[2], change[3]) in [
        (each.subject, each.name, each.a, each.b) for each in found
    ]
    assert len(found) == 1 + (path[1] == "calibration"), "which was null"


def test_parameters_are_those_of_the_tasks(bench: Any, tmp_path: Path) -> None:
    a, b = (make(bench, tmp_path / name, {"d": [(0, 5)]}) for name in "ab")
    for made, threshold, delay in ((a, 1, 2.0), (b, 3, 4.0)):
        made.tasks = [
            replace(
                task,
                parameters=json.dumps({"threshold": threshold}),
                attack_parameters=task.attack and json.dumps({"delay_s": delay}),
            )
            for task in made.tasks
        ]
    found = differences(scored(a), scored(b)).changes
    assert [(each.name, each.a, each.b) for each in found] == [
        ("attack replay.delay_s", "2.0", "4.0"),
        ("detector d.threshold", "1", "3"),
    ]
    assert {each.subject for each in found} == {"parameter"}


def test_what_is_printed_fits_80_columns(bench: Any, tmp_path: Path) -> None:
    names = ["a-detector-with-a-name-that-is-very-long", "b"]
    a, b = (
        scored(make(bench, tmp_path / name, dict.fromkeys(names, outings)))
        for name, outings in (("a", [(0, 5)] * 8), ("b", [(2, None)] * 8))
    )
    lines = printed(differences(a, b)).splitlines()
    assert max(map(len, lines)) <= 80
    (row,) = (line for line in lines if line.startswith("b "))
    assert row.split() == ["b", "0", "+36.00*", "100.0", "-100.0*", "5.0", "+55.0*"]


def test_for_machines_it_is_json(bench: Any, tmp_path: Path) -> None:
    folder = scored(make(bench, tmp_path, {"d": [(0, 5)]}))
    found = differences(folder, folder)
    assert json.loads(json.dumps(asdict(found), allow_nan=False))["tables"][0]["rows"]
