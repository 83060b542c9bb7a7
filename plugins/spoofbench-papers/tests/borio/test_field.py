"""Real logs of other vehicles, where they are beside the project: what they say of the paper's
statements.
"""

from pathlib import Path

import pyarrow.parquet as pq
import pytest
from spoofbench_papers import borio
from spoofbench_papers.reproduction import Reproduced

SHARED = Path(__file__).parents[4].parent / "shared" / "data"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.drive,
    pytest.mark.skipif(not SHARED.is_dir(), reason=f"the real logs are not there: {SHARED}"),
]


@pytest.fixture(scope="module")
def reproduced(
    tmp_path_factory: pytest.TempPathFactory, converted_drive: Path
) -> tuple[Path, Reproduced]:
    """All recordings; ``converted_drive`` skips where the drive is not installed."""
    assert converted_drive.exists()
    out = tmp_path_factory.mktemp("borio")
    return out, borio.reproduce(out, SHARED, False, lambda share: None)


def test_no_log_is_left_out(reproduced: tuple[Path, Reproduced]) -> None:
    out, found = reproduced
    assert not [note for note in found.notes if "left out" in note]
    assert pq.read_table(out / "recordings.parquet").num_rows == 15


def test_steady_cruise_is_hardest_on_m_ag_and_easiest_on_h_ag(
    reproduced: tuple[Path, Reproduced],
) -> None:
    rows = [
        row
        for row in pq.read_table(reproduced[0] / "dynamics.parquet").to_pylist()
        if row["recording"] == "phone-car"
    ]
    calm, lively = (
        {row["statistic"]: row["median"] for row in rows if row["quintile"] == number}
        for number in (1, 5)
    )
    fall = {statistic: lively[statistic] - calm[statistic] for statistic in calm}
    assert max(fall, key=fall.__getitem__) == "M_ag"
    assert min(fall, key=fall.__getitem__) == "H_ag"


def test_another_run_of_the_route_does_not_agree(reproduced: tuple[Path, Reproduced]) -> None:
    rows = [
        row
        for row in pq.read_table(reproduced[0] / "statistics.parquet").to_pylist()
        if row["case"] == "meacon-boston-run2"
    ]
    assert len(rows) == 6
    assert all(row["p99"] < 0.6 for row in rows)


def test_thresholds_do_not_transfer(reproduced: tuple[Path, Reproduced]) -> None:
    rows = pq.read_table(reproduced[0] / "transfer.parquet").to_pylist()
    share = {
        (row["fitted_on"], row["applied_to"]): row["false_alert_share"]
        for row in rows
        if row["statistic"] == "H"
    }
    assert share["drive", "drive"] < 0.02
    assert share["drive", "boston"] < 0.02
    assert share["drive", "iphone-3"] > 0.9


def test_verdicts(reproduced: tuple[Path, Reproduced]) -> None:
    failed = [cell.item for cell in reproduced[1].cells if cell.verdict == "not reproduced"]
    assert failed == [
        "Section V-A: the same elsewhere; recordings with less than 5",
        "check: contradicted seconds per minute, either, genuine",
    ]
