"""The decoder of NMEA 0183: frames in, epochs and their rows out.

The epochs are those of the first receiver; sentences of other receivers, of heading sensors and of
inertial sensors belong to the epoch in which they stand, and what they say of time makes their
offset from it. A log without a receiver has an epoch per sentence.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from spoofbench.arrays import Bools, Ints
from spoofbench.conversion import Columns, Rejects
from spoofbench.conversion.rows import take
from spoofbench.gnss_time import DAY_NS, SECOND_NS, wrap_difference
from spoofbench_converters.nmea.assembly import SENSORS, Assembly
from spoofbench_converters.nmea.batch import (
    CODES,
    GNSS_TALKERS,
    READ,
    Addresses,
    SentenceBatch,
    read_frames,
)
from spoofbench_converters.nmea.epochs import PreviousTimes, ReceiverTraits, open_within_bounds
from spoofbench_converters.serial.contract import ABSENT_NS, Epochs, Frames

JUDGED = 2_000  # sentences from the start of a log
MAX_RECEIVERS = 8

_POSITION = tuple(CODES[name] for name in ("GGA", "RMC", "GLL", "GNS"))
_CHANGES, _SHARE, _ALTERNATIONS = 3, 0.2, 10
_OF_SENSORS = np.isin(READ, list(SENSORS))


@dataclass(frozen=True, slots=True)
class DecoderOptions:
    """What the decoder asks of a converter's options.

    Attributes:
        source: talker, such as ``GP``, of the one receiver to convert where a log holds several;
            satellites in view and in use are kept of all GNSS talkers.
    """

    source: str | None = None

    def __post_init__(self) -> None:
        if self.source is not None and not re.fullmatch("[A-Z]{2}", self.source):
            raise ValueError(
                f"source must be a talker of two capital letters such as 'GP', not {self.source!r}"
            )


class NmeaDecoder:
    """Decodes one log; see :class:`spoofbench_converters.serial.contract.FrameDecoder`."""

    protocol: Literal["nmea"] = "nmea"

    def __init__(self, options: DecoderOptions) -> None:
        self._options = options
        self._addresses = Addresses()
        self._held: SentenceBatch | None = None
        self._before = PreviousTimes()
        self._receivers: dict[str, int] | None = None  # decided on the first sentences
        self._traits = ReceiverTraits()
        self._without_receiver = False
        self._assembly = Assembly()

    def push(self, frames: Frames) -> Iterator[Epochs | Rejects]:
        """Take the next piece's sentences."""
        if not frames.starts.size:
            return
        batch, rejects = read_frames(frames, self._addresses, self._options.source)
        yield from rejects
        self._held = batch if self._held is None else self._held.then(batch)
        if self._receivers is not None or self._held.size >= JUDGED:
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
        starts, before = open_within_bounds(frames, first, held.size, self._before, self._traits)
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

    def _receiver_of(self, held: SentenceBatch) -> Ints:
        """The receiver of each sentence, -1 for those of sensors."""
        talkers = self._addresses.talkers
        is_sensor = _OF_SENSORS[held.frames["code"]]
        if self._receivers is None:
            judged = take(held.frames, slice(0, JUDGED))
            self._receivers = tell_apart(judged, talkers)
            self._without_receiver = bool(is_sensor[:JUDGED].all())
            self._traits = ReceiverTraits.of(
                take(judged, self._number(judged, is_sensor[:JUDGED]) == 0)
            )
        return self._number(held.frames, is_sensor)

    def _number(self, frames: Columns, is_sensor: Bools) -> Ints:
        known = self._receivers or {}
        by_talker = np.array([receiver_of(talker, known) for talker in self._addresses.talkers])
        return np.where(is_sensor, -1, by_talker[frames["talker"]])


