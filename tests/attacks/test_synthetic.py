"""Extrapolation, held velocity and drag-off against their equations, on receivers without noise."""

from collections.abc import Callable

import numpy as np
import pymap3d
import pytest
from numpy.typing import NDArray

from spoofbench.attacks import Attack, make_variant
from spoofbench.attacks.extrapolation import Extrapolate, ExtrapolateSmooth
from spoofbench.attacks.pvt import epochs_s, metres_per_unit, motion_of
from spoofbench.attacks.synthetic import DragOff, ZeroAcceleration
from spoofbench.recording import Interval, Recording
from spoofbench.table import Table
from spoofbench.testing import drive

Floats = NDArray[np.float64]
PVT = "/gnss0/gnss/pvt"
LAT0, LON0 = 47.0, 8.0


def _ideal(
    north: Callable[[Floats], Floats], speed: Callable[[Floats], Floats], hz: float = 10.0
) -> Recording:
    """A receiver without noise that goes north along a meridian, full doubles."""
    time_s = np.arange(round(120 * hz)) / hz
    lat, lon, height = pymap3d.ned2geodetic(
        north(time_s), 0 * time_s, 0 * time_s, LAT0, LON0, 100.0
    )
    columns = {"lat_deg": lat, "lon_deg": lon, "height_m": height, "vel_n_mps": speed(time_s)}
    still = {"vel_e_mps": 0 * time_s, "vel_d_mps": 0 * time_s}
    return Recording(
        {PVT: Table("gnss/pvt", np.round(time_s * 1e9).astype(np.int64), {**columns, **still})}
    )


def _inside(recording: Recording, window: Interval) -> Table:
    return recording[PVT].between(window.start_ns, window.end_ns)


WINDOW = Interval(40 * 10**9, 80 * 10**9)
PERIOD_S = 40.0


def _swaying(hz: float = 10.0) -> Recording:
    omega = 2 * np.pi / PERIOD_S
    return _ideal(lambda t: 50 * np.sin(omega * t), lambda t: 50 * omega * np.cos(omega * t), hz)


@pytest.mark.parametrize("delay_s", [0.5, 2.0])
def test_extrapolation_is_lo_et_als(delay_s: float) -> None:
    clean = _swaying()
    made = _inside(make_variant("extrapolate", Extrapolate(delay_s), clean, WINDOW, 0), WINDOW)[
        "vel_n_mps"
    ]
    speed, dt = clean[PVT]["vel_n_mps"], 0.1
    rows, lag = np.flatnonzero(WINDOW.covers(clean[PVT].time_ns)), round(delay_s / dt)
    expected = speed[rows - lag] + delay_s * (speed[rows - lag] - speed[rows - lag - 1]) / dt
    assert np.allclose(made, expected, atol=1e-6)


def test_extrapolation_knows_uniform_motion() -> None:
    clean = _ideal(lambda t: 15 * t, lambda t: np.full_like(t, 15.0))
    made = _inside(make_variant("extrapolate", Extrapolate(2.0), clean, WINDOW, 0), WINDOW)
    true = _inside(clean, WINDOW)
    assert np.allclose(made["vel_n_mps"], 15.0, atol=1e-6)
    assert np.abs(made["lat_deg"] - true["lat_deg"]).max() * 111e3 < 1e-3


def test_smoothing_averages_the_last_seconds() -> None:
    clean = _swaying()
    early = Interval(WINDOW.start_ns - 10 * 10**9, WINDOW.end_ns)
    rough = _inside(make_variant("extrapolate", Extrapolate(), clean, early, 0), early)
    smooth = _inside(
        make_variant("extrapolate-smooth", ExtrapolateSmooth(smooth_s=4.0), clean, WINDOW, 0),
        WINDOW,
    )
    for name in ("vel_n_mps", "lat_deg"):
        expected = np.convolve(rough[name], np.full(40, 1 / 40), "valid")[-len(smooth) :]
        assert np.allclose(smooth[name], expected, atol=1e-6)


