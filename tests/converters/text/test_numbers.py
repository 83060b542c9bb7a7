"""Numbers of cells, against float and Decimal."""

from decimal import ROUND_HALF_UP, Decimal
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spoofbench_converters.text import numbers


def column(texts: list[str]) -> Any:
    """Return texts as cells, which have no characters but ASCII."""
    masked = (text.encode("ascii", "replace").decode() for text in texts)
    return pa.array([text or None for text in masked], pa.string())


decimals = st.one_of(
    st.integers(-(2**62), 2**62).map(str),
    st.decimals(-(10**9), 10**9, places=9).map(str),
    st.decimals(-(10**6), 10**6, places=14).map(lambda value: f"{value:f}"),
    st.floats(-1e9, 1e9).map(repr),
    st.floats(-1e9, 1e9).map(lambda value: f"{value:.9E}".replace("E+0", "E")),
)


NONSENSE = ["x1", "1.2.3", "--1", "1e", "9" * 60]


@settings(max_examples=150, deadline=None)
@given(
    texts=st.lists(
        st.one_of(decimals, st.sampled_from(["", "null", "NaN", *NONSENSE])), min_size=1, max_size=8
    )
)
def test_floats_are_those_of_python(texts: list[str]) -> None:
    values, bad = numbers.floats(column(texts))
    for text, value, wrong in zip(texts, values.tolist(), bad.tolist(), strict=True):
        if text in NONSENSE:
            assert wrong
        elif text in ("", "null", "NaN"):
            assert not wrong
            assert np.isnan(value)
        else:
            assert not wrong
            assert value == float(text)


@pytest.mark.parametrize("places", [0, 6, 9])
@settings(max_examples=100, deadline=None)
@given(texts=st.lists(decimals, min_size=1, max_size=8))
def test_scaled_numbers_are_exact(texts: list[str], places: int) -> None:
    values, present, bad = numbers.scaled(column(texts), places)
    for text, value, known, wrong in zip(
        texts, values.tolist(), present.tolist(), bad.tolist(), strict=True
    ):
        exact = Decimal(text).scaleb(places)
        if abs(exact) < 2**62:
            assert known
            assert not wrong
            assert abs(exact - value) <= Decimal("0.5") + (
                abs(exact) * Decimal("1e-15") if "e" in text.lower() else 0
            )
            if "e" not in text.lower():
                assert value == int(abs(exact).quantize(Decimal(1), ROUND_HALF_UP).copy_sign(exact))


@settings(max_examples=150, deadline=None)
@given(
    texts=st.lists(st.text("0123456789.-+,x\0 \xff", max_size=6), min_size=1, max_size=8),
    places=st.integers(0, 3),
)
def test_what_is_no_number_is_told(texts: list[str], places: int) -> None:
    read, scaled = numbers.floats(column(texts)), numbers.scaled(column(texts), places)
    assert scaled.bad.tolist() == read.bad.tolist()
    assert scaled.present.tolist() == (~np.isnan(read.values)).tolist()
    np.testing.assert_allclose(
        scaled.values[scaled.present],
        read.values[scaled.present] * 10**places,
        rtol=0,
        atol=0.500001,
    )


def test_the_largest_numbers() -> None:
    texts = [str(2**63 - 2**10 - 1), str(2**63), "9" * 19, "9" * 20, "-" + "9" * 18, "0" * 30 + "7"]
    values, present, bad = numbers.scaled(column(texts))
    assert present.tolist() == [True, False, False, False, True, True]
    assert bad.tolist() == [not there for there in present.tolist()]
    assert values[present].tolist() == [2**63 - 2**10 - 1, -(10**18 - 1), 7]


def test_a_number_of_nanoseconds_is_read_to_its_last_digit() -> None:
    assert numbers.scaled(column(["1764585664362463217"])).values.tolist() == [
        1_764_585_664_362_463_217
    ]
    assert numbers.scaled(column(["1764585664.362463217"]), 9).values.tolist() == [
        1_764_585_664_362_463_217
    ]
    assert numbers.scaled(column(["1,5E0"]), 9, decimal_comma=True).values.tolist() == [
        1_500_000_000
    ]
    assert numbers.scaled(column(["1.764585664362463E18"])).values.tolist() == [
        1_764_585_664_362_463_000
    ]


def test_exponents_beyond_all_measure() -> None:
    texts = ["1e-400", "-1E-9999", "1e400", "1e40", "2E0", "12345678901234567890e-19", "0e400"]
    values, present, bad = numbers.scaled(column(texts * 100), 9)
    assert values[:7].tolist() == [0, 0, 0, 0, 2_000_000_000, 1_234_567_890, 0]
    assert present[:7].tolist() == [True, True, False, False, True, True, True]
    assert bad[:7].tolist() == [False, False, False, True, False, False, False]
