"""From a raw log to a recording: detect the format, stream, account, write."""

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from spoofbench import config, plugins
from spoofbench.conversion.contract import (
    Block,
    Converter,
    Exporting,
    Item,
    Ledger,
    Reject,
    Rejects,
    SizeHint,
    SourceMetadata,
    Used,
)
from spoofbench.conversion.sources import Source, packing_of
from spoofbench.errors import ConversionError, PluginError, SpoofbenchError
from spoofbench.plugins import Plugin
from spoofbench.schema import SCHEMA_VERSION, split_topic

BACKWARDS = "time runs backwards"
TOO_EARLY = "times before 1970, which a recording cannot hold"
PACKING_DAMAGED = "the packing is damaged: what follows could not be unpacked"

_Metadata = dict[str, dict[str, str]]


def convert(
    source: Path,
    out: Path,
    *,
    format: str | None = None,  # noqa: A002 - the word that users know
    options: Mapping[str, str] = MappingProxyType({}),
    strict: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Ledger:
    """Convert one raw log to a recording.

    Args:
        source: a file, a folder or an archive.
        out: the recording to write; it appears whole or not at all.
        format: name of the converter; else found by content.
        options: the converter's options, as texts.
        strict: raise at the first part that must be skipped.
        progress: is told the share of the source that is done, 0 to 1.

    Raises:
        ConversionError: the log is not recognised, cannot be read or holds nothing; or ``strict``
            and something was skipped.
        PluginError: the converter cannot be loaded or breaks its contract; one that counts bytes
            must account for each.
    """
    from spoofbench.codec import Writer

    log = Source.of(source)
    if out.resolve().is_relative_to(source.resolve()):
        raise ConversionError(
            f"the output {str(out)!r} would change the log {str(source)!r}; choose another place"
        )
    plugin, converter = (
        (plugins.find(plugins.CONVERTERS, format), None)
        if format
        else detect_format(log, by_mapping="mapping" in options)
    )
    converter = converter or plugin.load()
    chosen = config.read(
        converter.Options,
        {key: config.Text(value) for key, value in options.items()},
        f"the {plugin.name} converter",
        noun="option",
        error=ConversionError,
    )
    log = log.reset()
    with ThreadPoolExecutor(1) as pool:
        digest = pool.submit(_digest, source)
        run = _Run(Ledger(converter.UNIT), strict)
        with Writer(out) as writer:
            for block in run.blocks(_items(plugin, converter, log, chosen), progress):
                writer.add(block.topic, block.table)
            run.close(plugin, log)
            if not run.ledger.rows:
                raise ConversionError(f"{source.name!r} gave no rows: {_why(run.ledger)}")
            if log.stats.companions:
                digest = pool.submit(_digest, source, tuple(log.stats.companions.values()))
            origin = {
                "file": source.name,
                **_digested(digest),
                **_made_by(plugin, converter, chosen),
            }
            writer.describe(run.metadata(origin))
    if progress:
        progress(1.0)
    return run.ledger


def detect_format(
    log: Source, only: str | None = None, *, by_mapping: bool = False
) -> tuple[Plugin, Converter]:
    """Return the converter that is surest that a log is its own; ``only`` that one is asked, if
    given.

    Where the user gives a mapping, a log that none claims goes to the converter that reads by
    mappings.

    Raises:
        PluginError: there is no such converter; NotRecognised: none claims it; ConversionError: two
            claim it alike.
    """
    claims: list[tuple[float, Plugin, Converter]] = []
    broken: list[str] = []
    for plugin in (
        [plugins.find(plugins.CONVERTERS, only)]
        if only
        else plugins.found(plugins.CONVERTERS).values()
    ):
        try:
            converter: Converter = plugin.load()
            claims.append((float(converter.sniff(log)), plugin, converter))
        except Exception as error:  # noqa: BLE001 - a plugin may raise anything
            broken.append(
                str(error) if isinstance(error, PluginError) else f"{plugin} failed: {error}"
            )
    claims.sort(key=lambda claim: -claim[0])
    if not claims or claims[0][0] <= 0:
        reader = next(
            (
                (plugin, converter)
                for _, plugin, converter in claims
                if by_mapping and isinstance(converter, Exporting)
            ),
            None,
        )
        if reader is not None:
            return reader
        tried = sorted(plugin.name for _, plugin, _ in claims)
        raise NotRecognised(
            f"no converter recognises {log.path.name!r}; tried {tried or 'none'}", broken
        )
    if len(claims) > 1 and claims[1][0] == claims[0][0]:
        names = sorted(plugin.name for score, plugin, _ in claims if score == claims[0][0])
        raise ConversionError(
            f"{log.path.name!r} may be of any of the formats {names}; say which with --format"
        )
    return claims[0][1], claims[0][2]


class NotRecognised(ConversionError):
    """No converter claims a log; ``broken`` says which could not be asked, and why."""

    def __init__(self, sentence: str, broken: Sequence[str]) -> None:
        super().__init__("; ".join([sentence, *broken]))
        self.broken = tuple(broken)


class _Run:
    """One conversion under way: its ledger and what its facts said."""

    def __init__(self, ledger: Ledger, strict: bool) -> None:
        self.ledger = ledger
        self._strict = strict
        self._facts: _Metadata = {}
        self._last_ns: dict[str, int] = {}

    def blocks(
        self, items: Iterator[Item], progress: Callable[[float], None] | None
    ) -> Iterator[Block]:
        """Yield the blocks with rows, in the order of time; account for all items."""
        extent = 0
        for item in items:
            if isinstance(item, SizeHint):
                extent = item.units
            elif isinstance(item, SourceMetadata):
                for name, record in item.metadata.items():
                    self._facts.setdefault(name, {}).update(record)
            elif isinstance(item, Reject | Rejects):
                self._reject(item)
            elif isinstance(item, Used):
                self.ledger.enter(item)
            else:
                block = self._forwards(item)
                self.ledger.enter(block)
                if len(block.table):
                    yield block
            if progress and extent:
                progress(min((self.ledger.used + self.ledger.skipped) / extent, 1.0))

    def _reject(self, reject: Reject | Rejects) -> None:
        if isinstance(reject, Rejects) and not reject.offsets.size:
            return
        if self._strict:
            offset, length = (
                (reject.offset, reject.length)
                if isinstance(reject, Reject)
                else (reject.offsets[0], reject.lengths[0])
            )
            raise ConversionError(
                f"{reject.reason} (at {self.ledger.unit[:-1]} {offset}, {length} "
                f"{self.ledger.unit}); "
                "convert without --strict to skip what cannot be used"
            )
        self.ledger.enter(reject)

    def _forwards(self, block: Block) -> Block:
        """Return the block without the rows that lie before 1970, or before those already
        written.
        """
        early = int(np.searchsorted(block.table.time_ns, 0, "left"))
        block = self._without(block, early, f"{TOO_EARLY}, in {block.topic}")
        times = block.table.time_ns
        last = self._last_ns.get(block.topic)
        behind = 0 if last is None else int(np.searchsorted(times, last, "left"))
        if times.size > behind:
            self._last_ns[block.topic] = int(times[-1])
        return self._without(block, behind, f"{BACKWARDS} in {block.topic}")

    def _without(self, block: Block, rows: int, reason: str) -> Block:
        """Return the block without its first rows, which are rejected with their share of the
        source.
        """
        if not rows:
            return block
        lost = round(block.used * rows / len(block.table))
        self._reject(Reject(self.ledger.used + self.ledger.skipped, lost, reason))
        return Block(block.topic, block.table.take(slice(rows, None)), block.used - lost)

    def close(self, plugin: Plugin, log: Source) -> None:
        """Enter where packed files end early, and hold a converter that counts bytes to the size of
        its source.

        Raises:
            PluginError: it accounted for more or for less.
        """
        for name in sorted(log.stats.damage):
            self._reject(Reject(log.stats.ended[name], 0, PACKING_DAMAGED))
        counted = self.ledger.used + self.ledger.skipped
        if self.ledger.unit == "bytes" and counted != log.size():
            raise PluginError(
                f"{plugin} accounts for {counted:,} bytes of {log.path.name!r}, which has "
                f"{log.size():,}; "
                f"report it to the authors of {plugin.distribution!r}"
            )

    def metadata(self, origin: Mapping[str, str]) -> _Metadata:
        """Return all metadata records of the recording."""
        primary: dict[str, str] = {}
        for topic in sorted(self.ledger.rows):
            name, kind = split_topic(topic)
            if name:
                primary.setdefault(kind, name)
        facts = self._facts
        records: _Metadata = {
            **facts,
            "origin": dict(origin),
            "ledger": self.ledger.as_metadata(),
            "recording": {
                "session_id": origin["sha256"][:16],
                **facts.get("recording", {}),
                "schema_version": SCHEMA_VERSION,
            },
            "primary": {**primary, **facts.get("primary", {})},
        }
        return {
            name: {key: _encodable(text) for key, text in record.items()}
            for name, record in records.items()
        }


def _items(plugin: Plugin, converter: Converter, log: Source, options: Any) -> Iterator[Item]:
    if converter.UNIT == "bytes" and log.path.is_file() and packing_of(log.path) is None:
        yield SizeHint(log.path.stat().st_size)
    items = converter.convert(log, options)
    while True:
        try:
            item = next(items)
        except StopIteration:
            return
        except SpoofbenchError:
            raise
        except Exception as error:  # a plugin may raise anything
            raise PluginError(
                f"{plugin} failed on {log.path.name!r}: {type(error).__name__}: {error}"
            ) from error
        if not isinstance(item, Item):
            raise PluginError(
                f"{plugin} must yield items of spoofbench.conversion, not {type(item).__name__}"
            )
        yield item


def _made_by(plugin: Plugin, converter: Converter, options: Any) -> dict[str, str]:
    return {
        "converter": plugin.name,
        "converter_version": converter.VERSION,
        "converter_distribution": f"{plugin.distribution} {plugin.version}",
        "options": json.dumps(config.plain(options), sort_keys=True),
    }


def _digested(digest: "Future[tuple[int, str]]") -> dict[str, str]:
    try:
        size, sha256 = digest.result()
    except OSError as error:
        raise ConversionError(f"the log cannot be read to its end: {error.strerror}") from error
    return {"size": str(size), "sha256": sha256}


def _digest(source: Path, beside: Sequence[Path] = ()) -> tuple[int, str]:
    """Return size and SHA-256 of a file; of a folder, or of a file with others beside it, those of
    sorted lines.

    A line is ``<sha256>  <size>  <path>`` of a file.
    """
    if source.is_file() and not beside:
        with source.open("rb") as file:
            return source.stat().st_size, hashlib.file_digest(file, "sha256").hexdigest()
    total, lines = 0, []
    folder, paths = (
        (source, source.rglob("*")) if source.is_dir() else (source.parent, iter([source, *beside]))
    )
    for path in sorted(path for path in paths if path.is_file()):
        size, sha256 = _digest(path)
        total += size
        lines.append(os.fsencode(f"{sha256}  {size}  {path.relative_to(folder).as_posix()}\n"))
    return total, hashlib.sha256(b"".join(lines)).hexdigest()


def _encodable(text: str) -> str:
    """Return text with the bytes of a file's name that are no UTF-8 spelled out."""
    return text.encode("utf-8", "backslashreplace").decode()


def _why(ledger: Ledger) -> str:
    if not ledger.reasons:
        return f"it holds no {ledger.unit} that the converter knows"
    reason, count = ledger.reasons.most_common(1)[0]
    return f"{ledger.skipped:,} {ledger.unit} were skipped, {count:,} of them because {reason}"
