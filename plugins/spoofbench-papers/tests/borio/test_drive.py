"""The 43-minute drive: what the reproduction of Borio says of it, genuine and replayed."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from spoofbench_papers import borio
from spoofbench_papers.reproduction import Reproduced, write_pages

pytestmark = pytest.mark.drive

FOUR = ("M_acc", "M_ag", "H_acc", "H_ag")


@pytest.fixture(scope="module")
def reproduced(
    short_form: Callable[[str], tuple[Path, Reproduced]], converted_drive: Path
) -> tuple[Path, Reproduced]:
    """The short form, which is the drive alone; ``converted_drive`` skips where there is none."""
    assert converted_drive.exists()
    return short_form("borio")


@pytest.fixture(scope="module")
def tables(reproduced: tuple[Path, Reproduced]) -> Mapping[str, list[dict[str, Any]]]:
    return {path.stem: pq.read_table(path).to_pylist() for path in reproduced[0].glob("*.parquet")}


def row(rows: list[dict[str, Any]], **wanted: Any) -> dict[str, Any]:
    (found,) = [row for row in rows if all(row[key] == value for key, value in wanted.items())]
    return found


@pytest.mark.parametrize(
    ("statistic", "median", "tolerance"),
    [("M_acc", 0.91, 0.03), ("M_ag", 0.985, 0.01), ("H_acc", 0.91, 0.03), ("H_ag", 0.99, 0.01)],
)
def test_gnss_and_imu_of_one_drive_agree(
    tables: Any, statistic: str, median: float, tolerance: float
) -> None:
    assert row(tables["statistics"], case="genuine", statistic=statistic)[
        "median"
    ] == pytest.approx(median, abs=tolerance)


@pytest.mark.parametrize("statistic", FOUR)
def test_a_replay_by_five_minutes_does_not_agree(tables: Any, statistic: str) -> None:
    found = row(tables["statistics"], case="replay-300s", statistic=statistic)
    assert abs(found["median"]) < 0.1
    assert found["p99"] < 0.5 or statistic.endswith("ag")


def test_a_replay_by_one_second_passes_and_by_three_does_not(tables: Any) -> None:
    assert row(tables["statistics"], case="replay-1s", statistic="H")["median"] > 0.7
    assert row(tables["statistics"], case="replay-3s", statistic="H")["p99"] < 0.7


def test_replays_are_the_less_alike_the_later(tables: Any) -> None:
    for statistic in FOUR:
        medians = [
            row(tables["statistics"], case=case, statistic=statistic)["median"]
            for case in ("genuine", *_replays(1, 2, 3, 5, 10))
        ]
        assert medians == sorted(medians, reverse=True)


def _replays(*delays_s: int) -> list[str]:
    return [f"replay-{delay_s}s" for delay_s in delays_s]


@pytest.mark.parametrize("kind", ["gnss_still", "imu_still"])
def test_gnss_and_imu_stand_still_together(tables: Any, kind: str) -> None:
    assert row(tables["contradictions"], case="genuine", kind=kind)["per_min"] < 1
    assert row(tables["contradictions"], case="replay-300s", kind=kind)["per_min"] > 5


def test_other_gravity_estimates_do_no_better_than_the_low_pass(tables: Any) -> None:
    for statistic in ("M_acc", "H_acc"):
        medians = {
            r["setting"]: r["median"] for r in tables["settings"] if r["statistic"] == statistic
        }
        assert [medians["constant"], medians["descent"]] == pytest.approx(
            [medians["low-pass"]] * 2, abs=0.01
        )


def test_noise_takes_h_ag_away_and_adaptive_weights_spare_h(tables: Any) -> None:
    genuine = [r for r in tables["gyro_noise"] if r["case"] == "genuine"]
    lost = [r["median"] for r in genuine if r["statistic"] == "H_ag"]
    assert lost == sorted(lost, reverse=True)
    assert lost[0] > 0.9 > 0.5 > lost[-1]
    low = {
        (r["gyro_noise_radps"], r["adaptive"]): r["p05"] for r in genuine if r["statistic"] == "H"
    }
    assert all(low[noise, True] > low[noise, False] for noise, _ in low)


def test_verdicts(reproduced: tuple[Path, Reproduced]) -> None:
    verdicts = {cell.item: cell.verdict for cell in reproduced[1].cells}
    assert [item for item, verdict in verdicts.items() if verdict == "not reproduced"] == [
        "check: contradicted seconds per minute, either, genuine"
    ]
    assert sum(item.startswith("check:") for item in verdicts) == 12


def test_pages(reproduced: tuple[Path, Reproduced], tables: Any) -> None:
    out, found = reproduced
    page = write_pages(out, borio, found).read_text()
    cells = json.loads((out / "verdicts.json").read_text())
    assert [set(cell) for cell in cells] == [
        {"item", "printed", "ours", "lo", "hi", "verdict", "reason"}
    ] * len(found.cells)
    assert page.count("<img") == len(found.pictures)
    assert all((out / f"{picture.name}.svg").exists() for picture in found.pictures)
    assert {"recording", "statistic", "case", "median", "p05", "p95", "share_below_0_7"} <= set(
        tables["statistics"][0]
    )
    assert "The logs of other vehicles are not there" in " ".join(found.notes)
