"""A spoofer that tracks the vehicle with errors (Tanil et al. 2018, Eqs 21, 60, 61).

White tracking errors s ~ N(0, sigma_s^2 I) in altitude add H[:, r_D] s to the fault. They move the
vertical error by a^T s and the whitened innovations by M s, so both parts of the risk share them:
their product is averaged, not the factors.

The paper averages over m = 20 samples. The exact route conditions on the induced error c = a^T s:
given c, the statistic q is a generalised chi-square whose characteristic function is known, and its
distribution function is a contour integral through the saddle point, which keeps relative accuracy
far into the tail (Rice 1980; Daniels 1987).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import interpolate
from scipy.linalg import cholesky, solve_triangular
from scipy.special import erfcx, log_ndtr, logsumexp

from spoofbench.arrays import Floats
from spoofbench_papers.integrity.fault import worst_fault
from spoofbench_papers.integrity.filtering import Run
from spoofbench_papers.integrity.model import ALTITUDE
from spoofbench_papers.integrity.risk import (
    Monitor,
    WorstCase,
    log_exceedance,
    log_missed,
    maximised,
    worst_case,
)

_CONTOUR_POINTS = 161
_CONTOUR_REACH = 6.0  # sinh of it, in standard deviations of the tilted distribution
_ERROR_POINTS = 61
_ERROR_REACH = 12.0


@dataclass(frozen=True, slots=True, eq=False)
class Tracking:
    """What the worst fault at unit lambda and unit tracking errors do, all white and whitened.

    Attributes:
        monitor: thresholds and the failure-mode slope.
        gain: a, vertical error per unit of tracking error of each epoch, ``(t,)``.
        shift: S^-1/2 E[gamma] of the worst fault at lambda = 1, in the basis of ``spread``'s
            columns, ``(t,)``.
        along: M a / |a|^2 in that basis, ``(t,)``: the innovations that an induced error c = 1
            brings along.
        spread: eigenvalues of M (I - a a^T / |a|^2) M^T, ``(t,)``.
        gram: M^T M, ``(t, t)``; ``cross``: M^T times the worst fault's whitened innovations,
            ``(t,)``.
        outside: squared length of shift and of along outside the basis, and their product,
            ``(3,)``.
    """

    monitor: Monitor
    gain: Floats
    shift: Floats
    along: Floats
    spread: Floats
    gram: Floats
    cross: Floats
    outside: Floats


def tracking(run: Run, monitor: Monitor, first: int = 1) -> Tracking:
    """Return what tracking errors from the first epoch of the attack on do to the monitor."""
    whiten = np.stack([cholesky(innovation, lower=True) for innovation in run.innovation])
    worst = np.stack(
        [
            solve_triangular(root, gamma, lower=True)
            for root, gamma in zip(whiten, worst_fault(run, first).innovation, strict=True)
        ]
    )
    gain, response = _responses(run, whiten, first)
    inducing = gain / np.linalg.norm(gain)
    projected = response - np.outer(response @ inducing, inducing)
    basis, singular, _ = np.linalg.svd(projected, full_matrices=False)
    flat = worst.reshape(-1)
    along = response @ gain / (gain @ gain)
    inside = np.stack([basis.T @ flat, basis.T @ along])
    outside = np.array(
        [
            flat @ flat - inside[0] @ inside[0],
            along @ along - inside[1] @ inside[1],
            flat @ along - inside[0] @ inside[1],
        ]
    )
    return Tracking(
        monitor,
        gain,
        inside[0],
        inside[1],
        singular**2,
        response.T @ response,
        response.T @ flat,
        outside,
    )


def _responses(run: Run, whiten: Floats, first: int) -> tuple[Floats, Floats]:
    """Return a, ``(t,)``, and M, ``(k n, t)``: what a unit tracking error of each epoch does."""
    model, epochs, count = run.model, len(run), len(run.model.noise)
    faults = epochs - first + 1
    unit = model.observation[:, ALTITUDE]
    response = np.zeros((epochs, count, faults))
    state = np.zeros((len(model.transition), faults))
    for k in range(first - 1, epochs):
        state = model.transition @ state
        innovation = -model.observation @ state
        innovation[:, k - first + 1] += unit
        state = state + run.gain[k] @ innovation
        response[k] = solve_triangular(whiten[k], innovation, lower=True)
    return state[ALTITUDE].copy(), response.reshape(epochs * count, faults)


def exact(of: Tracking, sigma_m: float) -> WorstCase:
    """Return the worst case over the fault's magnitude, the tracking errors averaged exactly.

    The magnitude is found with the saddle-point approximation, the risk at it by the contour
    integral.
    """
    if sigma_m == 0:
        return worst_case(of.monitor)
    error, _ = maximised(
        lambda error: log_risk_tracking(of, sigma_m, error, log_general_chi2_near),
        of.monitor.alert_limit_m,
    )
    log = log_risk_tracking(of, sigma_m, error, _log_general_chi2_where_it_counts)
    return WorstCase(error / of.monitor.slope_m, error, log / np.log(10))


def log_risk_tracking(of: Tracking, sigma_m: float, error_m: float, log_chi2: "LogChi2") -> float:
    """Return ln I_r of the worst-case fault with mean vertical error mu, by quadrature over the
    induced error.

    ``log_chi2(threshold, weights, degrees, shifts, others)`` gives the logarithm of the chance of a
    miss given each induced error, where ``others`` are the logarithms that it is added to.
    """
    points = np.linspace(-_ERROR_REACH, _ERROR_REACH, _ERROR_POINTS)
    induced = points * sigma_m * float(np.linalg.norm(of.gain))
    exceeded = log_exceedance(error_m + induced, of.monitor.deviation_m, of.monitor.alert_limit_m)
    others = exceeded - (points**2) / 2 - 0.5 * np.log(2 * np.pi)
    missed = log_chi2(
        of.monitor.threshold_squared,
        *_conditional(of, sigma_m, error_m / of.monitor.slope_m, induced),
        others,
    )
    return float(logsumexp(missed + others) + np.log(points[1] - points[0]))


def _log_general_chi2_where_it_counts(
    threshold: float, weights: Floats, degrees: Floats, shifts: Floats, others: Floats
) -> Floats:
    """The contour integral where its summand is within 1e-13 of the largest, the approximation
    elsewhere.
    """
    logs = log_general_chi2_near(threshold, weights, degrees, shifts, others)
    counts = logs + others > np.max(logs + others) - 30
    logs[counts] = log_general_chi2(threshold, weights, degrees, shifts[counts])
    return logs


def _conditional(
    of: Tracking, sigma_m: float, magnitude: float, induced_m: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return weights ``(t + 1,)``, degrees ``(t + 1,)`` and noncentralities ``(c, t + 1)`` of q
    given each induced error.
    """
    weights = 1 + sigma_m**2 * of.spread
    shifts = (magnitude * of.shift[None, :] + induced_m[:, None] * of.along[None, :]) ** 2 / weights
    rest = (
        magnitude**2 * of.outside[0]
        + induced_m**2 * of.outside[1]
        + 2 * magnitude * induced_m * of.outside[2]
    )
    degrees = np.append(np.ones(of.spread.size), of.monitor.degrees - of.spread.size)
    return np.append(weights, 1.0), degrees, np.column_stack([shifts, np.maximum(rest, 0)])


