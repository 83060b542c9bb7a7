"""Bags keep the laws of every converter."""

from pathlib import Path
from typing import Any

import pytest

from spoofbench.testing.converters import run_converter_checks


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "suffix"), [("ros1-lz4", "bag"), ("mcap", "mcap"), ("sqlite", "db3")]
)
def test_conformance(kind: str, suffix: str, sessions: Any, tmp_path: Path) -> None:
    path = sessions.WRITERS[kind](tmp_path / f"bag.{suffix}", sessions.drive(60))
    sample = path if path.is_file() else next(path.glob(f"*.{suffix}"))
    results = run_converter_checks("rosbag", [sample], streamed=kind != "sqlite")
    assert [result for result in results if not result.passed] == []
