"""Positions, heights, dates and speeds against what gpsd made of the same logs."""

import json
from collections import defaultdict
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from spoofbench_converters.serial.contract import ABSENT_NS

from spoofbench.gnss_time import DAY_NS

MS_NS = 1_000_000
DEGREES, METRES, MPS = (
    2e-9,
    0.06,
    0.06,
)  # gpsd writes nine decimals of a degree; speeds of VTG are finer than those of RMC


def reports(path: Any) -> list[dict[str, Any]]:
    lines = path.read_text("latin1").splitlines()
    found = [json.loads(line) for line in lines if line.startswith('{"class":"TPV"')]
    return [
        report
        for report in found
        if {"lat", "lon", "time"} <= report.keys() and report["mode"] >= 2
    ]


def test_solutions_are_those_of_gpsd(real_log: Any, nmea: ModuleType) -> None:
    """Every fix of gpsd is an epoch here, and one of its speeds in it is ours: until a sentence
    gives one it derives its own.
    """
    checked = real_log.with_name(f"{real_log.name}.chk")
    octets = nmea.content(real_log)
    if not checked.exists() or b"\xb5\x62" in octets:
        pytest.skip("gpsd's reports are not there, or are also of UBX messages")
    epochs, _, _ = nmea.decode([nmea.frames(octets)])
    by_time = defaultdict(list)
    for row in nmea.rows(epochs, "gnss0", "gnss/pvt"):
        if row["claimed_ns"] != ABSENT_NS and row["lat_deg"] is not None:
            by_time[row["claimed_ns"] % DAY_NS // MS_NS].append(row)
    speeds: dict[int, list[bool]] = defaultdict(list)
    for report in reports(checked):
        time_ns = int(np.datetime64(report["time"].rstrip("Z"), "ns").astype(np.int64))
        rows = by_time[time_ns % DAY_NS // MS_NS]
        assert rows, report
        row = min(
            rows,
            key=lambda row: (
                abs(row["lat_deg"] - report["lat"]) + abs(row["lon_deg"] - report["lon"])
            ),
        )
        assert row["lat_deg"] == pytest.approx(report["lat"], abs=DEGREES), report
        assert row["lon_deg"] == pytest.approx(report["lon"], abs=DEGREES), report
        assert row["period_ns"] == DAY_NS or row["claimed_ns"] // MS_NS == time_ns // MS_NS, report
        if "altHAE" in report and row["height_m"] is not None:
            assert row["height_m"] == pytest.approx(report["altHAE"], abs=METRES), report
        if "speed" in report and row["speed_mps"] is not None:
            speeds[time_ns].append(abs(row["speed_mps"] - report["speed"]) < MPS)
    assert sum(not any(agree) for agree in speeds.values()) <= 1
