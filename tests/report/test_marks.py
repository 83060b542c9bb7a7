"""What is said of a row beside its figures, each for its own reason."""

import pytest

from spoofbench.report.columns import FURTHER, MARKS, VERDICT, columns_of, explained
from spoofbench.report.marks import MEANINGS, marks

CASES = [
    ({"baseline": True, "rank": None}, "B", "baseline"),
    ({"keeps_target": False}, "*", "exceeds the target"),
    ({"ranked": {"far_per_hour_lo": None}}, "?", "no interval of its false alerts"),
    ({"ranked": {"far_per_hour_lo": None}, "rank": None}, "", ""),
    (
        {"told_apart": False, "sessions_needed": 1200},
        "=",
        "not told apart from the first (about 1,200 sessions could)",
    ),
    ({"told_apart": False}, "=", "not told apart from the first"),
    ({"told_apart": True}, "", ""),
    ({"not_better_than": "jump"}, "<", "not better than jump"),
    ({"apart": "the only row of its class"}, "a", "apart: the only row of its class"),
    ({"threshold": "raised only"}, "r", ""),
    ({"threshold": "no clean score"}, "n", ""),
    (
        {"ranked": None, "threshold": "uncalibratable"},
        "u",
        "no calibrated threshold: figures at the published one",
    ),
    ({"is_fitted": True}, "f", "fitted"),
    ({"is_fitted": True, "learns_from_attacks": True}, "l", "fitted, learned from attacks"),
    ({"parameter_sources": '{"a": "published", "b": "published"}'}, "p", "published: a, b"),
    ({"parameter_sources": '{"a": "data sheet"}'}, "d", "data sheet: a"),
    ({"parameter_sources": '{"a": "by hand"}'}, "h", "by hand: a"),
    ({"parameter_sources": '{"a": "session x"}'}, "s", "session x: a"),
    (
        {"failed": 1, "skipped": 2, "not_modelled": 3, "reasons": ("no", "other")},
        "!",
        "6 of 11 tasks failed or could not run, such as: no",
    ),
]


@pytest.mark.parametrize(("about", "letter", "said"), CASES)
def test_each_mark_has_its_cause(made_up, about, letter, said):
    if about.get("ranked"):
        about = about | {"ranked": made_up("figures", **about["ranked"])}
    row = made_up("row", **about)
    table = made_up("table", row)
    assert "".join(mark.letter for mark in marks(table, row)) == letter
    assert MARKS.entry(table, row).text == said


def test_too_few_episodes_are_said_beside_the_interval(made_up):
    row = made_up("row", ranked=made_up("figures", has_few_episodes=True))
    table = made_up("table", row)
    assert [mark.letter for mark in marks(table, row)] == ["e"]
    (column,) = (column for column in VERDICT if column.title == "False alerts")
    assert column.entry(table, row).remark == "too few episodes"


def test_marks_stand_in_one_order_and_every_letter_has_a_case(made_up):
    row = made_up("row", is_fitted=True, keeps_target=False, told_apart=False, failed=1)
    letters = [mark.letter for mark in marks(made_up("table", row), row)]
    assert letters == sorted(letters, key=list(MEANINGS).index) == ["*", "=", "f", "!"]
    assert {letter for _, letter, _ in CASES if letter} | {"e"} == set(MEANINGS)


def test_a_published_table_has_nothing_uncalibrated(made_up):
    row = made_up("row", ranked=made_up("figures"), threshold="published")
    assert marks(made_up("table", row, point="published"), row) == []


def test_columns_that_say_nothing_of_a_table_are_left_out(made_up):
    def titles(**about):
        table = made_up("table", made_up("row"), **about)
        return [column.heading for column in columns_of(table, (*VERDICT, *FURTHER))]

    usual = titles()
    assert "Family left out, of attacks" not in usual
    assert set(usual) - set(titles(point="published")) == {
        "False alerts as published, per hour",
        "Detected as published, of attacks",
        "Placebo as published, of windows",
    }
    assert set(usual) - set(titles(windows=1)) == {
        "Mean time, s to first detection",
        "Median time, s to first detection",
        "90 % time, s to first detection",
        "Median error, m before alert",
        "95 % error, m before alert",
        "Alerted, % of spoofed epochs",
        "Placebo, % of the same epochs",
    }
    learned = made_up("table", made_up("row", family_left_out=(2, 3)))
    (column,) = (c for c in columns_of(learned, FURTHER) if c.title == "Family left out")
    assert column.entry(learned, learned.rows[0]).text == "2/3"
    assert column in explained([learned])
    assert column not in explained([made_up("table", made_up("row"))])


def test_every_title_is_explained_or_explains_itself():
    explained_titles = {column.title for column in (*VERDICT, *FURTHER) if column.definition}
    assert {column.title for column in (*VERDICT, *FURTHER)} - explained_titles == {
        "Detector",
        "Marks",
        "90 % time",
        "Median error",
        "95 % error",
        "Detected as published",
        "Placebo as published",
    }


@pytest.mark.parametrize(
    ("detected", "mean_s", "text"), [(0, 60.0, "> 60.0"), (1, 45.0, "45.0"), (0, None, "-")]
)
def test_a_mean_time_of_misses_alone_is_a_bound(made_up, detected, mean_s, text):
    figures = made_up("figures", detected=detected, restricted_mean_ttfd_s=mean_s)
    row = made_up("row", ranked=figures)
    (column,) = (column for column in VERDICT if column.title == "Mean time")
    assert column.entry(made_up("table", row), row).text == text


def test_the_factor_says_how_it_came_about(made_up):
    (column,) = (column for column in VERDICT if column.title == "Threshold")
    for about, text in (
        ({}, "1.25 (calibrated)"),
        ({"factor_hi": 1.5}, "1.25 to 1.5 (calibrated)"),
        ({"threshold": "raised only"}, "1.25 (raised only)"),
        ({"threshold": "published"}, "published"),
        ({"factor_lo": None, "factor_hi": None, "threshold": "uncalibratable"}, "uncalibratable"),
    ):
        row = made_up("row", **about)
        assert column.entry(made_up("table", row), row).text == text


def test_hazardous_are_those_not_warned_of_in_time(made_up):
    (column,) = (column for column in FURTHER if column.title == "Hazardous")
    for warned, hazardous, text in ((3, 4, "1/4"), (0, 0, "-")):
        row = made_up("row", ranked=made_up("figures", warned=warned, hazardous=hazardous))
        assert column.entry(made_up("table", row), row).text == text
