"""What the receiver tells of itself: MON-VER, ESF-ALG, ESF-STATUS."""

import json
import re
from collections import Counter

import numpy as np

from spoofbench_converters.ubx.batch import Batch

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

    def read(self, batch: Batch) -> None:
        """Take what a batch tells."""
        self._version(batch)
        self._alignment(batch)
        self._status(batch)

    def _version(self, batch: Batch) -> None:
        picked = batch.all_of("MON-VER")
        batch.refuse(picked.frames, _TOLD)
        if not picked.frames.size:
            return
        blocks, place = batch.blocks("MON-VER", picked)
        head = picked.head[-1]
        software, hardware = _text(head["swVersion"]), _text(head["hwVersion"])
        told = {"device": hardware, "firmware": software, "hardware": hardware}
        for extension in blocks["extension"][place == picked.frames.size - 1].tolist():
            name, *value = re.split("[= ]", _text(extension), maxsplit=1)
            if name in _KEYS and value:
                told[_KEYS[name]] = value[0]
        self.receiver = {name: value for name, value in told.items() if value}

    def _alignment(self, batch: Batch) -> None:
        picked = batch.all_of("ESF-ALG")
        batch.refuse(picked.frames, _TOLD)
        if picked.frames.size:
            head = picked.head[-1]
            status = int(head["flags"]) >> 1 & 7
            self.alignment = {
                f"mounting_{axis}_deg": f"{int(head[axis]) / 100:g}"
                for axis in ("roll", "pitch", "yaw")
            }
            self.alignment["mounting_status"] = (
                _ALIGNMENT[status] if status < len(_ALIGNMENT) else str(status)
            )

    def _status(self, batch: Batch) -> None:
        picked = batch.all_of("ESF-STATUS")
        batch.refuse(picked.frames, _TOLD)
        if not picked.frames.size:
            return
        for mode, count in zip(
            *np.unique(picked.head["fusionMode"], return_counts=True), strict=True
        ):
            self._modes[_FUSION[mode] if mode < len(_FUSION) else str(mode)] += int(count)
        blocks, place = batch.blocks("ESF-STATUS", picked)
        sensors = [
            {
                "type": int(one["sensStatus1"]) & 63,
                "used": bool(one["sensStatus1"] & 64),
                "calibration": _CALIBRATION[int(one["sensStatus2"]) & 3],
            }
            for one in blocks[place == picked.frames.size - 1]
        ]
        self.fusion = {
            "fusion_reports": json.dumps(dict(sorted(self._modes.items()))),
            "fusion_sensors": json.dumps(sensors),
        }


def _text(raw: bytes) -> str:
    """Return text up to its first zero byte, printable characters only."""
    text = bytes(raw).split(b"\0")[0].decode("latin-1")
    return "".join(letter for letter in text if letter.isprintable()).strip()
