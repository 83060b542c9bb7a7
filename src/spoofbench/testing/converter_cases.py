"""What the checks of converters work on: one converter, sample logs, and what comes of a log."""

import hashlib
import json
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from spoofbench import plugins
from spoofbench.conversion import (
    Block,
    Converter,
    Item,
    Member,
    Reject,
    Rejects,
    SizeHint,
    Source,
    SourceMetadata,
    Used,
)
from spoofbench.errors import RecordingError, SpoofbenchError
from spoofbench.recording import Recording
from spoofbench.schema import split_topic
from spoofbench.table import Table
from spoofbench.testing.kit import CheckFailed, require

Run = tuple[int, int, str]
"""Offset, length and reason of a reject."""


@dataclass(frozen=True)
class ConverterUnderTest:
    """A converter under test: a module or object, or the name of an entry point; sample logs;
    options by name.
    """

    given: str | Converter
    samples: tuple[Path, ...]
    options: Mapping[str, Any]
    streamed: bool

    @cached_property
    def converter(self) -> Converter:
        """The converter, loaded from its entry point where a name was given.

        Raises:
            PluginError: there is no such entry point, or it cannot be loaded.
        """
        if not isinstance(self.given, str):
            return self.given
        loaded: Converter = plugins.find(plugins.CONVERTERS, self.given).load()
        return loaded

    @cached_property
    def wholes(self) -> Mapping[Path, "ConverterOutcome"]:
        """What comes of each sample as it is."""
        return {path: self.convert(path) for path in self.samples}

    def streams(self) -> Iterator[tuple[Path, bytes, "ConverterOutcome"]]:
        """Yield the samples that are files, with their bytes as they are stored, and what comes of
        them whole.
        """
        for path, whole in self.wholes.items():
            if path.is_file():
                yield path, path.read_bytes(), whole

    def convert(self, path: Path, source: type[Source] = Source) -> "ConverterOutcome":
        """Convert a log and return what comes of it.

        Raises:
            CheckFailed: it raises what is not a SpoofbenchError, or yields what is no item.
        """
        return outcome(self.converter, path, self.options, source)

    def convert_bytes(self, name: str, log: bytes) -> "ConverterOutcome":
        """Convert a log of these bytes, called so, and return what comes of it."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, name)
            path.write_bytes(log)
            return self.convert(path)

    def sniff(self, path: Path) -> float:
        """Ask whether a log is the converter's own; 0 where it cannot even be unpacked.

        Raises:
            CheckFailed: it raises, or answers other than 0 to 1.
        """
        try:
            log = Source.of(path)
        except SpoofbenchError:
            return 0.0
        try:
            score = self.converter.sniff(log)
        except Exception as error:
            raise CheckFailed(
                f"sniff() of {path.name!r} raises {type(error).__name__}: {error}"
            ) from error
        number = isinstance(score, int | float) and 0 <= score <= 1
        require(number, f"sniff() of {path.name!r} must answer 0 to 1, not {score!r}")
        return float(score)


@dataclass(frozen=True)
class ConverterOutcome:
    """What a conversion yielded.

    Attributes:
        parts: the tables of its blocks by topic.
        used: units that gave rows.
        rejects: in the order of their offsets; neighbours of one reason are one.
        facts: metadata, later facts over earlier ones.
        size: bytes of the unpacked log; None where it cannot be unpacked to its end.
        error: why the log was refused as a whole; None where it was not.
    """

    parts: Mapping[str, Sequence[Table]]
    used: int
    rejects: Sequence[Run]
    facts: Mapping[str, Mapping[str, str]]
    size: int | None
    error: str | None

    @cached_property
    def tables(self) -> Mapping[str, Table]:
        """All rows by topic.

        Raises:
            CheckFailed: those of a topic run backwards in time from one block to the next.
        """
        return {
            topic: _concat(topic, parts)
            for topic, parts in self.parts.items()
            if sum(map(len, parts))
        }

    @property
    def skipped(self) -> int:
        return sum(length for _, length, _ in self.rejects)

    @property
    def rows(self) -> int:
        return sum(len(table) for table in self.tables.values())

    @property
    def latest_ns(self) -> int | None:
        """Time of the last row of all."""
        return max((int(table.time_ns[-1]) for table in self.tables.values()), default=None)

    @cached_property
    def digests(self) -> Mapping[str, str]:
        """SHA-256 of what it consists of: equal where the recording's bytes are."""
        parts: dict[str, Any] = {
            f"the rows of {topic}": Recording({topic: table}).digest()
            for topic, table in self.tables.items()
        }
        parts |= {f"the facts {name!r}": dict(record) for name, record in self.facts.items()}
        parts |= {
            "the account": self.used,
            "the rejects": list(self.rejects),
            "the error": self.error,
        }
        return {
            name: hashlib.sha256(json.dumps(part, sort_keys=True).encode()).hexdigest()
            for name, part in parts.items()
        }


def differing(one: Mapping[str, str], other: Mapping[str, str]) -> str:
    """Name the first part that two digests do not share; empty where they are equal."""
    return next((name for name in sorted({*one, *other}) if one.get(name) != other.get(name)), "")


