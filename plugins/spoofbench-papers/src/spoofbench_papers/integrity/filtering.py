"""The covariance recursion of the filter: gains and innovation covariances, which no measurement
changes; and what a filter expects that believes in another error model than the truth's (Kujur et
al.).
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dposv

from spoofbench.arrays import Floats
from spoofbench_papers.integrity.model import LinearModel
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
    start: Floats
    predicted: Floats
    updated: Floats
    gain: Floats
    innovation: Floats

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


def warmed_up(model: LinearModel, epochs: int) -> Floats:
    """Return the covariance after so many epochs from the model's initial one, ``(s, s)``."""
    covariance = model.initial
    for _ in range(epochs):
        covariance = _epoch(model, covariance)[1]
    return covariance


def covariances(model: LinearModel, start: Floats, epochs: int) -> Run:
    """Run the filter's covariances over a monitor's epochs, each preceded by one time update.

    Args:
        model: of ``s`` states.
        start: P_0, ``(s, s)``.
        epochs: how many.

    Raises:
        ScenarioError: the deviations are so far apart that rounding leaves no positive covariance.
    """
    states, count = len(model.transition), len(model.noise)
    predicted, updated = np.empty((epochs, states, states)), np.empty((epochs, states, states))
    gain, innovation = np.empty((epochs, states, count)), np.empty((epochs, count, count))
    covariance = start
    for k in range(epochs):
        predicted[k], covariance, gain[k], innovation[k] = _epoch(model, covariance)
        updated[k] = covariance
    return Run(model, start, predicted, updated, gain, innovation)


def _epoch(model: LinearModel, covariance: Floats) -> tuple[Floats, Floats, Floats, Floats]:
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


@dataclass(frozen=True, slots=True)
class Expected:
    """E[q] of the cumulative statistic: what noise gives, and what a fault adds (lambda^2 under the
    believed covariances).
    """

    by_noise: float
    by_fault: float

    @property
    def total(self) -> float:
        """E[q] under the fault."""
        return self.by_noise + self.by_fault


def expected_statistic(
    truth: LinearModel, belief: LinearModel, warm_up_epochs: int, fault: Floats
) -> Expected:
    """Return E[q] over a monitor's epochs, the filter running on ``belief`` since the start of the
    warm-up.

    With e the error of the estimate and x the true error states, of which the filter's are another
    model, e_k = (I - L H)(Phi_b e + (Phi_b - Phi_t) x - w) + L (v + f): the covariance of (e, x) is
    carried along.

    Args:
        truth, belief: models of equal states and measurements.
        warm_up_epochs: how many epochs the filter runs before the monitor starts.
        fault: ``(k, n)``, added to the measurements of the monitor's epochs.
    """
    states = len(truth.transition)
    run = covariances(belief, belief.initial, warm_up_epochs + len(fault))
    wrong = belief.transition - truth.transition
    mistaken = np.flatnonzero(np.any(wrong != 0, axis=0))  # whose motion the filter gets wrong
    transition = np.block(
        [
            [belief.transition, wrong[:, mistaken]],
            [np.zeros((mistaken.size, states)), truth.transition[np.ix_(mistaken, mistaken)]],
        ]
    )
    driven = np.vstack([-np.eye(states), np.eye(states)[mistaken]])
    process = driven @ truth.process @ driven.T
    start = np.vstack([-np.eye(states), np.eye(states)[mistaken]])
    covariance = start @ truth.initial @ start.T
    observation = np.hstack([truth.observation, np.zeros((len(truth.noise), mistaken.size))])
    mean, by_noise, by_fault = np.zeros(states), 0.0, 0.0
    for k in range(len(run)):
        covariance = transition @ covariance @ transition.T + process
        gain = np.vstack([run.gain[k], np.zeros((mistaken.size, len(truth.noise)))])
        if k >= warm_up_epochs:
            scatter = observation @ covariance @ observation.T + truth.noise
            by_noise += float(np.trace(np.linalg.solve(run.innovation[k], scatter)))
            mean = belief.transition @ mean
            innovation = fault[k - warm_up_epochs] - truth.observation @ mean
            by_fault += float(innovation @ np.linalg.solve(run.innovation[k], innovation))
            mean = mean + run.gain[k] @ innovation
        kept = np.eye(len(covariance)) - gain @ observation
        covariance = kept @ covariance @ kept.T + gain @ truth.noise @ gain.T
    return Expected(by_noise, by_fault)
