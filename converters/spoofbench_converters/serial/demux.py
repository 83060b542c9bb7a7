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
    """What a piece of a log holds: frames by protocol, rejects, and the offset in the log up to
    which every byte is accounted for.
    """

    ubx: Frames
    nmea: Frames
    rejects: list[Rejects]
    end: int


@dataclass(frozen=True, slots=True)
class _PieceStart:
    """Whether a piece starts with a line, and whether right after a frame."""

    of_line: bool
    after_frame: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Scan:
    """What a scan takes, in the order of the log.

    Attributes:
        protocols: int8 ``(k,)``.
        starts, ends: int64 ``(k,)``, ``[start, end)`` of each frame.
        first, last: int64 ``(k,)``, ``[first, last)`` of each frame with what stands beside it.
        receive_time_ns: int64 ``(k,)``, ``ABSENT_NS`` where the log does not say.
        damage: where damaged frames start.
    """

    protocols: NDArray[np.int8]
    starts: Ints
    ends: Ints
    first: Ints
    last: Ints
    receive_time_ns: Ints
    damage: gaps.DamageMarks

    def frames(self, protocol: int, octets: Octets, base: int) -> Frames:
        """Return the frames of one protocol."""
        chosen = self.protocols == protocol
        starts, first = self.starts[chosen], self.first[chosen]
        return Frames(
            octets,
            starts,
            self.ends[chosen] - starts,
            base,
            self.last[chosen] - first,
            self.receive_time_ns[chosen],
            leads=starts - first,
        )


def demultiplex(
    stream: IO[bytes],
    timestamps: HostTimestamps,
    checksum: Checksum = "required",
    piece_bytes: int = PIECE_BYTES,
) -> Iterator[Piece]:
    """Yield a log's frames and rejects; what they are does not depend on the size of the pieces
    that are read.
    """
    base, start, held, more = 0, _PieceStart(of_line=True, after_frame=True), b"", True
    while more:
        new = _read(stream, piece_bytes)
        more, held = len(new) == piece_bytes, held + new
        if held and (not more or len(held) > _REACH):
            octets = np.frombuffer(held, np.uint8)
            limit = octets.size - _REACH if more else octets.size
            scan = _scan(octets, limit, checksum, start, timestamps)
            rejects, end = _rejects(octets, base, scan, start, more)
            yield Piece(
                scan.frames(_UBX, octets, base),
                scan.frames(_SENTENCE, octets, base),
                rejects,
                base + end,
            )
            if end:
                start = _PieceStart(
                    bool(octets[end - 1] in (_LF, _CR)), bool(np.any(scan.last == end))
                )
            base, held = base + end, held[end:]


def _read(stream: IO[bytes], size: int) -> bytes:
    """Return the next bytes of a stream, fewer than asked for only at its end."""
    pieces, missing = [], size
    while missing and (piece := stream.read(missing)):
        pieces.append(piece)
        missing -= len(piece)
    return b"".join(pieces)


def _scan(
    octets: Octets, limit: int, checksum: Checksum, start: _PieceStart, timestamps: HostTimestamps
) -> _Scan:
    """Find what starts before a limit, with what stands beside sentences.

    Starts of RTCM 3 messages are frequent within UBX frames. They are looked at there only if one
    of these frames is not taken.
    """
    ubx = framing.ubx(octets).before(limit)
    sentences = framing.sentences(octets, checksum).before(limit)
    whole = ubx.valid()
    whole = whole.take(framing.chosen(whole.starts, whole.ends))
    taken = _taken(ubx, sentences, framing.rtcm3(octets, whole).before(limit))
    if not np.array_equal(taken[1][taken[0] == _UBX], whole.starts):
        taken = _taken(ubx, sentences, framing.rtcm3(octets, None).before(limit))
    protocols, starts, ends = taken
    first, last, times = starts.copy(), ends.copy(), np.full(starts.size, ABSENT_NS)
    rows = np.flatnonzero(protocols == _SENTENCE)
    if rows.size:
        last[rows], times[rows] = _behind(octets, ends[rows], timestamps)
        before = np.append(0, last[:-1])[rows]
        first[rows], leading = _ahead(octets, starts[rows], before, start, timestamps)
        times[rows] = np.where(times[rows] == ABSENT_NS, leading, times[rows])
    return _Scan(protocols, starts, ends, first, last, times, _damage(octets, ubx, sentences))


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


