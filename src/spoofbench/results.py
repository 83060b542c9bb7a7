"""The results folder: what a run leaves behind, and how it is written and read.

::

    run.json                         the suite, versions, input digests, machine
    tasks.parquet                    one row per task: see Task
    decisions/<recording>.parquet    time_ns, score, available: see spoofbench.decisions
    truth/<variant>.parquet          the scoring grid of a variant, one row per epoch: see Truth;
                                     its metadata says the nominal interval, the attack intervals
                                     and the kinds that the variant has
    states/<fit>.pickle              what fitted detectors have learned
    calibration.parquet              thresholds: see spoofbench.scoring.operating
    curves.parquet                   operating curves: see there too
    scores.parquet                   one row per task and operating point: see
                                     spoofbench.scoring.score
    events.parquet                   one row per task, operating point and attack interval
    costs.parquet                    time and memory: the only file that may differ between equal
                                     runs

Decisions and truth never change once they are written. Every file is there whole or not at all,
and equal content gives equal bytes. Unknown is null.
"""

import contextlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from types import NoneType
from typing import Any, Literal, get_args

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from spoofbench.arrays import Bools, Floats, Times
from spoofbench.detector import Decisions
from spoofbench.errors import RecordingError, ResultsError
from spoofbench.recording import Interval

Status = Literal["ok", "skipped", "not_modelled", "failed", "timeout", "out_of_memory"]
FAILURES: frozenset[Status] = frozenset({"failed", "timeout", "out_of_memory"})
"""Statuses that count as misses; ``skipped`` and ``not_modelled`` are null."""


Provenance = Literal["real attack", "injected", "simulated"]
"""Of an attack: as it happened, ours on a real recording, or on a simulated one."""

Role = Literal["judged", "calibration", "family left out"]


@dataclass(frozen=True, slots=True)
class Task:
    """One row of ``tasks.parquet``: one detector on one variant of a recording.

    Attributes:
        task_id, variant_id: digests of what decides the result.
        role: ``judged``; ``calibration`` where it exists for thresholds alone; ``family left out``
            where the detector has learned from other attacks than the one it is judged on.
        recording, session, sensor_class: as in the suite.
        provenance: of the attacks on the recording.
        is_fused: whether the primary position is fused with inertial sensors.
        kinds: what a detector can see of the variant, as JSON text; None where it was not made.
        attack, attack_group, attack_plugin, attack_parameters, strength: None for an unattacked
            task; parameters as JSON text; attacks of one group are one at several strengths. Of a
            really attacked recording, ``attack`` is ``as recorded``.
        window, window_start_ns, window_end_ns: where the attack was to be; None as above.
        calibration_start_ns, calibration_end_ns: the part of an unattacked recording that sets
            thresholds; None where none does.
        judged_start_ns: from when on the recording is judged; None where it is not.
        held_out: sessions that thresholds and states must not have seen, as JSON text.
        left_out: plugin of the attacks that the state has not seen; None but for ``family left
            out`` and what calibrates that.
        fit_id: names the state of a fitted detector; None of one that is not.
        detector: name in the suite.
        plugin, plugin_distribution, plugin_version, parameters: what the detector is.
        parameter_sources: where those that are not defaults come from, as JSON text by name.
        input_class: what it looks at, such as ``gnss+imu``.
        requires: kinds without which it cannot run, as JSON text.
        memory_s: how long an alert may outlast its cause.
        warm_up_s: how much input it needs before its first decision.
        learns_from_attacks: whether it does.
        baseline: whether the detector says that it is one that others must beat.
        hold_s: how long a decision stands; None for its own rate.
        status, reason: what became of it, and why where that is not ``ok``.
    """

    task_id: str
    variant_id: str
    role: Role
    recording: str
    session: str
    sensor_class: str
    provenance: Provenance
    is_fused: bool
    kinds: str | None
    attack: str | None
    attack_group: str | None
    attack_plugin: str | None
    attack_parameters: str | None
    strength: float | None
    window: int | None
    window_start_ns: int | None
    window_end_ns: int | None
    calibration_start_ns: int | None
    calibration_end_ns: int | None
    judged_start_ns: int | None
    held_out: str
    left_out: str | None
    fit_id: str | None
    detector: str
    plugin: str
    plugin_distribution: str
    plugin_version: str
    parameters: str
    parameter_sources: str
    input_class: str
    requires: str
    memory_s: float
    warm_up_s: float
    learns_from_attacks: bool
    baseline: bool
    hold_s: float | None
    status: Status
    reason: str | None

    @property
    def is_judged(self) -> bool:
        """Whether false alerts or detections of it count."""
        return self.judged_start_ns is not None and self.role != "calibration"

    @property
    def calibrates(self) -> bool:
        """Whether its clean decisions set thresholds."""
        return self.calibration_start_ns is not None and self.attack is None


