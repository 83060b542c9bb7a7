"""The leaderboard: what is compared with what, who stands above whom, and what is pooled how."""

from dataclasses import asdict, replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import pytest
from scipy import stats

from spoofbench.errors import ResultsError
from spoofbench.results import FAILURES, write_run, write_tasks
from spoofbench.scoring.leaderboard import BoardTable, Leaderboard, LeaderboardRow, leaderboard
from spoofbench.scoring.statistics import survival_curve

WINDOW_S = 60.0


def ranked(bench: Any) -> Leaderboard:
    bench.score()
    return leaderboard(bench.path)


def only_table(bench: Any) -> BoardTable:
    (table,) = ranked(bench).tables
    return table


def rows(bench: Any) -> dict[str, LeaderboardRow]:
    return {row.detector: row for row in only_table(bench).rows}


def add(
    bench: Any, detector: str, false: range | list[int], hits: range | list[int], **about: Any
) -> None:
    bench.add(detector, alerts=false, **about)
    bench.add(detector, "replay", alerts=hits, **about)


def test_rows_that_keep_the_target_come_first_then_detection_then_time(bench: Any) -> None:
    everywhere = range(200)
    add(bench, "always", everywhere, everywhere)
    add(bench, "late", [], range(130, 160))
    add(bench, "early", [], range(100, 101))
    add(bench, "noisy", range(0, 200, 20), range(101, 160))
    add(bench, "never", [], [])
    table = only_table(bench)
    assert [row.detector for row in table.rows] == ["early", "late", "never", "noisy", "always"]
    assert [row.rank for row in table.rows] == [1, 2, 3, 4, 5]
    assert [row.keeps_target for row in table.rows] == [True, True, True, False, False]


def test_the_share_of_alerted_epochs_never_ranks(bench: Any) -> None:
    """A latch alerts longer, not more."""
    add(bench, "latch", [], range(111, 160))
    add(bench, "short", [], range(110, 112))
    assert [row.detector for row in only_table(bench).rows] == ["short", "latch"]


def test_one_false_alert_in_a_short_recording_does_not_prove_that_the_target_is_exceeded(
    bench: Any,
) -> None:
    add(bench, "once", [50], range(100, 160))
    row = rows(bench)["once"]
    assert row.published.far_per_hour == pytest.approx(18)
    assert row.published.far_per_hour_lo == pytest.approx(stats.chi2.ppf(0.025, 2) / 2 * 18)
    assert row.keeps_target is True


@pytest.mark.parametrize(("false", "keeps"), [([50], True), ([20, 40, 60, 80], False)])
def test_few_sessions_have_no_interval_and_keep_the_target_as_if_they_were_one(
    bench: Any, false: list[int], keeps: bool
) -> None:
    """Twice 200 s: one episode says nothing of a target of 1/h, eight say that it is exceeded."""
    bench.suite |= {"target_far_per_hour": 1.0}
    for session in ("one", "two"):
        place = {"recording": session, "session": session}
        add(bench, "d", false if session == "one" or not keeps else [], range(100, 160), **place)
    table = only_table(bench)
    row = table.rows[0]
    assert row.published.far_per_hour_lo is None
    assert row.published.far_per_hour == pytest.approx(len(false) * (1 if keeps else 2) * 9)
    assert row.keeps_target is keeps
    assert "the order is no claim" in " ".join(table.notes)


def test_equals_share_a_rank(bench: Any) -> None:
    for detector in ("a", "b", "c"):
        add(bench, detector, [], range(110, 160) if detector != "c" else [])
    assert {name: row.rank for name, row in rows(bench).items()} == {"a": 1, "b": 1, "c": 3}


def test_a_class_of_one_row_has_no_rank(bench: Any) -> None:
    add(bench, "mine", [], range(110, 160))
    add(bench, "never", [], [], baseline=True)
    found = rows(bench)
    assert (found["mine"].rank, found["mine"].apart) == (None, "the only row of its class")
    assert (found["never"].rank, found["never"].apart) == (None, "")


def test_false_alerts_are_pooled_by_time(bench: Any) -> None:
    bench.add("d", alerts=[10, 50], recording="one", session="one")
    bench.add(
        "d",
        alerts=range(150),
        unavailable=range(100, 400),
        recording="two",
        session="two",
        epochs=400,
    )
    figures = rows(bench)["d"].published
    assert figures.far_per_hour == pytest.approx((2 + 2) / (300 / 3600))
    assert figures.far_floor_per_hour == pytest.approx(3 / (300 / 3600))
    assert figures.alarm_share == pytest.approx((2 + 100) / 300)
    assert figures.availability == 0.5


