"""An assessment from a scenario file: everything is written, and agrees with itself."""

import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from spoofbench.assessing import assess

SCENARIO = Path(__file__).parents[2] / "src/spoofbench/integrity/scenarios/tanil2018-N.toml"


def test_everything_is_written(tmp_path: Path) -> None:
    text = SCENARIO.read_text().replace("warm_up_s = 3600.0", "warm_up_s = 60.0").replace("period_s = 140.0", "period_s = 20.0")
    (tmp_path / "mine.toml").write_text(text)
    shares: list[float] = []
    summary = assess(tmp_path / "mine.toml", tmp_path / "out", shares.append)
    assert json.loads((tmp_path / "out/summary.json").read_text()) == summary
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    tables = {name: pq.read_table(tmp_path / "out" / f"{name}.parquet").to_pylist() for name in ("periods_and_rates", "tracking", "delays")}
    own = next(row for row in tables["periods_and_rates"] if row["period_s"] == 20.0 and row["rate_hz"] == 2.0)
    perfect = next(row for row in tables["tracking"] if row["period_s"] == 20.0 and row["sigma_mm"] == 0)
    prompt = next(row for row in tables["delays"] if row["delay_s"] == 0 and row["sigma_mm"] == 0)
    for row in (own, perfect, prompt):
        assert row["log10_integrity_risk"] == pytest.approx(summary["log10_integrity_risk"], rel=1e-9)
    for name in (*tables, "fault"):
        assert (tmp_path / "out" / f"{name}.png").stat().st_size > 5000
        assert (tmp_path / "out" / f"{name}.svg").exists()
