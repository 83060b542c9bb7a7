"""Detectors that look at nothing but the clock, and the receiver's own word.

The former decide at every epoch of the primary receiver.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from spoofbench.arrays import Floats, Ints, Times
from spoofbench.detector import Decisions
from spoofbench.gnss_time import SECOND_NS
from spoofbench.recording import Recording
from spoofbench.schema.v1 import gnss_pb2

ALERT = 2.0
_SCORES = {
    gnss_pb2.SPOOFING_STATE_NONE: 0.0,
    gnss_pb2.SPOOFING_STATE_INDICATED: 2.0,
    gnss_pb2.SPOOFING_STATE_CONFIRMED: 3.0,
}


@dataclass(frozen=True)
class Never:
    """Never alerts."""

    requires: ClassVar[tuple[str, ...]] = ("gnss/pvt",)
    uses: ClassVar[tuple[str, ...]] = ()
    baseline: ClassVar[bool] = True
    memory_s: ClassVar[float] = 0.0

    def detect(self, recording: Recording) -> Decisions:
        """Score 0 at every epoch."""
        time_ns = _epochs(recording)
        return Decisions(time_ns, np.zeros(time_ns.size), np.ones(time_ns.size, bool))


@dataclass(frozen=True)
class Always:
    """Always alerts, whatever its scores are scaled by."""

    requires: ClassVar[tuple[str, ...]] = ("gnss/pvt",)
    uses: ClassVar[tuple[str, ...]] = ()
    baseline: ClassVar[bool] = True
    memory_s: ClassVar[float] = 0.0

    def detect(self, recording: Recording) -> Decisions:
        """Score +inf at every epoch."""
        time_ns = _epochs(recording)
        return Decisions(time_ns, np.full(time_ns.size, np.inf), np.ones(time_ns.size, bool))


@dataclass(frozen=True)
class _Alarms:
    """Base of detectors whose alarms have one length and a mean rate.

    Attributes:
        rate_per_hour: mean number of alarms per hour.
        alert_s: how long each lasts; up to 60 s it counts as one false alarm.
    """

    requires: ClassVar[tuple[str, ...]] = ("gnss/pvt",)
    uses: ClassVar[tuple[str, ...]] = ()
    baseline: ClassVar[bool] = True

    rate_per_hour: float = 1.0
    alert_s: float = 30.0

    def __post_init__(self) -> None:
        if not self.alert_s >= 1:
            raise ValueError(f"alert_s must be at least 1, not {self.alert_s!r}")
        if not 0 < self.rate_per_hour * self.alert_s < 3600:
            raise ValueError(
                "rate_per_hour must be positive and below 3600 / alert_s, not "
                f"{self.rate_per_hour!r}"
            )

    @property
    def memory_s(self) -> float:
        """The length of an alarm."""
        return self.alert_s


@dataclass(frozen=True)
class Periodic(_Alarms):
    """Alarms at equal intervals; the first comes to its end one period after the first epoch."""

    def detect(self, recording: Recording) -> Decisions:
        """Score 2 in an alarm, else 0."""
        time_ns = _epochs(recording)
        period_s = 3600 / self.rate_per_hour
        phase_s = (time_ns - time_ns[:1]) / 1e9 % period_s
        return Decisions(
            time_ns,
            np.where(phase_s >= period_s - self.alert_s, ALERT, 0.0),
            np.ones(time_ns.size, bool),
        )


@dataclass(frozen=True)
class Random(_Alarms):
    """Alarms whose starts are a Poisson process; those that overlap run together.

    Chance is drawn once per second of the recording's clock, as a stable hash of that second and
    the seed: the past does not depend on the future, and a recording and its variants get the same
    alarms. The score is the rate over the lowest rate at which there would be an alarm: scaling it
    by k is the same as a rate k times as high.

    Attributes:
        seed: another seed gives other alarms.
    """

    seed: int = 0

    def detect(self, recording: Recording) -> Decisions:
        """Score by the start within the last ``alert_s`` that the lowest rate would have had."""
        return _poisson(recording, np.arange(round(self.alert_s)), self.rate_per_hour, self.seed)


@dataclass(frozen=True)
class Bursts:
    """Bursts of short alarms, whose starts are a Poisson process.

    Alarms less than 10 s apart are one episode, so a burst of up to 60 s counts as one false alert;
    but each alarm is a fresh chance to begin within an attack. A detector that does not beat this
    row owes its detections to the way in which false alerts are counted. Chance is drawn as for
    :class:`Random`, and scaling the score by k is here, too, the same as a rate k times as high.

    Attributes:
        rate_per_hour: mean number of bursts per hour.
        burst_s: from the start of a burst to its end.
        every_s: from the start of an alarm to that of the next in a burst.
        alert_s: how long an alarm lasts.
        seed: another seed gives other bursts.
    """

    requires: ClassVar[tuple[str, ...]] = ("gnss/pvt",)
    uses: ClassVar[tuple[str, ...]] = ()
    baseline: ClassVar[bool] = True

    rate_per_hour: float = 1.0
    burst_s: float = 60.0
    every_s: float = 6.0
    alert_s: float = 1.0
    seed: int = 0

    def __post_init__(self) -> None:
        if not 1 <= self.alert_s < self.every_s <= self.burst_s:
            raise ValueError(
                "alert_s must be at least 1, and below every_s, which must be at most burst_s, not "
                f"{self.alert_s!r}, {self.every_s!r}, {self.burst_s!r}"
            )
        if not 0 < self.rate_per_hour * self.burst_s < 3600:
            raise ValueError(
                "rate_per_hour must be positive and below 3600 / burst_s, not "
                f"{self.rate_per_hour!r}"
            )

    @property
    def memory_s(self) -> float:
        """The length of a burst."""
        return self.burst_s

    def detect(self, recording: Recording) -> Decisions:
        """Score by the burst that the lowest rate would have had, and that has an alarm now."""
        offsets = np.arange(round(self.burst_s))
        alarms = offsets[offsets % round(self.every_s) < round(self.alert_s)]
        return _poisson(recording, alarms, self.rate_per_hour, self.seed)


@dataclass(frozen=True)
class ReceiverFlag:
    """Alerts where the receiver indicates or confirms spoofing; where it says nothing, unavailable.

    Decisions stand at the rows of the primary ``gnss/integrity``. How long receivers hold their
    flags is not known.
    """

    requires: ClassVar[tuple[str, ...]] = ("gnss/integrity",)
    uses: ClassVar[tuple[str, ...]] = ()
    baseline: ClassVar[bool] = True
    memory_s: ClassVar[float] = 0.0

    def detect(self, recording: Recording) -> Decisions:
        """Score 0 for none, 2 for indicated, 3 for confirmed; of several rows at one time the last
        counts.
        """
        table = recording.primary("gnss/integrity").last_per_time()
        states = table["spoofing"]  # 0, unknown, where it is absent
        score = np.full(states.size, np.nan)
        for state, value in _SCORES.items():
            score[states == state] = value
        return Decisions(table.time_ns, score, ~np.isnan(score))


def _epochs(recording: Recording) -> Times:
    """Return the distinct times of the primary receiver's epochs, ``(n,)``."""
    return np.unique(recording.primary("gnss/pvt").time_ns)