_TASK_TYPES: dict[Any, Any] = {
    bool: pa.bool_(),
    int: pa.int64(),
    int | None: pa.int64(),
    float: pa.float64(),
    float | None: pa.float64(),
}
TASK_SCHEMA = pa.schema(
    [(field.name, _TASK_TYPES.get(field.type, pa.string())) for field in fields(Task)]
)
_NEVER_NULL = [field.name for field in fields(Task) if NoneType not in get_args(field.type)]


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """The scoring grid of a variant, arrays of shape ``(n,)``, and its attack intervals.

    Attributes:
        time_ns: epochs of the variant's primary PVT, and the nominal epochs inside its gaps;
            increasing, on the recording's clock.
        observed: whether the variant has a row there (else a nominal epoch).
        spoofed: within an attack interval.
        guard: within 10 s after one, where an epoch is neither clean nor spoofed (a detector's
            ``memory_s`` may extend it).
        reviewed: whether it is known if there is an attack; of a really attacked recording, within
            an interval that is labelled attacked or clean. What is not counts as neither.
        lat_deg, lon_deg: WGS 84, as the variant says; NaN at nominal epochs.
        clean_lat_deg, clean_lon_deg: as the clean recording says; a really attacked one has none.
        position_error_m: 3-D distance of the two, NaN where either is absent.
        velocity_error_mps: norm of the difference of the two velocities.
        epoch_ns: nominal interval of the grid.
        intervals: the rows of ``/truth/attack``.
    """

    time_ns: Times
    observed: Bools
    spoofed: Bools
    guard: Bools
    reviewed: Bools
    lat_deg: Floats
    lon_deg: Floats
    clean_lat_deg: Floats
    clean_lon_deg: Floats
    position_error_m: Floats
    velocity_error_mps: Floats
    epoch_ns: int
    intervals: tuple[Interval, ...]


@dataclass(frozen=True, slots=True, eq=False)
class TaskOutcome:
    """What became of a task: decisions where it is ``ok``, else the reason why there are none."""

    status: Status
    reason: str | None
    decisions: Decisions | None


_TRUTH_TYPES: dict[Any, Any] = {Times: pa.int64(), Bools: pa.bool_(), Floats: pa.float64()}
_TRUTH_SCHEMA = pa.schema(
    [
        (field.name, _TRUTH_TYPES[field.type])
        for field in fields(Truth)
        if field.type in _TRUTH_TYPES
    ]
)


def write_truth(folder: Path, variant_id: str, truth: Truth, kinds: Sequence[str] = ()) -> None:
    """Write one variant's scoring grid and intervals, and the kinds that a detector can see."""
    columns = {name: getattr(truth, name) for name in _TRUTH_SCHEMA.names}
    metadata = {
        "epoch_ns": str(truth.epoch_ns),
        "kinds": json.dumps(list(kinds)),
        "intervals": json.dumps(
            [[interval.start_ns, interval.end_ns] for interval in truth.intervals]
        ),
    }
    write_parquet(
        _truth_file(folder, variant_id),
        pa.table(columns).replace_schema_metadata(metadata),
    )


def has_truth(folder: Path, variant_id: str) -> bool:
    """Whether a variant has a scoring grid; one that could not be made has none."""
    return _truth_file(folder, variant_id).exists()


def read_kinds(folder: Path, variant_id: str) -> list[str] | None:
    """Return the kinds that a detector can see of a variant; None where it could not be made.

    Raises:
        ResultsError: the file of its truth is damaged.
    """
    path = _truth_file(folder, variant_id)
    if not path.exists():
        return None
    try:
        kinds: list[str] = json.loads((pq.read_schema(path).metadata or {})[b"kinds"])
    except (OSError, pa.ArrowException, KeyError, ValueError) as error:
        raise ResultsError(f"{path} cannot be read: {error}; run the suite again") from error
    return kinds


def _truth_file(folder: Path, variant_id: str) -> Path:
    return folder / "truth" / f"{variant_id}.parquet"


