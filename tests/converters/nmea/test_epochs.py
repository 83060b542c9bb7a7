"""Which sentences make an epoch, whatever order a receiver has; and laws of the decoder as a
whole.
"""

import re
from collections.abc import Sequence
from types import ModuleType
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from spoofbench_converters.serial.contract import ABSENT_NS

from spoofbench.gnss_time import DAY_NS

SECOND_NS = 10**9


def gga(time: str, talker: str = "GP", lat: str = "4717.1133", quality: int = 1) -> str:
    return f"{talker}GGA,{time},{lat},N,00834.0000,E,{quality},08,1.0,499.6,M,48.0,M,,"


def rmc(
    time: str, talker: str = "GP", lat: str = "4717.1133", status: str = "A", date: str = "010324"
) -> str:
    return f"{talker}RMC,{time},{status},{lat},N,00834.0000,E,10.0,90.0,{date},,,A"


def gsv(cn0: int, talker: str = "GP") -> list[str]:
    return [
        f"{talker}GSV,2,1,05,01,10,020,{cn0},02,,,,03,,,,04,,,",
        f"{talker}GSV,2,2,05,05,80,300,{cn0}",
    ]


def gsa(pdop: float) -> str:
    return f"GPGSA,A,3,01,05,,,,,,,,,,,{pdop},1.0,1.5"


def clock(second: int, decimals: int = 2) -> str:
    return f"12{second // 60:02d}{second % 60:02d}" + (f".{0:0{decimals}d}" if decimals else "")


ORDERS = {
    "u-blox": lambda t, i: [
        rmc(t),
        f"GPVTG,90.0,T,,M,{i}.0,N,,K,A",
        gga(t),
        gsa(i),
        *gsv(i),
        f"GPGLL,4717.1133,N,00834.0000,E,{t},A,A",
    ],
    "SiRF": lambda t, i: [gga(t), gsa(i), *gsv(i), rmc(t), f"GPVTG,90.0,T,,M,{i}.0,N,,K,A"],
    "Telit": lambda t, i: [rmc(t), gga(t), gsa(i), *gsv(i)],
    "Android": lambda t, i: [*gsv(i), gsa(i), f"GPVTG,90.0,T,,M,{i}.0,N,,K,A", rmc(t), gga(t)],
    "Qualcomm": lambda t, i: [
        *gsv(i),
        f"GPGNS,{t},4717.1133,N,00834.0000,E,AN,08,1.0,499.6,48.0,,",
        gsa(i),
        gga(t),
        rmc(t),
    ],
}


@pytest.mark.parametrize("order", ORDERS)
def test_sentences_without_time_belong_to_their_burst(order: str, nmea: ModuleType) -> None:
    """Every burst has its own number in PDOP, C/N0 and VTG: they meet again in one epoch."""
    bodies = [body for second in range(20) for body in ORDERS[order](clock(second), 11 + second)]
    epochs, rejects, _ = nmea.decode([nmea.frames(nmea.log(*bodies))])
    assert not rejects
    rows = nmea.rows(epochs, "gnss0", "gnss/pvt")
    assert [row["pdop"] for row in rows] == [11.0 + second for second in range(20)]
    assert np.diff([row["claimed_ns"] for row in rows]).tolist() == [SECOND_NS] * 19
    signals = nmea.rows(epochs, "gnss0", "gnss/signal")
    assert {
        row["epoch"] - rows[0]["epoch"]: row["cn0_dbhz"] for row in signals if row["svid"] == 5
    } == dict(enumerate(range(11, 31)))


def test_a_log_that_begins_within_a_burst(nmea: ModuleType) -> None:
    bodies = [body for second in range(6) for body in ORDERS["Telit"](clock(second), 11 + second)]
    epochs, _, _ = nmea.decode([nmea.frames(nmea.log(*bodies[3:]))])
    rows = nmea.rows(epochs, "gnss0", "gnss/pvt")
    assert [row["pdop"] for row in rows if row["lat_deg"] is not None] == [
        12.0,
        13.0,
        14.0,
        15.0,
        16.0,
    ]