def outcome(
    converter: Converter, path: Path, options: Mapping[str, Any], source: type[Source] = Source
) -> ConverterOutcome:
    """Convert a log and return what comes of it.

    Raises:
        CheckFailed: the converter raises what is not a SpoofbenchError, or yields what is no item.
    """
    gathered = _Gathered()
    try:
        log = source.of(path)
    except SpoofbenchError as failure:
        return gathered.outcome(None, str(failure))
    error = None
    try:
        for item in converter.convert(log, converter.Options(**options)):
            gathered.add(item)
    except SpoofbenchError as failure:
        error = str(failure)
        require(
            bool(error) and "\n" not in error.strip(),
            f"on {path.name!r} the error must be one sentence, not {error!r}",
        )
    except CheckFailed:
        raise
    except Exception as failure:
        raise CheckFailed(
            f"convert() of {path.name!r} raises {type(failure).__name__}: {failure}"
        ) from failure
    return gathered.outcome(unpacked_size(log), error)


@dataclass
class _Gathered:
    parts: dict[str, list[Table]] = field(default_factory=dict)
    used: int = 0
    runs: list[Run] = field(default_factory=list)
    facts: dict[str, dict[str, str]] = field(default_factory=dict)

    def add(self, item: Item) -> None:
        if isinstance(item, Block):
            self._add_rows(item)
        elif isinstance(item, Used):
            self.used += item.units
        elif isinstance(item, Reject):
            self.runs.append((int(item.offset), int(item.length), item.reason))
        elif isinstance(item, Rejects):
            self.runs += [
                (*run, item.reason)
                for run in zip(item.offsets.tolist(), item.lengths.tolist(), strict=True)
            ]
        elif isinstance(item, SourceMetadata):
            for name, record in item.metadata.items():
                self.facts.setdefault(name, {}).update(record)
        elif not isinstance(item, SizeHint):
            raise CheckFailed(
                "convert() must yield Block, Used, Reject, Rejects, SourceMetadata or "
                f"SizeHint, not {type(item).__name__}"
            )

    def _add_rows(self, block: Block) -> None:
        try:
            kind = split_topic(block.topic)[1]
        except RecordingError as error:
            raise CheckFailed(f"a block's topic is not one of the schema: {error}") from error
        require(
            kind == block.table.kind.name,
            f"a block of {block.topic!r} has a table of kind {block.table.kind.name!r}",
        )
        require(block.used >= 0, f"a block of {block.topic!r} has used {block.used}")
        self.used += int(block.used)
        self.parts.setdefault(block.topic, []).append(block.table)

    def outcome(self, size: int | None, error: str | None) -> ConverterOutcome:
        return ConverterOutcome(
            MappingProxyType(self.parts),
            self.used,
            merged(self.runs),
            MappingProxyType(self.facts),
            size,
            error,
        )


def merged(runs: Sequence[Run]) -> tuple[Run, ...]:
    """Return rejects in the order of their offsets, neighbours of one reason as one."""
    kept: list[Run] = []
    for offset, length, reason in sorted(runs):
        if kept and kept[-1][2] == reason and kept[-1][0] + kept[-1][1] == offset:
            kept[-1] = (kept[-1][0], kept[-1][1] + length, reason)
        else:
            kept.append((offset, length, reason))
    return tuple(kept)


def _concat(topic: str, tables: Sequence[Table]) -> Table:
    """Return the rows of a topic's tables as one table.

    Raises:
        CheckFailed: time runs backwards from one to the next.
    """
    times = np.concatenate([table.time_ns for table in tables])
    require(
        bool(np.all(times[1:] >= times[:-1])),
        f"rows of {topic} run backwards in time from one block to the next",
    )
    return Table.concat([table for table in tables if len(table)])


def unpacked_size(log: Source) -> int | None:
    """Return the bytes of a log as :meth:`Source.open` and :meth:`Source.members` hand them out;
    None where they cannot.
    """
    try:
        members = log.members()
        openings: list[Callable[[], Any]] = [member.open for member in members.values()]
        if log.path.is_file() and not log.is_archive:
            openings = [log.open]
        total = 0
        for opening in openings:
            with opening() as stream:
                while piece := stream.read(2**20):
                    total += len(piece)
    except SpoofbenchError:
        return None
    return total


class _Trickle:
    """A stream that gives fewer bytes than it is asked for."""

    def __init__(self, stream: Any) -> None:
        self._stream, self._turn = stream, 0

    def read(self, size: int = -1) -> bytes:
        if size is None or size < 0:
            return bytes(self._stream.read())
        self._turn += 1
        return bytes(self._stream.read(max(1, min(size, 7919 * (self._turn % 5) + 4096))))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def __enter__(self) -> "_Trickle":
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.close()

    def __iter__(self) -> Iterator[bytes]:
        return iter(self._stream)


class TrickledSource(Source):
    """A source whose streams give fewer bytes than they are asked for."""

    @classmethod
    def of(cls, path: Path) -> "TrickledSource":
        return cls(path, Source.of(path).head)

    def open(self) -> Any:
        return _Trickle(super().open())

    def members(self) -> Mapping[str, Any]:
        return {
            name: _TrickledMember(m.name, m.size, m.path, m.info)
            for name, m in super().members().items()
        }


class _TrickledMember(Member):
    def open(self) -> Any:
        return _Trickle(super().open())