def test_who_has_no_result_on_a_cell_of_the_support_has_missed_it(bench: Any) -> None:
    """Whatever became of it: failed, timed out, ran out of memory, skipped or never available."""
    fates = ("ok", "failed", "timeout", "out_of_memory", "skipped")
    for number, fate in enumerate(fates):
        place = {"recording": f"r{number}", "session": f"s{number}"}
        add(bench, "whole", [], range(110, 160), **place)
        bench.add("lazy", **place)
        bench.add("lazy", "replay", alerts=range(100, 160), status=fate, **place)
        bench.add("blind", unavailable=range(200), **place)
        bench.add("blind", "replay", alerts=range(200), unavailable=range(200), **place)
    table = only_table(bench)
    assert [(row.detector, row.rank) for row in table.rows] == [
        ("whole", 1),
        ("lazy", 2),
        ("blind", 3),
    ]
    _, lazy, blind = table.rows
    assert (lazy.published.detected, lazy.published.attacks) == (1, 5)
    assert lazy.published.restricted_mean_ttfd_s == pytest.approx(4 * WINDOW_S / 5)
    assert lazy.published.detection_pct == pytest.approx(20)
    assert (lazy.failed, lazy.skipped, lazy.ok) == (3, 1, 6)
    assert (blind.published.detected, blind.published.availability) == (0, 0)
    assert table.windows == 5


def test_a_window_that_nobody_was_scored_on_is_faced_by_all_or_none(bench: Any) -> None:
    """All detectors failed on it: all have missed it, where the variant was made."""
    for detector in ("a", "b"):
        add(bench, detector, [], range(110, 160))
        bench.add(detector, "meacon", status="skipped")
    assert {row.published.attacks for row in rows(bench).values()} == {2}
    tasks = [replace(t, kinds=None) if t.attack == "meacon" else t for t in bench.tasks]
    bench.tasks[:] = tasks
    assert {row.published.attacks for row in rows(bench).values()} == {1}


def test_a_row_that_requires_more_stands_apart(bench: Any) -> None:
    """It is judged on the windows that have what it requires, and has no rank among the others."""
    poor = {"kinds": '["gnss/pvt"]', "recording": "poor"}
    for detector in ("a", "b", "wants-more"):
        requires = '["gnss/integrity"]' if detector == "wants-more" else '["gnss/pvt"]'
        rich = {"kinds": '["gnss/integrity","gnss/pvt"]', "requires": requires}
        add(bench, detector, [], range(100, 160), **rich)
        if detector == "wants-more":
            bench.add(detector, status="skipped", **poor, requires=requires)
            bench.add(detector, "replay", status="skipped", **poor, requires=requires)
        else:
            add(bench, detector, [], range(120, 160), **poor, requires=requires)
    found = rows(bench)
    assert (found["a"].rank, found["b"].rank) == (1, 1)
    assert found["wants-more"].rank is None
    assert found["wants-more"].apart.startswith("judged on 1 of 2 windows: it requires more")


def test_what_was_not_modelled_is_no_part_of_the_support_of_who_looks_at_it(bench: Any) -> None:
    for detector in ("a", "b"):
        about = {"input_class": "gnss+signal"}
        kinds = '["gnss/pvt","gnss/signal"]'
        bench.add(detector, kinds=kinds, **about)
        bench.add(detector, "replay", alerts=range(110, 160), kinds=kinds, **about)
        bench.add(detector, "drag-off", kinds='["gnss/pvt"]', status="not_modelled", **about)
    for name in ("x", "y"):
        bench.add(name, kinds='["gnss/pvt","gnss/signal"]')
        bench.add(name, "replay", kinds='["gnss/pvt","gnss/signal"]')
        bench.add(name, "drag-off", kinds='["gnss/pvt"]', alerts=[110])
    signal, plain = ranked(bench).tables
    assert (signal.input_class, signal.windows, signal.attacks) == ("gnss+signal", 1, ("replay",))
    assert (plain.input_class, plain.windows, plain.attacks) == ("gnss", 2, ("replay", "drag-off"))
    assert {row.detector for row in signal.rows} == {"a", "b"}
    assert {row.detector for row in plain.rows} == {"x", "y"}