def _deleted_s(attack: Attack, clean: Recording) -> list[int]:
    variant = make_variant("any", attack, clean, WINDOW, 0)
    return sorted(
        int(t / 1e9) for t in set(clean[PVT].time_ns.tolist()) - set(variant[PVT].time_ns.tolist())
    )


def test_what_cannot_be_predicted_is_deleted() -> None:
    clean = _swaying(1.0)
    table = clean[PVT]
    gap = clean.replace({PVT: table.take((table.time_ns < 50e9) | (table.time_ns >= 53e9))})
    assert _deleted_s(Extrapolate(), gap) == [53, 54]
    assert _deleted_s(ExtrapolateSmooth(smooth_s=4.0), gap) == [53, 54, 55, 56, 57]
    one_lost = clean.replace({PVT: table.take(table.time_ns // 10**9 != 51)})
    assert _deleted_s(Extrapolate(), one_lost) == [53]
    assert _deleted_s(ExtrapolateSmooth(smooth_s=4.0), one_lost) == [52, 53, 54, 55, 56]
    blind = table.time_ns // 10**9 == 50
    without_fix = clean.replace(
        {PVT: table.replace(**{name: np.where(blind, np.nan, table[name]) for name in table})}
    )
    assert _deleted_s(Extrapolate(), without_fix) == [53]  # 52 has no fix, as its delayed row


@pytest.mark.parametrize(
    "attack",
    [
        Extrapolate(2.0),
        ExtrapolateSmooth(2.0),
        ZeroAcceleration(1.0),
        ZeroAcceleration(0.4),
        DragOff(3.0),
    ],
)
@pytest.mark.parametrize("seed", range(4))
def test_position_is_the_integral_of_velocity(attack: Attack, seed: int) -> None:
    table = _inside(make_variant("any", attack, _swaying(), WINDOW, seed), WINDOW)
    motion, epoch = motion_of(table), epochs_s(table)
    steps = (
        np.diff(motion.position, axis=0)
        - (motion.rate[1:] + motion.rate[:-1]) / 2 * np.diff(epoch)[:, None]
    )
    assert (
        np.abs(steps * metres_per_unit(motion.position)[1:]).max() < 2e-4
    )  # trapezium rule, 0.1 s


def test_zero_acceleration_holds_the_last_genuine_velocity() -> None:
    clean = _swaying()
    made, last = (
        _inside(make_variant("any", ZeroAcceleration(), clean, WINDOW, 0), WINDOW),
        clean[PVT].until(WINDOW.start_ns - 1),
    )
    assert np.allclose(made["vel_n_mps"], last["vel_n_mps"][-1], atol=1e-3)


def test_half_of_the_acceleration_stays() -> None:
    clean = _swaying()
    full, half = (
        _inside(make_variant("any", ZeroAcceleration(s), clean, WINDOW, 0), WINDOW)["vel_n_mps"]
        for s in (1.0, 0.5)
    )
    assert np.allclose(half, (full + _inside(clean, WINDOW)["vel_n_mps"]) / 2, atol=2e-3)


def test_zero_acceleration_without_velocity_goes_on_by_position() -> None:
    clean = _ideal(lambda t: 15 * t, lambda t: np.full_like(t, 15.0))
    blind = clean.replace({PVT: clean[PVT].replace(vel_n_mps=None, vel_e_mps=None, vel_d_mps=None)})
    made = _inside(make_variant("any", ZeroAcceleration(), blind, WINDOW, 0), WINDOW)
    assert np.abs(made["lat_deg"] - _inside(clean, WINDOW)["lat_deg"]).max() * 111e3 < 0.01


def test_noise_stays_natural_without_acceleration() -> None:
    clean = drive(11, 400.0, 10.0, flaws=False)
    start_ns = clean.span.start_ns
    window = Interval(start_ns + 150 * 10**9, start_ns + 250 * 10**9)
    made, true = (
        _inside(r, window)["vel_d_mps"]
        for r in (make_variant("any", ZeroAcceleration(), clean, window, 0), clean)
    )
    made_roughness, true_roughness = (np.std(np.diff(velocity, 2)) for velocity in (made, true))
    assert 0.7 < made_roughness / true_roughness < 1.4


def test_noise_is_neither_the_windows_own_nor_that_of_another_speed() -> None:
    clean = _ideal(lambda t: 10 * np.maximum(t - 85, 0), lambda t: np.where(t > 85, 10.0, 0.0))
    table = clean[PVT].take(np.abs(clean[PVT].time_ns - 85e9) > 1e9)  # no row tells of the start
    noise = np.random.default_rng(0).normal(0, 0.1, len(table)) * (
        WINDOW.covers(table.time_ns) | (table.time_ns > 85e9)
    )
    noisy = clean.replace({PVT: table.replace(vel_n_mps=table["vel_n_mps"] + noise)})
    assert (
        np.abs(
            _inside(make_variant("any", ZeroAcceleration(), noisy, WINDOW, 0), WINDOW)["vel_n_mps"]
        ).max()
        < 1e-6
    )


@pytest.mark.parametrize(
    ("direction_deg", "vertical_share"), [(0.0, 0.0), (90.0, 0.0), (225.0, 0.6), (10.0, -1.0)]
)
def test_drag_off_goes_where_and_as_fast_as_it_is_told(
    direction_deg: float, vertical_share: float
) -> None:
    clean = drive(3, 120.0, flaws=False)
    window = Interval(clean.span.start_ns + 40 * 10**9, clean.span.start_ns + 100 * 10**9)
    attack = DragOff(2.0, 10.0, direction_deg, vertical_share)
    made, true = (
        _inside(r, window) for r in (make_variant("any", attack, clean, window, 0), clean)
    )
    ned = np.column_stack(
        pymap3d.geodetic2ned(
            made["lat_deg"],
            made["lon_deg"],
            made["height_m"],
            true["lat_deg"],
            true["lon_deg"],
            true["height_m"],
        )
    )
    level, direction = np.sqrt(1 - vertical_share**2), np.radians(direction_deg)
    unit = np.array([level * np.cos(direction), level * np.sin(direction), -vertical_share])
    elapsed = (made.time_ns - window.start_ns) / 1e9
    late = elapsed > 10
    assert np.allclose(ned[late], (2.0 * (elapsed[late] - 5.0))[:, None] * unit, atol=0.02)
    gained = np.column_stack([made[f"vel_{axis}_mps"] - true[f"vel_{axis}_mps"] for axis in "ned"])
    assert np.allclose(gained[late], 2.0 * unit, atol=2e-3)
    assert np.linalg.norm(ned[0]) < 0.1


def test_directions_are_drawn_all_around() -> None:
    clean = drive(3, 120.0, flaws=False)
    window = Interval(clean.span.start_ns + 40 * 10**9, clean.span.start_ns + 60 * 10**9)
    gains = [
        _inside(make_variant("any", DragOff(), clean, window, seed), window) for seed in range(24)
    ]
    north, east = (
        np.array([(g[f"vel_{a}_mps"] - _inside(clean, window)[f"vel_{a}_mps"])[-1] for g in gains])
        for a in "ne"
    )
    assert np.allclose(np.hypot(north, east), 1.0, atol=2e-3)
    assert len({*np.floor(np.arctan2(east, north) / (np.pi / 2))}) == 4


@pytest.mark.parametrize(
    ("make", "names"),
    [
        (lambda: DragOff(-1.0), "rate_mps"),
        (lambda: DragOff(ramp_s=np.nan), "ramp_s"),
        (lambda: DragOff(vertical_share=2.0), "vertical_share"),
        (lambda: DragOff(direction_deg=np.inf), "direction_deg"),
        (lambda: ZeroAcceleration(1.5), "strength"),
        (lambda: Extrapolate(np.nan), "delay_s"),
        (lambda: ExtrapolateSmooth(smooth_s=0.0), "smooth_s"),
    ],
)
def test_senseless_parameters_are_refused(make: Callable[[], Attack], names: str) -> None:
    with pytest.raises(ValueError, match=names):
        make()
