"""What the leaderboard says, in words and figures: shared by terminal, Markdown and page."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from spoofbench.formatting import NONE, between, counted, percent, rate, seconds
from spoofbench.results import Task, has_truth, read_rows, read_tasks, read_truth
from spoofbench.scoring.leaderboard import Cell, Leaderboard, Row, leaderboard
from spoofbench.scoring.score import EVENT_SCHEMA


@dataclass(frozen=True, slots=True)
class Extent:
    """How much a results folder rests on.

    Attributes:
        clean_h: length of the unattacked recordings.
        attacked_variants: how many were made.
        longest_attack_s: of those that each detector faced.
    """

    clean_h: float
    attacked_variants: int
    longest_attack_s: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Board:
    """A leaderboard and what it rests on."""

    ranking: Leaderboard
    extent: Extent
    tasks: tuple[Task, ...]

    def cells(self, detector: str) -> list[Cell | None]:
        """One detector's cells in the order of the attacks, None where there is none."""
        own = {cell.attack: cell for cell in self.ranking.cells if cell.detector == detector}
        return [own.get(attack) for attack in self.ranking.attacks]


def read_board(folder: Path) -> Board:
    """Read a results folder's leaderboard.

    Raises:
        ResultsError: the folder lacks a file or a file is damaged.
    """
    tasks = tuple(read_tasks(folder))
    return Board(leaderboard(folder), _extent(folder, tasks), tasks)


def _extent(folder: Path, tasks: Sequence[Task]) -> Extent:
    variants = {
        task.variant_id: task.attack for task in tasks if has_truth(folder, task.variant_id)
    }
    clean = [read_truth(folder, variant) for variant, attack in variants.items() if attack is None]
    longest_s: dict[str, float] = {}
    for event in read_rows(folder / "events.parquet", EVENT_SCHEMA):
        longest_s[event["detector"]] = max(longest_s.get(event["detector"], 0.0), event["length_s"])
    return Extent(
        clean_h=sum(truth.time_ns.size * truth.epoch_ns for truth in clean) / 3.6e12,
        attacked_variants=len(variants) - len(clean),
        longest_attack_s=longest_s,
    )


def time_to_detection(value_s: float | None, row: Row, extent: Extent) -> str:
    """Return a Kaplan-Meier quantile; where too few attacks are ever detected, that it exceeds the
    longest attack.
    """
    if value_s is None and row.detector in extent.longest_attack_s:
        return f"> {seconds(extent.longest_attack_s[row.detector])}"
    return seconds(value_s)


def far_interval(row: Row) -> str:
    """Return the exact 95 % interval of the false-alert rate."""
    return between(rate(row.far_per_hour_lo), rate(row.far_per_hour_hi))


def detection_interval(row: Row) -> str:
    """Return the 95 % interval of the detection percentage over sessions; a dash below 5
    sessions.
    """
    return between(percent(row.detection_pct_lo), percent(row.detection_pct_hi))


def cell_text(cell: Cell | None) -> str:
    """Return the detection percentage of a cell, a dash where there is nothing to measure."""
    return NONE if cell is None else percent(cell.detection_pct)


def basis(board: Board) -> str:
    """Return what the numbers rest on, one sentence."""
    ranking, extent = board.ranking, board.extent
    detectors, attacks = (
        counted(len(ranking.rows), "detector"),
        counted(len(ranking.attacks), "attack"),
    )
    variants, recordings = (
        counted(extent.attacked_variants, "attacked variant"),
        counted(ranking.recordings, "recording"),
    )
    return (
        f"{detectors}; {attacks}, {variants}; {recordings}, "
        f"{counted(ranking.sessions, 'session')}, {rate(extent.clean_h)} h."
    )


def legend(board: Board) -> list[str]:
    """Return what the leaderboard's numbers are, one entry each."""
    ranking = board.ranking
    clustered = any(row.detection_pct_lo is not None for row in ranking.rows)
    lines = [
        basis(board),
        ranking.note,
        (
            f"Target FA/h: {ranking.target_far_per_hour:g}; * is above it even at the lower end "
            "and ranks below the rest."
        ),
        "FA/h: alarm episodes per available clean hour, exact (Garwood) 95 % interval.",
        "Det %: alerted share of all spoofed epochs; unavailable ones count as missed. "
        + (
            "95 % interval by bootstrap over sessions."
            if clustered
            else "No interval below 5 sessions."
        ),
        "TTFD: time to first detection, s, Kaplan-Meier; > beyond the longest attack.",
        (
            "Avail %: available share of clean epochs. Fail: tasks that crashed or ran over a "
            "limit; they count as misses. - is unknown."
        ),
    ]
    return [line for line in lines if line]


def exceeds_target(row: Row) -> bool:
    """Whether a row's false-alert rate exceeds the target even at the lower end of its interval."""
    return row.keeps_target is False