def test_provenances_are_never_averaged(bench: Any) -> None:
    for detector in ("a", "b"):
        add(bench, detector, [], range(110, 160))
        place = {"recording": "sim", "session": "sim", "provenance": "simulated"}
        add(bench, detector, [20, 60], [], **place)
        bench.add(
            detector,
            "as recorded",
            alerts=[10, *range(100, 160)],
            recording="real",
            session="real",
            provenance="real attack",
        )
    real, injected, simulated = ranked(bench).tables
    assert [t.provenance for t in (real, injected, simulated)] == [
        "real attack",
        "injected",
        "simulated",
    ]
    assert [t.rows[0].published.detected for t in (real, injected, simulated)] == [1, 1, 0]
    assert [t.rows[0].published.episodes for t in (real, injected, simulated)] == [1, 1, 2]
    assert real.rows[0].published.placebo_attacks == 0, "it has no clean twin"


@pytest.mark.parametrize("said", [False, True])
def test_fused_positions_are_not_ranked_against_an_imu_unless_the_suite_says_so(
    bench: Any, said: bool
) -> None:
    bench.suite["ranks_fused"] = ["phone"] if said else []
    for detector in ("a", "b"):
        about = {"input_class": "gnss+imu"}
        add(bench, detector, [], range(110, 160), **about)
        fused = {"recording": "phone", "session": "phone", "sensor_class": "phone"}
        add(bench, detector, [20], [], is_fused=True, **fused, **about)
    for detector in ("x", "y"):
        add(bench, detector, [], range(110, 160))
        add(bench, detector, [20], [], is_fused=True, **fused)
    held, plain = ranked(bench).tables
    assert (held.windows, plain.windows) == (2 if said else 1, 2)
    assert [row.published.episodes for row in held.rows] == [1, 1] if said else [0, 0]
    words = " ".join(held.notes)
    assert ("Left out: 1 recording with positions" in words) == (not said)
    assert ("fused with inertial sensors, which hides" in words) == said


def test_baselines_of_fewer_inputs_stand_in_the_table_without_a_rank(bench: Any) -> None:
    for detector in ("a", "b"):
        add(bench, detector, [], range(110, 160), input_class="gnss+imu")
    add(bench, "never", [], [], baseline=True)
    add(bench, "lucky", [], range(105, 160), baseline=True)
    (table,) = ranked(bench).tables
    found = {row.detector: row for row in table.rows}
    assert (found["never"].rank, found["lucky"].rank, found["a"].rank) == (None, None, 1)
    assert found["a"].not_better_than == found["b"].not_better_than == "lucky"


def test_detection_has_an_interval_from_five_sessions_on(bench: Any) -> None:
    for sessions in range(1, 7):
        bench.add(
            "d",
            "replay",
            alerts=range(100 + sessions, 160),
            recording=f"r{sessions}",
            session=f"s{sessions}",
        )
        table = only_table(bench)
        figures = table.rows[0].published
        assert table.sessions == table.recordings == sessions
        assert figures.detection_pct is not None
        if sessions < 5:
            assert (figures.detection_pct_lo, figures.detected_share_lo) == (None, None)
        else:
            assert figures.detection_pct_lo is not None
            assert figures.detection_pct_hi is not None
            assert figures.detection_pct_lo < figures.detection_pct < figures.detection_pct_hi
            assert figures.detected_share_lo is not None
            assert figures.detected_share_lo < 1, "five of five are no proof"


def test_the_table_says_what_its_evidence_cannot_show(bench: Any) -> None:
    add(bench, "d", [], range(110, 160))
    notes = only_table(bench).notes
    assert notes == (
        "Thresholds are the published ones: nothing here has set them.",
        "0.056 clean hours cannot tell a rate of 54 false alerts per hour from none.",
        (
            "1 session orders detectors on what was recorded; how they do elsewhere, and "
            "whether the order holds, it takes more to say."
        ),
    )


def test_a_row_that_needs_more_input_than_the_suite_gives_stands_apart(bench: Any) -> None:
    bench.suite["warm_up_s"] = 30.0
    add(bench, "quick", [], range(110, 160), warm_up_s=30.0)
    add(bench, "other", [], range(110, 160))
    add(bench, "slow", [], range(100, 160), warm_up_s=31.0)
    found = rows(bench)
    assert (found["quick"].rank, found["other"].rank, found["slow"].rank) == (1, 1, None)
    assert found["slow"].apart == "it needs 31 s of input, the suite gives 30 s"


def test_scores_of_other_tasks_are_refused(bench: Any, tmp_path: Path) -> None:
    bench.add("d")
    bench.score()
    bench.tasks[:] = [replace(bench.tasks[0], task_id="another")]
    write_tasks(bench.path, bench.tasks)
    with pytest.raises(ResultsError, match="score it again"):
        leaderboard(bench.path)
    write_tasks(tmp_path / "empty", [])
    write_run(tmp_path / "empty", {})
    with pytest.raises(ResultsError, match="no tasks"):
        leaderboard(tmp_path / "empty")


