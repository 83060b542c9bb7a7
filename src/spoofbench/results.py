"""The results folder: one immutable file per outcome, tables over all of them, all of it Parquet.

::

    run.json                    versions, input digests, machine
    tasks.parquet               one row per task
    decisions/<task>.parquet    time_ns, score, available; status and reason in the file's metadata
    truth/<variant>.parquet     the scoring grid of a variant, per epoch; attack intervals in the file's metadata
    scores.parquet              one row per task
    events.parquet              one row per task and attack interval
    costs.parquet               time and memory: the only file that may differ between equal runs
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
import pyarrow.parquet as pq
from numpy.typing import NDArray

from spoofbench.detector import Decisions
from spoofbench.errors import PluginError, RecordingError, ResultsError
from spoofbench.recording import Interval

Status = Literal["ok", "skipped", "not_modelled", "failed", "timeout", "out_of_memory"]
FAILURES: frozenset[Status] = frozenset({"failed", "timeout", "out_of_memory"})
"""Statuses that count as misses; ``skipped`` and ``not_modelled`` are null."""


@dataclass(frozen=True, slots=True)
class Task:
    """One row of ``tasks.parquet``: one detector on one variant. An unattacked task has no attack,
    window or seed.
    """

    task_id: str
    variant_id: str
    recording: str
    session: str
    attack: str | None
    attack_parameters: str | None
    window_start_ns: int | None
    window_end_ns: int | None
    seed: int | None
    detector: str
    plugin: str
    plugin_distribution: str
    plugin_version: str
    parameters: str
    requires: str
    memory_s: float
    hold_s: float | None
    target_far_per_hour: float
    status: Status
    reason: str | None


_ARROW: dict[Any, Any] = {
    int: pa.int64(),
    int | None: pa.int64(),
    float: pa.float64(),
    float | None: pa.float64(),
}
TASK_SCHEMA = pa.schema(
    [(field.name, _ARROW.get(field.type, pa.string())) for field in fields(Task)]
)
_KNOWN = [field.name for field in fields(Task) if NoneType not in get_args(field.type)]


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """The scoring grid of a variant, arrays ``(n,)``, and its attack intervals.

    Attributes:
        time_ns: epochs of the variant's primary PVT, and the nominal epochs inside its gaps.
        observed: whether the variant has a row there (else a nominal epoch).
        spoofed: within an attack interval.
        guard: within 10 s after one, where an epoch is neither clean nor spoofed (a detector's
            ``memory_s`` may extend it).
        lat_deg, lon_deg: as the variant says; NaN at nominal epochs.
        clean_lat_deg, clean_lon_deg: as the clean recording says.
        position_error_m: 3-D distance of the two, NaN where either is absent.
        velocity_error_mps: norm of the difference of the two velocities.
        epoch_ns: nominal interval of the grid.
        intervals: the rows of ``/truth/attack``.
    """

    time_ns: NDArray[np.int64]
    observed: NDArray[np.bool_]
    spoofed: NDArray[np.bool_]
    guard: NDArray[np.bool_]
    lat_deg: NDArray[np.float64]
    lon_deg: NDArray[np.float64]
    clean_lat_deg: NDArray[np.float64]
    clean_lon_deg: NDArray[np.float64]
    position_error_m: NDArray[np.float64]
    velocity_error_mps: NDArray[np.float64]
    epoch_ns: int
    intervals: tuple[Interval, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What became of a task: decisions where the status is ``ok``, else the reason why there are
    none.
    """

    status: Status
    reason: str | None
    decisions: Decisions | None


_DECISION_SCHEMA = pa.schema(
    [("time_ns", pa.int64()), ("score", pa.float64()), ("available", pa.bool_())]
)


def write_outcome(folder: Path, task_id: str, outcome: Outcome) -> None:
    """Write one task's outcome, whole or not at all."""
    d = outcome.decisions
    columns: list[Any] = [[], [], []] if d is None else [d.time_ns, d.score, d.available]
    about = {"status": outcome.status, "reason": outcome.reason or ""}
    write_parquet(
        folder / "decisions" / f"{task_id}.parquet",
        pa.table(columns, _DECISION_SCHEMA.with_metadata(about)),
    )


