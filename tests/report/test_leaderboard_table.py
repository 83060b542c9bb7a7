"""The leaderboard in the terminal and in Markdown."""

import io
import re

import pytest
from rich.console import Console

from spoofbench.report import markdown, print_leaderboard
from spoofbench.report.leaderboard_table import COLUMNS
from spoofbench.scoring.leaderboard import leaderboard


def terminal(folder, width=80):
    console = Console(file=io.StringIO(), width=width, force_terminal=False)
    print_leaderboard(leaderboard(folder), console)
    return console.file.getvalue()


def cells(line):
    """Cells of a row of a Markdown table."""
    return [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]


@pytest.mark.parametrize("width", [60, 80, 200])
def test_the_terminal_shows_at_most_80_columns_and_cuts_nothing_off(folder, width):
    text = terminal(folder, width)
    assert max(map(len, text.splitlines())) <= min(width, 80)
    assert "\N{HORIZONTAL ELLIPSIS}" not in text
    assert text.count("n") >= 2 * 64
    for row in leaderboard(folder).rows:
        assert len(row.detector) > 28 or row.detector in text


def test_many_attacks_take_several_tables(make, tmp_path):
    attacks = [f"attack-{number}" for number in range(30)]
    text = terminal(make(tmp_path, ["only"], attacks, 300))
    assert max(map(len, text.splitlines())) <= 80
    assert text.count("Detection by attack") > 1
    assert all(f"attack-{number}" in " ".join(text.split()) for number in range(30))


def test_unknown_is_a_dash(folder):
    table = [line for line in markdown(leaderboard(folder)).splitlines() if line.startswith("|")]
    by_attack = {cells(line)[0]: cells(line)[1:] for line in table[-3:]}
    assert by_attack["correlation"][1] == "-"
    assert by_attack["n" * 64] == ["0.0", "0.0"]
    failing = next(cells(line) for line in table[:5] if "n" * 64 in line)
    assert failing[2:4] == ["-", "-"]


def test_both_say_what_the_thresholds_are_and_what_the_numbers_rest_on(folder):
    for text in (" ".join(terminal(folder).split()), markdown(leaderboard(folder))):
        assert "published ones" in text
        assert "Target FA/h: 1;" in text
        assert "3 detectors; 2 attacks, 6 attacked variants; 1 recording, 1 session, 0.17 h" in text


def test_terminal_and_markdown_have_the_same_figures(folder):
    printed = terminal(folder)
    for line in markdown(leaderboard(folder)).splitlines():
        if line.startswith("| 1 |"):
            assert all(figure.replace("\\", "") in printed for figure in cells(line))
            return
    pytest.fail("no row has rank 1")


def test_hostile_names_stay_one_cell_and_plain_text(hostile_folder):
    text = markdown(leaderboard(hostile_folder))
    tables = [line for line in text.splitlines() if line.startswith("|")]
    assert {len(cells(line)) for line in tables} == {10, 3}
    assert not re.search(r"(?<!\\)<", text)
    assert "\x1b" not in text
    assert "\x1b" not in terminal(hostile_folder)
    assert "[red]" in "".join(terminal(hostile_folder).split())


def test_failures_are_counted(folder):
    failing = next(row for row in leaderboard(folder).rows if row.detector == "n" * 64)
    line = next(line for line in markdown(leaderboard(folder)).splitlines() if "n" * 64 in line)
    assert cells(line)[9] == str(failing.failed) == "7"


def test_every_column_is_declared_with_what_its_figures_are():
    assert all(column.unit or column.title in ("Rank", "Detector") for column in COLUMNS)
    explained = {column.title for column in COLUMNS if column.term and column.definition}
    assert explained == {column.title for column in COLUMNS} - {"Detector", "90 %"}


def test_legend_and_headings_are_those_of_the_columns(folder):
    printed, text = terminal(folder), markdown(leaderboard(folder))
    head = cells(next(line for line in text.splitlines() if line.startswith("|")))
    shown = [column for column in COLUMNS if column.heading]
    assert [name for name in head if name != "95 %"] == [
        column.heading.replace("\n", " ") + column.heading_unit for column in shown
    ]
    for column in shown:
        assert all(part.lower() in printed.lower() for part in column.heading.split("\n"))
        if column.legend:
            assert f"{column.legend[0]}: {column.legend[1]}" in " ".join(printed.split())
