"""The examples run as they stand, each in a process of its own, and say what they promise."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.fuzz.seeds import nmea_lines
from spoofbench.codec import write
from spoofbench.testing import drive

EXAMPLES = Path(__file__).parent.parent / "examples"


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("examples") / "drive.mcap"
    write(drive(1, 240.0), path)
    return path


def run(name: str, *arguments: str | Path) -> str:
    """Run an example and return what it prints."""
    done = subprocess.run(
        [sys.executable, EXAMPLES / name, *map(str, arguments)],
        capture_output=True,
        text=True,
        env={**os.environ, "MPLBACKEND": "Agg"},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_example_is_run_here() -> None:
    text = Path(__file__).read_text()
    assert [path.name for path in EXAMPLES.glob("*.py") if f'"{path.name}"' not in text] == []


def test_convert_and_plot(tmp_path: Path) -> None:
    log = tmp_path / "log.nmea"
    log.write_bytes(b"\r\n".join(nmea_lines(60)) + b"\r\n")
    assert "60 rows     /gnss0/gnss/pvt" in run("convert_and_plot.py", log)
    assert log.with_suffix(".png").stat().st_size > 10_000


def test_attack_and_look(recording: Path) -> None:
    assert "drag-off" in run("attack_and_look.py", recording)
    assert recording.with_name("drag-off.png").stat().st_size > 10_000


def test_write_a_detector(recording: Path) -> None:
    printed = run("write_a_detector.py", recording)
    assert "FAIL" not in printed
    assert printed.count("pass  ") >= 13
    assert "detection " in printed


def test_run_a_suite(recording: Path, tmp_path: Path) -> None:
    printed = run("run_a_suite.py", recording, tmp_path / "results")
    assert "zero-acceleration" in printed
    assert (tmp_path / "results" / "scores.parquet").exists()


def test_score_one_detector(recording: Path) -> None:
    printed = run("score_one_detector.py", recording, "correlation")
    assert "of the spoofed epochs" in printed
    assert "per hour" in printed