def read_truth(folder: Path, variant_id: str) -> Truth:
    """Return one variant's scoring grid and intervals.

    Raises:
        ResultsError: the file is missing or damaged.
    """
    path = _truth_file(folder, variant_id)
    table = read_parquet(path)
    columns = columns_of(path, table, _TRUTH_SCHEMA)
    metadata = table.schema.metadata or {}
    try:
        pairs = json.loads(metadata[b"intervals"]) or np.empty((0, 2), np.int64)
        bounds = np.array(pairs).reshape(-1, 2)
        epoch_ns = int(metadata[b"epoch_ns"])
        if bounds.dtype != np.int64 or not 0 < epoch_ns < 2**63:
            raise ValueError("not whole nanoseconds")
        return Truth(
            **columns,
            epoch_ns=epoch_ns,
            intervals=tuple(Interval(*pair) for pair in bounds.tolist()),
        )
    except (KeyError, TypeError, ValueError, RecordingError, RecursionError) as error:
        raise ResultsError(
            f"{path} does not say its epoch and intervals; run the suite again"
        ) from error


def write_tasks(folder: Path, tasks: Sequence[Task]) -> None:
    """Write ``tasks.parquet``, rows in the order of the suite."""
    write_parquet(
        folder / "tasks.parquet",
        pa.Table.from_pylist([asdict(task) for task in tasks], TASK_SCHEMA),
    )


def read_task_table(folder: Path) -> pa.Table:
    """Return ``tasks.parquet`` as a table of the columns of :class:`Task`.

    Raises:
        ResultsError: the file is missing or damaged.
    """
    path = folder / "tasks.parquet"
    table = read_table(path, TASK_SCHEMA)
    unknown = [name for name in _NEVER_NULL if table[name].null_count]
    if not pc.all(pc.is_in(table["status"], pa.array(get_args(Status)))).as_py() and len(table):
        unknown.append("status")
    if unknown:
        raise ResultsError(
            f"{path} is damaged: {unknown[0]!r} is not known of every task; resume the run"
        )
    return table


def read_tasks(folder: Path) -> list[Task]:
    """Return the rows of ``tasks.parquet``, in the order of the suite.

    Raises:
        ResultsError: the file is missing or damaged.
    """
    columns = [column.to_pylist() for column in read_task_table(folder).columns]
    return [Task(*values) for values in zip(*columns, strict=True)]


def write_run(folder: Path, run: Mapping[str, Any]) -> None:
    """Write ``run.json``."""
    write_whole(
        folder / "run.json",
        lambda path: path.write_text(json.dumps(run, indent=1, sort_keys=True) + "\n"),
    )


def read_run(folder: Path) -> dict[str, Any]:
    """Return ``run.json``.

    Raises:
        ResultsError: the file is missing or damaged.
    """
    try:
        run: dict[str, Any] = dict(json.loads((folder / "run.json").read_text()))
    except (OSError, TypeError, ValueError, RecursionError) as error:
        raise ResultsError(f"{folder} is not a results folder: {error}") from error
    return run


def write_parquet(path: Path, table: pa.Table) -> None:
    """Write a table under a temporary name and rename it."""
    write_whole(path, lambda temporary: pq.write_table(table, temporary, compression="zstd"))


def read_parquet(path: Path) -> pa.Table:
    """Return a table.

    Raises:
        ResultsError: the file is missing or damaged.
    """
    try:
        # quickest for the many small files of a folder
        return pq.ParquetFile(pa.BufferReader(path.read_bytes())).read(use_threads=False)
    except (OSError, pa.ArrowException) as error:
        raise ResultsError(f"{path} cannot be read: {error}") from error


def read_table(path: Path, schema: pa.Schema) -> pa.Table:
    """Return a table of this schema, whose numbers are finite where they are not null.

    Raises:
        ResultsError: the file is missing or damaged.
    """
    table = read_parquet(path)
    if not table.schema.equals(schema):
        raise ResultsError(
            f"{path} is of another version of spoofbench: it has columns {table.column_names}; "
            "run the suite again"
        )
    for column in schema:
        if (
            column.type == pa.float64()
            and not np.isfinite(table[column.name].drop_null().to_numpy()).all()
        ):
            raise ResultsError(
                f"{path} is damaged: {column.name!r} is not finite everywhere; score the folder "
                "again"
            )
    return table


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Let a function write a file under a temporary name, then rename it: whole or not at all.

    Raises:
        ResultsError: it cannot be written.
    """
    temporary = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(temporary)
        temporary.replace(path)
    except BaseException as error:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            reason = error.strerror or error
            raise ResultsError(f"{str(path)!r} cannot be written: {reason}") from error
        raise


def columns_of(path: Path, table: pa.Table, schema: pa.Schema) -> dict[str, Any]:
    """Return columns of these types, without nulls, as arrays."""
    for column in schema:
        name = column.name
        if (
            name not in table.column_names
            or table[name].type != column.type
            or table[name].null_count
        ):
            raise ResultsError(f"{path} lacks values of {name!r}; delete it and resume the run")
    return {name: table[name].to_numpy() for name in schema.names}
