"""What make_variant promises of any attack, and what it refuses."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spoofbench import plugins
from spoofbench.attacks import Attack, attackable_span, draw_window, make_variant
from spoofbench.attacks.extrapolation import Extrapolate, ExtrapolateSmooth
from spoofbench.attacks.laws import differing
from spoofbench.attacks.replay import Meacon, RepeatBack, Replay
from spoofbench.attacks.synthetic import DragOff, ZeroAcceleration
from spoofbench.errors import NotApplicable, PluginError
from spoofbench.recording import Interval, Recording
from spoofbench.schema import KINDS, TRUTH_TOPIC, split_topic
from spoofbench.table import Column, Table
from spoofbench.testing import drive

PVT = "/gnss0/gnss/pvt"
ATTACKS: dict[str, Attack] = {
    "replay": Replay(delay_s=30.0),
    "repeat-back": RepeatBack(),
    "meacon": Meacon(separation_s=2.0),
    "extrapolate": Extrapolate(),
    "extrapolate-smooth": ExtrapolateSmooth(),
    "zero-acceleration": ZeroAcceleration(),
    "drag-off": DragOff(),
}


@cache
def _drive(seed: int = 7) -> Recording:
    return drive(seed, 120.0, second_sources=True)


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    """A drive with rows missing, fields missing, fixes missing, doubled stamps and other heights,
    as logs have them.
    """
    recording = _drive(draw(st.integers(0, 2)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    lost, blank = draw(st.sampled_from([0.0, 0.1, 0.5])), draw(st.sampled_from([0.0, 0.2]))
    dropped = draw(
        st.sets(
            st.sampled_from(
                ["lat_deg", "height_m", "vel_n_mps", "vel_d_mps", "h_acc_m", "gps_week"]
            )
        )
    )
    doubled = draw(st.booleans())
    for topic in recording.topics("gnss/pvt"):
        table = recording[topic]
        speed = np.round(np.hypot(table["vel_n_mps"], table["vel_e_mps"]), 2)
        course = (
            np.round(np.degrees(np.arctan2(table["vel_e_mps"], table["vel_n_mps"])) % 360, 1) % 360
        )
        heights = {"height_msl_m": np.round(table["height_m"] - 40, 3)}
        received = table.time_ns + rng.integers(0, 10**8, len(table))
        table = table.replace(
            speed_mps=speed, course_deg=course, receive_time_ns=received, **heights
        )
        gone = rng.random(len(table)) < blank
        table = table.replace(
            **{
                name: np.where(gone, np.nan, table[name])
                for name in ("lat_deg", "lon_deg", "vel_e_mps")
            }
        )
        table = table.replace(**dict.fromkeys(dropped)).take(rng.random(len(table)) >= lost)
        if doubled:
            table = table.take(np.repeat(np.arange(len(table)), 2))
        counts = Column(rng.integers(4, 12, len(table)), rng.random(len(table)) > blank)
        recording = recording.replace(
            {topic: table.replace(num_sv=counts, pdop=rng.uniform(1, 2, len(table)))}
        )
    return recording


@given(
    clean=recordings(),
    name=st.sampled_from(sorted(ATTACKS)),
    seed=st.integers(0, 50),
    duration_s=st.sampled_from([5.0, 30.0]),
)
def test_the_laws_hold_on_any_recording(
    clean: Recording, name: str, seed: int, duration_s: float
) -> None:
    attack = ATTACKS[name]
    try:
        window = draw_window(0, "any", seed, attackable_span(attack, clean), duration_s)
        variant = make_variant(name, attack, clean, window, seed)
    except NotApplicable:
        return
    assert make_variant(name, attack, clean, window, seed).digest() == variant.digest()
    assert variant.metadata == clean.metadata
    truth = variant[TRUTH_TOPIC]
    start_ns, end_ns = int(truth["start_ns"][0]), int(truth["end_ns"][0])
    assert window.start_ns <= start_ns < end_ns <= window.end_ns
    firsts, lasts, sources = [], [], []
    for topic in clean:
        kind = KINDS[split_topic(topic)[1]]
        if kind.name == "gnss/pvt":
            if found := _changed(clean[topic], variant[topic]):
                firsts.append(found[0])
                lasts.append(found[-1])
                sources.append(split_topic(topic)[0])
        elif kind.is_gnss_derived:
            assert topic not in variant
        else:
            assert variant[topic] == clean[topic]
    assert (min(firsts), max(lasts) + 1) == (start_ns, end_ns)
    assert json.loads(truth.texts("sources")[0]) == sorted(sources)
    assert json.loads(truth.texts("base_ids")[0]) == [clean.digest()]


def _changed(clean: Table, attacked: Table) -> list[int]:
    """Times of rows that were changed or deleted, found without the code under test: rows are
    compared as texts.
    """

    def texts(table: Table) -> dict[tuple[int, int], str]:
        names = sorted(name for name in clean)
        columns = [np.where(table.valid(name), table[name], np.nan).tolist() for name in names]
        rows: dict[tuple[int, int], str] = {}
        for time_ns, *row in zip(table.time_ns.tolist(), *columns, strict=True):
            count = sum((time_ns, k) in rows for k in (0, 1))
            rows[time_ns, count] = repr(row)
        return rows

    was, now = texts(clean), texts(attacked)
    assert set(now) <= set(was)
    return sorted(
        time_ns for time_ns, count in was if now.get((time_ns, count)) != was[time_ns, count]
    )


@given(clean=recordings(), name=st.sampled_from(sorted(ATTACKS)), seed=st.integers(0, 20))
def test_claimed_times_and_stamps_stay(clean: Recording, name: str, seed: int) -> None:
    try:
        window = draw_window(0, "any", seed, attackable_span(ATTACKS[name], clean), 20.0)
        variant = make_variant(name, ATTACKS[name], clean, window, seed)
    except NotApplicable:
        return
    for topic in clean.topics("gnss/pvt"):
        was, now = clean[topic], variant[topic]
        if len(was) != len(now):
            assert set(
                zip(now.time_ns.tolist(), now["receive_time_ns"].tolist(), strict=True)
            ) <= set(zip(was.time_ns.tolist(), was["receive_time_ns"].tolist(), strict=True))
            continue
        assert np.array_equal(was.time_ns, now.time_ns)
        for field in ("receive_time_ns", "gps_week", "tow_s", "time_valid"):
            assert not differing(was, now, field).any()


@pytest.mark.parametrize(
    "attack",
    [
        Replay(delay_s=0.0),
        RepeatBack(delay_s=0.0),
        Meacon(strength=0),
        Extrapolate(0.0),
        ZeroAcceleration(0.0),
        DragOff(0.0),
    ],
)
def test_strength_0_gives_the_clean_recording(attack: Attack) -> None:
    clean = _drive()
    assert attack.strength == 0
    assert make_variant("any", attack, clean, clean.span, 0) is clean


def test_strength_grows_the_change() -> None:
    clean, window = _drive(), _window(_drive())
    errors = []
    for strength in (0.1, 0.5, 1.0):
        table = make_variant("zero-acceleration", ZeroAcceleration(strength), clean, window, 0)[PVT]
        errors.append(np.nansum(np.abs(table["lat_deg"] - clean[PVT]["lat_deg"])))
    assert errors == sorted(errors)


def _window(clean: Recording, start_s: float = 60.0, end_s: float = 90.0) -> Interval:
    return Interval(
        clean.span.start_ns + int(start_s * 1e9), clean.span.start_ns + int(end_s * 1e9)
    )


@dataclass(frozen=True)
class Stranger:
    """An attack of a stranger that does what is registered under a name."""

    does: object
    models: ClassVar[frozenset[str]] = frozenset({"gnss/pvt"})
    attack_class: ClassVar[str] = "generated"
    level: ClassVar[str] = "pvt"
    strength: ClassVar[float] = 1.0
    strength_unit: ClassVar[str] = "1"

    def apply(
        self,
        clean: Recording,
        window: Interval,
        rng: np.random.Generator,
        donors: Sequence[Recording] = (),
    ) -> Any:
        return {**BROKEN, **LAWFUL, **FAILING}[str(self.does)](clean, window)


def _with(
    name: str, values: Callable[[Table, Any], Any]
) -> Callable[[Recording, Interval], Recording]:
    def change(clean: Recording, window: Interval) -> Recording:
        table = clean[PVT]
        inside = window.covers(table.time_ns)
        return clean.replace({PVT: table.replace(**{name: values(table, inside)})})

    return change


def _late(clean: Recording, window: Interval) -> Recording:
    return _with(
        "height_m", lambda table, inside: table["height_m"] + (table.time_ns >= window.start_ns)
    )(clean, window)


def _moved_stamps(clean: Recording, window: Interval) -> Recording:
    table = clean[PVT]
    moved = table.time_ns + window.covers(table.time_ns)
    return clean.replace(
        {PVT: Table("gnss/pvt", moved, {name: table.column(name) for name in table})}
    )


def _shaken(clean: Recording, window: Interval) -> Recording:
    imu = clean["/imu0/imu"]
    return clean.replace({"/imu0/imu": imu.replace(accel_x_mps2=imu["accel_x_mps2"] + 1)})


BROKEN: dict[str, Callable[[Recording, Interval], Any]] = {
    "must keep the rows outside the window": _late,
    "must keep the victim's log times": _moved_stamps,
    "must change GNSS-derived topics only": _shaken,
    "must not add topics": lambda clean, _: clean.replace({"/gnss7/gnss/pvt": clean[PVT]}),
    "must keep the metadata": lambda clean, _: clean.with_metadata(
        {"recording": {"clock": "gnss"}}
    ),
    "must keep the kind of a topic": lambda clean, _: clean.replace(
        {PVT: clean["/gnss0/gnss/clock"]}
    ),
    "must keep the times that the victim claims": _with(
        "tow_s", lambda table, inside: table["tow_s"] + inside
    ),
    "must not fill fields that the victim never reports": _with(
        "pdop", lambda table, inside: np.where(inside, 1.0, np.nan)
    ),
    "must let speed and course agree with velocity": _with(
        "vel_n_mps", lambda table, inside: table["vel_n_mps"] + 5.0 * inside
    ),
    "must move both heights alike": _with(
        "height_m", lambda table, inside: table["height_m"] + 5.0 * inside
    ),
}
LAWFUL: dict[str, Callable[[Recording, Interval], Any]] = {
    "raise": _with("height_m", lambda table, inside: table["height_m"] + np.pi * inside),
    "turn": _with(
        "course_deg", lambda table, inside: np.where(inside, 359.97, table["course_deg"])
    ),
    "nothing": lambda clean, _: clean,
    "less than the resolution": _with(
        "height_m", lambda table, inside: table["height_m"] + 1e-9 * inside
    ),
}
FAILING: dict[str, Callable[[Recording, Interval], Any]] = {
    "ZeroDivisionError": lambda clean, _: 1 / 0,
    "NoneType": lambda clean, _: None,
}


@pytest.mark.parametrize("law", BROKEN)
def test_a_broken_law_is_named(law: str) -> None:
    clean = _drive()
    table = clean[PVT]
    speed, course = (
        np.hypot(table["vel_n_mps"], table["vel_e_mps"]),
        np.degrees(np.arctan2(table["vel_e_mps"], table["vel_n_mps"])),
    )
    clean = clean.replace(
        {
            PVT: table.replace(
                speed_mps=speed, course_deg=course % 360, height_msl_m=table["height_m"] - 40
            )
        }
    )
    with pytest.raises(PluginError, match=law):
        make_variant("stranger", Stranger(law), clean, _window(clean), 0)


def test_what_is_lawful_is_rounded_and_noted() -> None:
    clean, window = _drive(), _window(_drive())
    table = make_variant("stranger", Stranger("raise"), clean, window, 3)[PVT]
    inside = window.covers(table.time_ns)
    assert np.array_equal(table["height_m"], np.round(table["height_m"], 3), equal_nan=True)
    assert np.allclose(
        (table["height_m"] - clean[PVT]["height_m"])[inside], np.pi, atol=6e-4, equal_nan=True
    )


def test_a_course_is_rounded_round() -> None:
    clean = _drive()
    table = clean[PVT]
    clean = clean.replace(
        {
            PVT: Table(
                "gnss/pvt",
                table.time_ns,
                {"course_deg": np.round(np.arange(len(table)) % 360 + 0.1, 1)},
            )
        }
    )
    variant, window = (
        make_variant("stranger", Stranger("turn"), clean, _window(clean), 0),
        _window(clean),
    )
    assert np.all(variant[PVT].between(window.start_ns, window.end_ns)["course_deg"] == 0)


@pytest.mark.parametrize("does", ["nothing", "less than the resolution"])
def test_an_attack_without_effect_is_not_applicable(does: str) -> None:
    clean = _drive()
    with pytest.raises(NotApplicable, match="changes no row"):
        make_variant("stranger", Stranger(does), clean, _window(clean), 0)


@pytest.mark.parametrize("reason", FAILING)
def test_a_failing_stranger_is_blamed_by_name(reason: str) -> None:
    clean = _drive()
    with pytest.raises(PluginError, match=f"attack 'stranger'.*{reason}"):
        make_variant("stranger", Stranger(reason), clean, _window(clean), 0)


def test_an_attacked_recording_is_not_attacked_again() -> None:
    clean = _drive()
    variant = make_variant("drag-off", DragOff(), clean, _window(clean), 0)
    with pytest.raises(NotApplicable, match="already"):
        make_variant("drag-off", DragOff(), variant, _window(clean), 0)


def test_a_parameter_that_json_cannot_hold_is_refused() -> None:
    with pytest.raises(PluginError, match="JSON"):
        make_variant("stranger", Stranger({1, 2}), _drive(), _window(_drive()), 0)


def test_the_truth_row_says_how_the_variant_was_made() -> None:
    clean = _drive()
    truth = make_variant("drag-off", DragOff(rate_mps=0.5), clean, _window(clean), 42)[TRUTH_TOPIC]
    words = {
        name: truth.texts(name)[0]
        for name in ("attack", "class", "strength_unit", "level", "parameters")
    }
    parameters = '{"direction_deg":null,"ramp_s":10.0,"rate_mps":0.5,"vertical_share":0.0}'
    assert words == {
        "attack": "drag-off",
        "class": "generated",
        "strength_unit": "m/s",
        "level": "pvt",
        "parameters": parameters,
    }
    assert (truth["strength"][0], truth["seed"][0], truth.time_ns[0]) == (
        0.5,
        42,
        truth["start_ns"][0],
    )


def test_seeds_and_parameters_draw_anew() -> None:
    clean = _drive()
    variants = [
        make_variant("drag-off", DragOff(rate), clean, _window(clean), seed)
        for rate, seed in ((1.0, 0), (1.0, 1), (2.0, 0))
    ]
    assert len({variant.digest() for variant in variants}) == 3


@given(
    suite_seed=st.integers(0, 2**63),
    seed=st.integers(0, 1000),
    room_s=st.floats(0, 1e5),
    duration_s=st.floats(1, 1e4),
)
def test_windows_lie_within(suite_seed: int, seed: int, room_s: float, duration_s: float) -> None:
    within = Interval(10**18, 10**18 + round(duration_s * 1e9) + round(room_s * 1e9))
    window = draw_window(suite_seed, "drive", seed, within, duration_s)
    assert within.start_ns <= window.start_ns <= window.end_ns <= within.end_ns
    assert window.end_ns - window.start_ns == round(duration_s * 1e9)


def test_windows_are_drawn_the_same_everywhere_and_evenly() -> None:
    within = Interval(0, 1_000_000_000_000)
    assert (
        draw_window(1, "drive", 0, within, 100.0).start_ns == 208_573_168_937
    )  # SHA-256 of [1,"drive",0] modulo 900 s and 1 ns
    starts = (
        np.array([draw_window(0, "drive", seed, within, 100.0).start_ns for seed in range(500)])
        / 900e9
    )
    assert np.abs(np.sort(starts) - (np.arange(500) + 0.5) / 500).max() < 1.63 / np.sqrt(
        500
    )  # Kolmogorov, 1 %
    with pytest.raises(NotApplicable, match="does not fit"):
        draw_window(0, "drive", 0, within, 1001.0)


def test_every_attack_of_the_distribution_is_here() -> None:
    assert {name: type(attack) for name, attack in ATTACKS.items()} == {
        name: plugin.load()
        for name, plugin in plugins.found(plugins.ATTACKS).items()
        if plugin.distribution == "spoofbench"
    }