def tell_apart(frames: Columns, talkers: Sequence[str]) -> dict[str, int]:
    """Return the receiver, 0 being the first, of each talker that has position sentences among
    ``n`` sentences, whose columns are ``(n,)``; talkers of GNSS come first.

    Talkers are one receiver unless their position sentences contradict each other: times that go
    back and forth between them, or other positions at one time, in at least three and a fifth of
    the changes from the one to the other; or every sentence of a type coming from the other one
    than the last, at another time. So a receiver that changes its talker from GP to GN stays one,
    and so does one that gives GPGNS, GLGNS and GNGNS.
    """
    rows = np.flatnonzero(np.isin(frames["code"], _POSITION) & (frames["tod_ns"] != ABSENT_NS))
    talker = frames["talker"][rows]
    present, first = np.unique(talker, return_index=True)
    names = [talkers[index] for index in present[np.argsort(first)].tolist()]
    names.sort(key=lambda name: name not in GNSS_TALKERS)
    against = _contradictions(frames, rows, talkers) if len(names) > 1 else set()
    receivers: list[list[str]] = []
    for name in names:
        fitting = (
            receiver
            for receiver in receivers
            if not any((name, other) in against for other in receiver)
        )
        receiver = next(fitting, None)
        if receiver is not None:
            receiver.append(name)
        elif len(receivers) < MAX_RECEIVERS:
            receivers.append([name])
        else:
            receivers[-1].append(name)
    return {name: number for number, receiver in enumerate(receivers) for name in receiver}


def receiver_of(talker: str, known: dict[str, int]) -> int:
    """Return the receiver of any talker: of one without positions, that of GN, or else the
    first.
    """
    return known.get(talker, known.get("GN", 0) if talker in GNSS_TALKERS else 0)


def _contradictions(frames: Columns, rows: Ints, talkers: Sequence[str]) -> set[tuple[str, str]]:
    changes, against = _changes(frames, rows)
    found = [
        pair
        for pair, count in changes.items()
        if against.get(pair, 0) >= max(_CHANGES, _SHARE * count)
    ]
    for code in _POSITION:
        found += _alternating(frames, rows[frames["code"][rows] == code])
    pairs = {(talkers[a], talkers[b]) for a, b in found}
    return pairs | {(b, a) for a, b in pairs}


def _changes(
    frames: Columns, rows: Ints
) -> tuple[dict[tuple[int, int], int], dict[tuple[int, int], int]]:
    """Count the changes from one talker to another, and those that contradict, by pair."""
    earlier, later = rows[:-1], rows[1:]
    other = frames["talker"][earlier] != frames["talker"][later]
    earlier, later = earlier[other], later[other]
    tod = frames["tod_ns"]
    fine = (frames["tod_places"][earlier] > 0) & (frames["tod_places"][later] > 0)
    step = wrap_difference(tod[later] - tod[earlier], DAY_NS)
    step = np.where(
        fine,
        step,
        wrap_difference((tod[later] // SECOND_NS - tod[earlier] // SECOND_NS) * SECOND_NS, DAY_NS),
    )
    tolerance = (
        np.maximum(frames["lat_deg_step"][earlier], frames["lat_deg_step"][later]) / 60 * 1.01
    )
    apart = np.zeros(later.size, bool)
    for name in ("lat_deg", "lon_deg"):
        apart |= np.abs(frames[name][later] - frames[name][earlier]) > tolerance
    wrong = (step < 0) | ((step == 0) & apart)
    pairs = np.sort(np.stack([frames["talker"][earlier], frames["talker"][later]], 1), axis=1)
    return _count(pairs), _count(pairs[wrong])


def _count(pairs: Ints) -> dict[tuple[int, int], int]:
    unique, counts = np.unique(pairs, axis=0, return_counts=True)
    return {(a, b): count for (a, b), count in zip(unique.tolist(), counts.tolist(), strict=True)}


def _alternating(frames: Columns, rows: Ints) -> list[tuple[int, int]]:
    """The pair of talkers that take turns throughout, if any."""
    talker, tod = frames["talker"][rows], frames["tod_ns"][rows]
    present = np.unique(talker)
    turns: Bools = (talker[1:] != talker[:-1]) & (tod[1:] != tod[:-1])
    if present.size == 2 and rows.size > _ALTERNATIONS and bool(turns.all()):
        return [(int(present[0]), int(present[1]))]
    return []