def read_outcome(folder: Path, task_id: str) -> Outcome | None:
    """Return one task's outcome, None where there is none yet.

    Raises:
        ResultsError: the file is damaged.
    """
    path = folder / "decisions" / f"{task_id}.parquet"
    if not path.exists():
        return None
    table = read_parquet(path)
    about = {key.decode(): value.decode() for key, value in (table.schema.metadata or {}).items()}
    if about.get("status") not in get_args(Status):
        raise ResultsError(f"{path} has no status; delete it and resume the run")
    decisions = None
    if about["status"] == "ok":
        try:
            decisions = Decisions(*_columns(path, table, _DECISION_SCHEMA).values())
        except PluginError as error:
            raise ResultsError(
                f"{path} is damaged: {error}; delete it and resume the run"
            ) from error
    return Outcome(about["status"], about.get("reason") or None, decisions)


_TRUTH_TYPES: dict[Any, Any] = {
    NDArray[np.int64]: pa.int64(),
    NDArray[np.bool_]: pa.bool_(),
    NDArray[np.float64]: pa.float64(),
}
_TRUTH_SCHEMA = pa.schema(
    [
        (field.name, _TRUTH_TYPES[field.type])
        for field in fields(Truth)
        if field.type in _TRUTH_TYPES
    ]
)


def write_truth(folder: Path, variant_id: str, truth: Truth) -> None:
    """Write one variant's scoring grid and intervals."""
    columns = {name: getattr(truth, name) for name in _TRUTH_SCHEMA.names}
    about = {
        "epoch_ns": str(truth.epoch_ns),
        "intervals": json.dumps(
            [[interval.start_ns, interval.end_ns] for interval in truth.intervals]
        ),
    }
    write_parquet(
        folder / "truth" / f"{variant_id}.parquet", pa.table(columns).replace_schema_metadata(about)
    )


def has_truth(folder: Path, variant_id: str) -> bool:
    """Whether a variant has a scoring grid; one that could not be made has none."""
    return (folder / "truth" / f"{variant_id}.parquet").exists()


def read_truth(folder: Path, variant_id: str) -> Truth:
    """Return one variant's scoring grid and intervals.

    Raises:
        ResultsError: the file is missing or damaged.
    """
    path = folder / "truth" / f"{variant_id}.parquet"
    table = read_parquet(path)
    columns = _columns(path, table, _TRUTH_SCHEMA)
    about = table.schema.metadata or {}
    try:
        bounds = np.array(json.loads(about[b"intervals"]) or np.empty((0, 2), np.int64)).reshape(
            -1, 2
        )
        epoch_ns = int(about[b"epoch_ns"])
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


def read_tasks(folder: Path) -> list[Task]:
    """Return the rows of ``tasks.parquet``.

    Raises:
        ResultsError: the file is missing or damaged.
    """
    path = folder / "tasks.parquet"
    rows = read_rows(path, TASK_SCHEMA)
    for row in rows:
        unknown = [name for name in _KNOWN if row[name] is None]
        if unknown or row["status"] not in get_args(Status):
            raise ResultsError(
                f"{path} is damaged: a task has no {(unknown or ['status'])[0]!r} that is known; "
                "resume the run"
            )
    return [Task(**row) for row in rows]


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
        return pq.read_table(path, partitioning=None)
    except (OSError, pa.ArrowException) as error:
        raise ResultsError(f"{path} cannot be read: {error}") from error


def read_rows(path: Path, schema: pa.Schema) -> list[dict[str, Any]]:
    """Return the rows of a table of this schema; unknown is None, and numbers are finite.

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
    rows: list[dict[str, Any]] = table.to_pylist()
    return rows


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Let a function write a file under a temporary name, and rename it: it is there whole or not
    at all.

    Raises:
        ResultsError: it cannot be written.
    """
    temporary = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(temporary)
        temporary.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise ResultsError(f"{str(path)!r} cannot be written: {error.strerror or error}") from error


def _columns(path: Path, table: pa.Table, schema: pa.Schema) -> dict[str, Any]:
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
