"""The leaderboard in the terminal: in 80 columns nothing that misleads."""

import io
import re

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rich.console import Console

from spoofbench.report import print_leaderboard
from spoofbench.report.columns import FALSE_ALERTS, RANK
from spoofbench.report.marks import MEANINGS
from spoofbench.scoring.leaderboard import AbsentDetector, leaderboard


def terminal(board, width=80):
    console = Console(file=io.StringIO(), width=width, force_terminal=False)
    print_leaderboard(board, console)
    return console.file.getvalue()


def words(text):
    return " ".join(text.split())


@given(st.data())
@settings(max_examples=25, suppress_health_check=[HealthCheck.too_slow], deadline=None)
def test_any_board_fits_80_columns_and_cuts_nothing_off(boards, data):
    board = data.draw(boards)
    text = terminal(board)
    assert max(map(len, text.splitlines())) <= 80
    assert "\N{HORIZONTAL ELLIPSIS}" not in text
    assert "\x1b" not in text
    for table in board.tables:
        for row in table.rows:
            false_alerts = FALSE_ALERTS.entry(table, row)
            assert false_alerts.text in text
            assert false_alerts.interval in text


@pytest.mark.parametrize("width", [60, 80, 200])
def test_a_console_of_any_width_is_at_most_80_columns_wide(folder, width):
    text = terminal(leaderboard(folder), width)
    assert max(map(len, text.splitlines())) <= min(width, 80)
    assert "\N{HORIZONTAL ELLIPSIS}" not in text


def test_a_ranked_row_has_its_interval_and_its_placebo(made_up):
    figures = made_up(
        "figures", far_per_hour=2.0, far_per_hour_lo=0.5, far_per_hour_hi=7.0, detected=3
    )
    rows = [made_up("row", "a", ranked=figures), made_up("row", "b", rank=2, ranked=figures)]
    text = terminal(made_up("board", made_up("table", *rows)))
    for rank, name in (("1", "a"), ("2", "b")):
        (line,) = re.findall(rf"^ *{rank} {name} .*$", text, re.MULTILINE)
        assert words(line) == f"{rank} {name} 2.00 0.50 to 7.00 3/4 (1) 5.0 - -"


def test_figures_that_leave_no_room_for_names_take_a_second_table(made_up):
    figures = made_up(
        "figures",
        far_per_hour=1.2e6,
        far_per_hour_lo=1.1e6,
        far_per_hour_hi=1.3e6,
        detected=0,
        attacks=1234,
        placebo_attacks=1234,
        restricted_mean_ttfd_s=1e6,
        error_before_alert_median_m=1.4e6,
        error_before_alert_largest_m=1.5e6,
    )
    row = made_up("row", "innovation-windowed", ranked=figures)
    text = terminal(made_up("board", made_up("table", row, windows=1234)))
    assert max(map(len, text.splitlines())) <= 80
    assert len(re.findall("^ *1 innovation", text, re.MULTILINE)) == 2
    for shown in ("1,100,000 to 1,300,000", "0/1234 (1)", "> 1,000,000", "1,500,000"):
        assert shown in text


def test_a_share_with_an_interval_shows_it_beneath(made_up):
    figures = made_up("figures", detected_share_lo=0.512, detected_share_hi=0.996)
    text = terminal(made_up("board", made_up("table", made_up("row", ranked=figures))))
    assert (
        re.search(r"^ +51-100 %$", text.replace("  \n", "\n"), re.MULTILINE) or "51-100 %" in text
    )


def test_a_single_window_is_told_and_has_no_percentage(made_up):
    hit = made_up("figures", detected=1, attacks=1, placebo_detected=None, placebo_attacks=0)
    miss = made_up(
        "figures",
        detected=0,
        attacks=1,
        placebo_detected=None,
        placebo_attacks=0,
        restricted_mean_ttfd_s=60.0,
    )
    rows = [made_up("row", "seer", ranked=hit), made_up("row", "blind", ranked=miss)]
    table = made_up("table", *rows, windows=1, provenance="real attack", attacks=("as recorded",))
    text = words(terminal(made_up("board", table)))
    assert "seer 0 0 to 3.69 detected after 5.0 s (-)" in text
    assert "blind 0 0 to 3.69 missed in 60.0 s (-)" in text
    assert "anecdote" in text
    assert "no placebo" in text
    assert "100 %" not in text
    assert "1/1" not in text
    assert "TTFD mean" not in text


