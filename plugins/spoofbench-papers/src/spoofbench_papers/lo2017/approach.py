"""Simulated approaches that stand in for the flights of Lo et al. (2017), which are not public.

Vertical acceleration is an Ornstein-Uhlenbeck process. A receiver turns it into positions at 10 Hz,
a phone samples it at 8 Hz, and a slow mismatch between the two (attitude) fills up what Table 1
prints for the difference. Arrays have the shape ``(epochs, runs)``; everything is averaged over 5 s
as the paper's curves are, with the span form.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from spoofbench_acceleration.statistics import Averaging, weights

from spoofbench.arrays import Bools, Floats

RATE_HZ = 10
PHONE_HZ = 8
AVERAGING_S = 5.0
WARM_UP_S = 30.0
GNSS_STATIC_MPS2 = 1.198
PHONE_STATIC_MPS2 = 0.027
PHONE_BIAS_MPS2 = -0.03
GNSS_AVERAGED_MPS2 = 0.028

_FINE_HZ = 40  # the lowest rate that holds the epochs of both sensors
_DESCENT_MPS = 3.7  # 3 degrees at 70 m/s: only a lost epoch shows it


@dataclass(frozen=True, slots=True)
class Approach:
    """What the paper prints of an approach, Table 1 and Figs 7, 8 and 23.

    Attributes:
        number: 1 to 4.
        duration_s: its length.
        decorrelation_s: lag at which the accelerometer's autocorrelation falls to 1/e.
        mean_mps2, std_mps2: of the averaged acceleration difference.
        correlation: of the two averaged accelerations; None where it is not printed.
        dropout_s: when the receiver loses an epoch; None for never.
    """

    number: int
    duration_s: float
    decorrelation_s: float
    mean_mps2: float
    std_mps2: float
    correlation: float | None
    dropout_s: float | None = None


APPROACHES = (
    Approach(1, 216.0, 3.1, 0.032, 0.089, 0.93),
    Approach(2, 108.0, 2.5, 0.022, 0.079, 0.96),
    Approach(3, 126.0, 2.5, 0.025, 0.065, None),
    Approach(4, 126.0, 3.1, 0.097, 0.070, None, dropout_s=44.0),
)


@dataclass(frozen=True, slots=True)
class Choices:
    """What the paper leaves open.

    Attributes:
        gust_s: correlation time of the motion; its 5 s average decorrelates within the 2.5 to 3.1 s
            of Table 1.
        mismatch_s: correlation time of the mismatch, slow against the average.
        smoothing_s: trailing mean of the spoofer who extrapolates and smooths.
    """

    gust_s: float = 0.35
    mismatch_s: float = 10.0
    smoothing_s: float = 4.0


CHOSEN = Choices()


@dataclass(frozen=True, slots=True)
class Flights:
    """Averaged vertical accelerations of one approach, m/s^2, ``(epochs, runs)`` at 10 Hz.

    Attributes:
        start: row at which the approach starts; those before are warm-up.
        phone_mps2: of the accelerometer, gravity taken off.
        gnss_mps2: of the receiver, outliers of a lost epoch included.
        gated_mps2: the same with what rests on a lost epoch left out (NaN).
    """

    start: int
    phone_mps2: Floats
    gnss_mps2: Floats
    gated_mps2: Floats


def fly(approach: Approach, seeds: Sequence[int], choices: Choices = CHOSEN) -> Flights:
    """Return one run of the approach per seed."""
    start, epochs = round(WARM_UP_S * RATE_HZ), round((WARM_UP_S + approach.duration_s) * RATE_HZ)
    rngs = [np.random.default_rng([seed, approach.number]) for seed in seeds]
    fine = epochs * _FINE_HZ // RATE_HZ
    gust = (
        level_mps2(approach)
        / _averaged_share(choices.gust_s)
        * ornstein_uhlenbeck(_noise(rngs, fine), choices.gust_s * _FINE_HZ)
    )
    raw, lost = _receiver(gust, _noise(rngs, epochs), approach.dropout_s)
    samples = gust[:: _FINE_HZ // PHONE_HZ]
    samples = samples + PHONE_STATIC_MPS2 * _noise(rngs, len(samples))
    felt = averaged(samples, PHONE_HZ)[np.arange(epochs) * PHONE_HZ // RATE_HZ]
    clean, _ = _receiver(gust, None, None)
    residual = felt - averaged(clean, RATE_HZ)
    mismatch = ornstein_uhlenbeck(_noise(rngs, epochs), choices.mismatch_s * RATE_HZ)
    phone = felt + approach.mean_mps2 + _filling(mismatch, residual, start, approach.std_mps2)
    return Flights(
        start,
        phone,
        averaged(raw, RATE_HZ),
        averaged(np.where(lost[:, None], np.nan, raw), RATE_HZ),
    )


def stand_still(seconds: float, seed: int) -> tuple[Floats, Floats]:
    """Return what phone and receiver say at rest, not averaged, ``(samples, 1)`` each; Fig 12."""
    rngs = [np.random.default_rng([seed, 0])]
    phone = PHONE_BIAS_MPS2 + PHONE_STATIC_MPS2 * _noise(rngs, round(seconds * PHONE_HZ))
    epochs = round(seconds * RATE_HZ)
    gnss, _ = _receiver(np.zeros((epochs * _FINE_HZ // RATE_HZ, 1)), _noise(rngs, epochs), None)
    return phone, gnss[2:]


def level_mps2(approach: Approach) -> float:
    """Return the standard deviation of the averaged motion that gives the printed correlation.

    With motion s, receiver noise e and mismatch m, of variances S, E and M and E + M printed, the
    correlation c obeys c^2 (S + E) (S + M) = S^2. Approaches without one fly through the mean level
    of the others.
    """
    if approach.correlation is None:
        levels = [level_mps2(other) for other in APPROACHES if other.correlation is not None]
        return sum(levels) / len(levels)
    c2, both, noise = approach.correlation**2, approach.std_mps2**2, GNSS_AVERAGED_MPS2**2
    product = noise * (both - noise)
    return float(
        np.sqrt(
            (c2 * both + np.sqrt((c2 * both) ** 2 + 4 * (1 - c2) * c2 * product)) / (2 * (1 - c2))
        )
    )


def ornstein_uhlenbeck(noise: Floats, correlation_steps: float) -> Floats:
    """Turn white noise of unit variance, ``(n, runs)``, into a stationary process of unit
    variance.
    """
    decay = np.exp(-1 / correlation_steps)
    values: Floats = noise * np.sqrt(1 - decay**2)
    values[0] = noise[0]
    for row in range(1, len(values)):
        values[row] += decay * values[row - 1]
    return values


def averaged(values: Floats, rate_hz: float, averaging: Averaging = "span") -> Floats:
    """Exponential average over 5 s of each run, ``(n, runs)``, whose first row is known.

    A NaN stays NaN and holds the state, which the next value then enters with the weight of the
    time since the last one.
    """
    result, state, steps = np.empty_like(values), values[0].copy(), np.ones(values.shape[1])
    for row, value in enumerate(values):
        known = ~np.isnan(value)
        share = weights(steps / rate_hz, AVERAGING_S, averaging)
        state = np.where(known, state + share * (value - state), state)
        steps = np.where(known, 1, steps + 1)
        result[row] = np.where(known, state, np.nan)
    return result


def _noise(rngs: Sequence[np.random.Generator], rows: int) -> Floats:
    """White noise of unit variance, ``(rows, runs)``."""
    return np.stack([rng.standard_normal(rows) for rng in rngs], axis=1)


def _averaged_share(gust_s: float) -> float:
    """Deviation of the averaged unit process over that of the process itself, by the AR(1)
    covariance at 10 Hz.
    """
    keep, decay = 1 - 2 / (AVERAGING_S * RATE_HZ + 1), np.exp(-1 / (gust_s * RATE_HZ))
    return float(np.sqrt((1 - keep) / (1 + keep) * (1 + keep * decay) / (1 - keep * decay)))


def _receiver(gust: Floats, noise: Floats | None, dropout_s: float | None) -> tuple[Floats, Bools]:
    """Second difference of noisy positions, and the rows that rest on a lost epoch, whose position
    repeats the one before.
    """
    step_s = 1 / _FINE_HZ
    velocity = np.cumsum(gust, axis=0) * step_s - _DESCENT_MPS
    position = (np.cumsum(velocity, axis=0) * step_s)[:: _FINE_HZ // RATE_HZ]
    if noise is not None:
        position = position + noise * GNSS_STATIC_MPS2 / np.sqrt(6) / RATE_HZ**2
    lost = np.zeros(len(position), np.bool_)
    if dropout_s is not None:
        row = round((WARM_UP_S + dropout_s) * RATE_HZ)
        position[row] = position[row - 1]
        lost[row : row + 3] = True
    acceleration = np.diff(position, 2, axis=0) * RATE_HZ**2
    return np.concatenate([np.repeat(acceleration[:1], 2, axis=0), acceleration]), lost


def _filling(mismatch: Floats, residual: Floats, start: int, std_mps2: float) -> Floats:
    """Scale each run's mismatch so that with the residual and the receiver's noise the difference
    has the printed deviation.
    """
    left = std_mps2**2 - GNSS_AVERAGED_MPS2**2 - residual[start:].var(axis=0)
    shape = mismatch - mismatch[start:].mean(axis=0)
    filling: Floats = shape * np.sqrt(np.maximum(left, 0)) / shape[start:].std(axis=0)
    return filling
