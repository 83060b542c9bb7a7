"""Rows of another time or place: whole, unmixed, from where they were asked for."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spoofbench.attacks import attackable_span, make_variant
from spoofbench.attacks.extrapolation import Extrapolate
from spoofbench.attacks.pvt import nearest_rows
from spoofbench.attacks.replay import Meacon, RepeatBack, Replay
from spoofbench.errors import NotApplicable
from spoofbench.recording import Interval, Recording
from spoofbench.table import Column, Table
from spoofbench.testing import drive

PVT = "/gnss0/gnss/pvt"
COPIED = (
    "lat_deg",
    "lon_deg",
    "height_m",
    "vel_n_mps",
    "vel_e_mps",
    "vel_d_mps",
    "h_acc_m",
    "num_sv",
    "fix_type",
)


def _window(recording: Recording, start_s: float, end_s: float) -> Interval:
    return Interval(
        recording.span.start_ns + int(start_s * 1e9), recording.span.start_ns + int(end_s * 1e9)
    )


def _marked(recording: Recording) -> Recording:
    """Every row has a number of its own, so that it is known where it went."""
    table = recording[PVT]
    return recording.replace(
        {PVT: table.replace(num_sv=np.arange(len(table)), h_acc_m=np.arange(len(table)) + 0.5)}
    )


@given(
    times=st.lists(st.integers(0, 1000), max_size=30),
    wanted=st.lists(st.integers(-100, 1100), max_size=30),
    within=st.integers(0, 60),
)
def test_the_nearest_row_is_found(times: list[int], wanted: list[int], within: int) -> None:
    time_ns = np.array(sorted(times), np.int64)
    for want, row in zip(
        wanted, nearest_rows(time_ns, np.array(wanted, np.int64), within), strict=True
    ):
        distances = np.abs(time_ns - want)
        if row < 0:
            assert not np.any(distances <= within)
        else:
            assert distances[row] == distances.min() <= within


@pytest.mark.parametrize("delay_s", [2.0, 30.0, 45.0])
def test_replayed_rows_are_whole_rows_of_the_shifted_time(delay_s: float) -> None:
    clean = _marked(drive(5, 120.0))
    window = _window(clean, 60, 100)
    variant, table = make_variant("replay", Replay(delay_s), clean, window, 0)[PVT], clean[PVT]
    inside = window.covers(variant.time_ns)
    rows = variant["num_sv"][inside].astype(int)
    assert np.abs(table.time_ns[rows] + delay_s * 1e9 - variant.time_ns[inside]).max() <= 0.5e9
    for name in COPIED:
        assert np.array_equal(variant[name][inside], table[name][rows], equal_nan=True)
    missing = [
        t
        for t in table.time_ns[window.covers(table.time_ns)]
        if np.abs(table.time_ns + delay_s * 1e9 - t).min() > 0.5e9
    ]
    assert set(table.time_ns) - set(variant.time_ns) == set(missing)


@pytest.mark.parametrize("delay_s", [2.0, 2.4, 2.5, 2.6])
@pytest.mark.parametrize("attack", [RepeatBack, Extrapolate])
def test_jitter_neither_repeats_nor_drops_a_delayed_row(
    attack: type[RepeatBack] | type[Extrapolate], delay_s: float
) -> None:
    clean = _marked(drive(5, 40.0, flaws=False))
    table = clean[PVT]
    jitter = np.random.default_rng(1).integers(-8_000_000, 8_000_000, len(table))
    clean = clean.replace(
        {
            PVT: Table(
                "gnss/pvt",
                np.sort(table.time_ns + jitter),
                {name: table.column(name) for name in table},
            )
        }
    )
    window = _window(clean, 10, 39)
    variant = make_variant("delayed", attack(delay_s), clean, window, 0)[PVT]
    assert np.array_equal(variant.time_ns, clean[PVT].time_ns)
    rows = variant["num_sv"][window.covers(variant.time_ns)].astype(int)
    assert set(np.diff(rows)) == {1}


def test_what_a_replayed_row_lacks_stays_lacking() -> None:
    clean = drive(5, 120.0, flaws=False)
    table = clean[PVT]
    known = np.random.default_rng(0).random(len(table)) < 0.5
    clean = clean.replace({PVT: table.replace(num_sv=Column(np.arange(len(table)), known))})
    variant = make_variant("replay", Replay(30.0), clean, _window(clean, 60, 100), 0)[PVT]
    inside = np.flatnonzero(_window(clean, 60, 100).covers(table.time_ns))
    assert np.array_equal(variant.valid("num_sv")[inside], known[inside - 30])
    assert np.array_equal(variant["num_sv"][inside], clean[PVT]["num_sv"][inside - 30])


def test_epochs_without_a_donor_row_are_deleted() -> None:
    clean = drive(5, 120.0)  # its receiver is silent from 48 to 56 s
    variant = make_variant("replay", Replay(30.0), clean, _window(clean, 60, 100), 0)
    assert 7 <= len(clean[PVT]) - len(variant[PVT]) <= 8


def test_a_delay_shorter_than_an_epoch_is_not_applicable() -> None:
    clean = drive(5, 120.0)
    with pytest.raises(NotApplicable, match=r"0\.5 s is shorter than the interval"):
        make_variant("repeat-back", RepeatBack(0.5), clean, _window(clean, 60, 100), 0)
    assert make_variant(
        "repeat-back", RepeatBack(0.5), drive(5, 120.0, 10.0), _window(clean, 60, 100), 0
    )


def test_history_bounds_the_supply() -> None:
    clean = drive(5, 120.0)
    supply = attackable_span(Replay(100.0), clean)
    assert supply.start_ns == clean[PVT].time_ns[0] + 100 * 10**9
    with pytest.raises(NotApplicable, match="has material for"):
        make_variant("replay", Replay(100.0), clean, _window(clean, 60, 100), 0)
    with pytest.raises(NotApplicable, match="300 s of history"):
        attackable_span(Replay(), clean)


def test_meaconed_rows_are_consecutive_rows_of_the_donor() -> None:
    clean, donor = drive(5, 120.0), _marked(drive(6, 200.0, flaws=False))
    window = _window(clean, 60, 100)
    variant = make_variant("meacon", Meacon(offset_s=50.0), clean, window, 0, [donor])[PVT]
    rows = variant["num_sv"][window.covers(variant.time_ns)].astype(int)
    assert np.array_equal(rows, 50 + np.arange(rows.size))
    for name in ("lat_deg", "vel_e_mps"):
        assert np.array_equal(variant[name][window.covers(variant.time_ns)], donor[PVT][name][rows])
    genuine = clean[PVT]
    assert np.array_equal(
        variant["tow_s"], genuine["tow_s"][np.isin(genuine.time_ns, variant.time_ns)]
    )


@pytest.mark.parametrize("seed", range(20))
def test_a_stretch_of_the_same_recording_keeps_its_distance(seed: int) -> None:
    clean = _marked(drive(7, 300.0))
    window = _window(clean, 100, 130)
    variant, table = (
        make_variant("meacon", Meacon(separation_s=20.0), clean, window, seed)[PVT],
        clean[PVT],
    )
    times = table.time_ns[variant["num_sv"][window.covers(variant.time_ns)].astype(int)]
    assert times.max() <= window.start_ns - 20 * 10**9 or times.min() >= window.end_ns + 20 * 10**9


def test_another_rate_is_refused_unless_asked_for() -> None:
    clean, donor = drive(5, 120.0), drive(6, 120.0, 10.0)
    window = _window(clean, 60, 100)
    with pytest.raises(NotApplicable, match="resample=true"):
        make_variant("meacon", Meacon(), clean, window, 0, [donor])
    variant = make_variant("meacon", Meacon(resample=True), clean, window, 0, [donor])
    assert '"resample":true' in variant["/truth/attack"].texts("parameters")[0]
    positions = set(
        zip(donor[PVT]["lat_deg"].tolist(), donor[PVT]["lon_deg"].tolist(), strict=True)
    )
    inside = variant[PVT].between(window.start_ns, window.end_ns)
    attacked = set(zip(inside["lat_deg"].tolist(), inside["lon_deg"].tolist(), strict=True))
    assert {pair for pair in attacked if pair[0] == pair[0]} <= positions


def test_a_source_without_counterpart_leaves_the_variant() -> None:
    clean, donor = drive(5, 120.0, second_sources=True), drive(6, 120.0)
    variant = make_variant("meacon", Meacon(), clean, _window(clean, 60, 80), 0, [donor])
    assert variant.topics("gnss/pvt") == (PVT,)


def test_sources_of_other_names_match_primary_to_primary() -> None:
    clean, other = drive(5, 120.0), drive(6, 120.0)
    donor = Recording({"/rover/gnss/pvt": other[PVT]})
    window = _window(clean, 60, 80)
    inside = make_variant("meacon", Meacon(), clean, window, 0, [donor])[PVT].between(
        window.start_ns, window.end_ns
    )
    assert set(inside["lat_deg"].tolist()) <= {*other[PVT]["lat_deg"].tolist()}


def test_each_source_is_aligned_with_its_donor() -> None:
    clean, donor = (
        drive(5, 120.0, second_sources=True),
        drive(6, 120.0, flaws=False, second_sources=True),
    )
    topic = "/gnss1/gnss/pvt"
    table = donor[topic]
    columns = {name: table.column(name) for name in table if name != "num_sv"}
    # half an epoch out of step with the primary, where jitter would swap the nearest rows
    donor = donor.replace(
        {
            topic: Table(
                "gnss/pvt", table.time_ns + 10**8, {**columns, "num_sv": np.arange(len(table))}
            )
        }
    )
    window = _window(clean, 60, 80)
    inside = make_variant("meacon", Meacon(), clean, window, 0, [donor])[topic].between(
        window.start_ns, window.end_ns
    )
    rows = inside["num_sv"].astype(int)
    assert rows.size >= 99
    assert np.all(np.diff(rows) == 1)


def test_a_donor_that_lacks_a_field_is_refused() -> None:
    clean, other = drive(5, 120.0), drive(6, 120.0)
    donor = other.replace({PVT: other[PVT].replace(h_acc_m=None)})
    with pytest.raises(NotApplicable, match="lack 'h_acc_m'"):
        make_variant("meacon", Meacon(), clean, _window(clean, 60, 80), 0, [donor])


def test_a_donors_decimals_become_the_victims() -> None:
    clean, other = drive(5, 120.0), drive(6, 120.0)
    table = clean[PVT]
    clean = clean.replace(
        {
            PVT: table.replace(
                **{f"vel_{axis}_mps": np.round(table[f"vel_{axis}_mps"], 2) for axis in "ned"}
            )
        }
    )
    velocity: Table = make_variant("meacon", Meacon(), clean, _window(clean, 60, 80), 0, [other])[
        PVT
    ]
    assert np.array_equal(velocity["vel_n_mps"], np.round(velocity["vel_n_mps"], 2), equal_nan=True)
