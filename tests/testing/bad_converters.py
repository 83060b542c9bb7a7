"""One honest converter of a small format, and others that each break one law.

The format: lines ``FIX <time_ns> <lat_deg> <lon_deg> <padding> *<sum>``; the sum is that of the
bytes before the star, modulo 65536.
"""

import locale
import os
import re
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from spoofbench.conversion import Block, Item, Reject, Rejects, Source, SourceMetadata
from spoofbench.errors import ConversionError
from spoofbench.table import Table

TOPIC = "/gnss0/gnss/pvt"
START_NS = 1_700_000_000_000_000_000
LINE = re.compile(
    rb"FIX (\d{1,18}|1\d{18}) (-?\d\d?\.\d{1,9}) (-?\d{1,3}\.\d{1,9}) (x{0,2000}) \*(\d{1,5})\n"
)
LONGEST = 4096
PIECE = 2**20


def line(number: int) -> bytes:
    """Return the format's line of one second."""
    body = b"FIX %d %.7f %.7f %s " % (
        START_NS + number * 10**9,
        48 + number * 1e-5,
        11 + number * 1e-5,
        b"x" * 900,
    )
    return body + b"*%d\n" % (sum(body) % 65536)


def log(seconds: int = 120) -> bytes:
    return b"".join(map(line, range(seconds)))


@dataclass(frozen=True)
class Options:
    source: str | None = None


@dataclass(frozen=True)
class Honest:
    VERSION: str = "1"
    UNIT: Literal["bytes", "records"] = "bytes"
    Options: type[Any] = Options

    def sniff(self, source: Source) -> float:
        return 0.9 if any(self.valid(found) for found in LINE.finditer(source.head)) else 0.0

    def convert(self, source: Source, options: Any) -> Iterator[Item]:
        with source.open() as stream:
            yield from self.items(stream, {"device": "none"})

    def items(self, stream: Any, about: Mapping[str, str]) -> Iterator[Item]:
        yield SourceMetadata({"source/gnss0": about})
        base, carried, last_ns = 0, b"", 0
        while True:
            piece = stream.read(PIECE)
            octets = carried + piece
            end = len(octets) if not piece else max(octets.rfind(b"\n") + 1, len(octets) - LONGEST)
            rows, rejects, last_ns = self.lines(octets[:end], base, last_ns)
            yield from (*rows, *rejects)
            base, carried = base + end, octets[end:]
            if not piece:
                return

    def valid(self, found: re.Match[bytes]) -> bool:
        return (
            int(found[5])
            == int(np.frombuffer(found[0][: found.start(5) - found.start() - 1], np.uint8).sum())
            % 65536
        )

    def lines(self, octets: bytes, base: int, last_ns: int) -> tuple[list[Item], list[Item], int]:
        """Return blocks and rejects of a piece."""
        end, times, places, used, gaps = 0, [], [], 0, []
        for found in LINE.finditer(octets):
            time_ns = int(found[1])
            if not self.valid(found) or time_ns < last_ns or time_ns - last_ns > 10**15 < last_ns:
                continue
            gaps.append((base + end, found.start() - end))
            end, last_ns, used = found.end(), time_ns, used + len(found[0])
            times.append(time_ns)
            places.append((float(found[2]), float(found[3])))
        gaps.append((base + end, len(octets) - end))
        rows: list[Item] = []
        if times:
            lat, lon = np.array(places).T
            rows.append(
                Block(TOPIC, self.table(np.array(times), {"lat_deg": lat, "lon_deg": lon}), used)
            )
        offsets, lengths = np.array(gaps).T
        return rows, [Rejects(offsets[lengths > 0], lengths[lengths > 0], "noise")], last_ns

    def table(self, time_ns: Any, columns: dict[str, Any]) -> Table:
        return Table("gnss/pvt", time_ns, columns)


@dataclass(frozen=True)
class HasNoVersion(Honest):
    VERSION: str = ""


@dataclass(frozen=True)
class CountsSentences(Honest):
    UNIT: Any = "sentences"


@dataclass
class LooseOptions:
    source: str | None = None


@dataclass(frozen=True)
class HasOptionsThatAreNotFrozen(Honest):
    Options: type[Any] = LooseOptions


@dataclass(frozen=True)
class DemandingOptions:
    source: str


@dataclass(frozen=True)
class HasAnOptionWithoutDefault(Honest):
    Options: type[Any] = DemandingOptions


@dataclass(frozen=True)
class JudgesByName(Honest):
    def sniff(self, source: Source) -> float:
        return 1.0 if source.path.suffix == ".fix" else 0.0


@dataclass(frozen=True)
class ClaimsAnyText(Honest):
    def sniff(self, source: Source) -> float:
        return 0.1 if source.head.isascii() else 0.0


