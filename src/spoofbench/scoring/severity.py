"""How strong an attack must be to be detected."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from spoofbench.arrays import Floats
from spoofbench.scoring.statistics import MIN_SESSIONS

MOST = 0.9
MIN_WINDOWS_FOR_MOST = 20
"""Share of windows that needs so many of them, and 5 sessions, at every strength."""

_ROUNDING = 1e-12


@dataclass(frozen=True, slots=True)
class DetectableStrength:
    """The strength from which a share of windows is detected.

    Attributes:
        strength: in the unit of the strengths; where it is censored, the strongest or the weakest
            that was tried.
        censored: where the share is not reached at the strongest, or already at the weakest.
    """

    strength: float
    censored: Literal["above the strongest", "below the weakest"] | None


@dataclass(frozen=True, slots=True, eq=False)
class SeverityCurve:
    """The share of windows detected over the strength of an attack, never falling.

    Attributes:
        strength: distinct, increasing from 0 on, shape ``(k,)``.
        detected: isotonic fit of the detected share, shape ``(k,)``, 0 to 1.
        windows, sessions: how many were tried at every strength at least.
    """

    strength: Floats
    detected: Floats
    windows: int
    sessions: int

    def strength_detected(self, share: float) -> DetectableStrength | None:
        """Return the strength at which the fit first reaches a share of the windows.

        Between two strengths the fit is a line over the logarithm of the strength. Strength 0 is no
        attack: it has no logarithm, and what the weakest attack already reaches is censored.

        Returns:
            None where only strength 0 was tried, and for a share of :data:`MOST` and more from
            fewer than 20 windows or 5 sessions.
        """
        few = self.windows < MIN_WINDOWS_FOR_MOST or self.sessions < MIN_SESSIONS
        attacks = self.strength > 0
        if not attacks.any() or (share >= MOST and few):
            return None
        strength, detected = self.strength[attacks], self.detected[attacks]
        reached = np.flatnonzero(detected >= share - _ROUNDING)
        if not reached.size:
            return DetectableStrength(float(strength[-1]), "above the strongest")
        at = int(reached[0])
        if at == 0:
            return DetectableStrength(float(strength[0]), "below the weakest")
        around = slice(at - 1, at + 1)
        found = np.exp(np.interp(share, detected[around], np.log(strength[around])))
        return DetectableStrength(float(found), None)


def severity_curve(
    strength: ArrayLike, detected: ArrayLike, sessions: ArrayLike
) -> SeverityCurve | None:
    """Fit the share of detected windows so that it never falls with the strength of the attack
    (Barlow et al. 1972), each strength weighted by its windows.

    Args:
        strength: of the attack in each window, not negative, shape ``(n,)``.
        detected: whether it was detected, shape ``(n,)``.
        sessions: label of each window's session, shape ``(n,)``.

    Returns:
        None without windows.

    Raises:
        ValueError: a strength is negative or not a number.
    """
    given, hits = np.asarray(strength, float), np.asarray(detected, float)
    if not given.size:
        return None
    if not (given >= 0).all():
        raise ValueError("strengths must be numbers from 0 on")
    from scipy.optimize import isotonic_regression

    strengths, level = np.unique(given, return_inverse=True)
    windows = np.bincount(level)
    session = np.unique(np.asarray(sessions), return_inverse=True)[1]
    pairs = np.unique(np.stack([level, session]), axis=1)
    fit = isotonic_regression(np.bincount(level, hits) / windows, weights=windows)
    return SeverityCurve(
        strengths, np.asarray(fit.x), int(windows.min()), int(np.bincount(pairs[0]).min())
    )
