"""A monitor whose filter believes in another error model than the truth's (Kujur et al.)."""

from dataclasses import dataclass

import numpy as np

from spoofbench_papers.integrity.filtering import covariances
from spoofbench_papers.integrity.model import Array, LinearModel


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
    truth: LinearModel, belief: LinearModel, warm_up_epochs: int, fault: Array
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
    mistaken = np.flatnonzero(
        np.any(wrong != 0, axis=0)
    )  # states whose true motion the filter gets wrong
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
