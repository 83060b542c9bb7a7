"""What must be said of a row beside its figures: a letter in the terminal, words elsewhere."""

import json
from collections.abc import Iterator
from dataclasses import dataclass

from spoofbench.scoring.leaderboard import BoardTable, LeaderboardRow
from spoofbench.suite import SUITES_TARGET

MEANINGS = {
    "B": "baseline that others must beat; it has no rank.",
    "*": "exceeds the target, even at the lower end of its interval, and stands below the rest.",
    "?": "no interval holds for its false alerts: it keeps the target if sessions are alike.",
    "=": "its detections cannot be told apart from those of the row ranked first.",
    "<": "not better than the best baseline.",
    "a": "stands apart without a rank.",
    "r": "threshold raised only: too little clean material to resolve the target.",
    "n": "threshold as published: no clean score above 0 to calibrate on.",
    "u": "has no calibrated threshold: the figures are those at the published one.",
    "e": "too few episodes for the interval to say much.",
    "f": "fitted by the run on what calibrates, never on what is judged.",
    "l": "fitted, and learned from attacks.",
    "p": "has parameters from a publication.",
    "d": "has parameters from a data sheet.",
    "h": "has parameters set by hand.",
    "s": "has parameters measured on a session that is not judged.",
    "!": "tasks failed or could not run: these attacks are missed.",
}
"""Of each letter, in the order in which they stand."""

_SOURCES = {"published": "p", "data sheet": "d", "by hand": "h"}
"""The letter of each source of parameters; any other is a session."""


@dataclass(frozen=True, slots=True)
class Mark:
    """One thing to be said of a row.

    Attributes:
        letter: a key of :data:`MEANINGS`.
        words: the same in full; "" where a column of Markdown and page says it.
    """

    letter: str
    words: str


def marks(table: BoardTable, row: LeaderboardRow) -> list[Mark]:
    """Return the marks of a row of a table, in the order of :data:`MEANINGS`."""
    order = list(MEANINGS)
    return sorted(_marks(table, row), key=lambda mark: order.index(mark.letter))


def _marks(table: BoardTable, row: LeaderboardRow) -> Iterator[Mark]:
    if row.baseline:
        yield Mark("B", "baseline")
    if row.exceeds_target:
        yield Mark("*", "exceeds the target")
    if row.rank is not None and row.shown.far_per_hour_lo is None:
        yield Mark("?", "no interval of its false alerts")
    if row.told_apart is False:
        needed = row.sessions_needed
        more = "" if needed is None else f" (about {needed:,} sessions could)"
        yield Mark("=", f"not told apart from the first{more}")
    if row.not_better_than is not None:
        yield Mark("<", f"not better than {row.not_better_than}")
    if row.apart:
        yield Mark("a", f"apart: {row.apart}")
    if row.ranked is None and table.point == "calibrated":
        yield Mark("u", "no calibrated threshold: figures at the published one")
    elif row.threshold in ("raised only", "no clean score"):
        yield Mark(row.threshold[0], "")
    if row.shown.has_few_episodes:
        yield Mark("e", "")
    if row.learns_from_attacks:
        yield Mark("l", "fitted, learned from attacks")
    elif row.is_fitted:
        yield Mark("f", "fitted")
    by_source: dict[str, list[str]] = {}
    for name, source in json.loads(row.parameter_sources).items():
        by_source.setdefault(source, []).append(name)
    by_source.pop(SUITES_TARGET, None)  # the board says what the target is
    for source, names in by_source.items():
        yield Mark(_SOURCES.get(source, "s"), f"{source}: {', '.join(names)}")
    missing = row.failed + row.skipped + row.not_modelled
    if missing:
        reason = f", such as: {row.reasons[0]}" if row.reasons else ""
        total = row.ok + missing
        yield Mark("!", f"{missing:,} of {total:,} tasks failed or could not run{reason}")
