"""Every message says what pyubx2 says it does, in the schema's units, on any payload and in real
logs.
"""

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pymap3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyubx2 import UBXReader
from spoofbench_converters.ubx.messages import MESSAGES, NUMBER, offset_in

from spoofbench.schema.v1 import gnss_pb2
from spoofbench.table import Table

Expected = dict[str, Any]
_UNKNOWN = 0xFFFFFFFF


def _acc(value: float, scale: float) -> float | None:
    return None if value == _UNKNOWN else value * scale


def _dop(value: float) -> float | None:
    return None if round(value * 100) == 9999 else value


def _position(m: Any) -> Expected:
    return {
        "lat_deg": m.lat,
        "lon_deg": m.lon,
        "height_m": m.height / 1e3,
        "height_msl_m": m.hMSL / 1e3,
    }


def _nowhere(*names: str) -> Expected:
    return dict.fromkeys(("lat_deg", "lon_deg", "height_m", "height_msl_m", *names))


def _fix(number: int, ok: int, differential: int, carrier: int) -> int | None:
    if number > 5:
        return None
    if not ok:
        return gnss_pb2.FIX_TYPE_NONE
    if number in (2, 3, 4) and carrier in (1, 2):
        return (gnss_pb2.FIX_TYPE_RTK_FLOAT, gnss_pb2.FIX_TYPE_RTK_FIXED)[carrier - 1]
    if number == 3 and differential:
        return gnss_pb2.FIX_TYPE_DIFFERENTIAL
    return number + 1


def _pvt(m: Any) -> Expected:
    fix = _fix(m.fixType, m.gnssFixOk, m.diffSoln, m.carrSoln)
    nowhere = fix == gnss_pb2.FIX_TYPE_NONE
    place = _nowhere() if m.invalidLlh or nowhere else _position(m)
    motion = {
        "vel_n_mps": m.velN / 1e3,
        "vel_e_mps": m.velE / 1e3,
        "vel_d_mps": m.velD / 1e3,
        "speed_mps": m.gSpeed / 1e3,
    }
    motion["course_deg"] = m.headMot % 360
    return {
        **place,
        **(dict.fromkeys(motion) if nowhere else motion),
        "h_acc_m": _acc(m.hAcc, 1e-3),
        "v_acc_m": _acc(m.vAcc, 1e-3),
        "s_acc_mps": _acc(m.sAcc, 1e-3),
        "time_acc_s": _acc(m.tAcc, 1e-9),
        "pdop": _dop(m.pDOP),
        "num_sv": m.numSV,
        "fix_type": fix,
        "time_valid": bool(m.validDate and m.validTime and m.fullyResolved),
    }


def _pvat(m: Any) -> Expected:
    fix = _fix(m.fixType, m.gnssFixOK, m.diffSoln, m.carrSoln)
    place = (
        _nowhere("vel_n_mps", "course_deg")
        if fix == gnss_pb2.FIX_TYPE_NONE
        else {**_position(m), "vel_n_mps": m.velN / 1e3}
    )
    return {
        **place,
        "fix_type": fix,
        "num_sv": m.numSV,
        "h_acc_m": _acc(m.hAcc, 1e-3),
        "s_acc_mps": _acc(m.sAcc, 1e-3),
    }


def _posllh(m: Any) -> Expected:
    place = _nowhere() if m.hAcc == _UNKNOWN else _position(m)
    return {**place, "h_acc_m": _acc(m.hAcc, 1e-3), "v_acc_m": _acc(m.vAcc, 1e-3)}


def _hpposllh(m: Any) -> Expected:
    unknown = m.invalidLlh or round(m.hAcc * 10) == _UNKNOWN
    place = (
        _nowhere()
        if unknown
        else {**_position(m), "height_m": m.height / 1e3, "height_msl_m": m.hMSL / 1e3}
    )
    return {**place, "h_acc_m": None if round(m.hAcc * 10) == _UNKNOWN else m.hAcc / 1e3}


def _geodetic(x: float, y: float, z: float) -> Expected:
    if not (x or y or z):
        return _nowhere()
    lat, lon, height = pymap3d.ecef2geodetic(x, y, z)
    return {"lat_deg": lat, "lon_deg": lon, "height_m": height}


