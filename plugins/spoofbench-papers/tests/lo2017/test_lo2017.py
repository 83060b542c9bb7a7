"""The reproduction in its short form: its files, its verdicts and what Table 2 must show."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2
from spoofbench_papers.lo2017 import cells as printed_cells
from spoofbench_papers.lo2017 import checks, recordings
from spoofbench_papers.lo2017.approach import APPROACHES, fly
from spoofbench_papers.lo2017.tables import CASES, MONITORS, STRIDES, convention, outcomes
from spoofbench_papers.reproduction import Reproduced

from spoofbench.recording import Recording
from spoofbench.table import Table

SEEDS = range(60)


@pytest.fixture
def written(short_form: Callable[[str], tuple[Path, Reproduced]]) -> tuple[Path, Reproduced]:
    return short_form("lo2017")


@pytest.fixture(scope="module")
def found() -> printed_cells.Outcomes:
    return printed_cells.by_key(
        [outcome for a in APPROACHES for outcome in outcomes(a, fly(a, SEEDS), (1, 3))]
    )


def test_every_printed_cell_has_a_verdict(written: tuple[Path, Reproduced]) -> None:
    out, _ = written
    verdicts = json.loads((out / "verdicts.json").read_text())
    items = [verdict["item"] for verdict in verdicts]
    assert len(set(items)) == len(items)
    assert sum(item.startswith("Table 2, ") and item.endswith("% detected") for item in items) == 64
    assert (
        sum(item.startswith("Table 2, ") and item.endswith("first detection, s") for item in items)
        == 64
    )
    assert not any(v["verdict"] == "matches" for v in verdicts if v["item"].startswith("Table"))


def test_table_2_is_complete(written: tuple[Path, Reproduced]) -> None:
    table = pq.read_table(written[0] / "table2.parquet").to_pylist()
    keys = {(row["case"], row["approach"], row["monitor"], row["convention"]) for row in table}
    assert len(keys) == len(table) == (len(CASES) + 1) * 4 * 2 * len(STRIDES)
    for row in table:
        assert row["detection_pct_lo"] <= row["detection_pct"] <= row["detection_pct_hi"]
        assert (row["ttfd_s"] is None) == (row["detected_share"] < 0.5) or row[
            "detected_share"
        ] == 0.5


def test_pictures_are_written_as_png_and_svg(written: tuple[Path, Reproduced]) -> None:
    out, found = written
    assert len(found.pictures) == 8
    assert all(
        (out / f"{picture.name}{suffix}").stat().st_size > 1000
        for picture in found.pictures
        for suffix in (".png", ".svg")
    )


def test_absent_logs_are_named(written: tuple[Path, Reproduced]) -> None:
    assert sum("is left out" in note for note in written[1].notes) == 1 + len(recordings.FLIGHTS)


FAILS = {
    "multi: repeat 0.5 s, %": (
        "approach 1 stays below 10 %, unless its motion is quicker than chosen"
    )
}
ITEMS = [*checks.printed_checks(), "nominal with lost epochs gated, %"]


@pytest.mark.parametrize(
    "item",
    [
        pytest.param(i, marks=pytest.mark.xfail(reason=FAILS[i], strict=True)) if i in FAILS else i
        for i in ITEMS
    ],
)
def test_table_2_as_a_whole(item: str, found: printed_cells.Outcomes) -> None:
    check = next(
        check
        for check in checks.simulated_checks(found, printed_cells.JUDGED)
        if check.item == item
    )
    assert check.holds, f"{item}: {check}"


def test_consecutive_samples_cannot_give_the_table(found: printed_cells.Outcomes) -> None:
    assert checks.mean_absolute_difference(found, convention(1)) > 15
    assert checks.mean_absolute_difference(found, convention(3)) <= checks.WANTED_POINTS


def test_later_samples_detect_more_of_the_repeat_back(found: printed_cells.Outcomes) -> None:
    for approach in APPROACHES:
        wide, narrow = (
            found["repeat 2 s", approach.number, "multi", convention(stride)].median_pct
            for stride in (3, 1)
        )
        assert wide > narrow + 25


def test_the_multi_condition_monitor_alerts_wherever_the_simple_one_does(
    found: printed_cells.Outcomes,
) -> None:
    for (case, approach, monitor, way), outcome in found.items():
        if monitor == MONITORS[0]:
            multi = found[case, approach, MONITORS[1], way]
            assert (multi.detection_pct >= outcome.detection_pct).all()
            assert (multi.ttfd_s <= outcome.ttfd_s).all()


@pytest.mark.parametrize("x", [0.5, 7.0, 30.0, 55.87])
def test_chi_square_of_seven_degrees(x: float) -> None:
    assert printed_cells.chi2_7_above(x) == pytest.approx(chi2.sf(x, 7), rel=1e-9)


@given(st.lists(st.tuples(st.floats(0, 60), st.floats(0, 360)), min_size=1, max_size=5))
def test_velocity_has_the_speed_and_course_of_the_log(rows: list[tuple[float, float]]) -> None:
    speed, course = np.array(rows).T
    pvt = Table("gnss/pvt", np.arange(len(rows)), {"speed_mps": speed, "course_deg": course})
    with_velocity = recordings.with_velocity(Recording({"/gnss0/gnss/pvt": pvt})).primary(
        "gnss/pvt"
    )
    north, east = with_velocity["vel_n_mps"], with_velocity["vel_e_mps"]
    np.testing.assert_allclose(np.hypot(north, east), speed, atol=1e-4)
    np.testing.assert_allclose(
        speed * np.sin(np.radians(course) - np.arctan2(east, north)), 0, atol=1e-3
    )


@pytest.mark.drive
def test_the_drive_bears_out_what_the_paper_says_of_cars() -> None:
    logs, _ = recordings.logs(None, with_drive=True)
    cells = list(recordings.cells([row for log in logs for row in recordings.rows(log)]))
    assert [cell.verdict for cell in cells] == ["trend only"] * 3