def _poisson(recording: Recording, alarm_s: Ints, rate_per_hour: float, seed: int) -> Decisions:
    """Return the decisions of a Poisson process of starts, each with an alarm in those whole
    seconds after it: the rate over the lowest one at which there would be an alarm.
    """
    time_ns = _epochs(recording)
    slots = (time_ns // SECOND_NS)[:, None] - alarm_s
    expected = rate_per_hour * SECOND_NS / 3.6e12
    score = expected / _waiting(slots, seed).min(axis=1, initial=np.inf)
    return Decisions(time_ns, score, np.ones(time_ns.size, bool))


def _waiting(slots: Ints, seed: int) -> Floats:
    """Return exponential variates of mean 1, of the shape of the slots: a Poisson process of rate r
    per slot has a start where r exceeds them.
    """
    key = _mixed(np.array(seed & 0xFFFF_FFFF_FFFF_FFFF, np.uint64))
    uniform = ((_mixed(slots.astype(np.uint64) ^ key) >> np.uint64(12)) + 0.5) / 2.0**52
    return np.asarray(-np.log1p(-uniform))


def _mixed(bits: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return one output of the generator splitmix64 (Steele, Lea, Flood 2014) per state, of its
    shape: the same on every machine.
    """
    with np.errstate(over="ignore"):
        bits = bits + np.uint64(0x9E3779B97F4A7C15)
        bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        return bits ^ (bits >> np.uint64(31))
