"""Numbers as text."""

import pytest

from spoofbench.formatting import (
    between,
    byte_size,
    counted,
    date_time,
    hours_minutes_seconds,
    percent,
    printable,
    rate,
    seconds,
)


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


@pytest.mark.parametrize(
    ("duration_s", "text"),
    [
        (0.4, "0 min 00 s"),
        (187, "3 min 07 s"),
        (3599.6, "1 h 00 min 00 s"),
        (93784, "26 h 03 min 04 s"),
    ],
)
def test_durations(duration_s, text):
    assert hours_minutes_seconds(duration_s) == text


@pytest.mark.parametrize(
    ("time_ns", "text"),
    [
        (1_700_000_000_999_999_999, "2023-11-14 22:13:20"),
        (-1, "1969-12-31 23:59:59"),
        (2**63 - 1, "2262-04-11 23:47:16"),
    ],
)
def test_times_are_dates(time_ns, text):
    assert date_time(time_ns) == text


@pytest.mark.parametrize(
    ("size", "text"), [(17, "17 bytes"), (4200, "4.2 kB"), (1_354_000_000, "1.35 GB")]
)
def test_sizes_have_three_figures(size, text):
    assert byte_size(size) == text
