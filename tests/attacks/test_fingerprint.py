"""What is no physics must not tell: on metadata and last digits alone, a classifier is at chance.

Rows of variants are told from the same rows of the clean recording by naive Bayes over features
that say how numbers are written, never how large they are; trained on some windows, tested on
others.
"""

import hashlib
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from spoofbench import codec, plugins
from spoofbench.attacks import attackable_span, draw_window, make_variant, resolution
from spoofbench.errors import NotApplicable
from spoofbench.recording import Recording
from spoofbench.table import Table
from spoofbench.testing import drive

PVT = "gnss/pvt"
WINDOWS = 16
RELABELLINGS = 99
Bits = NDArray[np.bool_]


def _written(values: NDArray[np.float64]) -> Bits:
    """How numbers are written, ``(n, features)``: which grids they lie on, exactly or nearly, and
    their last bits.
    """
    features = [
        np.isnan(values),
        np.signbit(values) & (values == 0),
        values.astype(np.float32) == values,
    ]
    for decimals in range(3, 11):
        grid = np.round(values, decimals)
        features += [
            grid == values,
            np.abs(grid - values) < 8 * np.spacing(np.abs(values)),
            np.rad2deg(np.deg2rad(grid)) == values,
        ]
    last = values.view(np.uint64)
    features += [(last & np.uint64(mask)) == 0 for mask in (0xF, 0xFF, 0xFFFF, 0xFFFFFFFF)]
    return np.column_stack(features)


def _features(recording: Recording, table: Table) -> Bits:
    """Features of rows: how each float is written, which fields they have, and what all rows share:
    text and metadata.
    """
    columns = [_written(table[name]) for name in sorted(table) if table[name].dtype == np.float64]
    columns += [table.valid(name)[:, None] for name in sorted(table)]
    columns += [(table.time_ns % step == 0)[:, None] for step in (10, 1000, 10**6)]
    shared = json.dumps(
        [
            recording.blind().metadata.get("recording", {}).get("clock"),
            sorted(table),
            sorted(_plain(recording)),
        ]
    )
    text = np.unpackbits(np.frombuffer(hashlib.sha256(shared.encode()).digest(), np.uint8)).astype(
        bool
    )
    return np.hstack([*columns, np.broadcast_to(text, (len(table), text.size))])


def _plain(recording: Recording) -> list[str]:
    return [
        f"{name} {key} {value}"
        for name, record in recording.blind().metadata.items()
        for key, value in record.items()
    ]


def _pairs(clean: Recording, name: str) -> list[tuple[Bits, Bits]]:
    """Those features of rows that are not the same everywhere, clean and attacked, for each
    window.
    """
    pairs = list(_all_features(clean, name))
    rows = np.vstack([side for pair in pairs for side in pair])
    varied = rows.any(axis=0) & ~rows.all(axis=0)
    return [(genuine[:, varied], attacked[:, varied]) for genuine, attacked in pairs]


def _all_features(clean: Recording, name: str) -> Iterator[tuple[Bits, Bits]]:
    """Features of moving rows in each window, clean and attacked; at rest the digits of a velocity
    are its size.
    """
    attack = plugins.make(plugins.ATTACKS, name)
    for seed in range(WINDOWS):
        try:
            window = draw_window(0, "any", seed, attackable_span(attack, clean), 60.0)
            variant = make_variant(name, attack, clean, window, seed)
        except NotApplicable:
            continue
        pair = []
        for recording in (clean, variant):
            table = recording.primary(PVT).between(window.start_ns, window.end_ns)
            moving = np.hypot(table["vel_n_mps"], table["vel_e_mps"]) > 2
            pair.append(_features(recording, table.take(moving)))
        yield pair[0], pair[1]


