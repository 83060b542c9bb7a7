"""What a detector decided on a variant, held against its truth."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from spoofbench.arrays import Bools, Floats
from spoofbench.detector import Decisions
from spoofbench.recording import Interval
from spoofbench.results import Truth
from spoofbench.scoring.calibration import EpisodeCurve, episode_curve
from spoofbench.scoring.grid import release_guard, score_on_grid, within
from spoofbench.scoring.metrics import Event, alarm_level, find_events


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """What a detector decided on a variant, at one threshold factor.

    Attributes:
        truth: of the variant.
        decisions: of the detector.
        score: that holds at each epoch, NaN where unavailable, shape ``(n,)``.
        hold_s: how long a decision stands.
        factor: alert where a score exceeds it.
    """

    truth: Truth
    decisions: Decisions
    score: Floats
    hold_s: float
    factor: float = 1.0

    def at(self, factor: float) -> "Trace":
        """Return the same decisions at another factor."""
        return replace(self, factor=factor)

    @property
    def level(self) -> Floats:
        """The factor below which each epoch has a false alert, NaN where unavailable, shape
        ``(n,)``; see :func:`~spoofbench.scoring.metrics.alarm_level`.
        """
        decisions = self.decisions
        return alarm_level(self.truth.time_ns, self.score, decisions.time_ns, decisions.score)

    @property
    def alert(self) -> Bools:
        """Whether it alerts at each epoch, shape ``(n,)``."""
        alert: Bools = self.score > self.factor
        return alert

    @property
    def decided(self) -> Bools:
        """Whether each decision is an alert, shape ``(m,)``."""
        return self.decisions.available & (self.decisions.score > self.factor)

    def clean(self, memory_s: float) -> Bools:
        """Return which epochs are known to be neither spoofed nor within the release guard, shape
        ``(n,)``.
        """
        truth = self.truth
        guard = release_guard(truth.time_ns, truth.intervals, memory_s)
        return truth.reviewed & ~(within(truth.time_ns, truth.intervals) | guard)

    def events(self, intervals: Sequence[Interval]) -> list[Event]:
        """Return what became of each interval."""
        truth = self.truth
        return find_events(
            self.decisions.time_ns,
            self.decided,
            intervals,
            hold_s=self.hold_s,
            end_ns=int(truth.time_ns[-1]) + truth.epoch_ns,
            unreviewed_ns=truth.time_ns[~truth.reviewed],
        )

    def episode_curve(self, epochs: Bools) -> EpisodeCurve:
        """Return how many alarm episodes these epochs have at each factor.

        Args:
            epochs: that count where the detector is available, shape ``(n,)``.
        """
        truth, level = self.truth, self.level
        return episode_curve(truth.time_ns, level, epochs & ~np.isnan(level), truth.epoch_ns)


def trace(decisions: Decisions, truth: Truth, hold_s: float) -> Trace:
    """Hold decisions against the truth of their variant, at their own threshold."""
    return Trace(truth, decisions, score_on_grid(decisions, truth, hold_s), hold_s)