def _behind(octets: Octets, ends: Ints, timestamps: HostTimestamps) -> tuple[Ints, Ints]:
    """Return where the lines of sentences end, with a time that stands there or on the next line,
    and these times.
    """
    last, times = framing.line_ends(octets, ends), np.full(ends.size, ABSENT_NS)
    following = np.minimum(last, octets.size - 1)
    odd = np.flatnonzero((last < octets.size) & ((last == ends) | (octets[following] == _COMMA)))
    if odd.size:
        line_stops = _stops(octets, last[odd])
        understood, found = timestamps.after(octets, last[odd], line_stops)
        understood &= (last[odd] == ends[odd]) | (found != ABSENT_NS)
        last[odd[understood]] = framing.line_ends(octets, line_stops[understood])
        times[odd[understood]] = found[understood]
    return last, times


def _ahead(
    octets: Octets, starts: Ints, before: Ints, start: _PieceStart, timestamps: HostTimestamps
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
        understood, found = timestamps.before(octets, begins, starts[odd])
        understood &= (begins > 0) | start.of_line | start.after_frame
        first[odd[understood]], times[odd[understood]] = begins[understood], found[understood]
    return first, times


def _stops(octets: Octets, offsets: Ints) -> Ints:
    """Return where the line of each offset ends, line end excluded."""
    breaks = np.append(np.flatnonzero((octets == _LF) | (octets == _CR)), octets.size)
    return breaks[np.searchsorted(breaks, offsets)]


def _rejects(
    octets: Octets, base: int, scan: _Scan, start: _PieceStart, more: bool
) -> tuple[list[Rejects], int]:
    """Return the rejects, and up to where they go: one that may go on behind that is left to the
    next piece.
    """
    end = octets.size
    if more:
        end = int(max(end - _REACH - MAX_STAMP, scan.last.max(initial=0)))
    rtcm3 = scan.protocols == _RTCM3
    found = [Rejects(scan.starts[rtcm3] + base, (scan.ends - scan.starts)[rtcm3], RTCM)]
    if not rtcm3.any():
        found = []
    starts, ends = np.append(0, scan.last), np.append(scan.first, end)
    skipped = starts < ends
    if not skipped.any():
        return found, end
    starts, ends, reasons = gaps.divide(
        octets, (starts[skipped], ends[skipped]), scan.damage, start.of_line
    )
    if more and ends[-1] == end:
        end, starts, ends, reasons = int(starts[-1]), starts[:-1], ends[:-1], reasons[:-1]
    return found + gaps.rejects(base, starts, ends, reasons), end


def _damage(octets: Octets, ubx: Candidates, sentences: Candidates) -> gaps.DamageMarks:
    """Return where damage starts; a sentence's only where an address begins, for in binary data
    ``$A`` is frequent.
    """
    damaged = np.flatnonzero(ubx.verdicts != framing.VALID)
    broken = np.flatnonzero(sentences.verdicts != framing.VALID)
    for index in (2, 3, 4):
        octet = octets.take(sentences.starts[broken] + index, mode="clip")
        broken = broken[(octet - np.uint8(ord("A")) < 26) | (octet - np.uint8(ord("0")) < 10)]
    return gaps.DamageMarks(
        np.concatenate([ubx.starts[damaged], sentences.starts[broken]]),
        np.concatenate(
            [_UBX_REASONS[ubx.verdicts[damaged]], _SENTENCE_REASONS[sentences.verdicts[broken]]]
        ),
    )


_UBX_REASONS = np.array([-1, gaps.UBX_WRONG, -1, -1, gaps.UBX_CUT], np.int8)
_SENTENCE_REASONS = np.array([-1, gaps.WRONG, gaps.MISSING, gaps.BROKEN, gaps.BROKEN], np.int8)


LOOKED_AT = 2**20
"""Bytes that are looked at where those of ``Source.head`` hold no frame: behind a long header."""


@dataclass(frozen=True, slots=True)
class Beginning:
    """Valid frames at the beginning of a source, and the share of its bytes that they make up."""

    ubx: int
    nmea: int
    share: float

    def confidence(self) -> float:
        """Return how sure it is that a source with such frames is a stream of them: 0.5 to 0.95,
        for one mostly of other text is for others to claim.
        """
        return 0.5 + 0.45 * self.share


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