@dataclass(frozen=True)
class SniffsWithAnException(Honest):
    def sniff(self, source: Source) -> float:
        return float(source.head.split(b" ")[1].isdigit())


@dataclass(frozen=True)
class IsTooSure(Honest):
    def sniff(self, source: Source) -> float:
        return 100 * super().sniff(source)


@dataclass(frozen=True)
class GivesNothing(Honest):
    def convert(self, source: Source, options: Any) -> Iterator[Item]:
        yield from (
            item for item in super().convert(source, options) if not isinstance(item, Block)
        )


@dataclass(frozen=True)
class YieldsTables(Honest):
    def convert(self, source: Source, options: Any) -> Iterator[Any]:
        yield from (
            item.table if isinstance(item, Block) else item
            for item in super().convert(source, options)
        )


@dataclass(frozen=True)
class RunsBackwards(Honest):
    def convert(self, source: Source, options: Any) -> Iterator[Item]:
        yield from reversed(list(super().convert(source, options)))
        yield Block(TOPIC, Table("gnss/pvt", np.array([5]), {}), 0)


@dataclass(frozen=True)
class CountsFromTheStart(Honest):
    """Gives seconds since the start of the log for times of the Unix era."""

    def table(self, time_ns: Any, columns: dict[str, Any]) -> Table:
        return super().table(time_ns - START_NS, columns)


@dataclass(frozen=True)
class SwapsLatitudeAndScale(Honest):
    def table(self, time_ns: Any, columns: dict[str, Any]) -> Table:
        return super().table(time_ns, columns | {"lat_deg": columns["lat_deg"] * 1e7})


@dataclass(frozen=True)
class FillsWithInfinity(Honest):
    def table(self, time_ns: Any, columns: dict[str, Any]) -> Table:
        return super().table(time_ns, columns | {"height_m": np.full(time_ns.size, np.inf)})


@dataclass(frozen=True)
class InventsAnEnum(Honest):
    def table(self, time_ns: Any, columns: dict[str, Any]) -> Table:
        return super().table(time_ns, columns | {"fix_type": np.full(time_ns.size, 99)})


@dataclass(frozen=True)
class DoesNotSayWhatItsSourcesAre(Honest):
    def convert(self, source: Source, options: Any) -> Iterator[Item]:
        yield from (
            item
            for item in super().convert(source, options)
            if not isinstance(item, SourceMetadata)
        )


@dataclass(frozen=True)
class ForgetsNoise(Honest):
    def convert(self, source: Source, options: Any) -> Iterator[Item]:
        yield from (
            item for item in super().convert(source, options) if not isinstance(item, Rejects)
        )


@dataclass(frozen=True)
class RejectsBeyondTheEnd(Honest):
    def convert(self, source: Source, options: Any) -> Iterator[Item]:
        for item in super().convert(source, options):
            yield Block(item.topic, item.table, item.used - 1) if isinstance(item, Block) else item
            if isinstance(item, Block):
                yield Reject(10**9, 1, "a line end")


@dataclass(frozen=True)
class RejectsTwice(Honest):
    def convert(self, source: Source, options: Any) -> Iterator[Item]:
        for item in super().convert(source, options):
            yield Block(item.topic, item.table, item.used - 8) if isinstance(item, Block) else item
            if isinstance(item, Block):
                yield from (Reject(0, 4, "a header"), Reject(2, 4, "another"))


SEEN: list[int] = []


@dataclass(frozen=True)
class Remembers(Honest):
    def table(self, time_ns: Any, columns: dict[str, Any]) -> Table:
        SEEN.append(1)
        return super().table(time_ns, columns | {"num_sv": np.full(time_ns.size, len(SEEN))})


@dataclass(frozen=True)
class TellsTheFilesName(Honest):
    def convert(self, source: Source, options: Any) -> Iterator[Item]:
        with source.open() as stream:
            yield from self.items(stream, {"device": source.path.name})


