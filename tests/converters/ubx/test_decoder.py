"""The same frames give the same rows however they are cut into pieces, and every byte is accounted
for.
"""

from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

_NAMES = (
    "NAV-PVT",
    "NAV-SAT",
    "NAV-EOE",
    "NAV-TIMEGPS",
    "RXM-RAWX",
    "RXM-SFRBX",
    "ESF-MEAS",
    "ESF-INS",
    "HNR-ATT",
    "MON-RF",
    "SEC-SIG",
    "ACK-ACK",
)


def _made(ubx: Any, plan: list[tuple[str, int, int]]) -> list[bytes]:
    frames = []
    for number, (name, tenth, late) in enumerate(plan):
        time_ms = max(0, tenth // 3 * 100 - late * 100)
        if name == "ACK-ACK":
            frames.append(ubx.frame(name, bytes(2)))
        elif name == "RXM-RAWX":
            frames.append(
                ubx.message(
                    name,
                    [{"gnssId": 6, "svId": number % 30, "cno": 40}],
                    rcvTow=max(0, time_ms - 4) / 1e3,
                    week=2200,
                )
            )
        elif name == "RXM-SFRBX":
            frames.append(ubx.message(name, [{"dwrd": number}], version=2))
        elif name == "ESF-MEAS":
            frames.append(
                ubx.message(name, [{"data": 16 << 24 | number}], timeTag=tenth * 10, flags=1 << 11)
            )
        elif name == "SEC-SIG":
            frames.append(ubx.frame(name, bytes([2, number & 127, 0, 0])))
        elif name == "MON-RF":
            frames.append(ubx.message(name, [{"agcCnt": number}]))
        elif name == "NAV-SAT":
            frames.append(ubx.message(name, [{"svId": number % 32, "cno": 30}], iTOW=time_ms))
        elif name == "HNR-ATT":
            frames.append(ubx.message(name, iTOW=time_ms + 33, accRoll=5, roll=number))
        elif name == "ESF-INS":
            frames.append(ubx.message(name, iTOW=time_ms, flags=0x3F00, xAccel=number))
        elif name == "NAV-TIMEGPS":
            frames.append(
                ubx.message(name, iTOW=time_ms, week=2200, valid=7, leapS=18, fTOW=-number)
            )
        elif name == "NAV-PVT":
            frames.append(
                ubx.message(name, iTOW=time_ms, lat=number, fixType=3, flags=1, numSV=number % 20)
            )
        else:
            frames.append(ubx.message(name, iTOW=time_ms))
    return frames


plans = st.lists(
    st.tuples(st.sampled_from(_NAMES), st.just(1), st.sampled_from([0] * 12 + [1, 2, 9, 30])),
    max_size=120,
).map(lambda steps: [(name, place, late) for place, (name, _, late) in enumerate(steps)])


@settings(max_examples=60)
@given(plans, st.lists(st.integers(0, 120), max_size=6))
def test_pieces_do_not_matter(ubx: Any, plan: list[tuple[str, int, int]], cuts: list[int]) -> None:
    frames = _made(ubx, plan)
    cuts = sorted(min(cut, len(frames)) for cut in cuts)
    whole, pieced = ubx.decode(frames), ubx.decode(frames, cuts)
    assert whole.same(pieced)
    assert whole.used + whole.rejected.total() == sum(map(len, frames))
    assert np.all(np.diff(whole.offset) > 0)


def test_pieces_do_not_matter_in_real_logs(ubx: Any, real_logs: dict[str, list[bytes]]) -> None:
    for name, frames in real_logs.items():
        few = frames[:1500]
        whole, pieced = ubx.decode(few), ubx.decode(few, list(range(7, len(few), 97)))
        assert whole.same(pieced), name
        assert whole.used + whole.rejected.total() == sum(map(len, few)), name


def test_what_bears_no_time_is_held_within_bounds(ubx: Any) -> None:
    frames = [ubx.frame("RXM-SFRBX", bytes([0, 1, 0, 0, 250, 0, 2, 0]) + bytes(1000))] * 13_000
    whole = ubx.decode(frames)
    assert whole.offset.size > 2
    assert len(whole.tables["/gnss0/gnss/navdata"]) == len(frames)
    assert whole.same(ubx.decode(frames, [1, 4_200, 9_000]))
