"""A column's resolution: what the receiver wrote stays, what it could not have written is moved to
what it could.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spoofbench.attacks.resolution import Floats, Rounding, resolution, resolutions
from spoofbench.table import Table

ROUNDINGS: dict[str, tuple[Rounding, float]] = {
    "decimals": (lambda x: np.round(x, 3), 1e-3),
    "scaled integers": (lambda x: np.rint(x * 1e7) * 1e-7, 1e-7),
    "divided integers": (lambda x: np.rint(x * 1e7) / 1e7, 1e-7),
    "radians of scaled integers": (lambda x: np.rad2deg(np.deg2rad(np.round(x, 7))), 1e-7),
    "singles": (lambda x: x.astype(np.float32).astype(np.float64), 1e-5),
    "singles of decimals": (lambda x: np.round(x, 2).astype(np.float32).astype(np.float64), 1e-2),
    "arc minutes": (lambda x: np.round(x * 60, 5) / 60, 1e-5 / 60),
    "degrees and arc minutes": (
        lambda x: np.trunc(x) + np.round((x - np.trunc(x)) * 60, 5) / 60,
        1e-5 / 60,
    ),
    "knots": (lambda x: np.round(x * 3600 / 1852, 2) * (1852 / 3600), 0.01 * 1852 / 3600),
    "sums of decimals": (lambda x: np.round(x - 47.3, 1) + 47.3, 0.1),
}


def _numbers(seed: int, scale: float = 90.0, n: int = 500) -> Floats:
    return np.random.default_rng(seed).uniform(-scale, scale, n)


def _last_bits(name: str) -> float:
    return (
        16 * float(np.spacing(90.0))
        if name in ("sums of decimals", "degrees and arc minutes", "knots")
        else 0.0
    )


@pytest.mark.parametrize("name", ROUNDINGS)
@given(seed=st.integers(0, 1000))
def test_what_was_written_stays(name: str, seed: int) -> None:
    column = ROUNDINGS[name][0](_numbers(seed))
    assert np.abs(resolution(column).represent(column, column) - column).max() <= _last_bits(name)


@pytest.mark.parametrize("name", ROUNDINGS)
@given(seed=st.integers(0, 1000))
def test_other_numbers_go_to_the_nearest_that_could_be_written(name: str, seed: int) -> None:
    rounding, step = ROUNDINGS[name]
    genuine, others = rounding(_numbers(seed)), _numbers(seed + 1)
    written = resolution(genuine).represent(others, genuine)
    assert np.abs(written - others).max() <= 0.51 * step
    assert np.abs(written - rounding(written)).max() <= _last_bits(name)


def test_last_bits_that_no_formula_explains_are_as_frequent_as_they_were() -> None:
    rounding = ROUNDINGS["sums of decimals"][0]
    genuine, others = rounding(_numbers(0, n=5000)), _numbers(1, n=5000)
    written = resolution(genuine).represent(others, genuine)

    def share_off_grid(values: Floats) -> float:
        return float(np.mean(values != np.round(values, 1)))

    assert 0.1 < share_off_grid(genuine) < 0.9
    assert abs(share_off_grid(written) - share_off_grid(genuine)) < 0.03


def test_full_doubles_are_left_alone() -> None:
    values = _numbers(3)
    assert resolution(_numbers(2)).rounding is None
    assert np.array_equal(resolution(_numbers(2)).represent(values, values), values)


def test_zeros_have_the_sign_that_they_had() -> None:
    without, with_one = np.array([0.0, 0.5, -0.5]), np.array([-0.0, 0.5, -0.5])
    tiny = np.array([-0.01, 0.5, 0.7])
    assert not np.signbit(resolution(without).represent(tiny, without)[0])
    assert np.signbit(resolution(with_one).represent(tiny, with_one)[0])


def test_a_single_precision_column_is_known() -> None:
    column = np.round(_numbers(4), 1).astype(np.float32)
    written = resolution(column).represent(np.array([41.26]), np.array([40.0])).astype(np.float32)
    assert written[0] == np.float32(41.3)


def test_fields_that_are_written_alike_help_one_another() -> None:
    n = np.arange(50)
    table = Table(
        "gnss/pvt",
        n,
        {
            "vel_n_mps": np.round(np.sin(n), 3),
            "vel_e_mps": np.round(np.cos(n), 3),
            "vel_d_mps": np.zeros(50),
        },
    )
    down = resolutions(table, ["vel_d_mps"])["vel_d_mps"]
    assert down.represent(np.array([0.1234]), np.zeros(1))[0] == 0.123


def test_a_field_that_never_changes_is_written_as_its_fellows() -> None:
    table = Table(
        "gnss/pvt", np.arange(50), {"lat_deg": _numbers(0, n=50), "lon_deg": np.full(50, 8.0)}
    )
    assert (
        resolutions(table, ["lon_deg"])["lon_deg"].represent(
            np.array([8.1234567890123]), np.array([8.0])
        )[0]
        == 8.1234567890123
    )
