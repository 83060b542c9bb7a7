"""The contract of converters, on a log of each shape: mixed lines, one wide table, an archive of
tables.
"""

from collections.abc import Callable
from pathlib import Path

import pytest

from spoofbench.testing import run_converter_checks


@pytest.mark.slow
def test_a_log_of_mixed_lines(tmp_path: Path, gnsslogger: Callable[..., bytes]) -> None:
    (tmp_path / "log").write_bytes(gnsslogger())
    _check(tmp_path / "log", streamed=True)


@pytest.mark.slow
def test_wide_tables(tmp_path: Path, sensorlog: Callable[..., bytes]) -> None:
    (tmp_path / "log").write_bytes(sensorlog(True))
    _check(tmp_path / "log", streamed=True)


def test_archives(sensor_logger: Callable[..., Path], phyphox: Callable[..., Path]) -> None:
    _check(sensor_logger("ios"), phyphox(), streamed=False)


def _check(*samples: Path, streamed: bool) -> None:
    results = run_converter_checks("phone", samples, streamed=streamed)
    assert {result.name: result.reason for result in results if not result.passed} == {}
