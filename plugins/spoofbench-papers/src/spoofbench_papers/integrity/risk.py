"""Integrity risk: the probability that the vertical error exceeds the alert limit and nothing is
detected, in logarithms.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize, stats
from scipy.special import log_ndtr

from spoofbench.arrays import Floats


@dataclass(frozen=True, slots=True)
class Monitor:
    """What decides the risk of an attack.

    Attributes:
        slope_m: rho, vertical error per unit of lambda.
        deviation_m: sigma_eps of the vertical error without an attack.
        threshold_squared: T^2; degrees: k n of the cumulative statistic; alert_limit_m: l.
    """

    slope_m: float
    deviation_m: float
    threshold_squared: float
    degrees: int
    alert_limit_m: float


@dataclass(frozen=True, slots=True)
class WorstCase:
    """The magnitude that maximises the risk: lambda, mean vertical error mu (m), and log10 of the
    integrity risk.
    """

    noncentrality: float
    error_m: float
    log10_risk: float


def log_exceedance(mean_m: ArrayLike, deviation_m: float, limit_m: float) -> Floats:
    """Return ln Pr(|eps| > l), eps ~ N(mean, deviation^2), by mean: scalar or ``(n,)``."""
    mean = np.asarray(mean_m, float)
    above, below = (
        log_ndtr((mean - limit_m) / deviation_m),
        log_ndtr((-limit_m - mean) / deviation_m),
    )
    return np.asarray(np.logaddexp(above, below))


def log_missed(noncentrality_squared: ArrayLike, threshold_squared: float, degrees: int) -> Floats:
    """Return ln Pr(q < T^2), q noncentral chi-square, by lambda^2: scalar or ``(n,)``.

    SciPy's distribution is good to about 1e-120; below that the value is that of the normal
    approximation of Sankaran (1963), which is continuous enough for a search, and far below any
    risk of interest.
    """
    shift = np.asarray(noncentrality_squared, float)
    with np.errstate(divide="ignore", under="ignore"):
        exact = np.log(stats.ncx2.cdf(threshold_squared, degrees, np.maximum(shift, 1e-300)))
    total = degrees + shift
    h = 1 - 2 * total * (degrees + 3 * shift) / (3 * (degrees + 2 * shift) ** 2)
    p = (degrees + 2 * shift) / total**2
    m = (h - 1) * (1 - 3 * h)
    z = ((threshold_squared / total) ** h - (1 + h * p * (h - 1 - 0.5 * (2 - h) * m * p))) / (
        h * np.sqrt(2 * p) * (1 + 0.5 * m * p)
    )
    return np.asarray(np.where(exact > -270, exact, np.minimum(log_ndtr(z), -270.0)))


def log_risk(error_m: ArrayLike, monitor: Monitor) -> Floats:
    """Return ln I_r of the worst-case fault by its mean vertical error mu (m), scalar or ``(n,)``
    (Tanil et al. 2018, Eq 45).
    """
    error = np.asarray(error_m, float)
    missed = log_missed((error / monitor.slope_m) ** 2, monitor.threshold_squared, monitor.degrees)
    return log_exceedance(error, monitor.deviation_m, monitor.alert_limit_m) + missed


def worst_case(monitor: Monitor) -> WorstCase:
    """Return the magnitude of the worst-case fault that maximises the integrity risk."""
    error, log = maximised(lambda error: float(log_risk(error, monitor)), monitor.alert_limit_m)
    return WorstCase(error / monitor.slope_m, error, log / np.log(10))


def maximised(function: Callable[[float], float], scale: float) -> tuple[float, float]:
    """Return where between 0 and twice the scale a function is largest, and its value there."""
    grid = np.linspace(0, 2 * scale, 41)
    values = [function(point) for point in grid.tolist()]
    best = int(np.argmax(values))
    bounds = (grid[max(best - 1, 0)], grid[min(best + 1, grid.size - 1)])
    found = optimize.minimize_scalar(
        lambda point: -function(point),
        bounds=bounds,
        method="bounded",
        options={"xatol": 1e-6 * scale},
    )
    return (
        (float(found.x), -float(found.fun))
        if -found.fun > values[best]
        else (float(grid[best]), values[best])
    )