def random_bench(bench: Any, rng: np.random.Generator) -> None:
    """Fill a folder with detectors, recordings and attacks, and tasks that went well or not."""
    statuses = ["ok"] * 5 + ["failed", "timeout", "out_of_memory", "skipped"]
    detectors, attacks = (f"d{n}" for n in range(rng.integers(1, 4))), range(rng.integers(1, 4))
    crossing = [(r, a) for r in range(rng.integers(1, 6)) for a in (None, *attacks)]
    for detector in detectors:
        for recording, attack in crossing:
            window = (100, 160) if attack is None else (int(100 + 5 * attack), 130 + 10 * attack)
            bench.add(
                detector,
                None if attack is None else f"a{attack}",
                window,
                alerts=np.flatnonzero(rng.random(200) < rng.choice([0, 0.01, 0.1])).tolist(),
                unavailable=np.flatnonzero(rng.random(200) < 0.1).tolist(),
                status=str(rng.choice(statuses)),
                recording=f"r{recording}",
                session=f"s{recording % 3}",
            )


def by_loop(bench: Any, detector: str, attack: str | None = None) -> dict[str, Any]:
    """Figures of a detector, or of its cell against one attack, by walking all rows."""
    events = {(e["task_id"], e["start_ns"]): e for e in bench.rows("events")}
    scores = {row["task_id"]: row for row in bench.rows("scores")}
    own = [task for task in bench.tasks if task.detector == detector]
    of_task = {task.task_id: task.variant_id for task in bench.tasks}
    whole_m = {
        (of_task[e["task_id"]], e["start_ns"]): e["largest_error_m"] for e in events.values()
    }
    hits, observed_s, lengths_s, epochs, errors_m = [], [], [], [], []
    for task in own:
        if task.attack is None or (attack is not None and task.attack != attack):
            continue
        length_s = (task.window_end_ns - task.window_start_ns) / 1e9
        event = events.get((task.task_id, task.window_start_ns))
        hit = event is not None and event["detected"]
        hits.append(hit)
        lengths_s.append(length_s)
        observed_s.append(event["ttfd_s"] if event is not None and hit else length_s)
        epochs.append((task.session, 0.0 if event is None else event["alerted_share"]))
        error_m = (
            whole_m.get((task.variant_id, task.window_start_ns))
            if event is None
            else event["largest_error_before_alert_m"]
        )
        errors_m += [] if error_m is None else [error_m]
    curve = survival_curve(observed_s, np.array(hits))
    sessions = sorted({session for session, _ in epochs})
    shares = [np.mean([share for name, share in epochs if name == s]) for s in sessions]
    found = {
        "detected": sum(hits),
        "attacks": len(hits),
        "detection_pct": pytest.approx(100 * np.mean(shares)),
        "restricted_mean_ttfd_s": pytest.approx(np.mean(observed_s))
        if len(set(lengths_s)) == 1
        else curve and curve.restricted_mean_s(max(lengths_s)),
        "ttfd_median_s": curve and curve.quantile_s(0.5),
        "error_before_alert_median_m": median(errors_m) if errors_m else None,
        "error_before_alert_largest_m": max(errors_m, default=None),
    }
    if attack is not None:
        return found
    clean = [scores[task.task_id] for task in own if task.attack is None]
    hours = sum(row["available_clean_h"] or 0 for row in clean)
    episodes = sum(row["episodes"] or 0 for row in clean)
    return found | {
        "episodes": episodes,
        "clean_h": pytest.approx(hours),
        "far_per_hour": pytest.approx(episodes / hours) if hours else None,
    }


@pytest.mark.parametrize("seed", range(12))
def test_figures_agree_with_a_loop_over_all_rows(bench: Any, seed: int) -> None:
    random_bench(bench, np.random.default_rng(seed))
    table = only_table(bench)
    assert {row.detector for row in table.rows} == {task.detector for task in bench.tasks}
    for index, row in enumerate(table.rows):
        expected = by_loop(bench, row.detector)
        assert {name: asdict(row.published)[name] for name in expected} == expected
        own = [task.status for task in bench.tasks if task.detector == row.detector]
        assert row.failed == sum(status in FAILURES for status in own)
        assert (row.ok, row.skipped) == (own.count("ok"), own.count("skipped"))
        for cell in table.cells_of(index):
            expected = by_loop(bench, cell.detector, cell.attack)
            assert {name: asdict(cell.figures)[name] for name in expected} == expected
    assert [(cell.detector, cell.attack) for cell in table.cells] == [
        (row.detector, attack) for row in table.rows for attack in table.attacks
    ]
