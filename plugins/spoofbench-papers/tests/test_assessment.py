"""An assessment from a scenario file: everything is written, and agrees with itself."""

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from spoofbench_papers.assessment import assess, draw_risk
from spoofbench_papers.integrity.scenario import ScenarioError

SCENARIO = Path(__file__).parents[1] / "src/spoofbench_papers/integrity/scenarios/tanil2018-N.toml"


def test_everything_is_written(tmp_path: Path) -> None:
    text = (
        SCENARIO.read_text()
        .replace("warm_up_s = 3600.0", "warm_up_s = 60.0")
        .replace("period_s = 140.0", "period_s = 20.0")
    )
    (tmp_path / "mine.toml").write_text(text)
    shares: list[float] = []
    summary = assess(tmp_path / "mine.toml", tmp_path / "out", shares.append)
    assert json.loads((tmp_path / "out/summary.json").read_text()) == summary
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    tables = {
        name: pq.read_table(tmp_path / "out" / f"{name}.parquet").to_pylist()
        for name in ("periods_and_rates", "tracking", "delays")
    }
    own = next(
        row
        for row in tables["periods_and_rates"]
        if row["period_s"] == 20.0 and row["rate_hz"] == 2.0
    )
    perfect = next(
        row for row in tables["tracking"] if row["period_s"] == 20.0 and row["sigma_mm"] == 0
    )
    prompt = next(row for row in tables["delays"] if row["delay_s"] == 0 and row["sigma_mm"] == 0)
    for row in (own, perfect, prompt):
        assert row["log10_integrity_risk"] == pytest.approx(
            summary["log10_integrity_risk"], rel=1e-9
        )
    for name in (*tables, "fault"):
        assert (tmp_path / "out" / f"{name}.png").stat().st_size > 5000
        assert (tmp_path / "out" / f"{name}.svg").exists()


def made(folder: Path, **values: object) -> Path:
    """Return a scenario file with other values."""
    lines = SCENARIO.read_text().split("\n")
    changed = [
        next(
            (f"{name} = {value}" for name, value in values.items() if line.startswith(f"{name} =")),
            line,
        )
        for line in lines
    ]
    assert sum(old != new for old, new in zip(lines, changed, strict=True)) == len(values)
    (folder / "mine.toml").write_text("\n".join(changed))
    return folder / "mine.toml"


@pytest.mark.parametrize(
    "values",
    [
        {"satellites_deg": [[20, 75], [60, 30]], "period_s": 5.0},
        {"rate_hz": 0.1, "period_s": 30.0},
        {"period_s": 1e-5},
        {"satellites_deg": [[20, 75], [20, 74]], "period_s": 5.0},
    ],
)
def test_the_least_gives_numbers(tmp_path: Path, values: dict[str, object]) -> None:
    """Two satellites, an epoch in ten seconds, one epoch in all, satellites side by side."""
    summary = assess(made(tmp_path, warm_up_s=60.0, **values), tmp_path / "out", lambda share: None)
    assert all(np.isfinite(value) for value in summary.values())
    for name in ("periods_and_rates", "tracking", "delays"):
        assert np.isfinite(
            pq.read_table(tmp_path / "out" / f"{name}.parquet")["log10_integrity_risk"].to_numpy()
        ).all()


def test_too_many_epochs(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="1201 epochs"):
        assess(made(tmp_path, period_s=600.0), tmp_path / "out", lambda share: None)


def test_any_name_can_be_drawn(tmp_path: Path) -> None:
    table = {
        "scenario": ["$x^{$"],
        "period_s": [1.0],
        "rate_hz": [1.0],
        "log10_integrity_risk": [-3.0],
    }
    draw_risk(tmp_path / "risk", table, ("period_s", "period, s"), ("rate_hz", "Hz"))
    assert (tmp_path / "risk.png").exists()
