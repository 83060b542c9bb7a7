"""The 43-minute drive: what the statistics say of it, genuine and replayed."""

import importlib.util
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from spoofbench import codec

pytestmark = pytest.mark.drive

REPRODUCTION = Path(__file__).parents[3] / "benchmarks" / "reproductions" / "borio_drive.py"
LAG_S = 0.34


@pytest.fixture(scope="module")
def measured(converted_drive: Path) -> Mapping[str, list[dict[str, Any]]]:
    if not REPRODUCTION.exists():
        pytest.skip("benchmarks/reproductions is not beside the plugin")
    spec = importlib.util.spec_from_file_location("borio_drive", REPRODUCTION)
    assert spec is not None
    assert spec.loader is not None
    reproduction = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(reproduction)
    tables: Mapping[str, list[dict[str, Any]]] = reproduction.measure(codec.read(converted_drive), LAG_S)
    return tables


def row(measured: Mapping[str, list[dict[str, Any]]], delay_s: float, statistic: str) -> dict[str, Any]:
    return next(row for row in measured["correlations"] if (row["delay_s"], row["statistic"]) == (delay_s, statistic))


@pytest.mark.parametrize(
    ("statistic", "median", "tolerance"), [("M_acc", 0.91, 0.03), ("M_ag", 0.985, 0.01), ("H_acc", 0.91, 0.03), ("H_ag", 0.99, 0.01)]
)
def test_gnss_and_imu_of_one_drive_agree(measured: Any, statistic: str, median: float, tolerance: float) -> None:
    assert row(measured, 0, statistic)["median"] == pytest.approx(median, abs=tolerance)


@pytest.mark.parametrize("statistic", ["M_acc", "M_ag", "H_acc", "H_ag"])
def test_a_replay_by_five_minutes_does_not_agree(measured: Any, statistic: str) -> None:
    found = row(measured, 300, statistic)
    assert abs(found["median"]) < 0.1
    assert found["p99"] < 0.5 or statistic.endswith("ag")


def test_a_replay_by_one_second_passes_and_by_three_does_not(measured: Any) -> None:
    assert row(measured, 1, "H")["median"] > 0.7
    assert row(measured, 3, "H")["p99"] < 0.7


@pytest.mark.parametrize("kind", ["gnss_still", "imu_still"])
def test_gnss_and_imu_stand_still_together(measured: Any, kind: str) -> None:
    genuine, replay = (row[f"{kind}_per_min"] for row in measured["contradictions"])
    assert genuine < 1
    assert replay > 5


def test_other_gravity_estimates_do_no_better_than_the_low_pass(measured: Any) -> None:
    medians = {row["setting"]: row for row in measured["settings"]}
    for other in ("constant", "descent"):
        for statistic in ("M_acc", "H_acc"):
            assert medians[other][statistic] == pytest.approx(medians["low_pass"][statistic], abs=0.01)
