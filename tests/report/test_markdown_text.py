"""The leaderboard in Markdown: every column, every table, and no markup from names."""

import re

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from spoofbench.report import markdown
from spoofbench.report.columns import FURTHER, VERDICT, columns_of
from spoofbench.scoring.leaderboard import SeverityRow, TransferRow, leaderboard
from spoofbench.scoring.severity import SeverityCurve


def cells(line):
    """Cells of a row of a Markdown table."""
    return [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]


def grids(text):
    """The tables, as lists of rows of cells, without the rule under the head."""
    blocks = re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE)
    return [[cells(line) for line in block.splitlines()] for block in blocks]


@given(st.data())
@settings(max_examples=25, suppress_health_check=[HealthCheck.too_slow], deadline=None)
def test_every_row_has_the_cells_of_its_head_and_nothing_is_markup(boards, data):
    text = markdown(data.draw(boards))
    assert all(len(row) == len(grid[0]) for grid in grids(text) for row in grid)
    assert not re.search(r"(?<!\\)[<>*`\[\]]", re.sub(r"\\\\", "", text))
    assert "\x1b" not in text


def test_each_table_has_its_columns_in_order(calibrated_folder):
    board = leaderboard(calibrated_folder)
    found = iter(grids(markdown(board)))
    for table in board.tables:
        for columns in (VERDICT, FURTHER):
            grid = next(found)
            shown = columns_of(table, columns)
            assert [name for name in grid[0] if name != "95 %"] == [c.heading for c in shown]
            place = grid[0].index("Detector")
            assert [row[place] for row in grid[2:]] == [row.detector for row in table.rows]
        if table.windows > 1:
            assert next(found)[0] == ["Detector", *table.attacks]
    assert len(board.tables) == 2


def test_tables_are_headed_by_provenance_and_input_class(calibrated_folder):
    text = markdown(leaderboard(calibrated_folder))
    assert re.findall("^## (.*)$", text, re.MULTILINE) == [
        "Real attacks, detectors of gnss",
        "Attacks injected into real recordings, detectors of gnss",
        "What the columns mean",
    ]
    assert "- A single attack: whether and when it is detected is an anecdote" in text


def test_figures_at_the_published_threshold_stand_beside(made_up):
    row = made_up(
        "row",
        ranked=made_up("figures", far_per_hour=0.5, detected=2),
        published=made_up("figures", far_per_hour=33.0, detected=3, placebo_detected=2),
    )
    verdict, further, _ = grids(markdown(made_up("board", made_up("table", row))))
    shown = dict(zip(verdict[0], verdict[2], strict=True))
    assert (shown["False alerts, per hour"], shown["Detected, of attacks"]) == ("0.50", "2/4")
    assert shown["Placebo, of windows"] == "1/4"
    beside = dict(zip(further[0], further[2], strict=True))
    assert beside["False alerts as published, per hour"] == "33.0"
    assert beside["Detected as published, of attacks"] == "3/4"
    assert beside["Placebo as published, of windows"] == "2/4"


def test_unknown_is_a_dash_and_failures_are_counted(folder):
    verdict, further, by_attack = grids(markdown(leaderboard(folder)))
    failing = next(row for row in verdict if "n" * 64 in row)
    shown = dict(zip(verdict[0], failing, strict=True))
    assert shown["False alerts, per hour"] == shown["95 %"] == "-"
    assert shown["Detected, of attacks"] == "0/6"
    assert further[[row[0] for row in further].index("n" * 64)][-1] == "7 failed"
    attacked = {row[0]: row[1:] for row in by_attack}
    assert attacked["n" * 64] == ["0/3 (0)", "0/3 (0)"]
    assert attacked["correlation"][1].startswith("0/3")


def test_what_is_carried_to_another_class_is_counted_not_averaged(made_up):
    board = made_up(
        "board",
        made_up("table", made_up("row")),
        transfer=(
            TransferRow("mine", "phone", "car", 1.234, 7, 3.5, 2, 4),
            TransferRow("odd", "phone", "car", None, 0, 0.0, 0, 0),
        ),
    )
    grid = grids(markdown(board))[-1]
    assert grid[2] == ["mine", "phone", "car", "1.23", "7 in 3.50 h", "2/4"]
    assert grid[3] == ["odd", "phone", "car", "-", "-", "-"]


def test_detectable_strength_is_given_or_censored_and_said(made_up):
    strength = np.array([1.0, 4.0])
    shares = {
        "seen": np.array([0.25, 0.75]),
        "strong": np.array([0.6, 0.95]),
        "weak": np.array([0.0, 0.1]),
    }
    rows = [made_up("row", name) for name in shares]
    board = made_up(
        "board",
        made_up("table", *rows),
        made_up("table", *rows, input_class="gnss+imu"),
        severity=tuple(
            SeverityRow(
                "injected", "gnss", name, "drag-off", SeverityCurve(strength, np.array(s), 20, 5)
            )
            for name, s in shares.items()
        ),
    )
    text = markdown(board)
    assert text.count("Detectable strength") == 1
    found = {row[0]: row[2:] for grid in grids(text) for row in grid if row[1] == "drag-off"}
    assert found == {
        "seen": ["2", "\\> 4", "20", "5"],
        "strong": ["\\<= 1", "3.28", "20", "5"],
        "weak": ["\\> 4", "\\> 4", "20", "5"],
    }


def test_hostile_names_stay_one_cell_and_plain_text(hostile_folder):
    text = markdown(leaderboard(hostile_folder))
    assert all(len(row) == len(grid[0]) for grid in grids(text) for row in grid)
    assert not re.search(r"(?<!\\)<", text)
    assert "\x1b" not in text
