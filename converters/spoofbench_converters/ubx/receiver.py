"""What the receiver reports of itself: clock, front end, its word on jamming and spoofing, time
marks, and metadata.
"""

import json
import re
from collections import Counter

import numpy as np
from numpy.typing import NDArray

from spoofbench.arrays import Bools, Ints
from spoofbench.schema.v1 import gnss_pb2
from spoofbench.table import Column
from spoofbench_converters.serial.contract import EpochRows
from spoofbench_converters.ubx.batch import (
    NO_ACCURACY,
    EpochBatch,
    FieldColumns,
    absent_where,
    scaled,
)
from spoofbench_converters.ubx.messages import MON_HW_6, SEC_SIG

_AGC_RANGE, _JAM_RANGE = 8191, 255
_HW_6_BYTES = 68
_SPOOFING = np.array(
    [
        gnss_pb2.SPOOFING_STATE_UNKNOWN,
        gnss_pb2.SPOOFING_STATE_NONE,
        gnss_pb2.SPOOFING_STATE_INDICATED,
        gnss_pb2.SPOOFING_STATE_CONFIRMED,
    ]
)
_JAMMING = np.array(
    [
        gnss_pb2.JAMMING_STATE_UNKNOWN,
        gnss_pb2.JAMMING_STATE_NONE,
        gnss_pb2.JAMMING_STATE_WARNING,
        gnss_pb2.JAMMING_STATE_CRITICAL,
    ]
)
_SIGLOG_KINDS = 2  # 0 a simulated signal, 1 an abnormal one
_SIGLOG_STARTED, _SIGLOG_STOPPED = 0, 1
_TIME_BASES = ("receiver", "gnss", "utc")


def clock(batch: EpochBatch, system: str, source: str) -> list[EpochRows]:
    """Return ``gnss/clock`` rows of NAV-CLOCK: ns, ns/s, ns and ps/s."""
    frames = batch.one_of(f"{system}-CLOCK")
    if not frames.index.size:
        return []
    batch.use(frames.index)
    head = frames.head
    columns: FieldColumns = {
        "bias_s": scaled(head["clkB"], 1e-9),
        "drift_sps": scaled(head["clkD"], 1e-9),
        "acc_s": scaled(head["tAcc"], 1e-9, NO_ACCURACY),
        "drift_acc_sps": scaled(head["fAcc"], 1e-12, NO_ACCURACY),
    }
    return [batch.rows(source, "gnss/clock", frames.index, columns)]


def front_end(batch: EpochBatch, source: str) -> list[EpochRows]:
    """Return ``gnss/rf`` rows, one per block of MON-RF, one per MON-HW in epochs without MON-RF.

    The AGC count is given as a share of 8191, the jamming indicator of 255 (UBX-MON-RF, agcCnt and
    jamInd). Block 0 is the L1 band; which band others are depends on the product, so they are named
    by their number.
    """
    found = []
    frames = batch.all_of("MON-RF")
    blocks, owner = batch.blocks("MON-RF", frames)
    if frames.index.size:
        batch.use(frames.index)
        words = ("L1", *(str(number) for number in range(1, 256)))
        band = Column(blocks["blockId"].astype(np.int32), None, words)
        found.append(
            batch.rows(source, "gnss/rf", frames.index[owner], {"band": band} | _gain(blocks))
        )
    index, head = _hardware(batch)
    reported = np.isin(batch.epoch[index], frames.epoch)
    batch.refuse(index[reported], "told by MON-RF of its epoch")
    if not reported.all():
        batch.use(index[~reported])
        band = Column(np.zeros(np.count_nonzero(~reported), np.int32), None, ("L1",))
        found.append(
            batch.rows(source, "gnss/rf", index[~reported], {"band": band} | _gain(head[~reported]))
        )
    return found


def _gain(fields: NDArray[np.void]) -> FieldColumns:
    return {
        "agc": fields["agcCnt"] / _AGC_RANGE,
        "noise": fields["noisePerMS"].astype(float),
        "jam_indicator": fields["jamInd"] / _JAM_RANGE,
    }


def _hardware(batch: EpochBatch) -> tuple[Ints, NDArray[np.void]]:
    """Return the frames of MON-HW, and the fields that its two layouts share."""
    new, old = batch.all_of("MON-HW"), batch.all_of("MON-HW", MON_HW_6)
    names = ["noisePerMS", "agcCnt", "flags", "jamInd"]
    head = np.zeros(new.index.size, [(name, new.head.dtype[name]) for name in names])
    before_8 = batch.buffer.size[new.index] == _HW_6_BYTES
    for name in names:
        head[name] = np.where(before_8, old.head[name], new.head[name])
    return new.index, head


