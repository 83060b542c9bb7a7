"""The worst-case fault: the sequence of false measurements that hides the largest vertical error
(Tanil et al. 2018, section III-C).

In the space of innovations the optimum has a closed form. With g_k = T^T and, backwards, gamma_i =
H P_i g_i (P_i before the update) and g_{i-1} = Phi^T g_i, the innovations gamma of the worst fault
are those of the paper's Eq (59), and of its late form, Eq (75), whose printed inverse is misplaced:
it must read (B^T S^-1 B)^-1 A^T T^T. No matrix B is built: 63 MB at 281 epochs, 4 GB at 8 Hz and
280 s.
"""

from dataclasses import dataclass

import numpy as np

from spoofbench.arrays import Floats
from spoofbench_papers.integrity.filtering import Run
from spoofbench_papers.integrity.model import ALTITUDE


@dataclass(frozen=True, slots=True, eq=False)
class Fault:
    """A fault and what it does, in the mean.

    Attributes:
        measurement: f_i, what is added to the measurements, ``(k, n)``, m.
        innovation: E[gamma_i], ``(k, n)``, m.
        error: E[x~_i], the error of the estimate, ``(k, s)``.
        noncentrality_squared: lambda^2 of the cumulative statistic (Eq 18).
    """

    measurement: Floats
    innovation: Floats
    error: Floats
    noncentrality_squared: float

    @property
    def vertical_error_m(self) -> float:
        """Error of the estimated altitude at the last epoch; down is positive."""
        return float(self.error[-1, ALTITUDE])

    def scaled(self, factor: float) -> "Fault":
        """Return the fault times a factor."""
        return Fault(
            self.measurement * factor,
            self.innovation * factor,
            self.error * factor,
            self.noncentrality_squared * factor**2,
        )


def worst_fault(run: Run, first: int = 1) -> Fault:
    """Return the worst-case fault over a run's epochs, scaled to lambda = 1: its vertical error is
    the failure-mode slope.

    Args:
        run: the filter's covariances over the monitor's epochs.
        first: the first epoch of the attack, counted from 1; a late attack leaves those before
            alone.
    """
    model, epochs = run.model, len(run)
    along = np.zeros(len(model.transition))
    along[ALTITUDE] = 1.0
    innovation = np.zeros((epochs, len(model.noise)))
    for k in reversed(range(first - 1, epochs)):
        innovation[k] = model.observation @ run.predicted[k] @ along
        along = model.transition.T @ along
    fault = fault_of_innovations(run, innovation)
    return fault.scaled(fault.noncentrality_squared**-0.5)


def fault_of_innovations(run: Run, innovation: Floats) -> Fault:
    """Return the fault that gives these mean innovations, ``(k, n)`` (Eqs 47 and 48 solved for
    f).
    """
    model = run.model
    error, measurement = np.zeros((len(run), len(model.transition))), np.empty_like(innovation)
    state = np.zeros(len(model.transition))
    for k in range(len(run)):
        state = model.transition @ state
        measurement[k] = innovation[k] + model.observation @ state
        state = state + run.gain[k] @ innovation[k]
        error[k] = state
    return Fault(measurement, innovation, error, noncentrality_squared(run, innovation))


def fault_of_measurements(run: Run, measurement: Floats) -> Fault:
    """Return what a fault ``(k, n)`` does to the estimate and the innovations, in the mean (Eqs 47
    and 48).
    """
    model = run.model
    error, innovation = np.zeros((len(run), len(model.transition))), np.empty_like(measurement)
    state = np.zeros(len(model.transition))
    for k in range(len(run)):
        state = model.transition @ state
        innovation[k] = measurement[k] - model.observation @ state
        state = state + run.gain[k] @ innovation[k]
        error[k] = state
    return Fault(measurement, innovation, error, noncentrality_squared(run, innovation))


def noncentrality_squared(run: Run, innovation: Floats) -> float:
    """Return lambda^2 = sum of gamma^T S^-1 gamma of mean innovations, ``(k, n)`` (Eq 18)."""
    whitened = np.linalg.solve(run.innovation, innovation[:, :, None])[:, :, 0]
    return float(np.sum(innovation * whitened))


def slopes_squared(run: Run, first: int = 1) -> Floats:
    """Return rho^2 of the worst-case fault for a monitor that ends at each epoch, ``(k,)``, m^2; 0
    before the attack.

    rho_k^2 = T (P_coast - P_k) T^T, where P_coast has coasted on inertial sensors alone since the
    epoch before the attack: the largest hidden error is what the measurements of the attack have
    taken from the covariance. This form is not in the paper; it equals its Eq (54).
    """
    model = run.model
    coasting = run.start if first == 1 else run.updated[first - 2]
    slopes = np.zeros(len(run))
    for k in range(first - 1, len(run)):
        coasting = model.transition @ coasting @ model.transition.T + model.process
        slopes[k] = coasting[ALTITUDE, ALTITUDE] - run.updated[k, ALTITUDE, ALTITUDE]
    return slopes
