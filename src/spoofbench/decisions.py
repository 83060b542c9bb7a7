"""Where the decisions of a run are kept: ``decisions/<recording>.parquet``, a row group per task.

Each file's metadata says, in the order of the suite, of every task of its recording what became of
it and how many rows it has. While a run is under way its outcomes are appended to
``decisions/unsorted.arrows``, one Arrow stream after the other, so that a run that is killed loses
at most what was being written; at its end they are sorted into the files.
"""

import json
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from spoofbench.detector import Decisions
from spoofbench.errors import PluginError, ResultsError
from spoofbench.results import Status, TaskOutcome, columns_of, write_whole

SCHEMA = pa.schema([("time_ns", pa.int64()), ("score", pa.float64()), ("available", pa.bool_())])
_UNSORTED = "unsorted.arrows"
_END = b"\xff\xff\xff\xff\0\0\0\0"  # of an Arrow stream

Read = Callable[[], TaskOutcome]


class OutcomeReader:
    """The outcomes in one recording's file.

    Raises:
        ResultsError: the file is damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._file = pq.ParquetFile(path)
            outcomes = json.loads((self._file.schema_arrow.metadata or {})[b"outcomes"])
            self._index: dict[str, tuple[Status, str | None, int | None]] = {}
            group = 0
            for task_id, status, reason, rows in outcomes:
                if status not in get_args(Status):
                    raise ValueError(f"no such status: {status!r}")
                has_rows = status == "ok" and rows > 0
                if has_rows and self._file.metadata.row_group(group).num_rows != rows:
                    raise ValueError(f"task {task_id!r} has not its {rows} rows")
                self._index[task_id] = (status, reason, group if has_rows else None)
                group += has_rows
            if group != self._file.num_row_groups:
                raise ValueError("the row groups are not those of its tasks")
        except (
            OSError,
            pa.ArrowException,
            IndexError,
            KeyError,
            RecursionError,
            TypeError,
            ValueError,
        ) as error:
            raise ResultsError(
                f"{path} is damaged: {error}; delete it and resume the run"
            ) from error

    def __iter__(self) -> Iterator[str]:
        """Yield the ids of its tasks."""
        return iter(self._index)

    def fate(self, task_id: str) -> tuple[Status, str | None]:
        """Return what became of a task, and why."""
        return self._index[task_id][:2]

    def get(self, task_id: str) -> TaskOutcome | None:
        """Return the outcome of a task, None where the file does not know it.

        Raises:
            ResultsError: the file is damaged.
        """
        if task_id not in self._index:
            return None
        status, reason, group = self._index[task_id]
        if status != "ok":
            return TaskOutcome(status, reason, None)
        try:
            table = (
                SCHEMA.empty_table()
                if group is None
                else self._file.read_row_group(group, use_threads=False)
            )
        except (OSError, pa.ArrowException) as error:
            raise ResultsError(
                f"{self.path} is damaged: {error}; delete it and resume the run"
            ) from error
        return TaskOutcome(status, reason, _decisions(self.path, table))


def _decisions(path: Path, table: pa.Table) -> Decisions:
    try:
        return Decisions(*columns_of(path, table, SCHEMA).values())
    except PluginError as error:
        raise ResultsError(f"{path} is damaged: {error}; delete it and resume the run") from error


class Outcomes:
    """The outcomes of a results folder, by recording and task.

    One file is open at a time: ask for the tasks of a recording together.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder / "decisions"
        self._open: tuple[str, OutcomeReader] | None = None

    def of(self, recording: str) -> OutcomeReader:
        """Return the outcomes of a recording's tasks.

        Raises:
            ResultsError: its file is missing or damaged.
        """
        if self._open is None or self._open[0] != recording:
            self._open = (recording, OutcomeReader(self._folder / f"{recording}.parquet"))
        return self._open[1]

    def decisions(self, recording: str, task_id: str) -> Decisions:
        """Return the decisions of a task that is ok.

        Raises:
            ResultsError: there are none, or the recording's file is damaged.
        """
        outcome = self.of(recording).get(task_id)
        if outcome is None or outcome.decisions is None:
            raise ResultsError(
                f"task {task_id!r} is ok but {self._folder.parent} has no decisions of it; resume "
                "the run"
            )
        return outcome.decisions


@dataclass(frozen=True, slots=True)
class _Stored:
    """An outcome that is stored: its status, and how to read it."""

    status: Status
    read: Read