def _auc(pairs: list[tuple[Bits, Bits]]) -> float:
    """Area under the ROC curve of naive Bayes, each half of the windows told apart by what the
    other half taught.
    """
    areas = []
    for train, test in ((pairs[::2], pairs[1::2]), (pairs[1::2], pairs[::2])):
        clean, attacked = (np.vstack(side) for side in zip(*train, strict=True))
        share = [(rows.sum(axis=0) + 1) / (len(rows) + 2) for rows in (clean, attacked)]
        yes, no = np.log(share[1] / share[0]), np.log((1 - share[1]) / (1 - share[0]))
        genuine, spoofed = (
            np.where(np.vstack(side), yes, no).sum(axis=1) for side in zip(*test, strict=True)
        )
        below, up_to = (
            np.searchsorted(np.sort(genuine), spoofed, side) for side in ("left", "right")
        )
        areas.append(np.mean(below + up_to) / 2 / genuine.size)
    return float(np.mean(areas))


def _chance(pairs: list[tuple[Bits, Bits]]) -> float:
    """Share of relabellings, each window's two sides swapped or not, that are told apart at least
    as well (permutation test).
    """
    rng, found = np.random.default_rng(0), _auc(pairs)
    swaps = rng.integers(0, 2, (RELABELLINGS, len(pairs)))
    areas = [
        _auc([pair[::-1] if swap else pair for pair, swap in zip(pairs, row, strict=True)])
        for row in swaps
    ]
    return (1 + sum(area >= found for area in areas)) / (1 + RELABELLINGS)


@pytest.fixture(scope="module")
def synthetic() -> Recording:
    """Two thousand seconds as a receiver and a converter write them: radians of 1e-7 deg, mm, mm/s,
    singles of accuracies.
    """
    clean = drive(21, 2000.0)
    table = clean.primary(PVT)
    angles = {
        name: np.rad2deg(np.deg2rad(np.round(table[name], 7))) for name in ("lat_deg", "lon_deg")
    }
    rng = np.random.default_rng(0)
    speed = {"speed_mps": np.round(np.hypot(table["vel_n_mps"], table["vel_e_mps"]), 3)}
    cov = {"cov_nn_m2": rng.uniform(0.1, 0.3, len(table)).astype(np.float32).astype(np.float64)}
    return clean.replace({clean.topics(PVT)[0]: table.replace(**angles, **speed, **cov)})


@pytest.fixture(scope="module")
def measured(converted_drive: Path) -> Recording:
    """The receiver of the 43-minute drive."""
    recording = codec.read(converted_drive)
    return Recording(
        {topic: recording[topic] for topic in recording.topics(PVT)}, recording.metadata
    )


@pytest.mark.parametrize("name", sorted(plugins.found(plugins.ATTACKS)))
def test_last_digits_do_not_tell(synthetic: Recording, name: str) -> None:
    pairs = _pairs(synthetic, name)
    assert len(pairs) >= WINDOWS // 2
    assert _auc(pairs) < 0.6
    assert _chance(pairs) > 0.01


@pytest.mark.drive
@pytest.mark.parametrize("name", sorted(plugins.found(plugins.ATTACKS)))
def test_last_digits_do_not_tell_on_the_drive(measured: Recording, name: str) -> None:
    pairs = _pairs(measured, name)
    assert len(pairs) >= WINDOWS // 2
    assert _auc(pairs) < 0.6
    assert _chance(pairs) > 0.01


@pytest.mark.parametrize(
    "name", ["drag-off", "extrapolate", "extrapolate-smooth", "zero-acceleration"]
)
@pytest.mark.parametrize("lapse", ["no resolution", "other resolution"])
def test_the_classifier_sees_a_lapse(
    synthetic: Recording, name: str, lapse: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = resolution.resolution

    def lapsed(column: NDArray[Any]) -> resolution.Resolution:
        good = found(column)
        if lapse == "no resolution":
            return replace(good, rounding=None)
        return (
            replace(good, rounding=lambda values: np.round(values, 7))
            if good.rounding is not None
            else good
        )

    monkeypatch.setattr(resolution, "resolution", lapsed)
    pairs = _pairs(synthetic, name)
    assert _auc(pairs) > 0.7
    assert _chance(pairs) <= 0.01
