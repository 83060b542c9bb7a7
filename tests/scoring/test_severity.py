"""Detectable strength: by hand, and its laws."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spoofbench.scoring.severity import DetectableStrength, SeverityCurve, severity_curve


def tried(shares: dict[float, float], windows: int = 20, sessions: int = 5) -> SeverityCurve:
    """So many windows at each strength, of which this share is detected."""
    rows = [
        (strength, number < share * windows, number % sessions)
        for strength, share in shares.items()
        for number in range(windows)
    ]
    curve = severity_curve(*zip(*rows, strict=True))
    assert curve is not None
    return curve


def test_between_strengths_the_logarithm_counts() -> None:
    curve = tried({0.1: 0.0, 1.0: 0.4, 10.0: 0.6, 100.0: 1.0})
    half, most = curve.strength_detected(0.5), curve.strength_detected(0.9)
    assert half == DetectableStrength(pytest.approx(10**0.5), None)
    assert most == DetectableStrength(pytest.approx(10**1.75), None)


def test_a_share_that_falls_is_pooled_by_its_windows() -> None:
    """0.8 of 10 windows before 0.2 of 20 gives 0.4 for both."""
    strength = [1.0] * 10 + [2.0] * 20 + [4.0] * 10
    detected = [True] * 8 + [False] * 2 + [True] * 4 + [False] * 16 + [True] * 10
    curve = severity_curve(strength, detected, range(40))
    assert curve is not None
    assert curve.detected == pytest.approx([0.4, 0.4, 1.0])
    assert (curve.windows, curve.sessions) == (10, 10)
    assert curve.strength_detected(0.5) == DetectableStrength(pytest.approx(2 * 2 ** (1 / 6)), None)


def test_what_lies_outside_is_censored() -> None:
    assert tried({0.5: 0.0, 1.0: 0.4}).strength_detected(0.5) == DetectableStrength(
        1.0, "above the strongest"
    )
    assert tried({0.5: 0.5, 1.0: 0.9}).strength_detected(0.5) == DetectableStrength(
        0.5, "below the weakest"
    )


def test_strength_zero_is_no_attack() -> None:
    curve = tried({0.0: 0.2, 1.0: 0.6, 2.0: 1.0})
    assert curve.strength_detected(0.5) == DetectableStrength(1.0, "below the weakest")
    assert tried({0.0: 0.2}).strength_detected(0.5) is None
    assert tried({0.0: 1.0, 1.0: 0.0}).strength_detected(0.5) == DetectableStrength(
        1.0, "below the weakest"
    ), "the fit never falls: what is seen without attack is seen with it"


@pytest.mark.parametrize(
    ("windows", "sessions", "known"), [(20, 5, True), (19, 5, False), (20, 4, False)]
)
def test_nine_tenths_need_20_windows_of_5_sessions(
    windows: int, sessions: int, known: bool
) -> None:
    curve = tried({1.0: 0.0, 2.0: 1.0}, windows, sessions)
    assert curve.strength_detected(0.5) is not None
    assert (curve.strength_detected(0.9) is not None) == known


def test_nothing_and_nonsense() -> None:
    assert severity_curve([], [], []) is None
    for strength in (-1.0, np.nan):
        with pytest.raises(ValueError, match="from 0 on"):
            severity_curve([strength], [True], ["a"])


@given(
    st.lists(
        st.tuples(st.sampled_from([0.0, 0.1, 0.3, 1.0, 3.0]), st.booleans()),
        min_size=1,
        max_size=40,
    ),
    st.sampled_from([0.25, 2.0, 1024.0]),
)
def test_the_unit_of_the_strength_scales_the_result(
    windows: list[tuple[float, bool]], unit: float
) -> None:
    strength, detected = np.array(windows, float).T
    curve, scaled = (severity_curve(s, detected, detected) for s in (strength, unit * strength))
    assert curve is not None
    assert scaled is not None
    assert (np.diff(curve.detected) >= 0).all()
    one, other = curve.strength_detected(0.5), scaled.strength_detected(0.5)
    assert (one is None) == (other is None)
    if one is not None and other is not None:
        assert other.strength == pytest.approx(unit * one.strength)
        assert other.censored == one.censored


@given(
    st.lists(
        st.tuples(st.sampled_from([0.1, 0.3, 1.0, 3.0]), st.booleans()), min_size=1, max_size=40
    ),
    st.data(),
)
def test_a_further_detection_never_raises_the_strength(
    windows: list[tuple[float, bool]], data: st.DataObject
) -> None:
    number = data.draw(st.integers(0, len(windows) - 1))
    better = [(s, hit or row == number) for row, (s, hit) in enumerate(windows)]
    found = []
    for rows in (windows, better):
        strength, detected = np.array(rows, float).T
        curve = severity_curve(strength, detected, detected)
        assert curve is not None
        half = curve.strength_detected(0.5)
        assert half is not None
        found.append(np.inf if half.censored == "above the strongest" else half.strength)
    assert found[1] <= found[0] * (1 + 1e-9)
