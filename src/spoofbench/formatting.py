"""Numbers, times and foreign text as people read them: the same in the terminal, in Markdown and on
the page. Unknown is a dash, never 0.
"""

from datetime import UTC, datetime, timedelta

NONE = "-"


def rate(value: float | None) -> str:
    """Return a rate or its bound with about three figures: ``0``, ``0.07``, ``6.91``, ``41.2``,
    ``1,204``.
    """
    if value is None:
        return NONE
    if value == 0:
        return "0"
    if 0 < value < 0.005:
        return "<0.01"
    places = 0 if value >= 99.95 else 1 if value >= 9.995 else 2
    return f"{value:,.{places}f}"


def percent(value: float | None) -> str:
    """Return a percentage with one decimal; what is not quite 0 or 100 is not written as 0.0 or
    100.0.
    """
    if value is None:
        return NONE
    if 0 < value < 0.05:
        return "<0.1"
    if 99.95 <= value < 100:
        return ">99.9"
    return f"{value:.1f}"


def share_percent(value: float | None) -> str:
    """Return a share of 1 as a percentage."""
    return percent(None if value is None else 100 * value)


def seconds(value: float | None) -> str:
    """Return a duration in seconds: one decimal below 100 s, none above."""
    if value is None:
        return NONE
    return f"{value:.1f}" if value < 99.95 else f"{value:,.0f}"


def hours_minutes_seconds(duration_s: float) -> str:
    """Return ``3 min 07 s``, ``1 h 02 min 03 s``."""
    minutes, whole_s = divmod(round(duration_s), 60)
    hours, minutes = divmod(minutes, 60)
    return (
        f"{hours} h {minutes:02d} min {whole_s:02d} s"
        if hours
        else f"{minutes} min {whole_s:02d} s"
    )


def date_time(time_ns: int) -> str:
    """Return a time in nanoseconds since 1970 as ``2026-03-08 12:59:30``, fractions cut off."""
    moment = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=time_ns // 1000)
    return f"{moment:%Y-%m-%d %H:%M:%S}"


def byte_size(size: float) -> str:
    """Return a number of bytes with three figures: ``17 bytes``, ``4.2 kB``, ``1.35 GB``."""
    for unit in ("bytes", "kB", "MB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:,.3g} GB"


def between(low: str, high: str) -> str:
    """Return an interval, a dash where a bound is unknown."""
    return NONE if NONE in (low, high) else f"{low} to {high}"


def counted(n: int, noun: str) -> str:
    """Return ``1 recording``, ``2 recordings``."""
    return f"{n:,} {noun}" + ("" if n == 1 else "s")


def printable(text: str) -> str:
    """Return text without control characters, which a terminal would obey."""
    return "".join(
        letter
        if letter.isprintable() or letter == "\N{NO-BREAK SPACE}"
        else "\N{REPLACEMENT CHARACTER}"
        for letter in text
    )
