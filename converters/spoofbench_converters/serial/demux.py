"""A log's bytes, each given to one owner: UBX frames, sentences, RTCM 3 messages, or a reject.

A scan goes from left to right. At each byte the first valid thing wins: a whole UBX frame, sentence
or RTCM 3 message whose checksum is right, as :mod:`spoofbench_converters.serial.framing` describes
them; else one byte is skipped. So a false start, a sentence within another, or a false length never
costs a valid frame behind it. The checksum option says what becomes of sentences without a
checksum, or with a wrong one.
"""

import io
from collections.abc import Iterator
from dataclasses import dataclass
from typing import IO

import numpy as np
from numpy.typing import NDArray

from spoofbench.arrays import Ints, Octets
from spoofbench.conversion import Rejects, Source
from spoofbench_converters.serial import framing, gaps
from spoofbench_converters.serial.contract import ABSENT_NS, Frames
from spoofbench_converters.serial.framing import Candidates, Checksum
from spoofbench_converters.serial.host_timestamps import MAX_STAMP, HostTimestamps

PIECE_BYTES = 4 * 2**20
RTCM = "RTCM 3 message: nothing in the schema"

_REACH = framing.MAX_FRAME + 4 * MAX_STAMP
"""How far behind the start of a frame there may be what decides on it and on its line, in bytes."""

_UBX, _SENTENCE, _RTCM3 = range(3)
_LF, _CR, _COMMA = b"\n\r,"


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """What a piece of a log holds: frames by protocol and rejects, and the offset in the log up to
    which all is told.
    """

    ubx: Frames
    nmea: Frames
    rejects: list[Rejects]
    end: int


@dataclass(frozen=True, slots=True)
class _Edge:
    """Whether a piece starts with a line, and whether right after a frame."""

    line: bool
    frame: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Owned:
    """Frames in the order of the log, and the extents ``[first, last)`` with what stands beside
    them.
    """

    protocols: NDArray[np.int8]
    starts: Ints
    ends: Ints
    first: Ints
    last: Ints
    receive_time_ns: Ints

    def of(self, protocol: int, octets: Octets, base: int) -> Frames:
        mine = self.protocols == protocol
        starts, used = self.starts[mine], (self.last - self.first)[mine]
        leads = starts - self.first[mine]
        return Frames(
            octets,
            starts,
            self.ends[mine] - starts,
            base,
            used,
            self.receive_time_ns[mine],
            leads=leads,
        )


def demultiplex(
    stream: IO[bytes],
    stamps: HostTimestamps,
    checksum: Checksum = "required",
    piece_bytes: int = PIECE_BYTES,
) -> Iterator[Piece]:
    """Yield a log's frames and rejects; what they are does not depend on the size of the pieces
    that are read.
    """
    base, edge, known, more = 0, _Edge(line=True, frame=True), b"", True
    while more:
        new = _read(stream, piece_bytes)
        more, known = len(new) == piece_bytes, known + new
        if known and (not more or len(known) > _REACH):
            octets = np.frombuffer(known, np.uint8)
            found = _find(octets, octets.size - _REACH if more else octets.size, checksum)
            owned = _owned(octets, found, edge, stamps)
            told = (
                int(max(octets.size - _REACH - MAX_STAMP, owned.last.max(initial=0)))
                if more
                else octets.size
            )
            rejects, kept = _rejects(octets, base, (owned, found.marks), (told, more), edge)
            yield Piece(
                owned.of(_UBX, octets, base),
                owned.of(_SENTENCE, octets, base),
                rejects,
                base + kept,
            )
            if kept:
                edge = _Edge(bool(octets[kept - 1] in (_LF, _CR)), bool(np.any(owned.last == kept)))
            base, known = base + kept, known[kept:]


def _read(stream: IO[bytes], size: int) -> bytes:
    """Return the next bytes of a stream, fewer than asked for only at its end."""
    pieces, missing = [], size
    while missing and (piece := stream.read(missing)):
        pieces.append(piece)
        missing -= len(piece)
    return b"".join(pieces)