def test_the_recorders_stamps_tell_bursts_apart(nmea: ModuleType) -> None:
    """Here VTG leads the burst, which only the pause before it shows."""
    bodies, stamps = [], []
    for second in range(5):
        bodies += [
            f"GPVTG,{second}.0,T,,M,1.0,N,,K,A",
            f"GPRMC,{clock(second)},A,4717.11,N,00834.00,E,,,010324,,,A",
        ]
        stamps += [second * SECOND_NS, second * SECOND_NS + 20_000_000]
    epochs, _, _ = nmea.decode([nmea.frames(nmea.log(*bodies), stamps=stamps)])
    assert [row["course_deg"] for row in nmea.rows(epochs, "gnss0", "gnss/pvt")] == [
        0.0,
        1.0,
        2.0,
        3.0,
        4.0,
    ]


def test_times_of_different_resolution_are_one_epoch(nmea: ModuleType) -> None:
    bodies = []
    for tenth in range(20):
        time = f"1200{tenth // 10:02d}.{tenth % 10}0"
        bodies += [gga(time)] + (
            [f"GPZDA,1200{tenth // 10:02d},01,03,2024,00,00"] if tenth % 10 == 0 else []
        )
    epochs, _, _ = nmea.decode([nmea.frames(nmea.log(*bodies))])
    rows = nmea.rows(epochs, "gnss0", "gnss/pvt")
    assert len(rows) == 20
    assert [row["period_ns"] for row in rows] == [
        0 if tenth % 10 == 0 else DAY_NS for tenth in range(20)
    ]


def test_a_clock_sentence_sent_late_is_of_the_fix_before(nmea: ModuleType) -> None:
    bodies = [
        body
        for s in range(5)
        for body in (gga(clock(s)), f"GPZDA,{clock(s)[:-2]}04,01,03,2024,00,00")
    ]
    epochs, _, _ = nmea.decode([nmea.frames(nmea.log(*bodies))])
    rows = nmea.rows(epochs, "gnss0", "gnss/pvt")
    assert [row["claimed_ns"] % SECOND_NS for row in rows] == [0] * 5


def test_a_date_is_that_of_its_own_time(nmea: ModuleType) -> None:
    """A GGA just before midnight beside a ZDA just after it is of the day before."""
    octets = nmea.log(gga("235959.98"), "GPZDA,000000.03,02,03,2024,00,00")
    epochs, _, _ = nmea.decode([nmea.frames(octets)])
    assert nmea.rows(epochs, "gnss0", "gnss/pvt")[0]["claimed_ns"] == np.datetime64(
        "2024-03-01T23:59:59.98", "ns"
    ).astype(int)


@pytest.mark.parametrize("date", ["010180", "060180", "010108", "050180", "010324"])
def test_a_date_without_a_fix_is_not_a_date(date: str, nmea: ModuleType) -> None:
    octets = nmea.log(
        rmc("120000.00", status="V", date=date),
        gga("120000.00", quality=0),
        rmc("120001.00"),
        gga("120001.00"),
    )
    epochs, _, _ = nmea.decode([nmea.frames(octets)])
    first, second = nmea.rows(epochs, "gnss0", "gnss/pvt")
    assert first["period_ns"] == DAY_NS
    assert (
        first["lat_deg"],
        first["height_m"],
        first["speed_mps"],
        first["course_deg"],
        first["gps_week"],
    ) == (None,) * 5
    assert (first["fix_type"], first["time_valid"]) == (1, False)
    assert (second["period_ns"], second["time_valid"], second["gps_week"]) == (0, True, 2303)


def test_epochs_without_any_time(nmea: ModuleType) -> None:
    burst = [
        "GPRMC,,V,,,,,,,,,,N",
        "GPVTG,,,,,,,,,N",
        "GPGGA,,,,,,0,00,99.99,,,,,,",
        "GPGSV,1,1,00",
        "GPGLL,,,,,,V,N",
    ]
    epochs, _, _ = nmea.decode([nmea.frames(nmea.log(*burst * 7))])
    rows = nmea.rows(epochs, "gnss0", "gnss/pvt")
    assert [row["claimed_ns"] for row in rows] == [ABSENT_NS] * 7
    assert {row["fix_type"] for row in rows} == {1}


