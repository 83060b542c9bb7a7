"""Laws of a judgement, from decisions to the leaderboard: what may not change it, and what may not
change it for the better.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spoofbench.detector import Decisions
from spoofbench.results import read_truth, write_truth
from spoofbench.scoring.calibration import episode_curve, threshold, total
from spoofbench.scoring.leaderboard import BoardTable, LeaderboardRow, leaderboard
from spoofbench.scoring.statistics import rate_interval
from tests.scoring.conftest import EPOCHS, Bench, truth_of

S = 1_000_000_000
TARGET_PER_HOUR = 40.0
LEAVE_ONE_OUT = {"split": "leave-one-session-out", "until_s": None, "classes": None}
WINDOW = (100, 160)


def new_bench(factory: pytest.TempPathFactory, **suite: Any) -> Bench:
    bench = Bench(factory.mktemp("bench"))
    bench.suite |= suite
    return bench


def only_table(bench: Bench) -> BoardTable:
    bench.score()
    (table,) = leaderboard(bench.path).tables
    return table


def row_of(bench: Bench, detector: str = "d") -> LeaderboardRow:
    (row,) = (row for row in only_table(bench).rows if row.detector == detector)
    return row


def add_scores(
    bench: Bench,
    detector: str,
    session: str,
    clean: Sequence[float],
    attacked: Sequence[float] | None,
    **about: Any,
) -> None:
    """Add one session, on which others calibrate: scores at 1 Hz as it is, and under attack."""
    place = {"recording": session, "session": session, "held_out": f'["{session}"]', **about}
    part = {"calibration_start_ns": 0, "calibration_end_ns": EPOCHS * S}
    for attack, scores, more in ((None, clean, part), ("replay", attacked, {})):
        if scores is not None:
            values = np.asarray(scores, float)
            made = Decisions(np.arange(EPOCHS) * S, values, ~np.isnan(values))
            bench.add(detector, attack, WINDOW, decisions=made, **place, **more)


def sixty_fourths(rng: np.random.Generator) -> Any:
    """Scores that a factor cannot merge, some unavailable."""
    values = np.ceil(64 * rng.exponential(0.4, EPOCHS)) / 64
    values[rng.random(EPOCHS) < 0.05] = np.nan
    return values


@pytest.mark.slow
@settings(deadline=None, max_examples=15)
@given(scale=st.floats(-3, 3).map(lambda power: 10.0**power), seed=st.integers(0, 9))
def test_scores_times_a_constant_change_nothing_at_the_calibrated_point(
    tmp_path_factory: pytest.TempPathFactory, scale: float, seed: int
) -> None:
    suite = {"target_far_per_hour": TARGET_PER_HOUR, "calibration": LEAVE_ONE_OUT}
    rng = np.random.default_rng(seed)
    own, rival = new_bench(tmp_path_factory, **suite), new_bench(tmp_path_factory, **suite)
    for number in range(3):
        clean, attacked, other = (sixty_fourths(rng) for _ in range(3))
        attacked[130:140] += rng.choice([0, 1, 5])
        for bench, factor in ((own, 1.0), (rival, scale)):
            add_scores(bench, "d", f"s{number}", factor * clean, factor * attacked)
            add_scores(bench, "other", f"s{number}", other, attacked)
    tables = [only_table(bench) for bench in (own, rival)]
    for before, after in zip(*(table.rows for table in tables), strict=True):
        assert before.threshold == "calibrated"
        for name in ("detector", "rank", "ranked", "threshold", "keeps_target", "told_apart"):
            assert getattr(before, name) == getattr(after, name), name
    assert tables[0].notes == tables[1].notes
    for name in ("scores", "events"):
        for one, two in zip(own.rows(name), rival.rows(name), strict=True):
            if one["point"] == "calibrated":
                expected = one["factor"] * (scale if one["detector"] == "d" else 1)
                assert two["factor"] == pytest.approx(expected)
                assert two | {"factor": one["factor"]} == one


def thresholds(bench: Bench) -> dict[str, tuple[str, float | None]]:
    return {row["detector"]: (row["how"], row["factor"]) for row in bench.rows("calibration")}


def test_what_cannot_be_calibrated_has_no_rank_and_what_is_only_raised_says_so(
    bench: Any,
) -> None:
    """Two sessions of 200 s each: the target of 1/h cannot be shown by the other."""
    bench.suite |= {"target_far_per_hour": 1.0, "calibration": LEAVE_ONE_OUT}
    silent = np.where((np.arange(EPOCHS) >= 110) & (np.arange(EPOCHS) < 120), 9.0, 0.0)
    clean = {
        "louder": np.where(np.arange(EPOCHS) == 50, 3.0, 0.5),
        "quieter": np.full(EPOCHS, 0.5),
        "silent": np.zeros(EPOCHS),
        "endless": np.where(np.arange(EPOCHS) == 50, np.inf, 0.5),
    }
    for detector, scores in clean.items():
        for session in ("one", "two"):
            add_scores(bench, detector, session, scores, np.maximum(scores, silent))
    table = only_table(bench)
    rows = {row.detector: row for row in table.rows}
    assert thresholds(bench) == {
        "louder": ("raised only", 3.0),
        "quieter": ("raised only", 1.0),
        "silent": ("no clean score", 1.0),
        "endless": ("uncalibratable", None),
    }
    assert {name: row.threshold for name, row in rows.items()} == {
        name: how for name, (how, _) in thresholds(bench).items()
    }
    assert [rows[name].rank for name in ("louder", "quieter", "silent")] == [1, 1, 1]
    assert (rows["endless"].rank, rows["endless"].apart) == (None, "uncalibratable")
    assert rows["endless"].ranked is None
    assert rows["endless"].published.detected == 2, "its published figures stand beside"
    assert table.rows[-1].detector == "endless"


def alert_sets(span: range) -> st.SearchStrategy[set[int]]:
    return st.sets(st.sampled_from(list(span)), max_size=12)


@st.composite
def noisy_sessions(draw: st.DrawFn) -> list[tuple[set[int], set[int]]]:
    """False alerts as recorded, and alerts within the attack, of some sessions."""
    one = st.tuples(alert_sets(range(EPOCHS)), alert_sets(range(*WINDOW)))
    count = draw(st.sampled_from([1, 2, 5]))
    return draw(st.lists(one, min_size=count, max_size=count))


def fill(bench: Bench, detector: str, sessions: list[tuple[set[int], set[int]]]) -> None:
    for number, (false, hits) in enumerate(sessions):
        place = {"recording": f"r{number}", "session": f"s{number}"}
        bench.add(detector, alerts=sorted(false), **place)
        before = {second for second in false if second < WINDOW[0]}
        bench.add(detector, "replay", WINDOW, alerts=sorted(hits | before), **place)


def beside(
    factory: pytest.TempPathFactory, sessions: Any, rival: Any, target: float
) -> LeaderboardRow:
    """The row of a detector beside its rival and a baseline."""
    bench = new_bench(factory, target_far_per_hour=target)
    fill(bench, "d", sessions)
    fill(bench, "rival", rival)
    for number in range(len(sessions)):
        place = {"recording": f"r{number}", "session": f"s{number}", "baseline": True}
        bench.add("simple", alerts=[3], **place)
        bench.add("simple", "replay", alerts=[150], **place)
    return row_of(bench)


def as_good(row: LeaderboardRow) -> tuple[int, bool, bool]:
    """Rank, whether it keeps the target, and whether it beats the baselines: least is best."""
    return (row.rank or 0, not row.keeps_target, row.not_better_than is not None)


def not_better(worse: LeaderboardRow, row: LeaderboardRow) -> bool:
    return all(one >= other for one, other in zip(as_good(worse), as_good(row), strict=True))


targets = st.sampled_from([1.0, 10.0, 30.0])


@pytest.mark.slow
@settings(deadline=None, max_examples=20)
@given(sessions=noisy_sessions(), target=targets, data=st.data())
def test_a_further_false_episode_never_improves_a_row(
    tmp_path_factory: pytest.TempPathFactory,
    sessions: list[tuple[set[int], set[int]]],
    target: float,
    data: st.DataObject,
) -> None:
    rival = [(set[int](), hits) for _, hits in sessions]
    number = data.draw(st.integers(0, len(sessions) - 1))
    false, hits = sessions[number]
    apart = [
        second for second in range(EPOCHS) if all(abs(second - other) >= 10 for other in false)
    ]
    if not apart:
        return
    more = [*sessions]
    more[number] = false | {data.draw(st.sampled_from(apart))}, hits
    row = beside(tmp_path_factory, sessions, rival, target)
    worse = beside(tmp_path_factory, more, rival, target)
    assert not_better(worse, row)
    assert worse.published.episodes == row.published.episodes + 1
    for name in ("far_per_hour", "far_per_hour_lo", "far_per_hour_hi", "alarm_share"):
        known = getattr(row.published, name)
        if known is not None:
            assert getattr(worse.published, name) >= known, name
    assert worse.published.detected <= row.published.detected
    assert (worse.published.restricted_mean_ttfd_s or 0) >= (
        row.published.restricted_mean_ttfd_s or 0
    )


@pytest.mark.slow
@settings(deadline=None, max_examples=20)
@given(sessions=noisy_sessions(), target=targets, data=st.data())
def test_detecting_earlier_never_worsens_a_row(
    tmp_path_factory: pytest.TempPathFactory,
    sessions: list[tuple[set[int], set[int]]],
    target: float,
    data: st.DataObject,
) -> None:
    """A first alert that comes earlier, or where there was none, in one attack."""
    rival = [(set[int](), {data.draw(st.integers(*WINDOW)) - 1}) for _ in sessions]
    number = data.draw(st.integers(0, len(sessions) - 1))
    false, hits = sessions[number]
    false = false - {WINDOW[0] - 1}
    sessions = [*sessions]
    sessions[number] = false, hits
    first = min(hits, default=WINDOW[1])
    earlier = [*sessions]
    earlier[number] = false, hits | {data.draw(st.integers(WINDOW[0], max(first - 1, WINDOW[0])))}
    row = beside(tmp_path_factory, sessions, rival, target)
    better = beside(tmp_path_factory, earlier, rival, target)
    assert not_better(row, better)
    assert better.published.detected >= row.published.detected
    for name in (
        "restricted_mean_ttfd_s",
        "error_before_alert_median_m",
        "error_before_alert_p95_m",
        "error_before_alert_largest_m",
    ):
        assert getattr(better.published, name) <= getattr(row.published, name), name
    assert better.published.far_per_hour == row.published.far_per_hour


OF_SESSIONS = {
    "clean_sessions",
    "has_few_episodes",
    *(f"{name}_lo" for name in ("far_per_hour", "detected_share", "detection_pct")),
    *(f"{name}_hi" for name in ("far_per_hour", "detected_share", "detection_pct")),
}
"""What sessions are the unit of."""


@pytest.mark.slow
@settings(deadline=None, max_examples=15)
@given(
    alike=noisy_sessions().map(lambda some: some[:1]),
    names=st.lists(st.integers(0, 5), min_size=6, max_size=6),
)
def test_relabelling_sessions_that_are_alike_changes_nothing_but_intervals(
    tmp_path_factory: pytest.TempPathFactory,
    alike: list[tuple[set[int], set[int]]],
    names: list[int],
) -> None:
    """Six recordings of equal decisions, each a session of its own, or in fewer sessions."""
    figures, ranks = [], []
    for labels in (range(6), names):
        bench = new_bench(tmp_path_factory, target_far_per_hour=1e9)
        for detector, sessions in (("d", alike * 6), ("rival", [(set[int](), {120})] * 6)):
            fill(bench, detector, sessions)
        bench.tasks[:] = [
            replace(task, session=f"s{labels[int(task.recording[1:])]}") for task in bench.tasks
        ]
        table = only_table(bench)
        figures.append({row.detector: asdict(row.published) for row in table.rows})
        ranks.append({row.detector: row.rank for row in table.rows})
    assert ranks[0] == ranks[1]
    for detector, before in figures[0].items():
        for name, value in before.items():
            if name not in OF_SESSIONS:
                assert figures[1][detector][name] == pytest.approx(value), name


def test_the_names_of_sessions_say_nothing(tmp_path_factory: pytest.TempPathFactory) -> None:
    rng = np.random.default_rng(4)
    scores = [(sixty_fourths(rng), sixty_fourths(rng)) for _ in range(6)]
    tables = []
    for names in (["a", "b", "c", "d", "e", "f"], ["f", "a", "e", "c", "b", "d"]):
        suite = {"target_far_per_hour": TARGET_PER_HOUR, "calibration": LEAVE_ONE_OUT}
        bench = new_bench(tmp_path_factory, **suite)
        for name, (clean, attacked) in zip(names, scores, strict=True):
            add_scores(bench, "d", name, clean, attacked)
            add_scores(bench, "other", name, attacked, clean)
        tables.append(only_table(bench))
    assert tables[0] == tables[1]


def test_of_a_real_attack_what_was_not_reviewed_is_neither_attacked_nor_clean(
    bench: Any,
) -> None:
    """Reviewed until 170 s: two false alerts, a detection, and an alarm that nobody can judge."""
    for detector, alerts in (("d", [20, 60, 110, 180, 195]), ("other", [])):
        place = {"recording": "real", "session": "real", "provenance": "real attack"}
        bench.add(detector, "as recorded", WINDOW, alerts=alerts, **place)
    truth = truth_of([WINDOW])
    write_truth(
        bench.path,
        bench.tasks[0].variant_id,
        replace(
            truth,
            reviewed=truth.time_ns < 170 * S,
            position_error_m=np.full(EPOCHS, np.nan),
        ),
        ["gnss/pvt"],
    )
    assert read_truth(bench.path, bench.tasks[0].variant_id).reviewed.sum() == 170
    row = row_of(bench)
    figures = row.published
    assert (figures.detected, figures.attacks, figures.episodes) == (1, 1, 2)
    assert figures.clean_h == pytest.approx(100 / 3600), "the guard of 10 s ends the review"
    assert (figures.placebo_detected, figures.placebo_attacks) == (None, 0)
    assert figures.error_before_alert_median_m is None, "where it was truly is not known"
    assert not any(task.calibrates for task in bench.tasks)


@pytest.mark.slow
@pytest.mark.parametrize("spread", [0.0, 0.15])
def test_a_threshold_of_half_of_the_sessions_keeps_the_target_on_the_other_half(
    spread: float,
) -> None:
    """Over many simulations the interval that is printed covers the target in at least 92 %,
    where sessions are of one kind, and where they differ in how noisy they are.
    """
    rng = np.random.default_rng(7)
    target, trials, covered = 4.0, 120, 0

    def session() -> Any:
        rows = 1800
        white = np.convolve(rng.standard_normal(rows + 4), np.ones(5) / math.sqrt(5), "valid")
        level = np.exp(0.4 * white) * math.exp(spread * rng.standard_normal())
        return episode_curve(2 * S * np.arange(rows), level, np.ones(rows, bool), 2 * S)

    for _ in range(trials):
        curves = [session() for _ in range(16)]
        found = threshold(total(curves[:8]), target)
        assert found.factor is not None
        rate = rate_interval(
            [curve.episodes_at(found.factor) for curve in curves[8:]],
            [curve.hours for curve in curves[8:]],
        )
        assert rate is not None
        covered += rate.lo <= target <= rate.hi
    assert covered >= 0.92 * trials