@dataclass(frozen=True, slots=True, eq=False)
class _Scan:
    """The frames that a scan takes, in order, and where damaged ones start."""

    protocols: NDArray[np.int8]
    starts: Ints
    ends: Ints
    marks: gaps.DamageMarks


def _find(octets: Octets, limit: int, checksum: Checksum) -> _Scan:
    """Find what starts before a limit.

    Starts of RTCM 3 messages are frequent within UBX frames. They are looked at there only if one
    of these frames is not taken.
    """
    ubx, sentences = (
        framing.ubx(octets).before(limit),
        framing.sentences(octets, checksum).before(limit),
    )
    whole = ubx.valid()
    whole = whole.take(framing.chosen(whole.starts, whole.ends))
    found = _taken(ubx, sentences, framing.rtcm3(octets, whole).before(limit))
    if not np.array_equal(found[1][found[0] == _UBX], whole.starts):
        found = _taken(ubx, sentences, framing.rtcm3(octets, None).before(limit))
    return _Scan(*found, _marks(octets, ubx, sentences))


def _taken(
    ubx: Candidates, sentences: Candidates, rtcm3: Candidates
) -> tuple[NDArray[np.int8], Ints, Ints]:
    """Return protocols, starts and ends of the frames that a scan takes."""
    valid = [found.valid() for found in (ubx, sentences, rtcm3)]
    starts, ends = (
        np.concatenate([found.starts for found in valid]),
        np.concatenate([found.ends for found in valid]),
    )
    protocols = np.repeat(
        np.array([_UBX, _SENTENCE, _RTCM3], np.int8), [found.starts.size for found in valid]
    )
    order = np.argsort(starts, kind="stable")
    taken = order[framing.chosen(starts[order], ends[order])]
    return protocols[taken], starts[taken], ends[taken]


def _owned(octets: Octets, found: _Scan, edge: _Edge, stamps: HostTimestamps) -> _Owned:
    """Give the frames that a scan takes what stands beside them."""
    protocols, starts, ends = found.protocols, found.starts, found.ends
    first, last, times = starts.copy(), ends.copy(), np.full(starts.size, ABSENT_NS)
    mine = np.flatnonzero(protocols == _SENTENCE)
    if mine.size:
        last[mine], times[mine] = _behind(octets, ends[mine], stamps)
        before = np.append(0, last[:-1])[mine]
        first[mine], leading = _ahead(octets, starts[mine], before, edge, stamps)
        times[mine] = np.where(times[mine] == ABSENT_NS, leading, times[mine])
    return _Owned(protocols, starts, ends, first, last, times)


def _behind(octets: Octets, ends: Ints, stamps: HostTimestamps) -> tuple[Ints, Ints]:
    """Return where the lines of sentences end, with a time that stands there or on the next line,
    and these times.
    """
    last, times = framing.line_ends(octets, ends), np.full(ends.size, ABSENT_NS)
    following = np.minimum(last, octets.size - 1)
    odd = np.flatnonzero((last < octets.size) & ((last == ends) | (octets[following] == _COMMA)))
    if odd.size:
        line_stops = _stops(octets, last[odd])
        understood, told = stamps.after(octets, last[odd], line_stops)
        understood &= (last[odd] == ends[odd]) | (told != ABSENT_NS)
        last[odd[understood]] = framing.line_ends(octets, line_stops[understood])
        times[odd[understood]] = told[understood]
    return last, times


def _ahead(
    octets: Octets, starts: Ints, before: Ints, edge: _Edge, stamps: HostTimestamps
) -> tuple[Ints, Ints]:
    """Return where sentences start with what a logger wrote before them, and the times that this
    tells.
    """
    first, times = starts.copy(), np.full(starts.size, ABSENT_NS)
    previous = octets[np.maximum(starts - 1, 0)]
    odd = np.flatnonzero((starts > before) & (previous != _LF) & (previous != _CR))
    if odd.size:
        breaks = np.append(-1, np.flatnonzero((octets == _LF) | (octets == _CR)))
        begins = np.maximum(before[odd], breaks[np.searchsorted(breaks, starts[odd]) - 1] + 1)
        understood, told = stamps.before(octets, begins, starts[odd])
        understood &= (begins > 0) | edge.line | edge.frame
        first[odd[understood]], times[odd[understood]] = begins[understood], told[understood]
    return first, times


