"""What a detector decided on a variant, held against its truth."""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from spoofbench.arrays import Bools, Floats
from spoofbench.detector import Decisions
from spoofbench.recording import Interval
from spoofbench.results import Truth
from spoofbench.scoring.calibration import EpisodeCurve, detection_times_s, episode_curve
from spoofbench.scoring.grid import release_guard, score_on_grid, within
from spoofbench.scoring.metrics import Event, alarm_level, find_events, share


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

    def detection_times_s(self, interval: Interval, factors: Floats) -> Floats:
        """Return the time to first detection at each factor, ``(g,)``, NaN where missed."""
        decisions = self.decisions
        return detection_times_s(decisions.time_ns, decisions.score, interval, factors)

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


@dataclass(frozen=True, slots=True, eq=False)
class Twin:
    """What a detector decided on the unattacked recording of its variants: the placebo.

    The attacks of a suite lie in the same windows, so that each answer is found once.
    """

    trace: Trace
    _found: dict[Hashable, Any] = field(default_factory=dict)

    def events(self, intervals: tuple[Interval, ...], factor: float) -> list[Event]:
        """Return what became of each interval at a factor, though there was no attack."""
        found: list[Event] = self._once(
            ("events", intervals, factor), lambda: self.trace.at(factor).events(intervals)
        )
        return found

    def alerted_share(self, intervals: tuple[Interval, ...], factor: float) -> float | None:
        """Return the alerted share of the epochs within the intervals, 0 to 1."""

        def find() -> float | None:
            inside = within(self.trace.truth.time_ns, intervals)
            return share(self.trace.at(factor).alert, inside)

        found: float | None = self._once(("share", intervals, factor), find)
        return found

    def detection_times_s(self, interval: Interval, factors: Floats) -> Floats:
        """Return the time to first alert in the interval at each factor, ``(g,)``."""
        found: Floats = self._once(
            ("times", interval, factors.tobytes()),
            lambda: self.trace.detection_times_s(interval, factors),
        )
        return found

    @property
    def clean_score(self) -> Floats:
        """The scores of the epochs that are known to be clean, increasing, shape ``(k,)``."""
        found: Floats = self._once("clean", lambda: np.sort(self.trace.score[self.trace.clean(0)]))
        return found

    def _once(self, key: Hashable, find: Callable[[], Any]) -> Any:
        if key not in self._found:
            self._found[key] = find()
        return self._found[key]
