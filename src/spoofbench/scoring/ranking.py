"""The leaderboard of a results folder: one row per detector configuration, one cell per detector and attack."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Row:
    """One detector configuration over all tasks of a folder; null is None throughout.

    Attributes:
        rank: 1 is best, equal where nothing tells two rows apart; None where no attacked task could be scored.
        detector: name in the suite.
        plugin, plugin_distribution, plugin_version, parameters: what it is; parameters as JSON text.
        baseline: a row of chance, for comparison.
        keeps_target: whether the lower end of the false-alert interval is at most the target; None where the rate is unknown.
        detection_pct: mean over attacked tasks, failures as 0; ``lo`` and ``hi`` by bootstrap over sessions, None below 5.
        restricted_mean_ttfd_s: mean time to first detection, restricted to the folder's longest attack.
        ttfd_median_s, ttfd_p90_s: Kaplan-Meier over attack intervals; None where fewer than that share are ever detected.
        p_md: missed share of attack intervals, with Clopper-Pearson interval; ``detected`` of ``events``.
        far_per_hour: episodes per available clean hour over unattacked tasks pooled by time, with Garwood interval.
        far_floor_per_hour: the lowest rate that so many hours can resolve, 3/T.
        far_epoch, availability: over the same tasks, pooled by epochs.
        position_error_at_detection_m: median over detected attack intervals.
        largest_undetected_position_error_m: over all spoofed epochs without alert.
        partial_auc: mean over attacked tasks of the area under the ROC curve at low P_FA, as a share of the largest possible.
        ok, failed, skipped, not_modelled: numbers of tasks; ``failed`` holds timeouts and memory as well.
    """

    rank: int | None
    detector: str
    plugin: str
    plugin_distribution: str
    plugin_version: str
    parameters: str
    baseline: bool
    keeps_target: bool | None
    detection_pct: float | None
    detection_pct_lo: float | None
    detection_pct_hi: float | None
    restricted_mean_ttfd_s: float | None
    ttfd_median_s: float | None
    ttfd_p90_s: float | None
    p_md: float | None
    p_md_lo: float | None
    p_md_hi: float | None
    detected: int
    events: int
    far_per_hour: float | None
    far_per_hour_lo: float | None
    far_per_hour_hi: float | None
    far_floor_per_hour: float | None
    far_epoch: float | None
    availability: float | None
    position_error_at_detection_m: float | None
    largest_undetected_position_error_m: float | None
    partial_auc: float | None
    ok: int
    failed: int
    skipped: int
    not_modelled: int


@dataclass(frozen=True, slots=True)
class Cell:
    """One detector configuration against one attack; fields as in :class:`Row`."""

    detector: str
    attack: str
    detection_pct: float | None
    p_md: float | None
    p_md_lo: float | None
    p_md_hi: float | None
    ttfd_median_s: float | None
    detected: int
    events: int
    ok: int
    failed: int
    skipped: int
    not_modelled: int


@dataclass(frozen=True, slots=True)
class Leaderboard:
    """What a results folder says.

    Attributes:
        rows: best first.
        cells: by detector in the order of the rows, then attack in the order of the suite.
        attacks: in the order of the suite.
        recordings, sessions: how many there are.
        target_far_per_hour: the false-alert rate that a detector is to keep.
        note: what every table must say about its thresholds; empty where there is nothing to say.
    """

    rows: tuple[Row, ...]
    cells: tuple[Cell, ...]
    attacks: tuple[str, ...]
    recordings: int
    sessions: int
    target_far_per_hour: float
    note: str
