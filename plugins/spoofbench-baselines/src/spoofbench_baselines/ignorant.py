"""Detectors that look at nothing but the clock. They decide at every epoch of the primary
receiver.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from spoofbench.detector import Decisions
from spoofbench.recording import Recording

SLOT_NS = (
    1_000_000_000  # chance is drawn once per second of the clock, whatever the receiver's rate
)
ALERT = 2.0


@dataclass(frozen=True)
class Never:
    """Never alerts."""

    requires: ClassVar[tuple[str, ...]] = ("gnss/pvt",)
    uses: ClassVar[tuple[str, ...]] = ()
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
    memory_s: ClassVar[float] = 0.0

    def detect(self, recording: Recording) -> Decisions:
        """Score +inf at every epoch."""
        time_ns = _epochs(recording)
        return Decisions(time_ns, np.full(time_ns.size, np.inf), np.ones(time_ns.size, bool))


@dataclass(frozen=True)
class _Alarms:
    """Alarms of one length at a mean rate.

    Attributes:
        rate_per_hour: mean number of alarms per hour.
        alert_s: how long each lasts; up to 60 s it counts as one false alarm.
    """

    requires: ClassVar[tuple[str, ...]] = ("gnss/pvt",)
    uses: ClassVar[tuple[str, ...]] = ()

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

    Chance is a stable hash of the seed and the second of the recording's clock, so the past does
    not depend on the future, and a recording and its variants get the same alarms. The score is the
    rate over the least rate at which there would be an alarm: scaling it by k is the same as a rate
    k times as high.

    Attributes:
        seed: another seed gives other alarms.
    """

    seed: int = 0

    def detect(self, recording: Recording) -> Decisions:
        """Score of the most eager start within the last ``alert_s``."""
        time_ns = _epochs(recording)
        slots = (time_ns // SLOT_NS)[:, None] - np.arange(round(self.alert_s))
        expected = self.rate_per_hour * SLOT_NS / 3.6e12
        score = expected / _waiting(slots, self.seed).min(axis=1, initial=np.inf)
        return Decisions(time_ns, score, np.ones(time_ns.size, bool))


def _epochs(recording: Recording) -> NDArray[np.int64]:
    """Distinct times of the primary receiver's epochs, shape ``(n,)``."""
    return np.unique(recording.primary("gnss/pvt").time_ns)


def _waiting(slots: NDArray[np.int64], seed: int) -> NDArray[np.float64]:
    """Exponential variates of mean 1, one per slot: a process of rate r per slot starts there where
    r exceeds it.
    """
    key = _mixed(np.array(seed & 0xFFFF_FFFF_FFFF_FFFF, np.uint64))
    uniform = ((_mixed(slots.astype(np.uint64) ^ key) >> np.uint64(12)) + 0.5) / 2.0**52
    return np.asarray(-np.log1p(-uniform))


def _mixed(bits: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """One output of the generator splitmix64 (Steele, Lea, Flood 2014) per state: the same on every
    machine.
    """
    with np.errstate(over="ignore"):
        bits = bits + np.uint64(0x9E3779B97F4A7C15)
        bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        return bits ^ (bits >> np.uint64(31))
