"""How often intervals hold the truth: at least 92 % of the time where 95 % is said."""

import numpy as np
import pytest

from benchmarks.coverage.__main__ import (
    SESSIONS,
    Case,
    cases,
    coverage,
    one_session_coverage,
    told_apart,
)
from spoofbench.scoring.statistics import Estimate


@pytest.mark.parametrize("sessions", SESSIONS)
@pytest.mark.parametrize(
    "case", [case for case in cases() if case.promised], ids=lambda c: f"{c.interval}, {c.data}"
)
def test_intervals_hold_the_truth(case: Case, sessions: int) -> None:
    held, width = coverage(case, sessions, 1500)
    assert held >= 0.92
    assert width > 0


def test_within_one_session() -> None:
    assert one_session_coverage(2000) >= 0.95


@pytest.mark.parametrize(("rows", "sessions"), [(2, 8), (6, 8), (6, 15)])
def test_alike_rows_are_told_apart_in_5_percent_at_most(rows: int, sessions: int) -> None:
    assert told_apart(rows, sessions, 300) <= 0.07


def test_an_interval_that_is_too_narrow_is_seen() -> None:
    """The percentage points of a normal mean with known spread, on five sessions of unknown."""

    def narrow(rng: np.random.Generator, n: int) -> Estimate:
        drawn = rng.normal(0, 1, n)
        value, error = float(drawn.mean()), float(drawn.std(ddof=1)) / n**0.5
        return Estimate(value, value - 1.96 * error, value + 1.96 * error)

    assert coverage(Case("mean", "normal", 0.0, narrow), 5, 2000)[0] < 0.9
