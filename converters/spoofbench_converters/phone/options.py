"""What a user may choose."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Options:
    """Options of the converter.

    Attributes:
        date: date or date and time (ISO 8601, UTC where no zone is given) at which a log without
            absolute time began.
        source: the one location provider to convert, where a log has several: ``GPS``, ``FLP`` or
            ``NLP``.
        append_clock: where the clock of a GnssLogger log jumps back, go on a median interval after
            the last row, instead of rejecting the rows that are behind.
        session: the recording's session id, instead of one from the log's digest.
    """

    date: str | None = None
    source: str | None = None
    append_clock: bool = False
    session: str | None = None