def _sol(m: Any) -> Expected:
    fix = _fix(m.gpsFix, m.gpsfixOK, m.diffSoln, 0)
    place = _nowhere("vel_n_mps")
    if fix != gnss_pb2.FIX_TYPE_NONE:
        place = _geodetic(m.ecefX / 100, m.ecefY / 100, m.ecefZ / 100)
        if m.ecefX or m.ecefY or m.ecefZ:
            east, north, up = pymap3d.ecef2enuv(
                m.ecefVX / 100, m.ecefVY / 100, m.ecefVZ / 100, place["lat_deg"], place["lon_deg"]
            )
            place |= {"vel_n_mps": north, "vel_e_mps": east, "vel_d_mps": -up}
    week = m.week if m.wknSet and m.week > 0 else None
    return {
        **place,
        "fix_type": fix,
        "num_sv": m.numSV,
        "pdop": _dop(m.pDOP),
        "s_acc_mps": _acc(m.sAcc, 1e-2),
        "gps_week": week,
    }


def _velned(m: Any) -> Expected:
    return {
        "vel_n_mps": m.velN / 100,
        "vel_e_mps": m.velE / 100,
        "vel_d_mps": m.velD / 100,
        "speed_mps": m.gSpeed / 100,
        "course_deg": m.heading % 360,
        "s_acc_mps": _acc(m.sAcc, 1e-2),
    }


def _clock(m: Any) -> Expected:
    return {
        "bias_s": m.clkB * 1e-9,
        "drift_sps": m.clkD * 1e-9,
        "acc_s": _acc(m.tAcc, 1e-9),
        "drift_acc_sps": _acc(m.fAcc, 1e-12),
    }


def _angles(m: Any) -> Expected | None:
    accuracy = max(m.accRoll, m.accPitch, m.accHeading)
    return (
        {
            "roll_deg": m.roll,
            "pitch_deg": m.pitch,
            "yaw_deg": m.heading,
            "attitude_acc_deg": accuracy,
        }
        if accuracy
        else None
    )


def _rates(m: Any) -> Expected | None:
    told = {}
    for axis in "xyz":
        told[f"rate_{axis}_radps"] = (
            math.radians(getattr(m, f"{axis}AngRate"))
            if getattr(m, f"{axis}AngRateValid")
            else None
        )
        told[f"linear_accel_{axis}_mps2"] = (
            getattr(m, f"{axis}Accel") if getattr(m, f"{axis}AccelValid") else None
        )
    return told if any(value is not None for value in told.values()) else None


def _timemark(m: Any) -> Expected | None:
    if not (m.newRisingEdge or m.newFallingEdge):
        return None
    rising, falling = m.newRisingEdge and m.time, m.newFallingEdge and m.time
    return {
        "channel": m.ch,
        "count": m.count,
        "rising_week": m.wnR if rising else None,
        "rising_tow_s": m.towMsR / 1e3 + m.towSubMsR / 1e9 if rising else None,
        "falling_week": m.wnF if falling else None,
        "falling_tow_s": m.towMsF / 1e3 + m.towSubMsF / 1e9 if falling else None,
        "acc_s": _acc(m.accEst, 1e-9),
    }


def _hnr(m: Any) -> Expected | None:
    place = _position(m) if m.GPSfixOK and m.gpsFix else _nowhere()
    told = {**place, "yaw_deg": m.headVeh if m.headVehValid else None}
    return told if any(value is not None for value in told.values()) else None


_ONE = {
    "NAV-PVT": ("/gnss0/gnss/pvt", _pvt),
    "NAV2-PVT": ("/gnss1/gnss/pvt", _pvt),
    "NAV-PVAT": ("/gnss0/gnss/pvt", _pvat),
    "NAV-POSLLH": ("/gnss0/gnss/pvt", _posllh),
    "NAV-HPPOSLLH": ("/gnss0/gnss/pvt", _hpposllh),
    "NAV-POSECEF": (
        "/gnss0/gnss/pvt",
        lambda m: _geodetic(m.ecefX / 100, m.ecefY / 100, m.ecefZ / 100),
    ),
    "NAV-SOL": ("/gnss0/gnss/pvt", _sol),
    "NAV-VELNED": ("/gnss0/gnss/pvt", _velned),
    "NAV-CLOCK": ("/gnss0/gnss/clock", _clock),
    "NAV-ATT": ("/ins0/ins/pva", _angles),
    "ESF-INS": ("/ins0/ins/pva", _rates),
    "HNR-ATT": ("/ins1/ins/pva", _angles),
    "HNR-INS": ("/ins1/ins/pva", _rates),
    "HNR-PVT": ("/ins1/ins/pva", _hnr),
    "NAV-STATUS": (
        "/gnss0/gnss/integrity",
        lambda m: {"spoofing": m.spoofDetState, "jamming": None},
    ),
    "MON-HW": (
        "/gnss0/gnss/rf",
        lambda m: {"agc": m.agcCnt / 8191, "noise": m.noisePerMS, "jam_indicator": m.jamInd / 255},
    ),
    "TIM-TM2": ("/gnss0/gnss/timemark", _timemark),
}
_GROUPS = {2: gnss_pb2.CONSTELLATION_GALILEO, 6: gnss_pb2.CONSTELLATION_GLONASS}


