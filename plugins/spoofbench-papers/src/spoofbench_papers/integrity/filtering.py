"""The covariance recursion of the filter: gains and innovation covariances, which no measurement
changes.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dposv

from spoofbench_papers.integrity.model import Array, LinearModel
from spoofbench_papers.integrity.scenario import ScenarioError


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """A filter's covariances over the ``k`` epochs of a monitor.

    Attributes:
        model: what is filtered.
        start: P_0 after the warm-up, ``(s, s)``.
        predicted: P_k before the measurement, ``(k, s, s)`` (Tanil et al. 2018, Eq 13).
        updated: P_k after it, ``(k, s, s)``.
        gain: L_k, ``(k, s, n)`` (Eq 11).
        innovation: S_k, ``(k, n, n)`` (Eq 16).
    """

    model: LinearModel
    start: Array
    predicted: Array
    updated: Array
    gain: Array
    innovation: Array

    def __len__(self) -> int:
        return len(self.gain)

    def until(self, epochs: int) -> "Run":
        """Return the run over its first epochs alone."""
        return Run(
            self.model,
            self.start,
            self.predicted[:epochs],
            self.updated[:epochs],
            self.gain[:epochs],
            self.innovation[:epochs],
        )


def warmed_up(model: LinearModel, epochs: int) -> Array:
    """Return the covariance after so many epochs from the model's initial one, ``(s, s)``."""
    covariance = model.initial
    for _ in range(epochs):
        covariance = _epoch(model, covariance)[1]
    return covariance


def covariances(model: LinearModel, start: Array, epochs: int) -> Run:
    """Run the filter's covariances over a monitor's epochs, each preceded by one time update."""
    states, count = len(model.transition), len(model.noise)
    predicted, updated = np.empty((epochs, states, states)), np.empty((epochs, states, states))
    gain, innovation = np.empty((epochs, states, count)), np.empty((epochs, count, count))
    covariance = start
    for k in range(epochs):
        predicted[k], covariance, gain[k], innovation[k] = _epoch(model, covariance)
        updated[k] = covariance
    return Run(model, start, predicted, updated, gain, innovation)


def _epoch(model: LinearModel, covariance: Array) -> tuple[Array, Array, Array, Array]:
    """Return P before and after the update, L and S. The update is Joseph's form, which stays
    symmetric and positive.
    """
    observation = model.observation
    predicted = model.transition @ covariance @ model.transition.T + model.process
    crossed = observation @ predicted
    innovation = crossed @ observation.T + model.noise
    _, solved, failed = dposv(innovation, crossed)  # by Cholesky: S is symmetric and positive
    if failed:
        raise ScenarioError(
            "the filter's covariance has lost its meaning in rounding; bring the scenario's "
            "deviations closer together"
        )
    gain = solved.T
    kept = np.eye(len(predicted)) - gain @ observation
    updated = kept @ predicted @ kept.T + gain @ model.noise @ gain.T
    return predicted, (updated + updated.T) / 2, gain, innovation
