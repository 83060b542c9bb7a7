"""Options of the converters of byte streams."""

from dataclasses import dataclass
from datetime import date

from spoofbench_converters.serial.frames import Checksum


@dataclass(frozen=True, kw_only=True)
class StreamOptions:
    """How a byte stream is converted.

    Attributes:
        date: reference date, YYYY-MM-DD: that of the first time of day or week which nothing else
            in the log dates.
        date_backward: carry dates backward too, from the first complete time to those before it.
        week_rollover: periods of 1024 weeks to add to complete times, for receivers that lost some.
        gap_s: a claimed time that goes forward by this or more is a step of the clock, which the
            time axis does not follow.
        append_clock: where a recorder's clock jumps back, go on at the nominal interval instead of
            rejecting rows.
        checksum: whether sentences need theirs.
        zone_is_utc: times of the recorder without a zone are UTC; else they are not used.
        session: what recordings of one session share.
    """

    date: str | None = None
    date_backward: bool = False
    week_rollover: int = 0
    gap_s: float = 3600.0
    append_clock: bool = False
    checksum: Checksum = "required"
    zone_is_utc: bool = False
    session: str | None = None

    def __post_init__(self) -> None:
        if self.date is not None:
            _ = date.fromisoformat(self.date)
        if not 0 < self.gap_s <= 86_400:
            raise ValueError(f"gap_s must be above 0 and at most 86400, not {self.gap_s!r}")
        if not -8 <= self.week_rollover <= 8:
            raise ValueError(
                "week_rollover must be a number of 1024-week periods from -8 to 8, not "
                f"{self.week_rollover!r}"
            )

    def date_ns(self) -> int | None:
        """Start of the reference date, Unix UTC in ns."""
        return (
            None
            if self.date is None
            else (date.fromisoformat(self.date) - date(1970, 1, 1)).days * 86_400_000_000_000
        )