def _said(m: Any, count: int, *names: str) -> Iterator[dict[str, Any]]:
    for place in range(1, count + 1):
        yield {name: getattr(m, f"{name}_{place:02d}") for name in names}


def _numbers(one: dict[str, Any]) -> Expected:
    known = one["gnssId"] <= 7
    return {
        "constellation": one["gnssId"] + 1 if known else None,
        "svid": None if one["svId"] == 255 else one["svId"],
    }


def _sat(m: Any) -> list[Expected]:
    found = []
    for one in _said(m, m.numSvs, "gnssId", "svId", "cno", "elev", "azim", "prRes", "svUsed"):
        known = -90 <= one["elev"] <= 90
        found.append(
            {
                **_numbers(one),
                "cn0_dbhz": one["cno"] or None,
                "elevation_deg": one["elev"] if known else None,
                "azimuth_deg": one["azim"] if known and 0 <= one["azim"] <= 360 else None,
                "used": bool(one["svUsed"]),
                "residual_m": one["prRes"] if one["cno"] else None,
            }
        )
    return found


def _sig(m: Any) -> list[Expected]:
    names = ("gnssId", "svId", "sigId", "cno", "prRes", "prUsed", "crUsed", "doUsed")
    return [
        {
            **_numbers(one),
            "cn0_dbhz": one["cno"] or None,
            "used": bool(one["prUsed"] or one["crUsed"] or one["doUsed"]),
        }
        for one in _said(m, m.numSigs, *names)
    ]


def _svinfo(m: Any) -> list[Expected]:
    return [
        {"cn0_dbhz": one["cno"] or None, "used": bool(one["svUsed"])}
        for one in _said(m, m.numCh, "svid", "cno", "svUsed")
        if one["svid"]
    ]


def _rawx(m: Any) -> list[Expected]:
    names = (
        "prMes",
        "cpMes",
        "doMes",
        "gnssId",
        "svId",
        "sigId",
        "freqId",
        "locktime",
        "cno",
        "prStd",
        "cpStd",
        "doStd",
        "prValid",
        "cpValid",
    )
    return [
        {
            **_numbers(one),
            "pseudorange_m": one["prMes"] if one["prValid"] else None,
            "carrier_cycles": one["cpMes"] if one["cpValid"] else None,
            "doppler_hz": one["doMes"],
            "cn0_dbhz": one["cno"] or None,
            "lock_time_s": one["locktime"] / 1e3,
            "pseudorange_std_m": 0.01 * 2 ** one["prStd"] if one["prValid"] else None,
            "carrier_std_cycles": 0.004 * one["cpStd"]
            if one["cpValid"] and one["cpStd"] < 15
            else None,
            "doppler_std_hz": 0.002 * 2 ** one["doStd"],
            "frequency_slot": one["freqId"] - 7 if one["gnssId"] == 6 else None,
        }
        for one in _said(m, m.numMeas, *names)
    ]


def _raw(m: Any) -> list[Expected]:
    return [
        {
            "pseudorange_m": one["prMes"] if one["mesQI"] >= 4 else None,
            "carrier_cycles": one["cpMes"] if one["mesQI"] >= 5 else None,
            "doppler_hz": one["doMes"] if one["mesQI"] >= 4 else None,
        }
        for one in _said(m, m.numSV, "prMes", "cpMes", "doMes", "mesQI")
    ]


def _measx(m: Any) -> list[Expected]:
    return [
        {**_numbers(one), "doppler_hz": one["dopplerHz"], "cn0_dbhz": one["cNo"] or None}
        for one in _said(m, m.numSv, "gnssId", "svId", "cNo", "dopplerHz")
    ]


def _rf(m: Any) -> list[Expected]:
    return [
        {
            "agc": one["agcCnt"] / 8191,
            "noise": one["noisePerMS"],
            "jam_indicator": one["jamInd"] / 255,
        }
        for one in _said(m, m.nBlocks, "agcCnt", "noisePerMS", "jamInd")
    ]