class OutcomeLog:
    """The outcomes of a run as it grows, from any thread.

    What a damaged file held is not known, and so is run again.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder / "decisions"
        self._folder.mkdir(parents=True, exist_ok=True)
        self._log = self._folder / _UNSORTED
        self._lock = threading.Lock()
        self._sorted: dict[str, list[str]] = {}
        self._stored: dict[str, _Stored] = {}
        self._new: set[str] = set()
        for path in sorted(self._folder.glob("*.parquet")):
            try:
                reader = OutcomeReader(path)
            except ResultsError:
                continue
            self._sorted[path.stem] = list(reader)
            for task_id in reader:
                self._stored[task_id] = _Stored(reader.fate(task_id)[0], _reading(reader, task_id))
        self._take_up()

    def _take_up(self) -> None:
        """Read what a killed run has left, and cut off what it was writing."""
        if not self._log.exists():
            return
        whole = 0
        with pa.memory_map(str(self._log)) as source:
            size = source.size()
            while whole < size:
                source.seek(whole)
                try:
                    task_id, status, _ = _read_stream(source, self._log)
                except ResultsError:
                    break
                self._stored[task_id] = _Stored(status, self._logged(whole))
                self._new.add(task_id)
                whole = source.tell()
        with self._log.open("r+b") as file:
            file.truncate(whole)

    def _logged(self, offset: int) -> Read:
        def read() -> TaskOutcome:
            with pa.memory_map(str(self._log)) as source:
                source.seek(offset)
                return _read_stream(source, self._log)[2]

        return read

    def status(self, task_id: str) -> Status | None:
        """Return what became of a task, None where that is not known."""
        stored = self._stored.get(task_id)
        return None if stored is None else stored.status

    def get(self, task_id: str) -> TaskOutcome | None:
        """Return the outcome of a task, None where there is none that can be read."""
        stored = self._stored.get(task_id)
        try:
            return None if stored is None else stored.read()
        except ResultsError:
            return None

    def add(self, task_id: str, outcome: TaskOutcome) -> None:
        """Append what became of a task."""
        made = outcome.decisions
        columns: Sequence[Any] = (
            [np.empty(0, column.type.to_pandas_dtype()) for column in SCHEMA]
            if made is None
            else (made.time_ns, made.score, made.available)
        )
        about = {"task": task_id, "status": outcome.status, "reason": outcome.reason or ""}
        sink = pa.BufferOutputStream()
        batch = pa.record_batch([pa.array(column) for column in columns], SCHEMA)
        with pa.ipc.new_stream(sink, SCHEMA.with_metadata(about)) as stream:
            stream.write_batch(batch)
        with self._lock, self._log.open("ab") as file:
            offset = file.tell()
            file.write(sink.getvalue())
            self._stored[task_id] = _Stored(outcome.status, self._logged(offset))
            self._new.add(task_id)

    def sort(self, tasks: Mapping[str, Sequence[str]]) -> None:
        """Write a file for each recording: its tasks, in their order; what is not among them goes.

        Raises:
            ResultsError: a file cannot be written.
        """
        for recording, task_ids in tasks.items():
            if self._sorted.get(recording) != list(task_ids) or self._new.intersection(task_ids):
                self._write(self._folder / f"{recording}.parquet", task_ids)
        keep = {f"{recording}.parquet" for recording in tasks}
        for path in self._folder.iterdir():
            if path.name not in keep:
                path.unlink()

    def _write(self, path: Path, task_ids: Iterable[str]) -> None:
        outcomes = [(task_id, self._stored[task_id].read()) for task_id in task_ids]
        index = [
            (
                task_id,
                outcome.status,
                outcome.reason,
                0 if outcome.decisions is None else outcome.decisions.time_ns.size,
            )
            for task_id, outcome in outcomes
        ]
        schema = SCHEMA.with_metadata({"outcomes": json.dumps(index, separators=(",", ":"))})

        def write(temporary: Path) -> None:
            with pq.ParquetWriter(temporary, schema, compression="zstd") as writer:
                for _, outcome in outcomes:
                    made = outcome.decisions
                    if made is not None and made.time_ns.size:
                        columns = [made.time_ns, made.score, made.available]
                        table = pa.table([pa.array(column) for column in columns], schema)
                        writer.write_table(table, row_group_size=made.time_ns.size)

        write_whole(path, write)


def _reading(reader: OutcomeReader, task_id: str) -> Read:
    def read() -> TaskOutcome:
        outcome = reader.get(task_id)
        assert outcome is not None, "its ids are those that it yields"
        return outcome

    return read


def _read_stream(source: Any, path: Path) -> tuple[str, Status, TaskOutcome]:
    """Return a task, its status and its outcome from where the source stands.

    Raises:
        ResultsError: what is there is damaged, or has no end: whatever were written after it would
            be taken for more of it.
    """
    try:
        with pa.ipc.open_stream(source) as stream:
            table = stream.read_all()
            metadata = stream.schema.metadata or {}
        source.seek(source.tell() - len(_END))
        if source.read(len(_END)) != _END:
            raise ValueError("it was cut short")
        about = {key.decode(): value.decode() for key, value in metadata.items()}
        status: Any = about["status"]
        decisions = _decisions(path, table) if status == "ok" else None
        return about["task"], status, TaskOutcome(status, about["reason"] or None, decisions)
    except (OSError, pa.ArrowException, KeyError, ValueError) as error:
        raise ResultsError(f"{path} is damaged: {error}; resume the run") from error