def test_a_clock_that_stands_while_the_position_moves(nmea: ModuleType) -> None:
    bodies = [
        body
        for i in range(30)
        for body in (
            rmc("120000", lat=f"47{i // 2:02d}.00"),
            gga("120000", lat=f"47{i // 2:02d}.00"),
        )
    ]
    epochs, rejects, _ = nmea.decode([nmea.frames(nmea.log(*bodies))])
    assert not rejects
    rows = nmea.rows(epochs, "gnss0", "gnss/pvt")
    assert [round(row["lat_deg"] * 60) - 47 * 60 for row in rows] == [i // 2 for i in range(30)]
    assert len({row["claimed_ns"] for row in rows}) == 1


def test_repetitions_are_rejects(nmea: ModuleType) -> None:
    bodies = [
        body
        for s in range(5)
        for body in (rmc(clock(s)), gga(clock(s)), rmc(clock(s)), gga(clock(s)), rmc(clock(s)))
    ]
    epochs, rejects, _ = nmea.decode([nmea.frames(nmea.log(*bodies))])
    assert len(nmea.rows(epochs, "gnss0", "gnss/pvt")) == 5
    assert {reject.reason: reject.offsets.size for reject in rejects} == {
        "NMEA GGA: the same epoch again": 5,
        "NMEA RMC: the same epoch again": 10,
    }


def test_one_receiver_changes_its_talker(nmea: ModuleType) -> None:
    bodies = [
        body
        for s in range(30)
        for body in (
            gga(clock(s), "GN" if s % 7 > 3 else "GP"),
            rmc(clock(s), "GN" if s % 7 > 3 else "GP"),
        )
    ]
    epochs, rejects, decoder = nmea.decode([nmea.frames(nmea.log(*bodies))])
    assert not rejects
    assert len(nmea.rows(epochs, "gnss0", "gnss/pvt")) == 30
    assert list(decoder.about()) == ["gnss0"]


def test_one_receiver_speaks_for_each_constellation(nmea: ModuleType) -> None:
    bodies = []
    for s in range(10):
        bodies += [gga(clock(s), "GP"), gga(clock(s), "GL"), f"GPGNS,{clock(s)},,,,,,6,,,,1.0,0"]
        bodies += [f"GNGNS,{clock(s)},4717.1133,N,00834.0000,E,FF,10,1.2,403.2,48.0,,"]
    epochs, rejects, decoder = nmea.decode([nmea.frames(nmea.log(*bodies))])
    rows = nmea.rows(epochs, "gnss0", "gnss/pvt")
    assert [row["num_sv"] for row in rows] == [10] * 10
    assert {reject.reason: reject.offsets.size for reject in rejects} == {
        "NMEA GGA: the same epoch again": 10,
        "NMEA GNS: the same epoch again": 10,
    }
    assert list(decoder.about()) == ["gnss0"]


def test_two_receivers_at_one_time_are_two_sources(nmea: ModuleType) -> None:
    bodies = [
        body
        for s in range(30)
        for body in (
            gga(clock(s)),
            rmc(clock(s)),
            gga(clock(s), "GN", "4800.5000"),
            rmc(clock(s), "GN", "4800.5000"),
        )
    ]
    epochs, rejects, decoder = nmea.decode([nmea.frames(nmea.log(*bodies))])
    assert not rejects
    for source, lat in (("gnss0", 47.285222), ("gnss1", 48.008333)):
        rows = nmea.rows(epochs, source, "gnss/pvt")
        assert len(rows) == 30
        assert {round(row["lat_deg"], 6) for row in rows} == {lat}
        assert {row["offset_ns"] for row in rows} == {0}
    assert {name: about["topic"] for name, about in decoder.about().items()} == {
        "gnss0": "NMEA GP",
        "gnss1": "NMEA GN",
    }


def test_a_plotter_that_repeats_an_old_position_is_a_source_of_its_own(nmea: ModuleType) -> None:
    bodies = [
        b
        for s in range(40)
        for b in (
            gga(clock(s, 0)),
            "APGLL,3806.9690,N,12137.4560,W,041601.00,A",
            rmc(clock(s, 0)),
            "APHDT,12.5,T",
        )
    ]
    epochs, _, decoder = nmea.decode([nmea.frames(nmea.log(*bodies))])
    rows = nmea.rows(epochs, "gnss0", "gnss/pvt")
    assert np.diff([row["claimed_ns"] for row in rows]).tolist() == [SECOND_NS] * 39
    assert {row["offset_ns"] for row in nmea.rows(epochs, "gnss1", "gnss/pvt")} == {0}
    assert len(nmea.rows(epochs, "ins0", "ins/pva")) == 40
    assert set(decoder.about()) == {"gnss0", "gnss1", "ins0"}


def test_one_talker_is_asked_for(nmea: ModuleType) -> None:
    bodies = [
        body
        for s in range(3)
        for body in (gga(clock(s)), gga(clock(s), "GN", "4800.5000"), *gsv(40, "GL"))
    ]
    epochs, rejects, _ = nmea.decode([nmea.frames(nmea.log(*bodies))], source="GN")
    assert {round(row["lat_deg"], 4) for row in nmea.rows(epochs, "gnss0", "gnss/pvt")} == {48.0083}
    assert [(reject.reason, reject.offsets.size) for reject in rejects] == [
        ("NMEA: another talker than the one asked for", 3)
    ]


def test_an_imu_with_a_clock_of_its_own(nmea: ModuleType) -> None:
    bodies = []
    for s in range(3):
        bodies.append(rmc(clock(s)))
        bodies += [
            f"GYOACC,010324,{clock(s)[:-2]}{tenth}00,0.01,0.02,0.03,100,0.1,0.2,9.8,100,0,5,100,0"
            for tenth in range(10)
        ]
    epochs, _, decoder = nmea.decode([nmea.frames(nmea.log(*bodies))])
    rows = nmea.rows(epochs, "imu0", "imu")
    assert (
        np.diff([row["claimed_ns"] + row["offset_ns"] for row in rows]).tolist()
        == [SECOND_NS // 10] * 29
    )
    assert (rows[0]["gyro_z_radps"], rows[0]["accel_z_mps2"]) == (0.03, 9.8)
    assert decoder.about()["imu0"]["device"] == "Unicore"


def test_a_log_of_an_imu_alone(nmea: ModuleType) -> None:
    body = (
        "VNYMR,+066.172,+003.948,+002.132,+00.2653,-00.0791,+00.3577,"
        "+00.558,+00.250,-10.355,+00.037773,+00.029186,-00.272747"
    )
    stamps = [1_700_000_000 * SECOND_NS + i * 25_000_000 for i in range(50)]
    epochs, _, _ = nmea.decode([nmea.frames(nmea.log(*[body] * 50), stamps=stamps)])
    assert np.concatenate([part.receive_time_ns for part in epochs]).tolist() == stamps
    rows = nmea.rows(epochs, "imu0", "imu")
    assert len(rows) == 50
    assert (rows[0]["accel_z_mps2"], rows[0]["gyro_z_radps"]) == (-10.355, -0.272747)
    assert nmea.rows(epochs, "mag0", "mag")[0]["field_x_ut"] == pytest.approx(26.53)
    assert nmea.rows(epochs, "ins0", "ins/pva")[0]["yaw_deg"] == 66.172


def test_an_epoch_is_bounded(nmea: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """What follows the last fix is kept, in epochs without a time, however it comes in pieces."""
    monkeypatch.setattr("spoofbench_converters.nmea.epochs.MAX_SENTENCES", 50)
    monkeypatch.setattr("spoofbench_converters.nmea.decoder.JUDGED", 20)
    bodies = [
        gga("120000.00"),
        *["VNIMU,1,2,3,4,5,6,7,8,9,20,101.3"] * 130,
        *["GPVTG,1.0,T,,M,1.0,N,,K"] * 40,
        *gsv(40) * 60,
        gga("120001.00"),
        *gsv(41) * 100,
    ]
    octets = nmea.log(*bodies)
    epochs, _, _ = nmea.decode([nmea.frames(octets)])
    times = [row["claimed_ns"] for row in nmea.rows(epochs, "gnss0", "gnss/pvt")]
    assert times[0] == 43_200 * SECOND_NS
    assert 43_201 * SECOND_NS in times
    assert sum(part.offset.size for part in epochs) > 6
    assert_same_in_pieces(nmea, octets, range(0, len(octets), 700))


TIMES = st.sampled_from(["120000.00", "120001.00", "120001.10", "120001", "120000", ""])
BODIES = st.one_of(
    st.builds(
        gga,
        st.sampled_from(["120000.00", "120001.00", "120001.10", "120000", ""]),
        st.sampled_from(["GP", "GN"]),
        quality=st.integers(0, 9),
    ),
    st.builds(rmc, TIMES, st.sampled_from(["GP", "AP"]), status=st.sampled_from("AV")),
    st.sampled_from(
        [
            *gsv(40),
            gsa(2.0),
            "GPVTG,,,,,,,,,N",
            "GPHDT,1.0,T",
            "GPZDA,120001,01,03,2024,00,00",
            "GPXYZ,1",
            "PABC,1",
            "PUBX,9",
        ]
    ),
    st.sampled_from(
        [
            "GNGRS,120000.00,1,0.1,,,,,,,,,,,,1,1",
            "GPDTM,P90,,0.0,N,0.0,E,0.0,W84",
            "VNIMU,1,2,3,4,5,6,7,8,9,20,101.3",
            "GPGSV,,,,",
        ]
    ),
)


@settings(max_examples=150, suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(
    bodies=st.lists(BODIES, min_size=1, max_size=40),
    cuts=st.lists(st.integers(0, 3000), max_size=8),
)
def test_pieces_make_no_difference_and_every_byte_has_an_owner(
    nmea: ModuleType, bodies: list[str], cuts: Sequence[int]
) -> None:
    with (
        patch("spoofbench_converters.nmea.decoder.JUDGED", 5),
        patch("spoofbench_converters.nmea.epochs.MAX_SENTENCES", 12),
    ):
        assert_same_in_pieces(nmea, nmea.log(*bodies), cuts)


def test_times_are_remembered_from_piece_to_piece(nmea: ModuleType) -> None:
    """A time that comes again is no new one, though the epoch that had it first is given
    already.
    """
    empty = "GPRMC,,V,,,,,,,,,,N"
    inertial = ["VNIMU,1,2,3,4,5,6,7,8,9,20,101.3"] * 20
    fix = "GPGLL,4717.1133,N,00834.0000,E,120001.10,A,A"
    for tail in (
        [empty, empty, fix],
        [empty, empty, "GPZDA,120001,01,03,2024,00,00"],
        [*inertial, empty, fix],
    ):
        octets = nmea.log(gga("120000.10"), gga("120001.10"), *tail)
        with (
            patch("spoofbench_converters.nmea.decoder.JUDGED", 1),
            patch("spoofbench_converters.nmea.epochs.MAX_SENTENCES", 12),
        ):
            epochs, _, _ = nmea.decode([nmea.frames(octets)])
            assert_same_in_pieces(
                nmea, octets, [line.start() + 1 for line in re.finditer(rb"\n", octets)]
            )
        rows = nmea.rows(epochs, "gnss0", "gnss/pvt")
        assert len(rows) == 3, tail


def test_real_logs_in_pieces(
    real_log: Any, nmea: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("spoofbench_converters.nmea.decoder.JUDGED", 300)
    octets = nmea.content(real_log)[:600_000]
    rng = np.random.default_rng(len(octets))
    assert_same_in_pieces(nmea, octets, rng.integers(0, len(octets), 12).tolist())


def assert_same_in_pieces(nmea: ModuleType, octets: bytes, cuts: Sequence[int]) -> None:
    whole = nmea.frames(octets)
    epochs, rejects, _ = nmea.decode([whole])
    used = sum(int(part.used.sum()) for part in epochs)
    assert used + sum(int(reject.lengths.sum()) for reject in rejects) == int(whole.used.sum())
    offsets = np.concatenate([part.offset for part in epochs] or [np.empty(0)])
    assert np.all(np.diff(offsets) > 0)
    cut_epochs, cut_rejects, _ = nmea.decode(list(nmea.pieces(octets, cuts)))
    assert np.array_equal(
        offsets, np.concatenate([part.offset for part in cut_epochs] or [np.empty(0)])
    )
    for source, kind in sorted(
        {(table.source, table.kind) for part in epochs for table in part.rows}
    ):
        assert nmea.rows(epochs, source, kind) == nmea.rows(cut_epochs, source, kind)
    assert account(rejects) == account(cut_rejects)


def account(rejects: Sequence[Any]) -> set[tuple[int, int, str]]:
    return {
        (o, n, r.reason)
        for r in rejects
        for o, n in zip(r.offsets.tolist(), r.lengths.tolist(), strict=True)
    }
