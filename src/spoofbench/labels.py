"""Labels of real attacks: what somebody found out about a recording, written beside its rows.

Labels come in a TOML file::

    labelled_by = "J. Doe, Example Institute"
    source = "https://example.org/report"   # where the labels are from
    time_base = "utc"                       # or "gps", "recording" (seconds after its first row),
                                            # or the offset of local times, such as "+02:00"
    time_check = "the position jumps within a second of both edges"

    [[attacked]]
    class = "generated"                     # replay, meaconing, generated, ...
    start = 2024-05-01T09:24:25
    end = 2024-05-01T09:47:45

    [[clean]]                               # reviewed, and no attack found
    start = 2024-05-01T08:00:00
    end = 2024-05-01T09:24:00

or in a CSV file with the columns ``state`` (``attacked`` or ``clean``), ``start``, ``end``,
``class``, ``labelled_by``, ``source``, ``time_base`` and ``time_check``. A time with an offset of
its own needs no time base. Intervals are half-open. What they leave out counts as not reviewed: a
detector is judged there neither by its alerts nor by its silence.
"""

import csv
import io
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Predicate, doc

from spoofbench import config
from spoofbench.codec import read, write
from spoofbench.errors import ConfigError, RecordingError
from spoofbench.formatting import date_time
from spoofbench.gnss_time import GPS_EPOCH_NS, YEARS, gps_to_utc
from spoofbench.recording import Interval, Recording, is_really_attacked
from spoofbench.schema import CLEAN_TOPIC, LABEL_TOPICS, TRUTH_TOPIC
from spoofbench.table import Table

_UNIX_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_MOST_S = 1e9  # fits in nanoseconds


def _says_something(text: str) -> bool:
    return bool(text.strip())


def _is_time_base(text: str) -> bool:
    return text in ("utc", "gps", "recording") or bool(
        re.fullmatch(r"[+-](0\d|1[0-4]):[0-5]\d", text)
    )


Words = Annotated[str, Predicate(_says_something), doc("a text that says something")]
TimeBase = Annotated[
    str,
    Predicate(_is_time_base),
    doc("'utc', 'gps', 'recording', or the offset of local times, such as '+02:00'"),
]


@dataclass(frozen=True, slots=True)
class Label:
    """One interval of a file of labels.

    Attributes:
        state: attacked, or reviewed and clean.
        start, end: as the file says them.
        labelled_by: person or organisation.
        source: where the label is from.
        time_check: how it was checked that the times fit the recording's clock.
        time_base: what the times are told by; None where each has an offset of its own.
        attack_class: of an attack alone.
    """

    state: Literal["attacked", "clean"]
    start: object
    end: object
    labelled_by: Words
    source: Words
    time_check: Words
    time_base: TimeBase | None = None
    attack_class: Words | None = field(default=None, metadata={"key": "class"})

    def __post_init__(self) -> None:
        if (self.state == "attacked") != (self.attack_class is not None):
            does = "needs a" if self.state == "attacked" else "has no"
            raise ValueError(f"an interval that is {self.state} {does} class")


@dataclass(frozen=True, slots=True)
class _LabelFile:
    """A TOML file of labels, whose intervals are read as :class:`Label`."""

    labelled_by: object
    source: object
    time_check: object
    time_base: object = None
    attacked: tuple[Mapping[str, object], ...] = ()
    clean: tuple[Mapping[str, object], ...] = ()


@dataclass(frozen=True, slots=True)
class _Placed:
    """A label on a recording's clock, and how an error calls it."""

    where: str
    interval: Interval
    label: Label


def label_file(file: Path, labels: Path, out: Path, *, replace: bool = False) -> Recording:
    """Write a recording with labels of a real attack, and return it.

    Args:
        file: the recording.
        labels: TOML, or CSV where its name ends so.
        out: where to write.
        replace: whether labels that are there may be exchanged.

    Raises:
        ConfigError: the labels cannot be read, or do not fit the recording; says what to do.
        RecordingError: the recording is labelled already, or carries an attack of ours.
        FormatError: the file is no recording.
    """
    labelled = label_recording(read(file), read_labels(labels), replace=replace)
    write(labelled, out)
    return labelled


def read_labels(path: Path) -> list[tuple[str, Label]]:
    """Return the labels of a file, each with how an error calls it.

    Raises:
        ConfigError: names the key, the value and what to do.
    """
    rows = _csv_rows(path) if path.suffix.lower() == ".csv" else _toml_rows(path)
    return [(where, config.read(Label, row, where)) for where, row in rows]


def label_recording(
    recording: Recording, labels: Sequence[tuple[str, Label]], *, replace: bool = False
) -> Recording:
    """Return a recording with labels of a real attack.

    Args:
        recording: of which the times are.
        labels: as :func:`read_labels` gives them.
        replace: whether labels that are there may be exchanged.

    Raises:
        ConfigError: no interval is attacked, or one overlaps another, is reversed or outside the
            recording, or does not say its time base.
        RecordingError: the recording is labelled already, or carries an attack of ours.
    """
    if TRUTH_TOPIC in recording and not is_really_attacked(recording):
        raise RecordingError("the recording carries an attack that was made: it is not a real one")
    if not replace and any(topic in recording for topic in LABEL_TOPICS):
        raise RecordingError("the recording is labelled already; exchange its labels by --replace")
    placed = sorted(
        (_Placed(where, _place(where, label, recording.span), label) for where, label in labels),
        key=lambda each: each.interval,
    )
    if not any(each.label.state == "attacked" for each in placed):
        raise ConfigError(
            "the labels have no attacked interval; a recording without an attack needs none"
        )
    for one, other in pairwise(placed):
        if other.interval.start_ns < one.interval.end_ns:
            raise ConfigError(f"{other.where} overlaps {one.where}; an epoch has one label")
    clean = _table(CLEAN_TOPIC, placed)
    return recording.replace(
        {TRUTH_TOPIC: _table(TRUTH_TOPIC, placed), CLEAN_TOPIC: clean if len(clean) else None}
    )


