"""Which talkers are one receiver, judged by the first sentences of a log.

Talkers are one receiver unless their position sentences contradict each other: times that go back
and forth between them, or other positions at one time, in at least three and a fifth of the changes
from the one to the other; or every sentence of a type coming from the other one than the last, at
another time. So a receiver that changes its talker from GP to GN stays one, and so does one that
gives GPGNS, GLGNS and GNGNS.
"""

from collections.abc import Sequence

import numpy as np

from spoofbench.conversion import Columns
from spoofbench.gnss_time import SECOND_NS
from spoofbench_converters.nmea.addresses import CODES, GNSS_TALKERS
from spoofbench_converters.nmea.fields import Bools, Ints
from spoofbench_converters.nmea.utc import nearest_turn
from spoofbench_converters.serial.contract import ABSENT_NS

JUDGED = 2_000  # sentences from the start of a log
MAX_RECEIVERS = 8

_POSITION = tuple(CODES[name] for name in ("GGA", "RMC", "GLL", "GNS"))
_CHANGES, _SHARE, _ALTERNATIONS = 3, 0.2, 10


def tell_apart(frames: Columns, talkers: Sequence[str]) -> dict[str, int]:
    """Return the receiver, 0 being the first, of each talker that has position sentences among
    these; talkers of GNSS come first.
    """
    rows = np.flatnonzero(np.isin(frames["code"], _POSITION) & (frames["tod_ns"] != ABSENT_NS))
    talker = frames["talker"][rows]
    present, first = np.unique(talker, return_index=True)
    names = [talkers[place] for place in present[np.argsort(first)].tolist()]
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
    step = nearest_turn(tod[later] - tod[earlier])
    step = np.where(
        fine, step, nearest_turn((tod[later] // SECOND_NS - tod[earlier] // SECOND_NS) * SECOND_NS)
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
