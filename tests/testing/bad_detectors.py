"""One honest detector and others that each break one law."""

import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from spoofbench.detector import Decisions, Labelled
from spoofbench.errors import NotApplicable
from spoofbench.recording import Recording


def speeds(recording: Recording) -> tuple[Any, Any]:
    """Times without repetition and the horizontal speed there."""
    table = recording.primary("gnss/pvt")
    time_ns, rows = np.unique(table.time_ns, return_index=True)
    return time_ns, np.hypot(table["vel_n_mps"], table["vel_e_mps"])[rows]


def decisions(time_ns: Any, score: Any) -> Decisions:
    return Decisions(time_ns, score, ~np.isnan(score))


@dataclass(frozen=True)
class Honest:
    """Alerts above a speed."""

    limit_mps: float = 12.0
    requires: ClassVar[tuple[str, ...]] = ("gnss/pvt",)
    uses: ClassVar[tuple[str, ...]] = ("imu",)
    memory_s: ClassVar[float] = 0.0

    def detect(self, recording: Recording) -> Decisions:
        time_ns, speed = speeds(recording)
        return decisions(time_ns, speed / self.limit_mps)


@dataclass(frozen=True)
class DecidesLate(Honest):
    """Needs two minutes, and does not declare them."""

    def detect(self, recording: Recording) -> Decisions:
        time_ns, speed = speeds(recording)
        return Decisions(time_ns, speed, time_ns >= time_ns[:1] + 120 * 10**9)


@dataclass(frozen=True)
class LooksOneEpochAhead(Honest):
    def detect(self, recording: Recording) -> Decisions:
        time_ns, speed = speeds(recording)
        ahead = np.append(speed[1:], speed[-1:])
        return decisions(time_ns, ahead / self.limit_mps)


@dataclass(frozen=True)
class LooksOneSampleAhead(Honest):
    """Interpolates the IMU at the epoch, which needs the sample after it."""

    def detect(self, recording: Recording) -> Decisions:
        time_ns, _ = speeds(recording)
        imu = recording.primary("imu")
        if not len(imu):
            return decisions(time_ns, np.full(time_ns.size, np.nan))
        return decisions(time_ns, np.interp(time_ns, imu.time_ns, imu["accel_x_mps2"]))


@dataclass(frozen=True)
class DividesByTheWholeFilesMaximum(Honest):
    def detect(self, recording: Recording) -> Decisions:
        time_ns, speed = speeds(recording)
        return decisions(time_ns, speed / np.nanmax(speed, initial=1.0))


@dataclass(frozen=True)
class ChoosesFieldsByTheWholeFile(Honest):
    """Takes the speed where any row has one, another statistic where none has."""

    def detect(self, recording: Recording) -> Decisions:
        time_ns, speed = speeds(recording)
        return decisions(
            time_ns,
            speed / 12
            if recording.primary("gnss/pvt").has("vel_n_mps")
            else np.zeros(time_ns.size),
        )


@dataclass(frozen=True)
class RemembersInItself(Honest):
    seen: list[int] = field(default_factory=list)

    def detect(self, recording: Recording) -> Decisions:
        time_ns, speed = speeds(recording)
        self.seen.append(time_ns.size)
        return decisions(time_ns, speed / 12 + len(self.seen))


@dataclass(frozen=True)
class RemembersInItsClass(Honest):
    """The first recording's mean serves for all that follow."""

    memory: ClassVar[list[float]] = []

    def detect(self, recording: Recording) -> Decisions:
        time_ns, speed = speeds(recording)
        if not self.memory:
            self.memory.append(float(np.nanmean(speed)))
        return decisions(time_ns, speed / self.memory[0])


@dataclass(frozen=True)
class AltersTheRecording(Honest):
    def detect(self, recording: Recording) -> Decisions:
        time_ns, speed = speeds(recording)
        recording.primary("gnss/pvt").time_ns = time_ns + 1
        return decisions(time_ns, speed / 12)


@dataclass(frozen=True)
class WritesIntoColumns(Honest):
    def detect(self, recording: Recording) -> Decisions:
        time_ns, speed = speeds(recording)
        recording.primary("gnss/pvt")["vel_n_mps"][:] = 0
        return decisions(time_ns, speed / 12)


@dataclass(frozen=True)
class DrawsFromTheGlobalGenerator(Honest):
    def detect(self, recording: Recording) -> Decisions:
        time_ns, speed = speeds(recording)
        return decisions(time_ns, speed / 12 + np.random.random())  # noqa: NPY002


@dataclass(frozen=True)
class SeedsTheGlobalGenerator(Honest):
    def detect(self, recording: Recording) -> Decisions:
        time_ns, speed = speeds(recording)
        np.random.seed(7)  # noqa: NPY002
        return decisions(time_ns, speed / 12 + np.random.random())  # noqa: NPY002


@dataclass(frozen=True)
class DependsOnHashes(Honest):
    def detect(self, recording: Recording) -> Decisions:
        time_ns, speed = speeds(recording)
        return decisions(time_ns, speed / 12 + hash("a word") % 1000)