def _toml_rows(path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    where = f"the labels {path.name!r}"
    table = config.read_toml(path, where)
    file = config.read(_LabelFile, table, where)
    common = {key: table[key] for key in table if key not in ("attacked", "clean")}
    for state in ("attacked", "clean"):
        for number, entry in enumerate(getattr(file, state), 1):
            here = f"{where}, [[{state}]] number {number}"
            for key in entry:
                if key not in ("start", "end", *(["class"] if state == "attacked" else [])):
                    raise ConfigError(f"{here} has an unknown key {key!r}")
            yield here, {"state": state, **entry, **common}


def _csv_rows(path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    where = f"the labels {path.name!r}"
    try:
        reader = csv.DictReader(io.StringIO(path.read_text("utf-8-sig")), strict=True)
        for row in reader:
            here = f"{where}, line {reader.line_num}"
            if None in row or None in row.values():
                raise ConfigError(f"{here} has not as many cells as the first line")
            yield here, {key.strip(): cell.strip() for key, cell in row.items() if cell.strip()}
    except OSError as error:
        raise ConfigError(f"{where} cannot be read: {error.strerror or error}") from error
    except (csv.Error, UnicodeDecodeError) as error:
        raise ConfigError(f"{where} is not CSV: {error}") from error


def _place(where: str, label: Label, span: Interval) -> Interval:
    """Return where a label lies on the recording's clock."""
    start_ns, end_ns = (
        _time_ns(f"{where}: {edge} = {_shown(value)}", value, label.time_base, span.start_ns)
        for edge, value in (("start", label.start), ("end", label.end))
    )
    if end_ns <= start_ns:
        raise ConfigError(f"{where}: it must end after it starts")
    if start_ns < span.start_ns or end_ns > span.end_ns:
        raise ConfigError(
            f"{where}: {date_time(start_ns)} to {date_time(end_ns)} UTC is not within the "
            f"recording, {date_time(span.start_ns)} to {date_time(span.end_ns)} UTC; check the "
            "time base, or cut the interval"
        )
    return Interval(start_ns, end_ns)


def _time_ns(what: str, value: object, time_base: str | None, first_ns: int) -> int:
    """Return a time on the recording's clock; ``what`` names it in an error."""
    if time_base == "recording":
        return first_ns + round(_seconds(what, value) * 1e9)
    moment = _moment(what, value)
    if moment.tzinfo is not None and time_base == "gps":
        raise ConfigError(f"{what} has an offset from UTC, which GPS time has not; leave it out")
    if moment.tzinfo is None and time_base is None:
        raise ConfigError(
            f'{what} does not say what clock it is of; add time_base = "utc", "gps", or the offset '
            'of local time, such as "+02:00"'
        )
    if moment.tzinfo is None:
        is_local = time_base not in ("utc", "gps")
        offset = datetime.strptime(str(time_base), "%z").tzinfo if is_local else UTC
        moment = moment.replace(tzinfo=offset)
    unix_ns = (moment - _UNIX_EPOCH) // timedelta(microseconds=1) * 1000
    return int(gps_to_utc(unix_ns - GPS_EPOCH_NS)) if time_base == "gps" else unix_ns


def _seconds(what: str, value: object) -> float:
    try:
        seconds = math.nan if isinstance(value, bool) else float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        seconds = math.nan
    if not abs(seconds) <= _MOST_S:
        raise ConfigError(f"{what} must be seconds after the recording's first row")
    return seconds


def _moment(what: str, value: object) -> datetime:
    if isinstance(value, str) and re.match(r"\d{4}-\d\d-\d\d[T ]\d", value):
        with suppress(ValueError):
            value = datetime.fromisoformat(value)
    if isinstance(value, datetime) and value.year in YEARS:
        return value
    raise ConfigError(f"{what} must be a date and a time, such as 2024-05-01T09:24:25Z")


def _shown(value: object) -> str:
    return value.isoformat() if isinstance(value, datetime) else repr(value)


def _table(topic: str, placed: Sequence[_Placed]) -> Table:
    """Return the rows of one of the label topics, in the order of time."""
    state = "attacked" if topic == TRUTH_TOPIC else "clean"
    chosen = [each for each in placed if each.label.state == state]
    labels = [each.label for each in chosen]
    starts, ends = (
        np.array([getattr(each.interval, edge) for each in chosen], np.int64)
        for edge in ("start_ns", "end_ns")
    )
    columns: dict[str, Any] = {
        "start_ns": starts,
        "end_ns": ends,
        "labelled_by": [label.labelled_by for label in labels],
        "label_source": [label.source for label in labels],
        "time_base": [label.time_base or "utc" for label in labels],
        "time_check": [label.time_check for label in labels],
    }
    if topic == TRUTH_TOPIC:
        columns |= {
            "class": [label.attack_class for label in labels],
            "provenance": ["real"] * len(labels),
        }
    return Table(topic.removeprefix("/"), starts, columns)