def _stops(octets: Octets, places: Ints) -> Ints:
    """Return where the line of each place ends, line end excluded."""
    breaks = np.append(np.flatnonzero((octets == _LF) | (octets == _CR)), octets.size)
    return breaks[np.searchsorted(breaks, places)]


def _rejects(
    octets: Octets,
    base: int,
    what: tuple[_Owned, gaps.DamageMarks],
    until: tuple[int, bool],
    edge: _Edge,
) -> tuple[list[Rejects], int]:
    """Return the rejects up to a place, and how far they go: one that may go on behind it is left
    to the next piece.
    """
    (owned, marks), (end, more) = what, until
    starts, ends = np.append(0, owned.last), np.append(owned.first, end)
    skipped = starts[starts < ends], ends[starts < ends]
    rtcm = (
        owned.starts[owned.protocols == _RTCM3],
        (owned.ends - owned.starts)[owned.protocols == _RTCM3],
    )
    rejects = [Rejects(rtcm[0] + base, rtcm[1], RTCM)] if rtcm[0].size else []
    if not skipped[0].size:
        return rejects, end
    starts, ends, reasons = gaps.divide(octets, skipped, marks, edge.line)
    if more and ends[-1] == end:
        end, starts, ends, reasons = int(starts[-1]), starts[:-1], ends[:-1], reasons[:-1]
    return rejects + gaps.rejects(base, starts, ends, reasons), end


def _marks(octets: Octets, ubx: Candidates, sentences: Candidates) -> gaps.DamageMarks:
    """Return where damage starts; a sentence's only where an address begins, for in binary data
    ``$A`` is frequent.
    """
    damaged = np.flatnonzero(ubx.verdicts != framing.VALID)
    broken = np.flatnonzero(sentences.verdicts != framing.VALID)
    for place in (2, 3, 4):
        octet = octets.take(sentences.starts[broken] + place, mode="clip")
        broken = broken[(octet - np.uint8(ord("A")) < 26) | (octet - np.uint8(ord("0")) < 10)]
    places = np.concatenate([ubx.starts[damaged], sentences.starts[broken]])
    return gaps.DamageMarks(
        places,
        np.concatenate(
            [_UBX_REASONS[ubx.verdicts[damaged]], _SENTENCE_REASONS[sentences.verdicts[broken]]]
        ),
    )


_UBX_REASONS = np.array([-1, gaps.UBX_WRONG, -1, -1, gaps.UBX_CUT], np.int8)
_SENTENCE_REASONS = np.array([-1, gaps.WRONG, gaps.MISSING, gaps.BROKEN, gaps.BROKEN], np.int8)


LOOKED_AT = 2**20
"""Bytes that are looked at where those of ``Source.head`` hold no frame: behind a long header."""

_LEAST, _MOST = 0.5, 0.95


@dataclass(frozen=True, slots=True)
class Beginning:
    """Valid frames at the beginning of a source, and the share of its bytes that they make up."""

    ubx: int
    nmea: int
    share: float

    def score(self) -> float:
        """Return how sure it is that a source with such frames is a stream of them; one mostly of
        other text is for others to claim.
        """
        return _LEAST + (_MOST - _LEAST) * self.share


def beginning(source: Source) -> Beginning:
    """Return what a source begins with; nothing for a folder and an archive."""
    if source.path.is_dir() or source.is_archive:
        return Beginning(0, 0, 0.0)
    found = _look(source.head)
    if not found.ubx and not found.nmea and source.head:
        with source.open() as stream:
            found = _look(stream.read(LOOKED_AT))
    return found


def _look(head: bytes) -> Beginning:
    ubx = nmea = used = 0
    for piece in demultiplex(io.BytesIO(head), HostTimestamps(zone_is_utc=True)):
        ubx, nmea = ubx + piece.ubx.starts.size, nmea + piece.nmea.starts.size
        used += int(piece.ubx.used.sum() + piece.nmea.used.sum())
    return Beginning(ubx, nmea, used / max(len(head), 1))
