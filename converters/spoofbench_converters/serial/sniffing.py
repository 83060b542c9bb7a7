"""Whether a source is a byte stream of a receiver, by the valid frames that it begins with."""

import io
from dataclasses import dataclass

from spoofbench.conversion import Source
from spoofbench_converters.serial.demux import demultiplex
from spoofbench_converters.serial.stamps import Stamps

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
    for piece in demultiplex(io.BytesIO(head), Stamps(zone_is_utc=True)):
        ubx, nmea = ubx + piece.ubx.starts.size, nmea + piece.nmea.starts.size
        used += int(piece.ubx.used.sum() + piece.nmea.used.sum())
    return Beginning(ubx, nmea, used / max(len(head), 1))