@dataclass(frozen=True)
class PeeksAtItsCallers(Honest):
    """Finds the truth in the variables of whoever called."""

    def detect(self, recording: Recording) -> Decisions:
        time_ns, speed = speeds(recording)
        frame: Any = sys._getframe()
        while frame:
            for value in frame.f_locals.values():
                if isinstance(value, Recording) and "/truth/attack" in value:
                    start = value["/truth/attack"]["start_ns"][0]
                    return decisions(time_ns, np.where(time_ns >= start, 2.0, 0.0))
            frame = frame.f_back
        return decisions(time_ns, speed / 12)


@dataclass(frozen=True)
class ReadsAFile(Honest):
    def detect(self, recording: Recording) -> Decisions:
        time_ns, speed = speeds(recording)
        with suppress(OSError):
            Path("/etc/hostname").read_bytes()
        return decisions(time_ns, speed / 12)


ATTACKED = {"from_ns": 0}


@dataclass(frozen=True)
class ReadsAGlobal(Honest):
    """Something else in the process has left the truth for it."""

    def detect(self, recording: Recording) -> Decisions:
        time_ns, speed = speeds(recording)
        return decisions(time_ns, speed / 12 + (time_ns > ATTACKED["from_ns"]))


@dataclass(frozen=True)
class StumblesOverRepeatedTimes(Honest):
    def detect(self, recording: Recording) -> Decisions:
        table = recording.primary("gnss/pvt")
        return decisions(table.time_ns, table["vel_n_mps"])


@dataclass(frozen=True)
class StumblesOverEmptiness(Honest):
    def detect(self, recording: Recording) -> Decisions:
        time_ns, speed = speeds(recording)
        return decisions(time_ns, speed / 12 + 0 * speed[0])


@dataclass(frozen=True)
class NeedsWhatItOnlyUses(Honest):
    def detect(self, recording: Recording) -> Decisions:
        recording.primary("imu")
        return super().detect(recording)


@dataclass(frozen=True)
class FailsWithoutItsKinds(Honest):
    def detect(self, recording: Recording) -> Decisions:
        recording["/gnss0/gnss/pvt"]
        return super().detect(recording)


@dataclass(frozen=True)
class NeverKnows(Honest):
    def detect(self, recording: Recording) -> Decisions:
        time_ns, _ = speeds(recording)
        return Decisions(time_ns, np.zeros(time_ns.size), np.zeros(time_ns.size, bool))


@dataclass(frozen=True)
class ScoresMinusInfinity(Honest):
    def detect(self, recording: Recording) -> Decisions:
        time_ns, speed = speeds(recording)
        return decisions(time_ns, np.where(speed < 1, -np.inf, speed))


@dataclass
class IsNotFrozen:
    requires: tuple[str, ...] = ("gnss/pvt",)
    uses: tuple[str, ...] = ()
    memory_s: float = 0.0

    def detect(self, recording: Recording) -> Decisions:
        return decisions(*speeds(recording))


@dataclass(frozen=True, init=False)
class TakesAnyParameter(Honest):
    def __init__(self, **parameters: Any) -> None:
        object.__setattr__(self, "limit_mps", parameters.get("limit_mps", 12.0))


@dataclass(frozen=True)
class RequiresAnUnknownKind(Honest):
    uses: ClassVar[tuple[str, ...]] = ("radar",)


@dataclass(frozen=True)
class HasEndlessMemory(Honest):
    memory_s: ClassVar[float] = float("inf")


@dataclass(frozen=True)
class CannotBePickled(Honest):
    rule: Any = field(default_factory=lambda: lambda: 0)


@dataclass(frozen=True)
class HonestLearner(Honest):
    """Alerts above the largest speed of clean recordings."""

    def fit(self, clean: Sequence[Recording], attacked: Sequence[Labelled]) -> Self:
        return replace(self, limit_mps=max(float(np.nanmax(speeds(one)[1])) for one in clean))


@dataclass(frozen=True)
class RefusesToLearn(Honest):
    def fit(self, clean: Sequence[Recording], attacked: Sequence[Labelled]) -> Self:
        raise NotApplicable("there is nothing to learn")


@dataclass(frozen=True)
class LearnsInPlace(HonestLearner):
    def fit(self, clean: Sequence[Recording], attacked: Sequence[Labelled]) -> Self:
        object.__setattr__(self, "limit_mps", super().fit(clean, attacked).limit_mps)
        return self


@dataclass(frozen=True)
class BecomesAnother(Honest):
    def fit(self, clean: Sequence[Recording], attacked: Sequence[Labelled]) -> Any:
        return HonestLearner()


@dataclass(frozen=True)
class LearnsByChance(HonestLearner):
    def fit(self, clean: Sequence[Recording], attacked: Sequence[Labelled]) -> Self:
        return replace(self, limit_mps=np.random.default_rng().uniform(5, 20))


@dataclass(frozen=True)
class LearnsInSecretFromAttacks(HonestLearner):
    def fit(self, clean: Sequence[Recording], attacked: Sequence[Labelled]) -> Self:
        return super().fit([*clean, *(one.recording for one in attacked)], []) if attacked else self


@dataclass(frozen=True)
class LooksAheadOnceFitted(HonestLearner):
    fitted: bool = False

    def fit(self, clean: Sequence[Recording], attacked: Sequence[Labelled]) -> Self:
        return replace(self, fitted=True)

    def detect(self, recording: Recording) -> Decisions:
        return LooksOneEpochAhead().detect(recording) if self.fitted else super().detect(recording)
