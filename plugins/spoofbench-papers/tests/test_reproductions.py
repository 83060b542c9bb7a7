"""The reproductions in their short form: what is deterministic agrees with the papers' checks."""

import json
from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from spoofbench_papers import kujur
from spoofbench_papers.reproduction import Reproduced

pytestmark = pytest.mark.slow


@pytest.fixture
def tanil(short_form: Callable[[str], tuple[Path, Reproduced]]) -> tuple[Path, Reproduced]:
    return short_form("tanil2018")


def test_tanil_verdicts(tanil: tuple[Path, Reproduced]) -> None:
    verdicts = {cell.item: cell.verdict for cell in tanil[1].cells}
    assert verdicts["Fig 3: threshold T_k"] == "matches"
    assert verdicts["Fig 3: integrity risk"] == "matches after calibration"
    assert verdicts["text to Fig 4: the growth with the rate reaches a plateau"] == "not reproduced"
    assert verdicts["Eq 61: 20 samples suffice"] == "not reproduced"
    assert verdicts["Fig 7: risk falls with the attack's delay, up to 3 mm"] == "trend only"


def test_tanil_tables(tanil: tuple[Path, Reproduced]) -> None:
    out, _ = tanil
    wanted = {
        "fig3": {
            "scenario",
            "threshold",
            "lambda",
            "mu_m",
            "sigma_eps_m",
            "rho_m",
            "integrity_risk",
        },
        "fig4": {"scenario", "rate_hz", "period_s", "integrity_risk"},
        "fig6": {"scenario", "sigma_mm", "period_s", "integrity_risk", "method"},
        "fig7": {"scenario", "sigma_mm", "delay_s", "integrity_risk"},
        "late": {"scenario", "first_epoch", "last_epoch", "rho_squared_m2"},
    }
    for name, columns in wanted.items():
        table = pq.read_table(out / f"{name}.parquet")
        assert columns <= set(table.column_names)
        assert table.num_rows
    late = pq.read_table(out / "late.parquet").to_pylist()
    assert {41, 141} <= {row["first_epoch"] for row in late}


def test_pages(tanil: tuple[Path, Reproduced]) -> None:
    out, found = tanil
    page = (out / "index.html").read_text()
    cells = json.loads((out / "verdicts.json").read_text())
    assert [set(cell) for cell in cells] == [
        {"item", "printed", "ours", "lo", "hi", "verdict", "reason"}
    ] * len(found.cells)
    assert all(
        f"{p.name}.png" in (out / "README.md").read_text() and (out / f"{p.name}.svg").exists()
        for p in found.pictures
    )
    assert page.count("<img") == len(found.pictures)
    assert "http" not in page


def test_kujur(short_form: Callable[[str], tuple[Path, Reproduced]]) -> None:
    out, found = short_form("kujur")
    rows = pq.read_table(out / "sensitivity.parquet").to_pylist()
    assert len(rows) == 12 * 2 * 2
    for row in rows:
        size = abs(row["change_pct"])
        if row["parameter"] in kujur.GNSS:
            assert size > 15
        else:
            assert size < (5 if row["case"] == "spoof_free" else 10)
    verdicts = [cell.verdict for cell in found.cells]
    assert verdicts.count("not reproduced") == 1  # the detection of their nominal spoofed example