_MANY: dict[str, tuple[str, Callable[[Any], list[Expected]]]] = {
    "NAV-SAT": ("/gnss0/gnss/signal", _sat),
    "NAV-SIG": ("/gnss0/gnss/signal", _sig),
    "NAV2-SAT": ("/gnss1/gnss/signal", _sat),
    "NAV-SVINFO": ("/gnss0/gnss/signal", _svinfo),
    "RXM-RAWX": ("/gnss0/gnss/observation", _rawx),
    "RXM-RAW": ("/gnss0/gnss/observation", _raw),
    "RXM-MEASX": ("/gnss0/gnss/observation", _measx),
    "MON-RF": ("/gnss0/gnss/rf", _rf),
}


def agree(table: Table, row: int, expected: Expected) -> None:
    """Fail where a row does not say what is expected; None is absent, and so is what is no finite
    number.
    """
    for name, value in expected.items():
        present = bool(table.valid(name)[row])
        if value is None or not math.isfinite(value):
            assert not present, f"{name} is {table[name][row]!r}, not absent"
            continue
        assert present, f"{name} is absent, not {value!r}"
        told = float(table[name][row])
        if isinstance(value, float):
            single = table[name].dtype == np.float32
            assert told == pytest.approx(
                value, rel=1e-6 if single else 1e-11, abs=1e-30 if abs(value) < 1e-6 else 2e-9
            ), name
        else:
            assert told == float(value) or (
                table[name].dtype == np.float32 and told == np.float32(value)
            ), name


def _set(octets: bytes, message: str, **fields: int) -> bytes:
    head = MESSAGES[NUMBER[message]].head
    changed = bytearray(octets)
    for name, value in fields.items():
        at, size = offset_in(head, name), head[name].itemsize
        changed[at : at + size] = np.array([value], head[name]).tobytes()
    return bytes(changed)


@pytest.mark.parametrize("name", _ONE)
@settings(max_examples=25)
@given(data=st.data())
def test_messages_of_one_row(ubx: Any, name: str, data: Any) -> None:
    topic, expect = _ONE[name]
    message = MESSAGES[NUMBER[name]]
    octets = data.draw(st.binary(min_size=message.head.itemsize, max_size=message.head.itemsize))
    if message.time:
        octets = _set(octets, name, **{message.time: data.draw(st.integers(0, 604_799_999))})
    frame = ubx.frame(name, octets)
    expected = expect(UBXReader.parse(frame))
    decoded = ubx.decode([frame])
    if expected is None:
        assert topic not in decoded.tables
        assert decoded.rejected.total() == len(frame)
        return
    assert len(decoded.tables[topic]) == 1
    agree(decoded.tables[topic], 0, expected)
    assert decoded.used == len(frame)


@pytest.mark.parametrize("name", _MANY)
@settings(max_examples=25)
@given(data=st.data())
def test_messages_of_many_rows(ubx: Any, name: str, data: Any) -> None:
    topic, expect = _MANY[name]
    message = MESSAGES[NUMBER[name]]
    assert message.block is not None
    count = data.draw(st.integers(0, 5))
    head = data.draw(st.binary(min_size=message.head.itemsize, max_size=message.head.itemsize))
    size = count * message.block.itemsize
    octets = _set(head, name, **{message.count: count}) + data.draw(
        st.binary(min_size=size, max_size=size)
    )
    if name == "RXM-RAWX":
        octets = np.array([1000.5]).tobytes() + octets[8:]
    elif message.time:
        octets = _set(octets, name, **{message.time: data.draw(st.integers(0, 604_799_999))})
    frame = ubx.frame(name, octets)
    expected = expect(UBXReader.parse(frame))
    decoded = ubx.decode([frame])
    assert (len(decoded.tables[topic]) if topic in decoded.tables else 0) == len(expected)
    for row, values in enumerate(expected):
        agree(decoded.tables[topic], row, values)
    assert decoded.used == len(frame)


def test_real_logs(ubx: Any, real_logs: dict[str, list[bytes]]) -> None:
    compared = 0
    for frames in real_logs.values():
        by_name: dict[str, list[bytes]] = {}
        for frame in frames:
            message = next(
                (
                    one
                    for one in MESSAGES
                    if one.name in _ONE | _MANY and frame[2:4] == ubx.frame(one.name, b"")[2:4]
                ),
                None,
            )
            if message is not None and len(frame) > 8:
                by_name.setdefault(message.name, []).append(frame)
        for name, several in by_name.items():
            for frame in several[:: max(1, len(several) // 8)]:
                topic, expect = (_ONE | _MANY)[name]
                told = expect(UBXReader.parse(frame))
                expected = told if isinstance(told, list) else [told] if told is not None else []
                tables = ubx.decode([frame]).tables
                assert (len(tables[topic]) if topic in tables else 0) == len(expected), name
                for row, values in enumerate(expected):
                    agree(tables[topic], row, values)
                compared += 1
    assert compared > 400
