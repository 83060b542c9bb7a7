"""Fuzzing goes on where a worker hangs or dies, and keeps what failed, as it can be made again."""

import time
from pathlib import Path

import misbehaving
import pytest

from benchmarks.fuzz import drive
from benchmarks.fuzz.seeds import nmea_lines
from spoofbench.sandbox import Sandbox

LOG = b"\r\n".join(nmea_lines(5)) + b"\r\n"


def test_a_healthy_converter_survives(tmp_path: Path) -> None:
    found = drive.fuzz("nmea", [LOG], 6.0, tmp_path / "corpus", workers=1)
    assert found.inputs > 0
    assert found.failures == {}
    assert found.peak_bytes < drive.MEMORY_BYTES
    assert not (tmp_path / "corpus").exists()


def test_failures_deaths_and_hangs_are_counted_and_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(drive, "_try", misbehaving.misbehave)
    monkeypatch.setattr(drive, "INPUT_S", 3.0)
    stream = drive._Stream("nmea", [LOG], 5, tmp_path)
    with Sandbox() as sandbox:
        sandbox.start(misbehaving.misbehave, "", [], 0, 0).end()  # the server is there
        found = stream.follow(sandbox, time.monotonic() + 8.0)
    hangs = found.failures.pop("hang of more than 3 s")
    assert hangs >= 1
    assert found.failures == {
        "ValueError in nmea.py:read": 1,
        "its process ended with exit status 7 before it had answered": 1,
    }
    assert found.inputs >= 4
    assert found.peak_bytes >= 1
    kept = {int(path.name.rpartition("-")[2]): path for path in tmp_path.glob("*[0-9]")}
    assert {1, 2, 3} <= kept.keys()
    for turn, path in kept.items():
        assert path.read_bytes() == drive.make([LOG], "nmea", 5, turn)
        assert path.with_name(f"{path.name}.txt").exists()
