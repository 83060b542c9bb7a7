"""Our own converters pass the public kit on logs made here, the way a stranger's would."""

import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from benchmarks.fuzz.seeds import made, nmea_lines, phone_log, table_log, ubx_log
from spoofbench.testing import check_converter
from spoofbench.testing.kit import Check

SECONDS = 90


@cache
def _folder() -> Path:
    return Path(tempfile.mkdtemp())


def _log(name: str, octets: bytes) -> Path:
    path = _folder() / name
    path.write_bytes(octets)
    return path


def _checks() -> list[Any]:
    nmea = b"\r\n".join(nmea_lines(SECONDS)) + b"\r\n"
    checks: list[tuple[str, list[Check[Any]]]] = [
        ("nmea", check_converter("nmea", [_log("log.nmea", nmea)]).args[1]),
        ("ubx", check_converter("ubx", [_log("log.ubx", ubx_log(SECONDS))]).args[1]),
        ("phone", check_converter("phone", [_log("gnss_log.txt", phone_log(SECONDS))]).args[1]),
        ("table", check_converter("table", [_log("trip.csv", table_log(SECONDS))]).args[1]),
    ]
    bags = [_log(f"{place}.bag", bag) for place, bag in enumerate(made("rosbag", _folder()))]
    checks.append(("rosbag", check_converter("rosbag", bags, streamed=False).args[1]))
    return [
        pytest.param(check, id=f"{name}-{check}") for name, of_one in checks for check in of_one
    ]


@pytest.mark.slow
@pytest.mark.parametrize("check", _checks())
def test_conformance(check: Check[Any]) -> None:
    check()
