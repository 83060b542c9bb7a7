"""What is said around the tables of a leaderboard, the same in terminal, Markdown and page."""

from collections.abc import Iterator

from spoofbench.formatting import NONE, counted, rate
from spoofbench.report.columns import detected, of
from spoofbench.scoring.figures import Figures
from spoofbench.scoring.leaderboard import (
    BoardTable,
    Leaderboard,
    LeaderboardCell,
    SeverityRow,
    TransferRow,
)

PROVENANCES = {
    "real attack": "Real attacks",
    "injected": "Attacks injected into real recordings",
    "simulated": "Simulated attacks",
}

NO_TABLES = "Nothing could be judged: no recording and attack of the suite could be made."

TRANSFER = "Thresholds carried to another sensor class"
TRANSFER_HEAD = ("Detector", "Fitted on", "Judged on", "Factor", "False alerts", "Detected")
TRANSFER_NOTE = (
    "Each threshold is calibrated on one class and judged, unchanged, on another; the factor is on "
    "the published threshold."
)

SEVERITY = "Detectable strength"
SEVERITY_HEAD = ("Detector", "Attack", "Half", "90 %", "Windows", "Sessions")
SEVERITY_NOTE = (
    "The strength from which half and 90 % of the windows are detected, in the unit of the "
    "attack's parameter, by an isotonic fit. > where the strongest does not reach the share, <= "
    "where the weakest already does; 90 % needs 20 windows and 5 sessions at each strength."
)


def heading(table: BoardTable) -> str:
    """Return provenance and input class."""
    return f"{PROVENANCES[table.provenance]}, detectors of {table.input_class}"


def evidence(board: Leaderboard, table: BoardTable) -> str:
    """Return what the figures of a table rest on, and where its thresholds come from."""
    if not table.windows:
        attacks = "No attack"
    else:
        attacks = (
            f"{counted(table.windows, 'attack')} in "
            f"{counted(table.disjoint_windows, 'disjoint window')} of "
            f"{counted(table.recordings, 'recording')} of {counted(table.sessions, 'session')}"
        )
    clean = (
        f"{rate(table.clean_h)} clean h of {counted(table.clean_sessions, 'session')}"
        if table.clean_h
        else "no clean hours"
    )
    target = f"{board.target_far_per_hour:g} FA/h"
    point = (
        f"calibrated for {target}"
        if table.point == "calibrated"
        else f"as published, the target is {target}"
    )
    classes = ", ".join(table.sensor_classes)
    return f"{attacks}; {clean}; sensor class {classes}; thresholds {point}."


def notes(table: BoardTable) -> list[str]:
    """Return what the evidence of a table cannot show, a sentence each."""
    more = []
    if table.windows == 1:
        more.append("A single attack: whether and when it is detected is an anecdote, not a rate.")
    if table.provenance == "real attack":
        more.append(
            "A real attack has no unattacked twin, so there is no placebo: hold detections against "
            "those of the baselines that alert by chance."
        )
    return [*table.notes, *more]


def cell_text(table: BoardTable, cell: LeaderboardCell) -> str:
    """Return what a cell of detections by attack shows."""
    return detected_and_placebo(table, cell.figures)


def detected_and_placebo(table: BoardTable, figures: Figures) -> str:
    """Return attacks detected of all, or when the only one is, and in brackets in how many of the
    same windows an alert begins without attack.
    """
    if not figures.attacks:
        return NONE
    chance = of(figures.placebo_detected, figures.placebo_attacks)
    if figures.placebo_attacks == figures.attacks:
        chance = str(figures.placebo_detected)
    return f"{detected(table, figures)} ({chance})"


def transfer_cells(row: TransferRow) -> tuple[str, ...]:
    """Return the row under :data:`TRANSFER_HEAD`."""
    return (
        row.detector,
        row.fitted_on,
        row.judged_on,
        NONE if row.factor is None else f"{row.factor:.3g}",
        f"{row.episodes:,} in {rate(row.clean_h)} h" if row.clean_h else NONE,
        of(row.detected, row.attacks),
    )


def severity_of(board: Leaderboard, table: BoardTable) -> list[tuple[str, ...]]:
    """Return the rows under :data:`SEVERITY_HEAD` of one table."""
    place = table.provenance, table.input_class
    return [
        _severity_cells(row) for row in board.severity if (row.provenance, row.input_class) == place
    ]


def absent(board: Leaderboard) -> list[str]:
    """Return of each detector that is in no table why."""
    return [f"{row.detector} is in no table: {row.reason}." for row in board.absent]


def _severity_cells(row: SeverityRow) -> tuple[str, ...]:
    """Return the row under :data:`SEVERITY_HEAD`."""
    return (
        row.detector,
        row.attack,
        *(_strength(row, share) for share in (0.5, 0.9)),
        str(row.curve.windows),
        str(row.curve.sessions),
    )


_CENSORED = {"above the strongest": "> ", "below the weakest": "<= ", None: ""}


def _strength(row: SeverityRow, share: float) -> str:
    found = row.curve.strength_detected(share)
    return NONE if found is None else f"{_CENSORED[found.censored]}{found.strength:.3g}"


def details(table: BoardTable) -> Iterator[str]:
    """Yield what the marks of a table's rows stand for in that table, where it differs by row."""
    for name in dict.fromkeys(row.not_better_than for row in table.rows):
        if name is not None:
            yield f"<: {name} is as good or better."
    needed = {row.sessions_needed for row in table.rows if row.told_apart is False} - {None}
    if needed:
        numbers = sorted(n for n in needed if n is not None)
        some = f"{numbers[0]:,}" + (f" to {numbers[-1]:,}" if len(numbers) > 1 else "")
        yield f"=: about {some} sessions could tell them apart from the first."
    for row in table.rows:
        if row.apart:
            yield f"a: {row.detector}: {row.apart}."
    for row in table.rows:
        missing = row.failed + row.skipped + row.not_modelled
        if missing:
            reason = f", such as: {row.reasons[0]}" if row.reasons else ""
            yield f"!: {row.detector}: {missing:,} of {row.ok + missing:,} tasks{reason}"