class Integrity:
    """Makes ``gnss/integrity`` rows: of SEC-SIG and SEC-SIGLOG, and until a log has SEC-SIG, one
    per epoch of older messages.

    SEC-SIG reports spoofing (spoofingState: 1 none, 2 indicated, 3 affirmed) and jamming
    (jammingState: 1 none, 2 indicated with the fix still good, 3 no reliable fix), unknown while
    its detection is off. Older receivers report spoofing by NAV-STATUS (spoofDetState: 1 none, 2
    indicated, 3 several indications) and jamming by MON-RF or MON-HW (jammingState, of which the
    worst band's counts); receivers with SEC-SIG leave these at 0. 0 is unknown throughout.

    ``raw`` holds, of SEC-SIG, its spoofing byte and above it its jamming byte, in version 2 the one
    byte of both; else flags2 of NAV-STATUS and above it flags of MON-RF's block or MON-HW; of
    SEC-SIGLOG, detectionType and above it eventType.
    """

    def __init__(self) -> None:
        self._has_security = False

    def rows(self, batch: EpochBatch, source: str) -> list[EpochRows]:
        """Return the rows of a batch."""
        found = []
        security = batch.all_of("SEC-SIG", SEC_SIG)
        older = np.zeros(batch.count, bool)
        if not self._has_security:
            older[: int(security.epoch.min()) if security.epoch.size else batch.count] = True
        if security.index.size:
            self._has_security = True
            batch.use(security.index)
            found.append(
                batch.rows(source, "gnss/integrity", security.index, _security(security.head))
            )
        return [*_older(batch, older, source), *found, *_events(batch, source)]


def _security(head: NDArray[np.void]) -> FieldColumns:
    old = head["version"] == 1
    jam, spoof = (
        np.where(old, head["jam"], head["both"] & 7),
        np.where(old, head["spoof"], head["both"] >> 3),
    )
    raw = np.where(old, spoof.astype(np.int64) | jam.astype(np.int64) << 8, head["both"])
    return {
        "spoofing": np.where(spoof & 1 > 0, _state(_SPOOFING, spoof >> 1 & 7), 0),
        "jamming": np.where(jam & 1 > 0, _state(_JAMMING, jam >> 1 & 3), 0),
        "raw": raw,
    }


def _state(states: NDArray[np.integer], reported: NDArray[np.integer]) -> NDArray[np.integer]:
    return np.where(reported < states.size, states[np.minimum(reported, states.size - 1)], 0)


def _older(batch: EpochBatch, wanted: Bools, source: str) -> list[EpochRows]:
    """Return one row per wanted epoch with NAV-STATUS, MON-RF or MON-HW."""
    spoofing, jamming = np.full(batch.count, -1), np.full(batch.count, -1)
    raw, frame = np.zeros(batch.count, np.int64), np.full(batch.count, -1)
    rf = batch.all_of("MON-RF")
    blocks, owner = batch.blocks("MON-RF", rf)
    index, head = _hardware(batch)
    for epoch, rows, flags, state in (
        (rf.epoch[owner], rf.index[owner], blocks["flags"], blocks["flags"] & 3),
        (batch.epoch[index], index, head["flags"], head["flags"] >> 2 & 3),
    ):
        order = np.argsort(state, kind="stable")  # of one epoch's, the worst is written last
        jamming[epoch[order]] = _state(_JAMMING, state)[order]
        raw[epoch[order]] = flags[order].astype(np.int64) << 8
        frame[epoch] = rows
    status = batch.one_of("NAV-STATUS")
    flags = status.head["flags2"]
    spoofing[status.epoch] = _state(_SPOOFING, flags >> 3 & 3)
    raw[status.epoch] |= flags
    frame[status.epoch] = status.index
    reported = np.flatnonzero(wanted & (frame >= 0))
    if not reported.size:
        return []
    batch.use(frame[reported])
    columns: FieldColumns = {
        "spoofing": Column(np.maximum(spoofing[reported], 0), spoofing[reported] >= 0),
        "jamming": Column(np.maximum(jamming[reported], 0), jamming[reported] >= 0),
        "raw": raw[reported],
    }
    return [batch.rows(source, "gnss/integrity", frame[reported], columns)]


def _events(batch: EpochBatch, source: str) -> list[EpochRows]:
    """Return rows of the events in SEC-SIGLOG that began within a second of its output.

    A report lists past events again and again; those that are older were either reported before or
    lie before the log.
    """
    frames = batch.all_of("SEC-SIGLOG")
    blocks, owner = batch.blocks("SEC-SIGLOG", frames)
    fresh = (
        (blocks["timeElapsed"] <= 1)
        & (blocks["eventType"] <= _SIGLOG_STOPPED)
        & (blocks["detectionType"] < _SIGLOG_KINDS)
    )
    index = frames.index[owner[fresh]]
    batch.use(index)
    batch.refuse(np.setdiff1d(frames.index, index), "no event within the last second")
    if not index.size:
        return []
    event = blocks[fresh]
    began = event["eventType"] == _SIGLOG_STARTED
    columns: FieldColumns = {
        "spoofing": np.where(
            began, gnss_pb2.SPOOFING_STATE_INDICATED, gnss_pb2.SPOOFING_STATE_NONE
        ),
        "raw": event["detectionType"].astype(np.int64) | event["eventType"].astype(np.int64) << 8,
    }
    return [batch.rows(source, "gnss/integrity", index, columns)]


