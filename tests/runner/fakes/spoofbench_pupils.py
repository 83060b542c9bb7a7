"""Plugins for suites in which recordings say whose they are, and detectors what they were taught.

A recording of these tests says in every row the number of its session, as its height, and what
:class:`~spoofbench_fakes.Steady` is to score, as its velocity. Attacks leave their mark in the
downward velocity.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from spoofbench_fakes import PVT, Nudge, Steady

from spoofbench.detector import Decisions, Labelled
from spoofbench.errors import NotApplicable
from spoofbench.recording import Interval, Recording
from spoofbench.table import Table


def _marks(pvt: Table, name: str) -> list[int]:
    return sorted({int(value) for value in pvt[name].tolist()})


@dataclass(frozen=True)
class Pupil(Steady):
    """Writes down what it was taught on: sessions with their first and last times, as JSON text."""

    scale: float = 1.0
    taught: str = ""

    def fit(self, clean: Sequence[Recording], attacked: Sequence[Labelled]) -> Self:
        lessons = []
        for recording in clean:
            pvt = recording.primary(PVT)
            times = [int(pvt.time_ns[0]), int(pvt.time_ns[-1])]
            lessons.append({"sessions": _marks(pvt, "height_m"), "times": times, "attack": [0]})
        return replace(self, taught=json.dumps(lessons))


@dataclass(frozen=True)
class AttackPupil(Pupil):
    """Learns from attacks, too, and writes down which, and when they were said to be on."""

    learns_from_attacks: ClassVar[bool] = True

    def fit(self, clean: Sequence[Recording], attacked: Sequence[Labelled]) -> Self:
        lessons = json.loads(super().fit(clean, []).taught)
        for one in attacked:
            pvt = one.recording.primary(PVT)
            within = np.zeros(len(pvt), bool)
            for interval in one.attacked:
                within |= interval.covers(pvt.time_ns)
            lessons.append(
                {
                    "sessions": _marks(pvt, "height_m"),
                    "attack": sorted({int(mark) for mark in pvt["vel_d_mps"][within]}),
                    "marked": bool((within == (pvt["vel_d_mps"] != 0)).all()),
                }
            )
        return replace(self, taught=json.dumps(lessons))


@dataclass(frozen=True)
class Memoriser(Steady):
    """Scores 0 where it knows the place: in sample it never alerts."""

    scale: float = 1.0
    places: tuple[float, ...] = ()

    def fit(self, clean: Sequence[Recording], attacked: Sequence[Labelled]) -> Self:
        places = sorted({lat for one in clean for lat in one.primary(PVT)["lat_deg"].tolist()})
        return replace(self, places=tuple(places))

    def detect(self, recording: Recording) -> Decisions:
        lat_deg = recording.primary(PVT)["lat_deg"]
        made = super().detect(recording)
        score = np.where(np.isin(lat_deg, self.places), 0.0, made.score)
        return Decisions(made.time_ns, score, made.available)


@dataclass(frozen=True)
class Unteachable(Pupil):
    """Wants more than there is."""

    def fit(self, clean: Sequence[Recording], attacked: Sequence[Labelled]) -> Self:
        raise NotApplicable("it takes a hundred recordings")


@dataclass(frozen=True)
class Patient(Steady):
    """Needs long input before it decides."""

    warm_up_s: float = 0.0


@dataclass(frozen=True)
class Boost(Nudge):
    """Adds to the northward velocity; its mark is 1."""

    shift_deg: float = 0.0
    gain_mps: float = 1.0

    @property
    def strength(self) -> float:
        return self.gain_mps

    def apply(
        self,
        clean: Recording,
        window: Interval,
        rng: np.random.Generator,
        donors: Sequence[Recording] = (),
    ) -> Recording:
        topic = clean.topics(PVT)[0]
        table = clean[topic]
        within = window.covers(table.time_ns)
        return clean.replace(
            {
                topic: table.replace(
                    vel_n_mps=table["vel_n_mps"] + np.where(within, self.gain_mps, 0.0),
                    vel_d_mps=np.where(within, 1.0, table["vel_d_mps"]),
                )
            }
        )


@dataclass(frozen=True)
class Borrow(Nudge):
    """Gives the velocity and the height of the first donor; its mark is 2."""

    def apply(
        self,
        clean: Recording,
        window: Interval,
        rng: np.random.Generator,
        donors: Sequence[Recording] = (),
    ) -> Recording:
        if not donors:
            raise NotApplicable("nobody lends it anything")
        topic = clean.topics(PVT)[0]
        table, lent = clean[topic], donors[0][topic]
        within = window.covers(table.time_ns)
        row = np.arange(len(table)) % len(lent)
        return clean.replace(
            {
                topic: table.replace(
                    vel_n_mps=np.where(within, lent["vel_n_mps"][row] + 1.0, table["vel_n_mps"]),
                    height_m=np.where(within, lent["height_m"][row], table["height_m"]),
                    vel_d_mps=np.where(within, 2.0, table["vel_d_mps"]),
                )
            }
        )


@dataclass(frozen=True)
class Thin(Nudge):
    """Takes two of three epochs away."""

    def apply(
        self,
        clean: Recording,
        window: Interval,
        rng: np.random.Generator,
        donors: Sequence[Recording] = (),
    ) -> Recording:
        topic = clean.topics(PVT)[0]
        table = clean[topic]
        kept = ~window.covers(table.time_ns) | (np.arange(len(table)) % 3 == 0)
        return clean.replace({topic: table.take(np.flatnonzero(kept))})
