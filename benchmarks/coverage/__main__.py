"""How often the intervals of a board hold the truth.

``python -m benchmarks.coverage`` simulates sessions whose truth is known, and prints for 5, 8 and
15 of them how often the nominal 95 % interval of each printed kind holds it, and how often rows
that are alike are told apart. Intervals and the shapes of data that can occur in each:

- episodes per hour: counts, whose rates differ between sessions as negative binomial, exponential
  or normal data do;
- shares from 0 to 1 and restricted mean times over their horizon: Beta(0.5, 1), and the others cut
  to that range;
- differences of such shares between two rows.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from math import exp

import numpy as np

from spoofbench.arrays import Floats
from spoofbench.scoring.comparison import compare_with_first
from spoofbench.scoring.statistics import Estimate, poisson_rate, rate_interval, share_interval

SESSIONS = (5, 8, 15)
Draw = Callable[[np.random.Generator, int], Floats]
"""Values of so many sessions, ``(n,)``."""


@dataclass(frozen=True, slots=True)
class Case:
    """A kind of interval on a kind of data.

    Attributes:
        interval: the kind.
        data: in words.
        truth: what the interval estimates.
        estimate: draws so many sessions and returns the interval.
        promised: whether it is to hold at least 92 % of the time.
    """

    interval: str
    data: str
    truth: float
    estimate: Callable[[np.random.Generator, int], Estimate | None]
    promised: bool = True


def _beta(rng: np.random.Generator, n: int) -> Floats:
    return rng.beta(0.5, 1, n)


def _normal(rng: np.random.Generator, n: int) -> Floats:
    return np.clip(rng.normal(0.5, 0.1, n), 0, 1)


def _exponential(rng: np.random.Generator, n: int) -> Floats:
    """Times of mean 60 s, restricted to 300 s."""
    return np.minimum(rng.exponential(60, n), 300) / 300


def _negative_binomial(rng: np.random.Generator, n: int) -> Floats:
    """Ten seconds of alarm per episode, as a share of an hour."""
    return np.minimum(rng.negative_binomial(20 / 13, 1 / 14, n) / 360, 1)


SHARES: tuple[tuple[str, float, Draw], ...] = (
    ("Beta(0.5, 1)", 1 / 3, _beta),
    ("1 - Beta(0.5, 1)", 2 / 3, lambda rng, n: 1 - _beta(rng, n)),
    ("normal, 0.5 +- 0.1", 0.5, _normal),
    ("exponential time to detection", (1 - exp(-5)) / 5, _exponential),
    ("negative binomial share in alarm", 20 / 360, _negative_binomial),
    ("0 or 1, of chance 0.8", 0.8, lambda rng, n: rng.binomial(1, 0.8, n).astype(float)),
    (
        "3 windows of chance Beta(0.5, 1)",
        1 / 3,
        lambda rng, n: rng.binomial(3, _beta(rng, n)) / 3,
    ),
)
RATES: tuple[tuple[str, Draw], ...] = (
    ("negative binomial, dispersion 14", lambda rng, n: rng.gamma(20 / 13, 13, n)),
    ("exponential", lambda rng, n: rng.exponential(20, n)),
    ("normal, 20 +- 5", lambda rng, n: np.maximum(rng.normal(20, 5, n), 0)),
    ("all alike", lambda _, n: np.full(n, 20.0)),
)
DIFFERENCES: tuple[tuple[str, float, Draw], ...] = (
    ("two Beta(0.5, 1)", 0.0, lambda rng, n: _beta(rng, n) - _beta(rng, n)),
    ("Beta(0.5, 1) against never", 1 / 3, _beta),
    ("normal, 0.1 +- 0.1", 0.1, lambda rng, n: np.clip(rng.normal(0.1, 0.1, n), -1, 1)),
    (
        "exponential times, 60 s less 30 s",
        (1 - exp(-5)) / 5 - (1 - exp(-10)) / 10,
        lambda rng, n: _exponential(rng, n) - np.minimum(rng.exponential(30, n), 300) / 300,
    ),
    (
        "negative binomial shares in alarm",
        0.0,
        lambda rng, n: _negative_binomial(rng, n) - _negative_binomial(rng, n),
    ),
    (
        "1 of chance 0.1, else 0",
        0.1,
        lambda rng, n: rng.binomial(1, 0.1, n).astype(float),
    ),
)


def cases() -> list[Case]:
    """Return every interval that is printed over several sessions, on all data that apply."""
    found = [Case("episodes per hour", data, 20.0, _rate(draw)) for data, draw in RATES]
    found += [
        Case("episodes per hour", f"{data}; 0.5 to 2 h each", 20.0, _rate(draw, 0.5, 2))
        for data, draw in RATES
    ]
    found += [
        Case("episodes per hour", f"{data}; 0.1 to 4 h each", 20.0, _rate(draw, 0.1, 4), False)
        for data, draw in RATES
    ]
    found += [
        Case("episodes per hour, too few", f"{data}, tenfold rarer", 2.0, _rarer(draw), False)
        for data, draw in RATES
    ]
    found += [Case("share", data, truth, _share(draw)) for data, truth, draw in SHARES]
    found += [
        Case("difference", data, truth, _difference(draw)) for data, truth, draw in DIFFERENCES
    ]
    return found


def _rate(
    per_hour: Draw, least_h: float = 1.0, most_h: float = 1.0
) -> Callable[[np.random.Generator, int], Estimate | None]:
    def estimate(rng: np.random.Generator, n: int) -> Estimate | None:
        hours = rng.uniform(least_h, most_h, n)
        return rate_interval(rng.poisson(per_hour(rng, n) * hours), hours)

    return estimate


def _rarer(per_hour: Draw) -> Callable[[np.random.Generator, int], Estimate | None]:
    return _rate(lambda rng, n: per_hour(rng, n) / 10)


def _share(draw: Draw) -> Callable[[np.random.Generator, int], Estimate | None]:
    return lambda rng, n: share_interval(draw(rng, n))


def _difference(draw: Draw) -> Callable[[np.random.Generator, int], Estimate | None]:
    def estimate(rng: np.random.Generator, n: int) -> Estimate | None:
        difference = draw(rng, n)
        first, other = np.maximum(-difference, 0), np.maximum(difference, 0)
        return compare_with_first([first, other], largest=1.0)[0].difference

    return estimate


def coverage(case: Case, sessions: int, repeats: int, seed: int = 0) -> tuple[float, float]:
    """Return how often the intervals of a case hold its truth, and their median width."""
    rng = np.random.default_rng(seed)
    found = [case.estimate(rng, sessions) for _ in range(repeats)]
    held = [one is not None and one.lo <= case.truth <= one.hi for one in found]
    width = [one.hi - one.lo for one in found if one is not None]
    return float(np.mean(held)), float(np.median(width))


def one_session_coverage(repeats: int, seed: int = 0) -> float:
    """Return how often the interval within one session holds the rate of a Poisson process."""
    found = [poisson_rate(count, 1.0) for count in np.random.default_rng(seed).poisson(5, repeats)]
    return float(np.mean([one is not None and one.lo <= 5 <= one.hi for one in found]))


def told_apart(rows: int, sessions: int, repeats: int, seed: int = 0) -> float:
    """Return how often any of so many alike rows is told apart from the first."""
    rng = np.random.default_rng(seed)
    return float(
        np.mean(
            [
                any(
                    one.told_apart for one in compare_with_first(rng.beta(0.5, 1, (rows, sessions)))
                )
                for _ in range(repeats)
            ]
        )
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--repeats", type=int, default=4000, help="simulations of each case")
    repeats: int = parser.parse_args().repeats
    print(f"{'coverage of 95 % in %, and median width':72}", end="")
    print(*(f"{n:>12} sessions" for n in SESSIONS))
    for case in cases():
        print(f"{case.interval + ': ' + case.data:72}", end="")
        for n in SESSIONS:
            held, width = coverage(case, n, repeats)
            print(f"{100 * held:13.1f} {width:7.3f}", end=" ")
        print()
    print(f"within one session, Poisson of mean 5: {100 * one_session_coverage(repeats):.1f} %")
    for rows, n in ((2, 8), (6, 8), (6, 15)):
        wrong = 100 * told_apart(rows, n, max(repeats // 4, 1))
        print(f"{rows} rows alike, {n} sessions: any told apart in {wrong:.1f} %")


if __name__ == "__main__":
    main()
