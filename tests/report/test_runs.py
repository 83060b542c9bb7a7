"""What the page carries of decisions and tracks loses nothing that matters."""

import base64

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from spoofbench.detector import Decisions
from spoofbench.report.runs import (
    ABSENT_DM,
    INFINITE,
    STEPS,
    UNAVAILABLE,
    ArrayPool,
    TangentPlane,
    milliseconds,
    pack_scores,
    thinned,
)

scores = st.lists(
    st.floats(-1e6, 1e300) | st.sampled_from([1.0, np.nextafter(1.0, 2.0), np.inf]),
    min_size=1,
    max_size=60,
)


@given(scores, st.data())
def test_rounding_never_moves_a_score_over_the_threshold(values, data):
    available = np.array(
        data.draw(st.lists(st.booleans(), min_size=len(values), max_size=len(values)))
    )
    decisions = Decisions(np.arange(len(values)), values, available)
    steps = pack_scores(decisions.score, decisions.available)
    assert np.array_equal(steps > STEPS, decisions.alert)
    assert np.array_equal(steps == UNAVAILABLE, ~available)
    assert np.array_equal(steps == INFINITE, available & np.isposinf(decisions.score))


@given(st.lists(st.floats(-1e6, 1e12), min_size=1, max_size=60))
def test_rounding_is_as_fine_as_the_page_says(values):
    score = np.array(values)
    y = pack_scores(score, np.ones(score.size, bool)) / STEPS
    back = np.where(np.abs(y) <= 1, y, np.sign(y) * 10.0 ** (np.abs(y) - 1))
    assert np.all(np.abs(back - score) <= np.maximum(0.0005, 0.0012 * np.abs(score)))


@given(st.integers(1, 400), st.integers(8, 120), st.randoms(use_true_random=False))
def test_thinning_keeps_extremes_alerts_and_gaps_of_every_stretch(n, limit, random):
    score = np.array([random.lognormvariate(0, 1) for _ in range(n)])
    decisions = Decisions(np.arange(n), score, np.array([random.random() < 0.7 for _ in range(n)]))
    kept = thinned(decisions, limit)
    assert kept.size <= max(limit, 4) + 2
    if n <= limit:
        assert np.array_equal(kept, np.arange(n))
        return
    for rows in np.array_split(np.arange(n), limit // 4):
        left = np.intersect1d(rows, kept)
        assert decisions.alert[rows].any() == decisions.alert[left].any()
        assert decisions.available[rows].all() == decisions.available[left].all()
        if decisions.available[rows].any():
            assert np.nanmax(decisions.score[rows]) == np.nanmax(decisions.score[left])
            assert np.nanmin(decisions.score[rows]) == np.nanmin(decisions.score[left])


def test_the_plane_keeps_lengths_near_its_origin_and_marks_absence():
    metre_deg = 1 / 111_132.95  # of latitude at 45 degrees (meridional radius 6,367,382 m)
    plane = TangentPlane(45.0, 7.0)
    dm = plane.east_north_dm(
        np.array([45.0, 45.0 + 100 * metre_deg, np.nan]), np.array([7.0, 7.0, 7.0])
    )
    assert np.abs(dm[:, :2] - [[0, 0], [0, 1000]]).max() <= 1
    assert np.array_equal(dm[:, 2], [ABSENT_DM, ABSENT_DM])


def test_times_are_rounded_to_the_nearest_millisecond():
    assert milliseconds(
        np.array([1_000_000_499_999, 1_000_000_500_000]), 1_000_000_000_000
    ).tolist() == [0, 1]


def test_equal_arrays_are_stored_once():
    pool = ArrayPool()
    assert [pool.add([1, 2], "<i4"), pool.add([3], "<i2"), pool.add(np.array([1, 2]), "<i4")] == [
        0,
        1,
        0,
    ]
    assert [
        np.frombuffer(base64.b64decode(item), kind).tolist()
        for item, kind in zip(pool.items, ("<i4", "<i2"), strict=True)
    ] == [
        [1, 2],
        [3],
    ]
