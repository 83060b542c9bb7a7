"""spoofbench in a notebook or a script: one call per step.

::

    from spoofbench import api

    api.convert("drive.ubx", "drive.mcap")
    clean = api.read("drive.mcap")
    api.to_pandas(clean.primary("gnss/pvt"))["speed_mps"].plot()

    variant = api.make_variant(clean, "drag-off", start_s=600.0, rate_mps=0.5)
    decisions = api.detect("correlation", variant)
    scores = api.evaluate("correlation", variant, clean)      # detection, time to first detection
    false = api.evaluate("correlation", clean)                # false alerts, with their interval

    api.run("suite.toml", "results")
    board = api.leaderboard("results")
    changed = api.compare("results", "other-results")         # B - A, and what changed

Recordings, tables and decisions are the ones that detectors and attacks get: see
:mod:`spoofbench.recording`, :mod:`spoofbench.table` and :mod:`spoofbench.detector`. Detectors and
attacks are given by the name of an entry point and its parameters, or as instances. Whatever a user
can cause is raised as a :class:`~spoofbench.errors.SpoofbenchError` with one sentence.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spoofbench import codec, conversion, plugins
from spoofbench import detector as detectors
from spoofbench.attacks.contract import Attack, choose_window
from spoofbench.attacks.contract import make_variant as make_variant_in
from spoofbench.detector import Decisions, Detector
from spoofbench.labels import label_recording, read_labels
from spoofbench.recording import Recording
from spoofbench.table import Table

if TYPE_CHECKING:
    import pandas as pd

    from spoofbench.scoring.differences import Differences

__all__ = [
    "compare",
    "convert",
    "detect",
    "evaluate",
    "label",
    "leaderboard",
    "make_variant",
    "read",
    "run",
    "to_pandas",
]


def convert(
    log: str | Path,
    out: str | Path,
    *,
    format: str | None = None,  # noqa: A002
    **options: str,
) -> conversion.Ledger:
    """Convert a raw log to a recording and return the ledger of what was used and skipped.

    Args:
        log: file, folder or archive.
        out: the recording to write, ``.mcap``.
        format: the converter; None tells it by content.
        options: of the converter, as texts.

    Raises:
        ConversionError: the log is of no known format, or cannot be converted.
    """
    return conversion.convert(Path(log), Path(out), format=format, options=options)


def read(path: str | Path) -> Recording:
    """Return the recording in a file, its tables loaded when first used.

    Raises:
        FormatError: the file is no recording.
    """
    return codec.read(Path(path))


def to_pandas(rows: Table | Decisions) -> pd.DataFrame:
    """Return a table, or decisions, as a data frame.

    The index is the time, UTC. Floats are NaN where absent; other numbers and flags get a nullable
    type where some are absent; text is categorical. Decisions have ``score``, ``available`` and
    ``alert``.
    """
    import pandas as pd

    index = pd.DatetimeIndex(rows.time_ns.astype("datetime64[ns]"), tz="UTC", name="time")
    if isinstance(rows, Decisions):
        values = {"score": rows.score, "available": rows.available, "alert": rows.alert}
        return pd.DataFrame(values, index)
    return pd.DataFrame({name: _series_values(rows, name) for name in rows}, index)


def _series_values(table: Table, name: str) -> Any:
    import pandas as pd

    column = table.column(name)
    if column.categories is not None:
        return pd.Categorical.from_codes(column.values, pd.Index(column.categories))
    if column.valid is None:
        return column.values
    values = column.values.copy()
    if values.dtype.kind == "b":
        return pd.arrays.BooleanArray(values, ~column.valid)
    return pd.arrays.IntegerArray(values, ~column.valid)


def make_variant(
    clean: Recording,
    attack: str | Attack,
    *,
    start_s: float | None = None,
    duration_s: float = 120.0,
    seed: int = 0,
    donors: Sequence[Recording] = (),
    **parameters: Any,
) -> Recording:
    """Return a recording as it is under an attack, with its truth in ``/truth/attack``.

    Args:
        clean: recording without attack.
        attack: name of an entry point of ``spoofbench.attacks``, or an instance.
        start_s: of the window, after the recording's first row; None draws it by the seed.
        duration_s: of the window.
        seed: of the window and of whatever the attack draws.
        donors: recordings that the attack may take signals from.
        parameters: of the named attack.

    Raises:
        PluginError: there is no such attack or parameter.
        NotApplicable: it cannot be made on this recording.
    """
    if isinstance(attack, str):
        name, chosen = attack, plugins.make(plugins.ATTACKS, attack, parameters)
    else:
        name, chosen = type(attack).__name__, dataclasses.replace(attack, **parameters)  # type: ignore[type-var]
    window = choose_window(chosen, clean, donors, start_s, duration_s, seed)
    return make_variant_in(name, chosen, clean, window, seed, donors)


def label(recording: Recording, labels: str | Path, *, replace: bool = False) -> Recording:
    """Return a recording with labels of a real attack, in ``/truth/attack`` and ``/truth/clean``.

    Args:
        recording: that the labels are of.
        labels: TOML or CSV: see :mod:`spoofbench.labels`.
        replace: whether labels that are there may be exchanged.

    Raises:
        ConfigError: the labels cannot be read, or do not fit the recording.
        RecordingError: it is labelled already, or carries an attack of ours.
    """
    return label_recording(recording, read_labels(Path(labels)), replace=replace)


def detect(detector: str | Detector, recording: Recording, **parameters: Any) -> Decisions:
    """Run a detector on what it declares of the blind part of a recording.

    Args:
        detector: name of an entry point of ``spoofbench.detectors``, or an instance.
        recording: clean or attacked.
        parameters: of the named detector.

    Raises:
        PluginError: there is no such detector or parameter, or it does not return decisions.
        RecordingError: the recording lacks a kind that the detector requires.
    """
    return detectors.detect(_detector(detector, parameters), recording)


def evaluate(
    detector: str | Detector,
    variant: Recording,
    clean: Recording | None = None,
    *,
    hold_s: float | None = None,
    **parameters: Any,
) -> dict[str, Any]:
    """Return the scores of a detector on a recording, as in ``scores.parquet``; None is unknown.

    An attacked recording gives ``detection_pct``, ``ttfd_s`` and their like, one without attack
    gives false alerts. Thresholds are the detector's own.

    Args:
        detector: name of an entry point of ``spoofbench.detectors``, or an instance.
        variant: attacked or not.
        clean: what it was before the attack; without it, position errors are unknown.
        hold_s: how long a decision stands; None is 1.1 times the interval of the fixes or, where
            that is longer, of the decisions (of which at most 10 s).
        parameters: of the named detector.

    Raises:
        PluginError: there is no such detector or parameter, or it does not return decisions.
        RecordingError: the recording lacks a kind that the detector requires, or has fewer than two
            epochs of ``gnss/pvt``.
    """
    from spoofbench.scoring.grid import build_truth
    from spoofbench.scoring.score import score_decisions

    chosen = _detector(detector, parameters)
    truth = build_truth(clean or variant, variant)
    if clean is None and truth.intervals:
        unknown = np.full(truth.time_ns.size, np.nan)
        truth = dataclasses.replace(truth, position_error_m=unknown, velocity_error_mps=unknown)
    decisions = detectors.detect(chosen, variant)
    return score_decisions(decisions, truth, memory_s=chosen.memory_s, hold_s=hold_s)


def run(suite: str | Path, results: str | Path, *, resume: bool = False) -> None:
    """Run a suite into a results folder and score it.

    Args:
        suite: a TOML file, see :mod:`spoofbench.suite`.
        results: folder; must not hold any results unless ``resume``.
        resume: run only what is missing.

    Raises:
        SuiteError, PluginError: the suite is invalid, or names what does not exist.
        ResultsError: the folder has results of another run.
    """
    from spoofbench import runner
    from spoofbench.suite import load_suite

    runner.run(load_suite(Path(suite)), Path(results), resume=resume)


def leaderboard(results: str | Path) -> pd.DataFrame:
    """Return the leaderboard of a results folder: its tables one after the other, best rows first.

    The index is provenance, input class and detector. Figures are those of the table's operating
    point where a row has it, ``point``, else those at the published threshold.

    Raises:
        ResultsError: the folder has no results, or damaged ones.
    """
    import pandas as pd

    from spoofbench.scoring.leaderboard import leaderboard as ranked

    rows = []
    for table in ranked(Path(results)).tables:
        for row in table.rows:
            about = dataclasses.asdict(row)
            del about["ranked"], about["published"]
            place = {"provenance": table.provenance, "input_class": table.input_class}
            point = table.point if row.ranked else "published"
            rows.append(place | about | {"point": point} | dataclasses.asdict(row.shown))
    index = ["provenance", "input_class", "detector"]
    return pd.DataFrame(rows, columns=None if rows else index).set_index(index)


def compare(a: str | Path, b: str | Path) -> Differences:
    """Return what differs between two results folders, B - A, and what changed.

    Raises:
        ResultsError: a folder has no results, or damaged ones, or the two share nothing.
    """
    from spoofbench.scoring.differences import differences

    return differences(Path(a), Path(b))


def _detector(detector: str | Detector, parameters: dict[str, Any]) -> Detector:
    if isinstance(detector, str):
        made: Detector = plugins.make(plugins.DETECTORS, detector, parameters)
        return made
    return dataclasses.replace(detector, **parameters)  # type: ignore[type-var]
