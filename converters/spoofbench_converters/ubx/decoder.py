"""UBX: u-blox's binary messages into epochs and rows."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from spoofbench.conversion import Rejects
from spoofbench.errors import ConversionError
from spoofbench_converters.serial.contract import ABSENT_NS, EpochRows, Epochs, Frames
from spoofbench_converters.ubx import inertial, receiver, satellites
from spoofbench_converters.ubx.batch import EpochBatch
from spoofbench_converters.ubx.frames import FrameBuffer, accept
from spoofbench_converters.ubx.grouping import Grouper
from spoofbench_converters.ubx.inertial import TICK_BASIS, UbxSensors
from spoofbench_converters.ubx.receiver import Device
from spoofbench_converters.ubx.solution import Solutions
from spoofbench_converters.ubx.times import EpochTimeReader

_CONFLICTS, _CONFLICT_SHARE = 20, 0.05


class UbxDecoder:
    """Decodes one receiver's messages.

    Sources: ``gnss0``, the receiver; ``gnss1``, its second solution without inertial sensors
    (NAV2); ``ins0``, its integrated solution at navigation epochs, ``ins1`` that between them
    (HNR); ``imu0``, ``imu1``, ...: ESF-MEAS of each provider and ESF-RAW, as they appear.
    """

    protocol: Literal["ubx"] = "ubx"

    def __init__(self) -> None:
        self._buffer = FrameBuffer.none()
        self._grouper = Grouper()
        self._time_reader, self._device, self._sensors = EpochTimeReader(), Device(), UbxSensors()
        self._solutions = {"NAV": Solutions(), "NAV2": Solutions()}
        self._integrity = receiver.Integrity()
        self._emitted = 0  # epochs
        self._conflicts = 0
        self._sources: set[str] = set()

    def push(self, frames: Frames) -> Iterator[Epochs | Rejects]:
        """Take the next piece's frames; yield what is complete, and frames that give no rows, with
        the reason.
        """
        if not frames.starts.size:
            return
        accepted, rejects = accept(frames)
        yield from rejects
        accepted = replace(accepted, epoch=self._grouper.assign(accepted))
        self._buffer = self._buffer.join(accepted)
        yield from self._emit(self._grouper.first_open)

    def finish(self) -> Iterator[Epochs | Rejects]:
        """Give what is still held.

        Raises:
            ConversionError: two receivers' solutions are interleaved.
        """
        yield from self._emit(self._grouper.end)
        if self._conflicts >= _CONFLICTS and self._conflicts > _CONFLICT_SHARE * self._emitted:
            raise ConversionError(
                f"two UBX receivers are interleaved in this log: {self._conflicts} epochs have "
                "two solutions that differ; split it first"
            )

    def _emit(self, end: int) -> Iterator[Epochs | Rejects]:
        """Yield the epochs before ``end``; keep the frames of the others."""
        complete = self._buffer.epoch < end
        ready = self._buffer.take(complete)
        self._buffer = self._buffer.take(~complete).compact()
        if not ready.number.size:
            return
        first = self._emitted
        self._emitted = end
        batch = EpochBatch(ready, first, end - first)
        epochs, rejects = self._decode(batch)
        self._conflicts += batch.conflicts
        yield from rejects
        yield epochs

    def _decode(self, batch: EpochBatch) -> tuple[Epochs, list[Rejects]]:
        times = self._time_reader.read(batch)
        rows: list[EpochRows] = []
        for system, source in (("NAV", "gnss0"), ("NAV2", "gnss1")):
            rows += self._solutions[system].rows(batch, times, system, source)
            rows += satellites.signals(batch, system, source)
            rows += receiver.clock(batch, system, source)
        rows += satellites.observations(batch, "gnss0")
        rows += satellites.navigation_data(batch, "gnss0")
        rows += receiver.front_end(batch, "gnss0")
        rows += self._integrity.rows(batch, "gnss0")
        rows += receiver.time_marks(batch, "gnss0")
        rows += inertial.navigation(batch, "ins0")
        rows += inertial.high_rate(batch, times, "ins1")
        rows += self._sensors.rows(batch)
        self._device.read(batch)
        rows = EpochRows.by_topic(rows)
        self._sources.update(one.source for one in rows)
        used, rejects = batch.settle()
        opened, received = _begins(batch)
        return Epochs(opened, times.claimed_ns, times.period_ns, received, used, rows), rejects

    def about(self) -> Mapping[str, Mapping[str, str]]:
        """Return, by source, what the messages report of it; after :meth:`finish`."""
        about: dict[str, dict[str, str]] = {source: {} for source in sorted(self._sources)}
        for source in about:
            about[source] |= {
                name: self._device.receiver[name]
                for name in ("device", "firmware")
                if name in self._device.receiver
            }
        fused = self._solutions["NAV"].fused or self._device.fused
        if "gnss0" in about:
            about["gnss0"] |= self._device.receiver
            if self._time_reader.leap_s is not None:
                about["gnss0"]["leap_seconds"] = str(self._time_reader.leap_s)
            if fused or self._solutions["NAV"].fixed:
                about["gnss0"]["solution"] = "fused" if fused else "gnss"
        if "gnss1" in about:
            about["gnss1"]["solution"] = "gnss"
        for source in ("ins0", "ins1"):
            if source in about:
                about[source] |= {
                    "solution": "fused",
                    **self._device.fusion,
                    **self._device.alignment,
                }
        for (message, number), source in self._sensors.sources.items():
            if source in about:
                about[source] |= {
                    "message": message,
                    "tick_basis": TICK_BASIS[message],
                    **({"provider": str(number)} if message == "ESF-MEAS" else {}),
                    **self._device.alignment,
                }
        return about


def _begins(batch: EpochBatch) -> tuple[np.ndarray, np.ndarray]:
    """Return offset and receive time of each epoch's first frame."""
    offset, received = np.zeros(batch.count, np.int64), np.full(batch.count, ABSENT_NS)
    offset[batch.epoch[::-1]] = batch.buffer.offset[::-1]
    received[batch.epoch[::-1]] = batch.buffer.receive_time_ns[::-1]
    return offset, received
