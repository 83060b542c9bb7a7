"""Messages of one time of week are one epoch, in whatever order and number they come."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spoofbench_converters.ubx.messages import MESSAGES, Role

from spoofbench.errors import ConversionError

PVT = "/gnss0/gnss/pvt"
_SAME_EPOCH = ("NAV-PVT", "NAV-DOP", "NAV-HPPOSLLH", "NAV-CLOCK", "NAV-TIMEGPS", "NAV-EOE")


def _pvt(ubx: Any, time_ms: int, **fields: Any) -> bytes:
    return bytes(ubx.message("NAV-PVT", iTOW=time_ms, fixType=3, flags=1, **fields))


def _epoch(ubx: Any, second: int, names: list[str]) -> list[bytes]:
    told: dict[str, dict[str, Any]] = {
        "NAV-PVT": {"fixType": 3, "flags": 1, "lat": 100 * second, "pDOP": 150},
        "NAV-DOP": {"hDOP": 90 + second, "pDOP": 150},
        "NAV-HPPOSLLH": {"lat": 100 * second, "latHp": 7, "hAcc": 123},
        "NAV-TIMEGPS": {"week": 2300, "leapS": 18, "valid": 7, "fTOW": -250},
    }
    return [ubx.message(name, iTOW=second * 1000, **told.get(name, {})) for name in names]


@settings(max_examples=40)
@given(
    st.lists(
        st.permutations(_SAME_EPOCH).flatmap(
            lambda names: st.integers(1, len(names)).map(lambda n: names[:n])
        ),
        min_size=1,
        max_size=8,
    )
)
def test_an_epoch_is_one_row_completed_by_all_its_messages(
    ubx: Any, epochs: list[list[str]]
) -> None:
    decoded = ubx.decode(
        [frame for second, names in enumerate(epochs) for frame in _epoch(ubx, second, names)]
    )
    solved = [
        second for second, names in enumerate(epochs) if {"NAV-PVT", "NAV-HPPOSLLH"} & set(names)
    ]
    assert decoded.offset.size == len(epochs)
    assert decoded.epoch.get(PVT, np.zeros(0)).tolist() == solved
    for row, second in enumerate(solved):
        table, names = decoded.tables[PVT], set(epochs[second])
        fine = 7e-9 if "NAV-HPPOSLLH" in names else 0.0
        assert table["lat_deg"][row] == pytest.approx(second * 1e-5 + fine, abs=1e-12)
        assert table.valid("hdop")[row] == ("NAV-DOP" in names)
        assert table.valid("gps_week")[row] == ("NAV-TIMEGPS" in names)
        assert table["tow_s"][row] == pytest.approx(
            second - 250e-9 * ("NAV-TIMEGPS" in names), abs=1e-10
        )


def test_a_late_message_joins_its_epoch(ubx: Any) -> None:
    frames = [
        _pvt(ubx, 1000),
        _pvt(ubx, 2000),
        ubx.message("NAV-DOP", iTOW=1000, hDOP=120),
        _pvt(ubx, 3000),
    ]
    decoded = ubx.decode(frames)
    assert decoded.epoch[PVT].tolist() == [0, 1, 2]
    assert decoded.tables[PVT]["hdop"].tolist() == pytest.approx([1.2, np.nan, np.nan], nan_ok=True)


def test_a_time_that_comes_again_much_later_is_another_epoch(ubx: Any) -> None:
    decoded = ubx.decode([_pvt(ubx, 1000 * second) for second in [*range(12), *range(12)]])
    assert len(decoded.tables[PVT]) == 24
    assert not decoded.rejected


def test_a_repeated_message_is_refused(ubx: Any) -> None:
    frames = [_pvt(ubx, 1000), _pvt(ubx, 1000), _pvt(ubx, 2000)]
    decoded = ubx.decode(frames)
    assert len(decoded.tables[PVT]) == 2
    assert decoded.rejected == {"UBX NAV-PVT: repeated in its epoch": 100}


def test_two_receivers_are_refused(ubx: Any) -> None:
    frames = [_pvt(ubx, 1000 * second, lat=receiver) for second in range(40) for receiver in (1, 2)]
    with pytest.raises(ConversionError, match="two UBX receivers"):
        ubx.decode(frames)


def test_raw_measurements_belong_to_the_solution_made_from_them(ubx: Any) -> None:
    frames = []
    for tick in range(1, 30):  # 25 Hz; the receiver's clock is 11 ms slow
        frames.append(ubx.message("RXM-RAWX", [{"svId": 5}], rcvTow=tick * 0.04 - 0.011, week=2300))
        frames.append(_pvt(ubx, tick * 40))
    decoded = ubx.decode(frames)
    assert decoded.offset.size == 29
    assert np.array_equal(decoded.epoch["/gnss0/gnss/observation"], decoded.epoch[PVT])


def test_raw_measurements_alone_tell_the_time(ubx: Any) -> None:
    frames = [
        ubx.message(
            "RXM-RAWX", [{"svId": 5}], rcvTow=second + 0.001, week=2300, leapS=18, recStat=1
        )
        for second in range(4)
    ]
    decoded = ubx.decode(frames)
    start = (315_964_800 + 2300 * 604_800 - 18) * 10**9
    assert decoded.claimed_ns.tolist() == [start + second * 10**9 + 10**6 for second in range(4)]
    assert not decoded.period_ns.any()


def test_high_rate_messages_keep_their_own_time(ubx: Any) -> None:
    frames = []
    for second in range(10, 14):
        frames.append(_pvt(ubx, second * 1000))
        for part in range(1, 4):  # HNR comes before the solution of the next second
            time_ms = second * 1000 + part * 250
            frames.append(ubx.message("HNR-INS", iTOW=time_ms, flags=0x3F00, xAccel=part))
            frames.append(ubx.message("HNR-ATT", iTOW=time_ms, accRoll=1, roll=part))
    decoded = ubx.decode(frames)
    topic = "/ins1/ins/pva"
    assert decoded.offset.size == 4
    assert decoded.offset_ns[topic].tolist() == [250_000_000, 500_000_000, 750_000_000] * 4
    assert decoded.tables[topic]["linear_accel_x_mps2"].tolist() == pytest.approx(
        [0.01, 0.02, 0.03] * 4
    )
    assert decoded.tables[topic]["roll_deg"].tolist() == pytest.approx([1e-5, 2e-5, 3e-5] * 4)


def test_high_rate_messages_alone_are_epochs_of_a_second(ubx: Any) -> None:
    decoded = ubx.decode([ubx.message("HNR-ATT", iTOW=100 * tick, accRoll=1) for tick in range(35)])
    assert decoded.offset.size == 4
    assert np.unique(decoded.offset_ns["/ins1/ins/pva"]).tolist() == [
        tick * 10**8 for tick in range(10)
    ]


def test_second_solutions_are_a_source_of_their_own(ubx: Any) -> None:
    frames = [
        ubx.message(name, iTOW=1000, fixType=fix, flags=1, lat=lat)
        for name, fix, lat in (("NAV-PVT", 4, 1), ("NAV2-PVT", 3, 2))
    ]
    decoded = ubx.decode(frames)
    assert decoded.offset.size == 1
    assert decoded.tables["/gnss1/gnss/pvt"]["lat_deg"][0] == pytest.approx(2e-7)
    assert (decoded.about["gnss0"]["solution"], decoded.about["gnss1"]["solution"]) == (
        "fused",
        "gnss",
    )


def test_what_completes_nothing_is_refused(ubx: Any) -> None:
    decoded = ubx.decode([ubx.message("NAV-EOE", iTOW=1000), ubx.message("NAV-DOP", iTOW=2000)])
    assert decoded.rejected == {
        "UBX NAV-EOE: nothing in its epoch to complete": 12,
        "UBX NAV-DOP: nothing in its epoch to complete": 26,
    }


def test_lengths_and_counts_that_cannot_be_are_refused(ubx: Any) -> None:
    frames = [
        ubx.frame("NAV-PVT", bytes(91)),
        ubx.frame("NAV-SAT", bytes([0] * 5 + [3] + [0] * 2 + [0] * 24)),
        ubx.frame("ESF-MEAS", bytes([0] * 4 + [0, 3 << 3] + [0] * 2 + [0] * 8)),
        ubx.frame("SEC-SIG", bytes([9] + [0] * 11)),
        ubx.frame("MON-VER", b""),
        ubx.frame("ACK-ACK", bytes(2)),
    ]
    decoded = ubx.decode(frames)
    assert set(decoded.rejected) == {
        "UBX NAV-PVT: length not known",
        "UBX NAV-SAT: length not known",
        "UBX ESF-MEAS: length not known",
        "UBX SEC-SIG: length not known",
        "UBX MON-VER: a poll",
        "UBX ACK-ACK: nothing in the schema",
    }
    assert decoded.rejected.total() == sum(map(len, frames))


@settings(max_examples=40)
@given(st.lists(st.tuples(st.sampled_from(MESSAGES), st.binary(max_size=140)), max_size=12))
def test_any_payload_is_accounted_for(ubx: Any, told: list[tuple[Any, bytes]]) -> None:
    frames = []
    for message, octets in told:
        size = message.lengths[0] if message.lengths else message.head.itemsize
        frames.append(
            ubx.frame(message.name, octets if len(octets) % 2 else octets[:size].ljust(size, b"\1"))
        )
    decoded = ubx.decode(frames)
    assert decoded.used + decoded.rejected.total() == sum(map(len, frames))


def test_roles_are_told_by_messages_with_a_time() -> None:
    assert {message.role for message in MESSAGES if message.time} == {
        Role.NAV,
        Role.RAW,
        Role.HIGH_RATE,
    }
    assert all(message.role == Role.UNTIMED for message in MESSAGES if not message.time)