def test_unknown_is_a_dash(made_up):
    nothing = made_up(
        "figures",
        far_per_hour=None,
        far_per_hour_lo=None,
        far_per_hour_hi=None,
        detected=0,
        attacks=0,
        placebo_detected=None,
        placebo_attacks=0,
        restricted_mean_ttfd_s=None,
        longest_attack_s=None,
    )
    table = made_up("table", made_up("row", rank=None, ranked=nothing), windows=0, attacks=())
    assert "- mine - - - - - -" in words(terminal(made_up("board", table)))


def test_many_attacks_take_several_tables(make, tmp_path):
    attacks = [f"attack-{number}" for number in range(30)]
    text = terminal(leaderboard(make(tmp_path, ["only"], attacks, 300)))
    assert max(map(len, text.splitlines())) <= 80
    assert len(re.findall(r"^only +[0-3]/3 ", text, re.MULTILINE)) > 1
    assert all(f"attack-{number}" in words(text) for number in range(30))


def test_it_says_what_the_thresholds_are_and_what_the_numbers_rest_on(folder, calibrated_folder):
    text = words(terminal(leaderboard(folder)))
    assert "Attacks injected into real recordings, detectors of gnss" in text
    assert "6 attacks in 3 disjoint windows of 1 recording of 1 session; 0.16 clean h" in text
    assert "sensor class car; thresholds as published, the target is 1 FA/h." in text
    text = words(terminal(leaderboard(calibrated_folder)))
    assert "Real attacks, detectors of gnss" in text
    assert "sensor class car; thresholds calibrated for 1 FA/h." in text


def test_every_note_of_the_leaderboard_is_printed(folder, calibrated_folder):
    for path in (folder, calibrated_folder):
        board = leaderboard(path)
        text = words(terminal(board))
        notes = [note for table in board.tables for note in table.notes]
        assert notes
        assert all(note in text for note in notes)


def test_every_mark_that_is_shown_is_explained_and_no_other(made_up):
    rows = [
        made_up("row", "a", is_fitted=True),
        made_up("row", "b", rank=2, told_apart=False, sessions_needed=12),
        made_up("row", "c", rank=3, keeps_target=False, not_better_than="jump"),
        made_up("row", "d", rank=None, apart="it is odd", failed=2, reasons=("no luck",)),
    ]
    text = terminal(made_up("board", made_up("table", *rows)))
    shown = [letter for letter, meaning in MEANINGS.items() if f"{letter}: {meaning}"[:70] in text]
    assert shown == ["*", "=", "<", "a", "f", "!"]
    flat = words(text)
    assert "<: jump is as good or better." in flat
    assert "=: about 12 sessions could tell them apart from the first." in flat
    assert "a: d: it is odd." in flat
    assert "!: d: 2 of 7 tasks, such as: no luck" in flat


def test_a_row_without_calibrated_threshold_says_that_its_figures_are_others(made_up):
    row = made_up("row", rank=None, ranked=None, threshold="uncalibratable")
    text = words(terminal(made_up("board", made_up("table", row))))
    assert re.search(r"- mine 0 0 to 3.69 4/4 \(1\) 5.0 - - u", text)
    assert f"u: {MEANINGS['u']}" in text


def test_nobody_is_left_out_in_silence(made_up):
    absent = (AbsentDetector("receiver-flag", "the recording has no flag"),)
    for tables in ((), (made_up("table", made_up("row")),)):
        text = words(terminal(made_up("board", *tables, absent=absent)))
        assert "receiver-flag is in no table: the recording has no flag." in text
    assert "Nothing could be judged" in words(terminal(made_up("board")))


def test_hostile_names_are_plain_text(hostile_folder):
    text = terminal(leaderboard(hostile_folder))
    assert "\x1b" not in text
    assert "[red]" in "".join(text.split())


def test_ranks_are_those_of_the_leaderboard(folder):
    (table,) = leaderboard(folder).tables
    text = terminal(leaderboard(folder))
    for row in table.rows:
        if row.rank is not None:
            assert re.search(rf"^ *{RANK.entry(table, row).text} {row.detector[:10]}", text, re.M)
