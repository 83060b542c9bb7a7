"""The simulated approaches: what was set comes out, and what was not set is what the process should
give.
"""

from typing import Any

import numpy as np
import pytest
from spoofbench_papers.lo2017 import approach as a
from spoofbench_papers.lo2017.tables import signatures

SEEDS = range(60)


@pytest.fixture(scope="module")
def flown() -> dict[int, a.Flights]:
    return {approach.number: a.fly(approach, SEEDS) for approach in a.APPROACHES}


@pytest.mark.parametrize(
    "approach", a.APPROACHES, ids=lambda approach: f"approach-{approach.number}"
)
def test_table_1_comes_out(approach: a.Approach, flown: dict[int, a.Flights]) -> None:
    medians = {
        name: float(np.median(values))
        for name, values in signatures(flown[approach.number]).items()
    }
    assert medians["mean_mps2"] == pytest.approx(approach.mean_mps2, abs=0.003)
    assert medians["std_mps2"] == pytest.approx(approach.std_mps2, rel=0.03)
    assert 2.5 <= medians["decorrelation_s"] <= 3.2
    if approach.correlation is not None:
        assert medians["correlation"] == pytest.approx(approach.correlation, abs=0.01)


def test_the_approach_lasts_as_printed(flown: dict[int, a.Flights]) -> None:
    for approach in a.APPROACHES:
        flights = flown[approach.number]
        assert (len(flights.phone_mps2) - flights.start) / a.RATE_HZ == approach.duration_s


def test_a_run_depends_on_its_seed_alone() -> None:
    together, alone = a.fly(a.APPROACHES[1], [4, 7]), a.fly(a.APPROACHES[1], [7])
    for name in ("phone_mps2", "gnss_mps2", "gated_mps2"):
        np.testing.assert_allclose(getattr(together, name)[:, 1:], getattr(alone, name), rtol=1e-9)
    assert (together.phone_mps2[:, 0] != together.phone_mps2[:, 1]).all()


def test_only_approach_4_loses_an_epoch(flown: dict[int, a.Flights]) -> None:
    for number, flights in flown.items():
        gone = np.flatnonzero(np.isnan(flights.gated_mps2).any(axis=1)) - flights.start
        assert gone.tolist() == ([440, 441, 442] if number == 4 else [])


def test_the_receiver_is_late_by_half_its_second_difference(flown: dict[int, a.Flights]) -> None:
    """By 0.1 s, against 0.05 s on average since the last sample of the phone: the best fit lies
    between.
    """
    flights = flown[3]
    phone, gnss = (values[flights.start :] for values in (flights.phone_mps2, flights.gnss_mps2))
    shifts = np.array([-5, -3, -1, 1, 3, 5])
    misfit = [
        ((phone[5:-5] - gnss[5 + shift : len(gnss) - 5 + shift]) ** 2).mean() for shift in shifts
    ]
    square, linear, _ = np.polyfit(shifts / a.RATE_HZ, misfit, 2)
    assert 0 < -linear / (2 * square) < 0.1


def test_gating_takes_the_outlier_out(flown: dict[int, a.Flights]) -> None:
    """The outlier is 2 (3.7 m/s) / (0.1 s) of raw acceleration, a share of 2/51 of which is
    averaged in.
    """
    flights = flown[4]
    after = flights.start + 441
    outlier = flights.gnss_mps2[after] - flights.gated_mps2[after - 2]
    assert np.median(outlier) == pytest.approx(-3.7 / 0.1 * 2 / 51, rel=0.5)
    later = slice(after + 2, after + 6)
    assert np.abs(flights.gated_mps2[later] - flights.gated_mps2[after - 2]).max() < 1.0


def test_ornstein_uhlenbeck() -> None:
    noise = np.random.default_rng(0).standard_normal((200, 20_000))
    values = a.ornstein_uhlenbeck(noise, 10.0)
    for lag in (0, 5, 20):
        assert (values[100] * values[100 + lag]).mean() == pytest.approx(
            np.exp(-lag / 10), abs=0.03
        )
    assert values[0].var() == pytest.approx(1, abs=0.03)


def test_noise_at_rest_is_the_printed_one() -> None:
    phone, gnss = a.stand_still(2000.0, seed=1)
    assert phone.std() == pytest.approx(0.027, rel=0.02)
    assert gnss.std() == pytest.approx(1.198, rel=0.02)
    assert a.averaged(gnss, a.RATE_HZ)[500:].std() == pytest.approx(0.028, abs=0.001)


def test_position_noise_is_that_of_the_second_difference() -> None:
    """White position noise p has a second difference of sqrt(6) p / dt^2: 4.9 mm give 1.198 m/s^2
    at 10 Hz.
    """
    _, gnss = a.stand_still(2000.0, seed=2)
    spread: Any = gnss[:, 0] - gnss.mean()
    lagged = [
        float((spread[lag:] * spread[: spread.size - lag]).mean() / spread.var())
        for lag in (1, 2, 3)
    ]
    assert lagged == pytest.approx([-4 / 6, 1 / 6, 0], abs=0.03)
