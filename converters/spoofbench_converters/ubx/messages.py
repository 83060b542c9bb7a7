"""Layouts of the UBX messages that say something the schema holds.

Field names, types and offsets are those of u-blox's interface descriptions: u-blox 6
(GPS.G6-SW-10018), 7 (GPS.G7-SW-12001), 8/M8 (UBX-13003221), F9P (UBX-18010854), F9R (UBX-19056845),
F10 (UBX-22036922) and X20 (UBX-24011213). All is little-endian. Scales stand with the code that
turns fields into columns.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from spoofbench_converters.ubx.names import key_of

PAYLOAD = 6  # where it begins in a frame: after two sync bytes, class, id and two bytes of length
FRAME_OVERHEAD = PAYLOAD + 2  # and two of checksum


class Role(IntEnum):
    """How a message belongs to an epoch."""

    UNTIMED = 0  # to the one under way
    NAV = 1  # its iTOW is that of the navigation epoch
    RAW = 2  # its time of week is the receiver's own, milliseconds off
    HIGH_RATE = 3  # its iTOW lies between navigation epochs


@dataclass(frozen=True, slots=True)
class Message:
    """One message: a head of constant layout, then blocks of one layout.

    Attributes:
        head, block: layouts; ``block`` None where there are none.
        count: field of the head that gives the number of blocks; empty where only the length gives
            it.
        lengths: payload lengths of its versions; empty where it has blocks. A shorter version lacks
            the last fields, which read 0.
        time: field of the head with the time of week, in ms (s in RXM-RAWX).
    """

    name: str
    head: np.dtype[np.void]
    block: np.dtype[np.void] | None = None
    count: str = ""
    lengths: tuple[int, ...] = ()
    role: Role = Role.UNTIMED
    time: str = ""


def layout(text: str) -> np.dtype[np.void]:
    """Return the packed little-endian structure of ``"iTOW:u4 _:3 nano:i4"``; ``_:n`` are n bytes
    of no interest.
    """
    names: list[str] = []
    formats: list[str] = []
    offsets: list[int] = []
    size = 0
    for word in text.split():
        name, _, kind = word.partition(":")
        if name == "_":
            size += int(kind)
            continue
        names.append(name)
        formats.append(f"<{kind}")
        offsets.append(size)
        size += np.dtype(kind).itemsize
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})


def offset_in(structure: np.dtype[np.void], name: str) -> int:
    """Return where a field begins, in bytes."""
    assert structure.fields is not None
    return structure.fields[name][1]


_UTC = "year:u2 month:u1 day:u1 hour:u1 min:u1 sec:u1"
_LLH = "lon:i4 lat:i4 height:i4 hMSL:i4"
_NED = "velN:i4 velE:i4 velD:i4"
_ANGLES = "roll:i4 pitch:i4 heading:i4 accRoll:u4 accPitch:u4 accHeading:u4"
_RATES = "xAngRate:i4 yAngRate:i4 zAngRate:i4 xAccel:i4 yAccel:i4 zAccel:i4"
_COVARIANCE = " ".join(
    f"{kind}Cov{axes}:f4"
    for kind in ("pos", "vel")
    for axes in ("NN", "NE", "ND", "EE", "ED", "DD")
)

_HEADS = {
    "NAV-POSECEF": "iTOW:u4 ecefX:i4 ecefY:i4 ecefZ:i4 pAcc:u4",
    "NAV-POSLLH": f"iTOW:u4 {_LLH} hAcc:u4 vAcc:u4",
    "NAV-STATUS": "iTOW:u4 gpsFix:u1 flags:u1 fixStat:u1 flags2:u1 ttff:u4 msss:u4",
    "NAV-DOP": "iTOW:u4 gDOP:u2 pDOP:u2 tDOP:u2 vDOP:u2 hDOP:u2 nDOP:u2 eDOP:u2",
    "NAV-ATT": f"iTOW:u4 version:u1 _:3 {_ANGLES}",
    "NAV-SOL": (
        "iTOW:u4 fTOW:i4 week:i2 gpsFix:u1 flags:u1 ecefX:i4 ecefY:i4 ecefZ:i4 pAcc:u4 ecefVX:i4 "
        "ecefVY:i4 ecefVZ:i4 sAcc:u4"
        " pDOP:u2 _:1 numSV:u1 _:4"
    ),
    "NAV-PVT": (
        f"iTOW:u4 {_UTC} valid:u1 tAcc:u4 nano:i4 fixType:u1 flags:u1 flags2:u1 numSV:u1 {_LLH} "
        f"hAcc:u4 vAcc:u4 {_NED}"
        " gSpeed:i4 headMot:i4 sAcc:u4 headAcc:u4 pDOP:u2 flags3:u2 _:4 headVeh:i4 magDec:i2 "
        "magAcc:u2"
    ),
    "NAV-VELECEF": "iTOW:u4 ecefVX:i4 ecefVY:i4 ecefVZ:i4 sAcc:u4",
    "NAV-VELNED": f"iTOW:u4 {_NED} speed:u4 gSpeed:u4 heading:i4 sAcc:u4 cAcc:u4",
    "NAV-HPPOSECEF": (
        "version:u1 _:3 iTOW:u4 ecefX:i4 ecefY:i4 ecefZ:i4 ecefXHp:i1 ecefYHp:i1 ecefZHp:i1 "
        "flags:u1 pAcc:u4"
    ),
    "NAV-HPPOSLLH": (
        f"version:u1 _:2 flags:u1 iTOW:u4 {_LLH} lonHp:i1 latHp:i1 heightHp:i1 hMSLHp:i1 "
        "hAcc:u4 vAcc:u4"
    ),
    "NAV-PVAT": (
        "iTOW:u4 version:u1 valid:u1 year:u2 month:u1 day:u1 hour:u1 min:u1 sec:u1 _:3 tAcc:u4 "
        "nano:i4 fixType:u1 flags:u1 flags2:u1"
        f" numSV:u1 {_LLH} hAcc:u4 vAcc:u4 {_NED} gSpeed:i4 sAcc:u4 vehRoll:i4 vehPitch:i4 "
        "vehHeading:i4 motHeading:i4"
        " accRoll:u2 accPitch:u2 accHeading:u2 magDec:i2 magAcc:u2 errEllipseOrient:u2 "
        "errEllipseMajor:u4 errEllipseMinor:u4 _:8"
    ),
    "NAV-TIMEGPS": "iTOW:u4 fTOW:i4 week:i2 leapS:i1 valid:u1 tAcc:u4",
    "NAV-TIMEUTC": f"iTOW:u4 tAcc:u4 nano:i4 {_UTC} valid:u1",
    "NAV-CLOCK": "iTOW:u4 clkB:i4 clkD:i4 tAcc:u4 fAcc:u4",
    "NAV-TIMELS": (
        "iTOW:u4 version:u1 _:3 srcOfCurrLs:u1 currLs:i1 srcOfLsChange:u1 lsChange:i1 "
        "timeToLsEvent:i4 dateOfLsGpsWn:u2"
        " dateOfLsGpsDn:u2 _:3 valid:u1"
    ),
    "NAV-COV": f"iTOW:u4 version:u1 posCovValid:u1 velCovValid:u1 _:9 {_COVARIANCE}",
    "NAV-EOE": "iTOW:u4",
    "NAV-SVINFO": "iTOW:u4 numCh:u1 globalFlags:u1 _:2",
    "NAV-SAT": "iTOW:u4 version:u1 numSvs:u1 _:2",
    "NAV-SIG": "iTOW:u4 version:u1 numSigs:u1 _:2",
    "RXM-RAW": "iTOW:i4 week:i2 numSV:u1 _:1",
    "RXM-SFRB": "chn:u1 svid:u1 dwrd:(10,)u4",
    "RXM-SFRBX": "gnssId:u1 svId:u1 sigId:u1 freqId:u1 numWords:u1 chn:u1 version:u1 _:1",
    "RXM-MEASX": (
        "version:u1 _:3 gpsTOW:u4 gloTOW:u4 bdsTOW:u4 _:4 qzssTOW:u4 gpsTOWacc:u2 gloTOWacc:u2 "
        "bdsTOWacc:u2 _:2 qzssTOWacc:u2"
        " numSv:u1 flags:u1 _:8"
    ),
    "RXM-RAWX": "rcvTow:f8 week:u2 leapS:i1 numMeas:u1 recStat:u1 version:u1 _:2",
    "MON-VER": "swVersion:S30 hwVersion:S10",
    "MON-HW": (
        "pinSel:u4 pinBank:u4 pinDir:u4 pinVal:u4 noisePerMS:u2 agcCnt:u2 aStatus:u1 aPower:u1 "
        "flags:u1 _:22 jamInd:u1 _:14"
    ),
    "MON-RF": "version:u1 nBlocks:u1 recInf:u1 _:1",
    "TIM-TM2": (
        "ch:u1 flags:u1 count:u2 wnR:u2 wnF:u2 towMsR:u4 towSubMsR:u4 towMsF:u4 towSubMsF:u4 "
        "accEst:u4"
    ),
    "ESF-MEAS": "timeTag:u4 flags:u2 id:u2",
    "ESF-RAW": "msss:u4",
    "ESF-STATUS": (
        "iTOW:u4 version:u1 initStatus1:u1 initStatus2:u1 _:5 fusionMode:u1 _:2 numSens:u1"
    ),
    "ESF-ALG": "iTOW:u4 version:u1 flags:u1 error:u1 _:1 yaw:u4 pitch:i2 roll:i2",
    "ESF-INS": f"flags:u4 _:4 iTOW:u4 {_RATES}",
    "SEC-SIG": "version:u1 flags:u1 _:1 jamNumCentFreqs:u1",
    "SEC-SIGLOG": "version:u1 numEvents:u1 _:6",
    "HNR-PVT": (
        f"iTOW:u4 {_UTC} valid:u1 nano:i4 gpsFix:u1 flags:u1 _:2 {_LLH} gSpeed:i4 speed:i4 "
        "headMot:i4 headVeh:i4"
        " hAcc:u4 vAcc:u4 sAcc:u4 headAcc:u4 _:4"
    ),
    "HNR-ATT": f"iTOW:u4 version:u1 _:3 {_ANGLES}",
    "HNR-INS": f"flags:u4 _:4 iTOW:u4 {_RATES}",
}
_BLOCKS = {
    "NAV-SVINFO": "chn:u1 svid:u1 flags:u1 quality:u1 cno:u1 elev:i1 azim:i2 prRes:i4",
    "NAV-SAT": "gnssId:u1 svId:u1 cno:u1 elev:i1 azim:i2 prRes:i2 flags:u4",
    "NAV-SIG": (
        "gnssId:u1 svId:u1 sigId:u1 freqId:u1 prRes:i2 cno:u1 qualityInd:u1 corrSource:u1 "
        "ionoModel:u1 sigFlags:u2 _:4"
    ),
    "RXM-RAW": "cpMes:f8 prMes:f8 doMes:f4 sv:u1 mesQI:i1 cno:i1 lli:u1",
    "RXM-SFRBX": "dwrd:u4",
    "RXM-MEASX": (
        "gnssId:u1 svId:u1 cNo:u1 mpathIndic:u1 dopplerMS:i4 dopplerHz:i4 wholeChips:u2 "
        "fracChips:u2 codePhase:u4 intCodePhase:u1"
        " pseuRangeRMSErr:u1 _:2"
    ),
    "RXM-RAWX": (
        "prMes:f8 cpMes:f8 doMes:f4 gnssId:u1 svId:u1 sigId:u1 freqId:u1 locktime:u2 cno:u1 "
        "prStdev:u1 cpStdev:u1 doStdev:u1 trkStat:u1 _:1"
    ),
    "MON-VER": "extension:S30",
    "MON-RF": (
        "blockId:u1 flags:u1 antStatus:u1 antPower:u1 postStatus:u4 _:4 noisePerMS:u2 agcCnt:u2 "
        "jamInd:u1 ofsI:i1 magI:u1 ofsQ:i1"
        " magQ:u1 _:3"
    ),
    "ESF-MEAS": "data:u4",
    "ESF-RAW": "data:u4 sTtag:u4",
    "ESF-STATUS": "sensStatus1:u1 sensStatus2:u1 freq:u1 faults:u1",
    "SEC-SIG": "jamStateCentFreq:u4",
    "SEC-SIGLOG": "timeElapsed:u4 detectionType:u1 eventType:u1 _:2",
}
_COUNTS = {
    "NAV-SVINFO": "numCh", "NAV-SAT": "numSvs", "NAV-SIG": "numSigs", "RXM-RAW": "numSV",
    "RXM-SFRBX": "numWords", "RXM-MEASX": "numSv",
    "RXM-RAWX": "numMeas", "MON-RF": "nBlocks", "ESF-STATUS": "numSens", "SEC-SIGLOG": "numEvents",
}  # fmt: skip
_LENGTHS = {"NAV-PVT": (84, 92, 96), "MON-HW": (60, 68)}  # NAV-PVT of u-blox 7 ends with pDOP
_TIMES = {"RXM-RAW": "iTOW", "RXM-RAWX": "rcvTow", "RXM-MEASX": "gpsTOW"}
_NAV2 = (
    "POSECEF", "POSLLH", "STATUS", "DOP", "PVT", "VELECEF", "VELNED", "PVAT", "TIMEGPS", "TIMEUTC",
    "CLOCK", "TIMELS", "COV", "EOE", "SAT",
    "SIG",
)  # fmt: skip

MON_HW_6 = layout("_:16 noisePerMS:u2 agcCnt:u2 aStatus:u1 aPower:u1 flags:u1 _:30 jamInd:u1 _:14")
"""MON-HW of u-blox 6 and 7, 68 bytes."""
SEC_SIG = layout("version:u1 both:u1 _:2 jam:u1 _:3 spoof:u1 _:3")
"""SEC-SIG: ``both`` of version 2, ``jam`` and ``spoof`` of version 1."""


def _role(name: str) -> Role:
    if name in _TIMES:
        return Role.RAW
    if name.startswith("HNR-"):
        return Role.HIGH_RATE
    return Role.NAV if name.startswith("NAV-") or name == "ESF-INS" else Role.UNTIMED


def _message(name: str) -> Message:
    head, role = layout(_HEADS[name]), _role(name)
    block = layout(_BLOCKS[name]) if name in _BLOCKS else None
    lengths = () if block is not None else _LENGTHS.get(name, (head.itemsize,))
    return Message(
        name,
        head,
        block,
        _COUNTS.get(name, ""),
        lengths,
        role,
        _TIMES.get(name, "iTOW" if role else ""),
    )


MESSAGES: tuple[Message, ...] = (
    *(_message(name) for name in _HEADS),
    *(replace(_message(f"NAV-{name}"), name=f"NAV2-{name}") for name in _NAV2),
)
NUMBER: Mapping[str, int] = {message.name: number for number, message in enumerate(MESSAGES)}
"""Place of a message in :data:`MESSAGES`, by name."""

NUMBER_OF_KEY: NDArray[np.int16] = np.full(1 << 16, -1, np.int16)
"""The same by class * 256 + id, -1 where the schema holds nothing of it."""
NUMBER_OF_KEY[[key_of(message.name) for message in MESSAGES]] = np.arange(len(MESSAGES))
