"""Raw measurements of every constellation and tracking state."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from spoofbench_converters import phone
from spoofbench_converters.phone import android

from spoofbench.schema import KINDS
from spoofbench.table import Table
from spoofbench.testing.converter_cases import outcome

SPEED_OF_LIGHT_MPS = 299_792_458.0
DAY_NS, WEEK_NS, LEAP_S = 86_400 * 10**9, 604_800 * 10**9, 18
GPS_NS = 1_384_035_218_000_000_000  # a Wednesday
CODE, TOW_DECODED, AMBIGUOUS, TOD_DECODED, E1C, TOW_KNOWN, TOD_KNOWN = (
    1,
    8,
    16,
    128,
    2048,
    16384,
    32768,
)


def measured(folder: Path, header: str, rows: list[dict[str, object]]) -> Table:
    """Convert raw measurements, each of these columns, and return the rows in their order."""
    names = (
        next(line for line in header.splitlines() if line.startswith("# Raw,"))
        .removeprefix("# Raw,")
        .split(",")
    )
    clock = {
        "utcTimeMillis": 1_700_000_000_000,
        "TimeNanos": 0,
        "FullBiasNanos": -GPS_NS,
        "BiasNanos": 0.0,
        "LeapSecond": LEAP_S,
    }
    lines = []
    for row in rows:
        cells = {
            **clock,
            "TimeOffsetNanos": 0.0,
            "ChipsetElapsedRealtimeNanos": 5_000_000_000,
            **row,
        }
        lines.append(",".join(["Raw", *(str(cells.get(name, "")) for name in names)]))
    (folder / "log").write_text(header + "\n".join(lines) + "\n")
    return outcome(phone, folder / "log", {}).tables["/gnss0/gnss/observation"]


@pytest.fixture(scope="module")
def header(gnsslogger: Callable[..., bytes]) -> str:
    return "".join(
        line for line in gnsslogger().decode().splitlines(keepends=True) if line.startswith("#")
    )


@pytest.mark.parametrize(
    ("constellation", "state", "system_ns", "period_ns"),
    [
        (1, TOW_DECODED, 0, WEEK_NS),
        (1, TOW_KNOWN, 0, WEEK_NS),
        (2, TOW_DECODED, 0, WEEK_NS),
        (3, TOD_DECODED, (3 * 3600 - LEAP_S) * 10**9, DAY_NS),
        (3, TOD_KNOWN, (3 * 3600 - LEAP_S) * 10**9, DAY_NS),
        (4, TOW_DECODED, 0, WEEK_NS),
        (5, TOW_DECODED, -14 * 10**9, WEEK_NS),
        (6, TOW_DECODED, 0, WEEK_NS),
        (6, E1C, 0, 100_000_000),
        (7, TOW_KNOWN, 0, WEEK_NS),
    ],
)
@pytest.mark.parametrize("since_rollover_ns", [None, 40_000_000])
def test_a_pseudorange_is_the_time_of_flight(
    tmp_path: Path,
    header: str,
    constellation: int,
    state: int,
    system_ns: int,
    period_ns: int,
    since_rollover_ns: int | None,
) -> None:
    """Also where the satellite sent before its week or day ended, and the phone received after."""
    gps = (
        GPS_NS
        if since_rollover_ns is None
        else (GPS_NS // period_ns + 1) * period_ns - system_ns + since_rollover_ns
    )
    flight = 71_234_567
    row = {
        "FullBiasNanos": -gps,
        "ConstellationType": constellation,
        "Svid": 5,
        "State": CODE | state,
        "ReceivedSvTimeNanos": (gps + system_ns - flight) % period_ns,
    }
    found = measured(tmp_path, header, [row])
    np.testing.assert_allclose(
        found["pseudorange_m"], flight * 1e-9 * SPEED_OF_LIGHT_MPS, rtol=1e-12
    )


@pytest.mark.parametrize(
    "change",
    [
        {"State": CODE},
        {"State": CODE | TOW_DECODED | AMBIGUOUS},
        {"State": CODE | TOD_DECODED},
        {"FullBiasNanos": ""},
        {"ReceivedSvTimeNanos": ""},
        {"ReceivedSvTimeNanos": 1},
        {"State": CODE | TOD_DECODED, "ConstellationType": 0},
        {"State": CODE | TOW_DECODED, "ConstellationType": 3},
    ],
)
def test_an_ambiguous_time_gives_no_pseudorange(
    tmp_path: Path, header: str, change: dict[str, object]
) -> None:
    row = {
        "ConstellationType": 1,
        "Svid": 5,
        "State": CODE | TOW_DECODED,
        "ReceivedSvTimeNanos": (GPS_NS - 70_000_000) % WEEK_NS,
    }
    found = measured(tmp_path, header, [row, {**row, **change}])
    assert np.isnan(found["pseudorange_m"]).tolist() == [False, True]


@pytest.mark.parametrize(
    ("constellation", "svid", "hertz", "code", "expected"),
    [
        (1, 5, 1575420030.0, "C", (1, 5, "1C", None)),
        (1, 5, 1176450050.0, "Q", (1, 5, "5Q", None)),
        (1, 5, "", "", (1, 5, "1C", None)),
        (2, 131, 1575420030.0, "", (2, 131, "1C", None)),
        (3, 9, 1600875010.0, "", (7, 9, "1C", -2)),
        (3, 102, 1603125000.0, "C", (7, None, "1C", 2)),
        (3, 98, "", "", (7, None, "1C", -2)),
        (4, 194, 1575420030.0, "C", (6, 2, "1C", None)),
        (4, 184, 1575420030.0, "Z", (6, 2, "1Z", None)),
        (2, 184, 1575420030.0, "C", (2, 184, "1C", None)),
        (5, 21, 1561097980.0, "I", (4, 21, "2I", None)),
        (5, 21, 1561097980.0, "", (4, 21, "2I", None)),
        (5, 40, 1176450050.0, "P", (4, 40, "5P", None)),
        (6, 7, 1575420030.0, "", (3, 7, "1", None)),
        (6, 7, 1207140000.0, "X", (3, 7, "7X", None)),
        (7, 3, 1176450050.0, "A", (8, 3, "5A", None)),
        (0, 3, 1575420030.0, "C", (None, 3, None, None)),
        (99, "", "", "", (None, None, None, None)),
    ],
)
def test_satellites_and_signals(
    tmp_path: Path,
    header: str,
    constellation: int,
    svid: object,
    hertz: object,
    code: str,
    expected: tuple[object, ...],
) -> None:
    row = {
        "ConstellationType": constellation,
        "Svid": svid,
        "CarrierFrequencyHz": hertz,
        "CodeType": code,
    }
    found = measured(tmp_path, header, [row])
    values = [
        found[name][0] if found.valid(name)[0] else None
        for name in ("constellation", "svid", "frequency_slot")
    ]
    assert (values[0], values[1], found.texts("signal")[0], values[2]) == expected


def test_a_phase_counts_only_where_it_is_valid(tmp_path: Path, header: str) -> None:
    row: dict[str, object] = {
        "ConstellationType": 1,
        "CarrierFrequencyHz": 1575420000.0,
        "AccumulatedDeltaRangeMeters": 190.29,
    }
    states = [0, 1, 16, 1 | 4, 1 | 2]
    largest = 340282346638528860000000000000000000000
    states_by_svid = dict(enumerate(states, 5))
    row["AccumulatedDeltaRangeUncertaintyMeters"] = largest
    rows = [
        {**row, "Svid": svid, "AccumulatedDeltaRangeState": state}
        for svid, state in states_by_svid.items()
    ]
    found = measured(tmp_path, header, rows)
    assert np.isnan(found["carrier_cycles"]).tolist() == [True, False, True, False, False]
    assert found["carrier_cycles"][1] == pytest.approx(190.29 * 1575.42e6 / SPEED_OF_LIGHT_MPS)
    assert np.isnan(found["carrier_std_cycles"]).all()


def test_every_constellation_is_one_of_the_schema() -> None:
    known = {
        value.number
        for value in KINDS["gnss/observation"]
        .message.fields_by_name["constellation"]
        .enum_type.values
    }
    assert set(android.SCHEMA_CONSTELLATION.tolist()) <= known