def log_general_chi2(threshold: float, weights: Floats, degrees: Floats, shifts: Floats) -> Floats:
    """Return ln Pr(sum_j w_j chi2(degrees_j, shifts_cj) < threshold), ``(c,)``; weights and degrees
    ``(j,)``, shifts ``(c, j)``.

    The contour of the inversion integral runs through the saddle point of K(t) - t threshold, K
    being the cumulant function; the trapezoidal rule converges exponentially along it: to 1e-11
    with hundreds of degrees of freedom; with ten, to 1e-6, and to 1e-3 where a miss is nearly
    certain.
    """
    saddle, curvature = _saddle(threshold, weights, degrees, shifts)
    even = np.linspace(-_CONTOUR_REACH, _CONTOUR_REACH, _CONTOUR_POINTS)
    # Few degrees of freedom have slowly falling tails: the steps grow.
    steps, widths = np.sinh(even), np.cosh(even) * (even[1] - even[0])
    logs = np.empty(saddle.size)
    for c, (t, bend) in enumerate(zip(saddle.tolist(), curvature.tolist(), strict=True)):
        point = t + 1j * steps / np.sqrt(bend)
        factor = 1 - 2 * weights[:, None] * point[None, :]
        cumulant = (
            -0.5 * (degrees @ np.log(factor))
            + (shifts[c] * weights) @ (1 / factor) * point
            - point * threshold
        )
        top = float(np.max(cumulant.real))
        integral = np.sum((np.exp(cumulant - top) / -point).real * widths) / (
            2 * np.pi * np.sqrt(bend)
        )
        logs[c] = top + np.log(integral)
    return logs


