"""The commands ``reproduce`` and ``integrity`` on the command line of spoofbench."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

SCENARIO = Path(__file__).parents[1] / "src/spoofbench_papers/integrity/scenarios/tanil2018-N.toml"
HEAVY = ("numpy", "scipy", "matplotlib", "filterpy", "pyarrow")


def _spoofbench(*words: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "from spoofbench.cli import main; main()", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, check=False)


@pytest.mark.parametrize(
    ("words", "code", "reason"),
    [
        (["reproduce", "lo2016", "-o", "out"], 1, "no paper is called 'lo2016'; did you mean"),
        (["reproduce", "kujur", "-o", "out", "--data", "absent"], 2, "absent"),
        (["reproduce", "kujur"], 2, "-o"),
        (["integrity", "absent.toml", "-o", "out"], 1, "the scenario 'absent.toml' cannot be read"),
        (["integrity", "-o", "out"], 2, "SCENARIO"),
    ],
)
def test_mistakes(tmp_path: Path, words: list[str], code: int, reason: str) -> None:
    done = _spoofbench(*words, cwd=tmp_path)
    assert done.returncode == code
    assert reason in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_scenario_is_assessed(tmp_path: Path) -> None:
    text = SCENARIO.read_text()
    for name, value in (("period_s", 1.0), ("warm_up_s", 10.0)):
        old = next(line for line in text.split("\n") if line.startswith(f"{name} ="))
        text = text.replace(old, f"{name} = {value}")
    (tmp_path / "mine.toml").write_text(text)
    done = _spoofbench("integrity", "mine.toml", "-o", "out", "--json", cwd=tmp_path)
    assert json.loads(done.stdout) == json.loads((tmp_path / "out" / "summary.json").read_text())


def test_help_imports_nothing_heavy(tmp_path: Path) -> None:
    code = (
        "import sys; from spoofbench_papers import commands; "
        f"print([name for name in {HEAVY!r} if name in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, check=True
    )
    assert done.stdout.strip() == "[]"
