"""The decoder of NMEA 0183: frames in, epochs and their rows out.

The epochs are those of the first receiver; sentences of other receivers, of heading sensors and of
inertial sensors belong to the epoch in which they stand, and what they say of time makes their
offset from it. A log without a receiver has an epoch per sentence.
"""

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np

from spoofbench.conversion import Columns, Rejects
from spoofbench.conversion.rows import take
from spoofbench_converters.nmea import receivers
from spoofbench_converters.nmea.addresses import READ, Addresses
from spoofbench_converters.nmea.assembly import Assembly
from spoofbench_converters.nmea.batch import Batch, read_frames
from spoofbench_converters.nmea.epochs import Before, Habits, open_within_bounds
from spoofbench_converters.nmea.fields import Bools, Ints
from spoofbench_converters.nmea.options import DecoderOptions
from spoofbench_converters.nmea.sensors import SENSORS
from spoofbench_converters.serial.contract import Epochs, Frames

_OF_SENSORS = np.isin(READ, list(SENSORS))


class NmeaDecoder:
    """Decodes one log; see :class:`spoofbench_converters.serial.contract.Decoder`."""

    protocol: Literal["nmea"] = "nmea"

    def __init__(self, options: DecoderOptions) -> None:
        self._options = options
        self._addresses = Addresses()
        self._held: Batch | None = None
        self._before = Before()
        self._receivers: dict[str, int] | None = None  # decided on the first sentences
        self._habits = Habits()
        self._without_receiver = False
        self._assembly = Assembly()

    def push(self, frames: Frames) -> Iterator[Epochs | Rejects]:
        """Take the next piece's sentences."""
        batch, rejects = read_frames(frames, self._addresses, self._options.source)
        yield from rejects
        self._held = batch if self._held is None else self._held.then(batch)
        if self._receivers is not None or self._held.size >= receivers.JUDGED:
            yield from self._release(last=False)

    def finish(self) -> Iterator[Epochs | Rejects]:
        """Give what is held."""
        if self._held is not None:
            yield from self._release(last=True)

    def about(self) -> Mapping[str, Mapping[str, str]]:
        """Return the sources' metadata."""
        return self._assembly.about()

    def _release(self, last: bool) -> Iterator[Epochs | Rejects]:
        """Give the epochs that are complete: all but the last."""
        held = self._held
        if held is None or not held.size:
            return
        receiver = self._receiver_of(held)
        first = np.flatnonzero(receiver == 0)
        frames = held.frames if first.size == held.size else take(held.frames, first)
        starts, before = open_within_bounds(frames, first, held.size, self._before, self._habits)
        end = (
            held.size
            if last or (self._without_receiver and not first.size)
            else int(np.flatnonzero(starts)[-1])
        )
        if self._without_receiver:
            starts |= receiver < 0
        if end:
            self._before = before
            done, self._held = held.split(end)
            yield from self._assembly.epochs(
                done, starts[:end], receiver[:end], self._addresses.talkers
            )

    def _receiver_of(self, held: Batch) -> Ints:
        """The receiver of each sentence, -1 for those of sensors."""
        talkers = self._addresses.talkers
        is_sensor = _OF_SENSORS[held.frames["code"]]
        if self._receivers is None:
            judged = take(held.frames, slice(0, receivers.JUDGED))
            self._receivers = receivers.tell_apart(judged, talkers)
            self._without_receiver = bool(is_sensor[: receivers.JUDGED].all())
            self._habits = Habits.of(
                take(judged, self._number(judged, is_sensor[: receivers.JUDGED]) == 0)
            )
        return self._number(held.frames, is_sensor)

    def _number(self, frames: Columns, is_sensor: Bools) -> Ints:
        known = self._receivers or {}
        by_talker = np.array(
            [receivers.receiver_of(talker, known) for talker in self._addresses.talkers]
        )
        return np.where(is_sensor, -1, by_talker[frames["talker"]])
