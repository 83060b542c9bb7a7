"""Plugins that learn with scikit-learn: one from clean recordings, one from attacked ones, too."""

import pickle
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from spoofbench.arrays import Floats, Times
from spoofbench.detector import Decisions, Labelled
from spoofbench.errors import NotApplicable
from spoofbench.navigation.gnss import local_position_ned, velocity_ned
from spoofbench.recording import Recording

PVT = "gnss/pvt"
LEAST_ROWS = 50


@dataclass(frozen=True)
class _Forest:
    """What both have in common: features of the last epochs, and a model as pickled bytes.

    Attributes:
        window: epochs that the features are taken over.
        trees: of the forest.
        seed: of its chance.
        model: what was learned; empty before, and then nothing is available.
    """

    window: int = 5
    trees: int = 20
    seed: int = 0
    model: bytes = b""

    requires: ClassVar[tuple[str, ...]] = (PVT,)
    uses: ClassVar[tuple[str, ...]] = ()
    memory_s: ClassVar[float] = 10.0

    @property
    def warm_up_s(self) -> float:
        return float(self.window + 1)

    def detect(self, recording: Recording) -> Decisions:
        time_ns, features = windowed_features(recording, self.window)
        score = np.full(time_ns.size, np.nan)
        known = ~np.isnan(features).any(axis=1)
        if self.model and known.any():
            score[known] = self._score(features[known])
        return Decisions(time_ns, score, known & bool(self.model))

    def _score(self, features: Floats) -> Floats:
        raise NotImplementedError

    def _rows(self, recordings: Sequence[Recording]) -> Floats:
        """Return the features of all epochs that have them, ``(n, 4)``."""
        features = [windowed_features(one, self.window)[1] for one in recordings]
        rows = np.concatenate([np.empty((0, 4)), *features])
        rows = rows[~np.isnan(rows).any(axis=1)]
        if len(rows) < LEAST_ROWS:
            raise NotApplicable(f"a forest needs {LEAST_ROWS} epochs to grow on, not {len(rows)}")
        return rows


@dataclass(frozen=True)
class IsolationTrees(_Forest):
    """Scores how unlike clean epochs an epoch is, over the 99 % point of clean ones."""

    def fit(self, clean: Sequence[Recording], attacked: Sequence[Labelled]) -> Self:
        from sklearn.ensemble import IsolationForest

        forest = IsolationForest(n_estimators=self.trees, random_state=self.seed)
        rows = self._rows(clean)
        forest.fit(rows)
        limit = float(np.quantile(-forest.score_samples(rows), 0.99))
        return replace(self, model=pickle.dumps((forest, limit)))

    def _score(self, features: Floats) -> Floats:
        forest, limit = pickle.loads(self.model)
        return np.asarray(-forest.score_samples(features) / limit)


@dataclass(frozen=True)
class AttackTrees(_Forest):
    """Scores the probability of an attack over a half, by a forest that memorises its material."""

    learns_from_attacks: ClassVar[bool] = True

    def fit(self, clean: Sequence[Recording], attacked: Sequence[Labelled]) -> Self:
        from sklearn.ensemble import RandomForestClassifier

        spoofed = [
            one.recording.between(span.start_ns, span.end_ns)
            for one in attacked
            for span in one.attacked
        ]
        if not spoofed:
            raise NotApplicable("there is no attacked recording to learn from")
        rows, spoofed_rows = self._rows(clean), self._rows(spoofed)
        forest = RandomForestClassifier(n_estimators=self.trees, random_state=self.seed)
        forest.fit(
            np.concatenate([rows, spoofed_rows]),
            np.arange(len(rows) + len(spoofed_rows)) >= len(rows),
        )
        return replace(self, model=pickle.dumps(forest))

    def _score(self, features: Floats) -> Floats:
        return np.asarray(2 * pickle.loads(self.model).predict_proba(features)[:, 1])


def windowed_features(recording: Recording, window: int) -> tuple[Times, Floats]:
    """Return the epochs and, of the last ``window`` of them, mean speed, mean and largest
    acceleration, and largest jump of the position against the velocity, ``(n, 4)``; NaN where one
    of the epochs lacks something.
    """
    pvt = recording.primary(PVT).last_per_time()
    features = np.full((len(pvt), 4), np.nan)
    if len(pvt) <= window:
        return pvt.time_ns, features
    seconds = np.diff(pvt.time_ns) / 1e9
    velocity = velocity_ned(pvt)[:, :2]
    position = local_position_ned(pvt["lat_deg"], pvt["lon_deg"], pvt["height_m"])[:, :2]
    mean = (velocity[1:] + velocity[:-1]) / 2
    acceleration = np.hypot(*np.diff(velocity, axis=0).T) / seconds
    jump = np.hypot(*(np.diff(position, axis=0) - mean * seconds[:, None]).T)
    of_steps = np.stack([np.hypot(*mean.T), acceleration, jump], axis=1)
    of_steps[~np.isfinite(of_steps)] = np.nan
    windows = np.lib.stride_tricks.sliding_window_view(of_steps, window, axis=0)
    features[window:] = np.column_stack([windows[:, :2].mean(axis=2), windows[:, 1:].max(axis=2)])
    return pvt.time_ns, features