def log_general_chi2_near(
    threshold: float, weights: Floats, degrees: Floats, shifts: Floats, others: Floats | None = None
) -> Floats:
    """Return what :func:`log_general_chi2` does, good to a few per cent: for searching.

    The saddle-point formula of Lugannani and Rice (1980), and the normal distribution where a miss
    is likely.
    """
    del others
    saddle, curvature = _saddle(threshold, weights, degrees, shifts)
    factor = 1 - 2 * weights[None, :] * saddle[:, None]
    cumulant = np.sum(
        -0.5 * degrees * np.log(factor) + shifts * weights * saddle[:, None] / factor, 1
    )
    root = -np.sqrt(np.maximum(2 * (saddle * threshold - cumulant), 1e-12))
    mills = (
        np.sqrt(np.pi / 2) * erfcx(-root / np.sqrt(2))
        + 1 / root
        - 1 / (saddle * np.sqrt(curvature))
    )
    tail = (
        -(root**2) / 2 - 0.5 * np.log(2 * np.pi) + np.log(np.maximum(mills, np.finfo(float).tiny))
    )
    mean, variance = (
        np.sum(weights * (degrees + shifts), 1),
        np.sum(2 * weights**2 * (degrees + 2 * shifts), 1),
    )
    away = (threshold - mean) / np.sqrt(variance)
    return np.asarray(np.where(away > -1, log_ndtr(away), tail))


LogChi2 = Callable[[float, Floats, Floats, Floats, Floats], Floats]


def _saddle(
    threshold: float, weights: Floats, degrees: Floats, shifts: Floats
) -> tuple[Floats, Floats]:
    """Return t < 0 where the distribution tilted by exp(t q) has its mean at the threshold, and
    K''(t), each ``(c,)``.

    K' is convex and increasing, so Newton's method from the right never oversteps. Where the mean
    lies below the threshold already, t stays one reciprocal deviation below 0: any t < 0 will do
    for the contour.
    """
    t = -1 / np.sqrt(np.sum(2 * weights**2 * (degrees + 2 * shifts), 1))
    for _ in range(100):
        factor = 1 - 2 * weights[None, :] * t[:, None]
        first = np.sum(weights * (degrees / factor + shifts / factor**2), 1) - threshold
        second = np.sum(2 * weights**2 * (degrees / factor**2 + 2 * shifts / factor**3), 1)
        step = np.where(first > 0, first / second, 0.0)
        t = t - step
        if np.all(step <= 1e-10 * np.abs(t)):
            break
    return t, second


@dataclass(frozen=True, slots=True, eq=False)
class Draws:
    """Tracking errors of unit deviation, drawn: what each does to the vertical error, to lambda^2
    alone and with the fault, ``(m,)``.
    """

    induced: Floats
    squared: Floats
    crossed: Floats


def drawn(of: Tracking, samples: int, rng: np.random.Generator) -> Draws:
    """Draw tracking errors of unit deviation; all deviations and magnitudes share them."""
    draws = rng.standard_normal((samples, of.gain.size))
    return Draws(draws @ of.gain, np.einsum("ij,ij->i", draws @ of.gram, draws), draws @ of.cross)


def sampled(of: Tracking, sigma_m: float, draws: Draws) -> WorstCase:
    """Return the worst case with the tracking errors averaged over samples, the same for all
    magnitudes (Eq 61).
    """
    monitor = of.monitor
    squared, crossed, induced = (
        sigma_m**2 * draws.squared,
        sigma_m * draws.crossed,
        sigma_m * draws.induced,
    )
    furthest = np.sqrt(float(np.max(squared))) + 2 * monitor.alert_limit_m / monitor.slope_m + 10
    roots = np.linspace(0, furthest, 400)
    missed = interpolate.CubicSpline(
        roots, log_missed(roots**2, monitor.threshold_squared, monitor.degrees)
    )

    def log_risk(error: float) -> float:
        magnitude = error / monitor.slope_m
        shift = np.maximum(magnitude**2 + 2 * magnitude * crossed + squared, 0)
        logs = log_exceedance(error + induced, monitor.deviation_m, monitor.alert_limit_m) + missed(
            np.sqrt(shift)
        )
        return float(logsumexp(logs)) - float(np.log(induced.size))

    error, log = maximised(log_risk, monitor.alert_limit_m)
    return WorstCase(error / monitor.slope_m, error, log / np.log(10))
