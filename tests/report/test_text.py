"""Numbers as text."""

import pytest

from spoofbench.report.text import between, counted, percent, printable, rate, seconds


@pytest.mark.parametrize("form", [rate, percent, seconds])
def test_unknown_is_a_dash_and_zero_is_zero(form):
    assert form(None) == "-"
    assert float(form(0.0)) == 0


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.07, "0.07"),
        (6.914, "6.91"),
        (41.23, "41.2"),
        (1204.4, "1,204"),
        (0.004, "<0.01"),
        (9.996, "10.0"),
        (99.96, "100"),
    ],
)
def test_rates_have_about_three_figures(value, text):
    assert rate(value) == text


@pytest.mark.parametrize(
    ("value", "text"), [(0.04, "<0.1"), (99.96, ">99.9"), (100.0, "100.0"), (97.34, "97.3")]
)
def test_almost_is_not_all(value, text):
    assert percent(value) == text


def test_an_interval_with_an_unknown_bound_is_unknown():
    assert between("0", "5.1") == "0 to 5.1"
    assert between("-", "5.1") == between("0", "-") == "-"


def test_plurals():
    assert [counted(n, "hour") for n in (0, 1, 1200)] == ["0 hours", "1 hour", "1,200 hours"]


def test_control_characters_do_not_reach_a_terminal():
    assert printable("a\x1b[31mb\x07") == "a\N{REPLACEMENT CHARACTER}[31mb\N{REPLACEMENT CHARACTER}"