def time_marks(batch: EpochBatch, source: str) -> list[EpochRows]:
    """Return ``gnss/timemark`` rows of TIM-TM2: the edges that are new, in its week and time of
    week where its time is valid.
    """
    frames = batch.all_of("TIM-TM2")
    flags = frames.head["flags"]
    rising, falling, valid = flags & 128 > 0, flags & 4 > 0, flags & 64 > 0
    batch.refuse(frames.index[~(rising | falling)], "no new edge")
    keep = rising | falling
    index, head = frames.index[keep], frames.head[keep]
    if not index.size:
        return []
    batch.use(index)
    base = flags[keep].astype(np.int64) >> 3 & 3
    columns: FieldColumns = {
        "channel": head["ch"].astype(np.int64),
        "count": head["count"].astype(np.int64),
        "acc_s": scaled(head["accEst"], 1e-9, NO_ACCURACY),
        "time_base": Column(
            np.where(base < len(_TIME_BASES), base, -1).astype(np.int32), None, _TIME_BASES
        ),
    }
    for edge, letter, new in (("rising", "R", rising[keep]), ("falling", "F", falling[keep])):
        reported = new & valid[keep]
        columns[f"{edge}_week"] = Column(
            np.where(reported, head[f"wn{letter}"], 0).astype(np.int64), reported
        )
        tow = head[f"towMs{letter}"].astype(np.float64) * 1e-3 + head[f"towSubMs{letter}"] * 1e-9
        columns[f"{edge}_tow_s"] = absent_where(~reported, tow)
    return [batch.rows(source, "gnss/timemark", index, columns)]


_FUSION = ("initialising", "fusing", "suspended", "disabled")
_ALIGNMENT = (
    "user-defined",
    "roll and pitch under way",
    "roll, pitch and yaw under way",
    "coarse",
    "fine",
)
_CALIBRATION = ("none", "calibrating", "calibrated", "calibrated")
_TOLD = "told in the metadata"
_KEYS = {"MOD": "device", "FWVER": "firmware", "PROTVER": "protocol_version"}


class Device:
    """Gathers metadata; the last word counts."""

    def __init__(self) -> None:
        self.receiver: dict[str, str] = {}
        self.alignment: dict[str, str] = {}
        self.fusion: dict[str, str] = {}
        self._modes: Counter[str] = Counter()

    @property
    def fused(self) -> bool:
        """Whether the receiver has said that it fuses inertial sensors into its solution."""
        return self._modes["fusing"] > 0

    def read(self, batch: EpochBatch) -> None:
        """Take what a batch reports."""
        self._version(batch)
        self._alignment(batch)
        self._status(batch)

    def _version(self, batch: EpochBatch) -> None:
        frames = batch.all_of("MON-VER")
        batch.refuse(frames.index, _TOLD)
        if not frames.index.size:
            return
        blocks, owner = batch.blocks("MON-VER", frames)
        head = frames.head[-1]
        software, hardware = _text(head["swVersion"]), _text(head["hwVersion"])
        reported = {"device": hardware, "firmware": software, "hardware": hardware}
        for extension in blocks["extension"][owner == frames.index.size - 1].tolist():
            name, *value = re.split("[= ]", _text(extension), maxsplit=1)
            if name in _KEYS and value:
                reported[_KEYS[name]] = value[0]
        self.receiver = {name: value for name, value in reported.items() if value}

    def _alignment(self, batch: EpochBatch) -> None:
        frames = batch.all_of("ESF-ALG")
        batch.refuse(frames.index, _TOLD)
        if frames.index.size:
            head = frames.head[-1]
            status = int(head["flags"]) >> 1 & 7
            self.alignment = {
                f"mounting_{axis}_deg": f"{int(head[axis]) / 100:g}"
                for axis in ("roll", "pitch", "yaw")
            }
            self.alignment["mounting_status"] = (
                _ALIGNMENT[status] if status < len(_ALIGNMENT) else str(status)
            )

    def _status(self, batch: EpochBatch) -> None:
        frames = batch.all_of("ESF-STATUS")
        batch.refuse(frames.index, _TOLD)
        if not frames.index.size:
            return
        for mode, count in zip(
            *np.unique(frames.head["fusionMode"], return_counts=True), strict=True
        ):
            self._modes[_FUSION[mode] if mode < len(_FUSION) else str(mode)] += int(count)
        blocks, owner = batch.blocks("ESF-STATUS", frames)
        sensors = [
            {
                "type": int(one["sensStatus1"]) & 63,
                "used": bool(one["sensStatus1"] & 64),
                "calibration": _CALIBRATION[int(one["sensStatus2"]) & 3],
            }
            for one in blocks[owner == frames.index.size - 1]
        ]
        self.fusion = {
            "fusion_reports": json.dumps(dict(sorted(self._modes.items()))),
            "fusion_sensors": json.dumps(sensors),
        }


def _text(raw: bytes) -> str:
    """Return text up to its first zero byte, printable characters only."""
    text = bytes(raw).split(b"\0")[0].decode("latin-1")
    return "".join(letter for letter in text if letter.isprintable()).strip()
