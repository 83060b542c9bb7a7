"""The grid: every epoch that a receiver owed, once, with its truth and its decision."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spoofbench.detector import Decisions
from spoofbench.errors import LimitError, RecordingError
from spoofbench.recording import Interval, Recording
from spoofbench.results import Truth
from spoofbench.scoring.grid import build_truth, default_hold_s, release_guard, score_on_grid
from spoofbench.table import Table

S = 1_000_000_000
TOPIC = "/gnss0/gnss/pvt"


def recording(seconds: list[float], north_m: float = 0.0, **columns: object) -> Recording:
    time_ns = np.array([round(s * S) for s in seconds], np.int64)
    n = time_ns.size
    pvt = {
        "lat_deg": np.full(n, 40.0 + north_m / 111_035.0),
        "lon_deg": np.full(n, -105.0),
        "height_m": np.full(n, 1600.0),
        "vel_n_mps": np.full(n, 3.0),
        "vel_e_mps": np.full(n, 4.0),
        "vel_d_mps": np.zeros(n),
        **columns,
    }
    return Recording({TOPIC: Table("gnss/pvt", time_ns, pvt)})


def attacked(seconds: list[float], windows: list[tuple[int, int]], **kwargs: float) -> Recording:
    start_ns, end_ns = (np.array(bounds, np.int64) * S for bounds in zip(*windows, strict=True))
    truth = Table(
        "truth/attack",
        start_ns,
        {"start_ns": start_ns, "end_ns": end_ns, "attack": ["replay"] * len(windows)},
    )
    return recording(seconds, **kwargs).replace({"/truth/attack": truth})


def really_attacked(
    seconds: list[float], attacks: list[tuple[int, int]], clean: list[tuple[int, int]]
) -> Recording:
    """A recording with labels of a real attack."""
    tables = {}
    for topic, windows in (("truth/attack", attacks), ("truth/clean", clean)):
        bounds = np.array(windows, np.int64).reshape(-1, 2) * S
        tables[topic] = Table(
            topic, bounds[:, 0], {"start_ns": bounds[:, 0], "end_ns": bounds[:, 1]}
        )
    real = tables["truth/attack"].replace(provenance=["real"] * len(attacks))
    return recording(seconds).replace(
        {"/truth/attack": real, "/truth/clean": tables["truth/clean"]}
    )


def seconds(truth: Truth) -> list[float]:
    return (truth.time_ns / S).tolist()


def test_an_unattacked_recording_is_its_own_truth() -> None:
    clean = recording([0, 1, 2, 3])
    truth = build_truth(clean, clean)
    assert seconds(truth) == [0, 1, 2, 3]
    assert truth.epoch_ns == S
    assert truth.observed.all()
    assert not truth.spoofed.any()
    assert not truth.guard.any()
    assert (truth.position_error_m == 0).all()
    assert (truth.velocity_error_mps == 0).all()
    assert truth.intervals == ()


def test_gaps_get_nominal_epochs() -> None:
    clean = recording([0, 1, 2, 5.2, 6.2])
    truth = build_truth(clean, clean)
    assert seconds(truth) == [0, 1, 2, 3, 4, 5.2, 6.2]
    assert truth.observed.tolist() == [True, True, True, False, False, True, True]
    assert np.isnan(truth.lat_deg[3:5]).all()
    assert np.isnan(truth.position_error_m[3:5]).all()


@pytest.mark.parametrize("kept", [[0, 1, 2, 3], [0, 1, 2, 6.01, 7.0], [4, 5], []])
def test_epochs_that_an_attack_deletes_stay_on_the_grid(kept: list[float]) -> None:
    clean = recording([0, 1, 2, 3, 4, 5.02, 6.01, 7])
    truth = build_truth(clean, recording(kept))
    assert (
        seconds(truth) == [0, 1, 2, 3, 4, 5.02, 6.01, 7]
        if kept != [4, 5]
        else [0, 1, 2, 3, 4, 5, 6.01, 7]
    )
    np.testing.assert_array_equal(
        truth.observed, np.isin(truth.time_ns, [round(s * S) for s in kept])
    )
    assert not np.isnan(truth.clean_lat_deg[~truth.observed]).any()


def test_epochs_at_slightly_other_times_are_not_doubled() -> None:
    truth = build_truth(recording([0, 1, 2, 3]), recording([0.2, 1.2, 2.2, 3.2]))
    assert seconds(truth) == [0.2, 1.2, 2.2, 3.2]
    assert np.isnan(truth.position_error_m).all()


def test_a_variant_without_pvt_is_scored_on_the_clean_epochs() -> None:
    clean = recording([0, 1, 2])
    truth = build_truth(clean, clean.replace({TOPIC: None}))
    assert seconds(truth) == [0, 1, 2]
    assert not truth.observed.any()


def test_spoofed_and_guard_are_half_open_and_apart() -> None:
    clean = recording(list(range(40)))
    truth = build_truth(clean, attacked(list(range(40)), [(5, 8), (14, 16)]))
    assert np.flatnonzero(truth.spoofed).tolist() == [5, 6, 7, 14, 15]
    assert np.flatnonzero(truth.guard).tolist() == [
        8,
        9,
        10,
        11,
        12,
        13,
        16,
        17,
        18,
        19,
        20,
        21,
        22,
        23,
        24,
        25,
    ]
    assert truth.intervals == (Interval(5 * S, 8 * S), Interval(14 * S, 16 * S))
    assert np.flatnonzero(release_guard(truth.time_ns, truth.intervals, 20.0)).max() == 35


def test_a_really_attacked_recording_has_labels_and_no_twin() -> None:
    labelled = really_attacked(list(range(40)), [(5, 8), (20, 22)], [(0, 5), (30, 35)])
    truth = build_truth(labelled, labelled)
    assert np.flatnonzero(truth.spoofed).tolist() == [5, 6, 7, 20, 21]
    assert np.flatnonzero(truth.reviewed).tolist() == [*range(8), 20, 21, *range(30, 35)]
    for unknown in (
        truth.clean_lat_deg,
        truth.clean_lon_deg,
        truth.position_error_m,
        truth.velocity_error_mps,
    ):
        assert np.isnan(unknown).all()
    assert not np.isnan(truth.lat_deg).any()


def test_of_an_attack_of_ours_everything_is_reviewed() -> None:
    variant = attacked(list(range(40)), [(5, 8)])
    truth = build_truth(recording(list(range(40))), variant)
    assert truth.reviewed.all()
    assert (truth.position_error_m == 0).all()


def test_errors_are_metres_and_metres_per_second() -> None:
    clean = recording([0, 1, 2])
    moved = recording(
        [0, 1, 2],
        north_m=100.0,
        height_m=np.array([1600.0, 1600.0, np.nan]),
        vel_e_mps=np.array([4.0, 7.0, np.nan]),
    )
    truth = build_truth(clean, moved)
    assert truth.position_error_m[:2] == pytest.approx([100, 100], rel=1e-3)
    np.testing.assert_array_equal(truth.velocity_error_mps, [0, 3, np.nan])
    assert np.isnan(truth.position_error_m[2])


def test_height_above_mean_sea_level_serves_where_the_ellipsoidal_one_is_absent() -> None:
    low, high = (
        recording([0, 1], height_m=np.full(2, np.nan), height_msl_m=np.full(2, h))
        for h in (10.0, 35.0)
    )
    assert build_truth(low, high).position_error_m == pytest.approx([25, 25])


def test_rows_of_one_time_are_one_epoch() -> None:
    assert seconds(build_truth(*[recording([0, 1, 1, 2])] * 2)) == [0, 1, 2]


def test_of_rows_of_one_time_the_last_counts_as_it_does_for_detectors() -> None:
    clean = recording([0, 1, 1, 2])
    pvt = clean["/gnss0/gnss/pvt"]
    moved = clean.replace(
        {"/gnss0/gnss/pvt": pvt.replace(lat_deg=pvt["lat_deg"] + np.array([0.0, 1.0, 0.0, 0.0]))}
    )
    assert build_truth(clean, moved).position_error_m.tolist() == [0.0, 0.0, 0.0]


def test_too_few_epochs_and_endless_gaps_are_refused() -> None:
    with pytest.raises(RecordingError, match="1 'gnss/pvt' epochs"):
        build_truth(*[recording([0])] * 2)
    with pytest.raises(LimitError, match="split the recording"):
        build_truth(*[recording([0, 1, 2, 3e8])] * 2)


def decisions(seconds: list[float], score: list[float]) -> Decisions:
    return Decisions(np.array([round(s * S) for s in seconds], np.int64), score, ~np.isnan(score))


def test_an_epoch_takes_the_latest_decision_that_still_stands() -> None:
    truth = build_truth(*[recording([0, 1, 2, 3, 4, 5])] * 2)
    made = decisions([0, 0.4, 0.8, 2.05, 3.2, 3.5], [0.1, 5.0, 0.2, 3.0, 4.0, np.nan])
    np.testing.assert_array_equal(
        score_on_grid(made, truth, 1.1), [0.1, 0.2, np.nan, 3.0, np.nan, np.nan]
    )


@pytest.mark.parametrize(
    ("clean_s", "hold_s"),
    [
        ([], 1.1),
        ([7], 1.1),
        ([0, 0.1, 0.2, 0.3], 1.1),
        ([0, 4, 8, 30], 4.4),
        ([0, 60, 120, 121], 11.0),
    ],
)
def test_the_default_hold(clean_s: list[float], hold_s: float) -> None:
    times = np.array([round(t * S) for t in clean_s], np.int64)
    assert default_hold_s(S, times) == pytest.approx(hold_s)
    assert default_hold_s(30 * S, times) == pytest.approx(33)


def test_a_hold_lets_a_decision_last() -> None:
    truth = build_truth(*[recording([0, 1, 2, 3, 4])] * 2)
    np.testing.assert_array_equal(
        score_on_grid(decisions([0.5], [2.0]), truth, 2.5), [np.nan, 2, 2, 2, np.nan]
    )
    np.testing.assert_array_equal(score_on_grid(decisions([], []), truth, 2.5), [np.nan] * 5)


TIMES = st.lists(st.integers(-50, 350), max_size=40, unique=True).map(sorted)


@given(TIMES, st.integers(0, 30), st.data())
def test_agrees_with_a_loop(tenths: list[int], hold: int, data: st.DataObject) -> None:
    truth = build_truth(*[recording([0, 1, 2, 5, 6.1, 7, 8, 9, 20, 21])] * 2)
    score = data.draw(
        st.lists(st.floats(0, 2) | st.just(np.nan), min_size=len(tenths), max_size=len(tenths))
    )
    expected = []
    for epoch in truth.time_ns.tolist():
        earlier = [
            (t * S // 10, s) for t, s in zip(tenths, score, strict=True) if t * S // 10 <= epoch
        ]
        held = bool(earlier) and epoch - earlier[-1][0] <= hold * S // 10
        expected.append(earlier[-1][1] if held else np.nan)
    got = score_on_grid(decisions([t / 10 for t in tenths], score), truth, hold / 10)
    np.testing.assert_array_equal(got, expected)