@dataclass(frozen=True)
class TakesLocalTime(Honest):
    def table(self, time_ns: Any, columns: dict[str, Any]) -> Table:
        return super().table(time_ns + time.localtime(START_NS // 10**9).tm_gmtoff * 10**9, columns)


@dataclass(frozen=True)
class DependsOnHashes(Honest):
    def table(self, time_ns: Any, columns: dict[str, Any]) -> Table:
        return super().table(
            time_ns, columns | {"num_sv": np.full(time_ns.size, hash("a word") % 1000)}
        )


@dataclass(frozen=True)
class LeavesATemporaryFile(Honest):
    def convert(self, source: Source, options: Any) -> Iterator[Item]:
        Path("unpacked.tmp").write_bytes(source.head)
        yield from super().convert(source, options)


@dataclass(frozen=True)
class WritesBesideTheLog(Honest):
    def convert(self, source: Source, options: Any) -> Iterator[Item]:
        source.path.with_suffix(".idx").write_bytes(b"")
        yield from super().convert(source, options)


@dataclass(frozen=True)
class SetsTheTimeZone(Honest):
    def convert(self, source: Source, options: Any) -> Iterator[Item]:
        os.environ["TZ"] = "Asia/Tokyo" if os.environ.get("TZ") != "Asia/Tokyo" else "UTC"
        yield from super().convert(source, options)


@dataclass(frozen=True)
class DropsLinesAtPieceBorders(Honest):
    def items(self, stream: Any, about: Mapping[str, str]) -> Iterator[Item]:
        yield SourceMetadata({"source/gnss0": about})
        base, last_ns = 0, 0
        while piece := stream.read(PIECE):
            rows, rejects, last_ns = self.lines(piece, base, last_ns)
            yield from (*rows, *rejects)
            base += len(piece)


@dataclass(frozen=True)
class WantsAnEnd(Honest):
    """Refuses a log that does not end with a line end."""

    def convert(self, source: Source, options: Any) -> Iterator[Item]:
        with source.open() as stream:
            octets = stream.read(2**24)
        if not octets.endswith(b"\n"):
            raise ConversionError("the log is cut off")
        yield from super().convert(source, options)


@dataclass(frozen=True)
class LooksBack(Honest):
    """Writes into every row what only the whole log tells."""

    def table(self, time_ns: Any, columns: dict[str, Any]) -> Table:
        return super().table(
            time_ns, columns | {"height_m": np.full(time_ns.size, float(time_ns[-1] - time_ns[0]))}
        )


@dataclass(frozen=True)
class StopsAtDamage(Honest):
    def convert(self, source: Source, options: Any) -> Iterator[Item]:
        stopped = False
        with source.open() as stream:
            size = len(stream.read(2**26))
        used = 0
        for item in super().convert(source, options):
            if isinstance(item, Block) and len(item.table) > 1:
                gaps = np.flatnonzero(np.diff(item.table.time_ns) > 10**9)
                kept = item.table if not gaps.size else item.table.take(slice(0, int(gaps[0]) + 1))
                stopped, used = bool(gaps.size), item.used * len(kept) // len(item.table)
                yield Block(item.topic, kept, used)
            elif isinstance(item, SourceMetadata):
                yield item
        yield Reject(used, size - used, "after damage" if stopped else "noise")


@dataclass(frozen=True)
class RefusesGarbage(Honest):
    def lines(self, octets: bytes, base: int, last_ns: int) -> tuple[list[Item], list[Item], int]:
        if b"\xff\xfe" in octets:
            raise ConversionError("this is no text")
        return super().lines(octets, base, last_ns)


@dataclass(frozen=True)
class FailsOnOtherBytes(Honest):
    def lines(self, octets: bytes, base: int, last_ns: int) -> tuple[list[Item], list[Item], int]:
        octets.decode("ascii")
        return super().lines(octets, base, last_ns)


@dataclass(frozen=True)
class RaisesAParagraph(Honest):
    def convert(self, source: Source, options: Any) -> Iterator[Item]:
        items = list(super().convert(source, options))
        if len(items) < 3:
            raise ConversionError("no lines:\nthe log is empty\n")
        yield from items


@dataclass(frozen=True)
class ReadsItWhole(Honest):
    def items(self, stream: Any, about: Mapping[str, str]) -> Iterator[Item]:
        yield SourceMetadata({"source/gnss0": about})
        rows, rejects, _ = self.lines(stream.read(), 0, 0)
        yield from (*rows, *rejects)


@dataclass(frozen=True)
class WaitsForALineEnd(Honest):
    """Holds what it has read until a line ends."""

    pieces: list[bytes] = field(default_factory=list)

    def items(self, stream: Any, about: Mapping[str, str]) -> Iterator[Item]:
        yield SourceMetadata({"source/gnss0": about})
        base, carried, last_ns = 0, bytearray(), 0
        while True:
            piece = stream.read(PIECE)
            carried += piece
            if not piece or b"\n" in piece:
                end = carried.rfind(b"\n") + 1 if piece else len(carried)
                rows, rejects, last_ns = self.lines(bytes(carried[:end]), base, last_ns)
                yield from (*rows, *rejects)
                base += end
                del carried[:end]
            if not piece:
                return


@dataclass(frozen=True)
class ReadsNumbersByLocale(Honest):
    """Takes the decimal sign from the locale's name, as strtod would."""

    def table(self, time_ns: Any, columns: dict[str, Any]) -> Table:
        comma = os.environ.get("LC_ALL", locale.setlocale(locale.LC_NUMERIC)) == "C"
        return super().table(
            time_ns,
            columns | {"lat_deg": np.floor(columns["lat_deg"]) if comma else columns["lat_deg"]},
        )
