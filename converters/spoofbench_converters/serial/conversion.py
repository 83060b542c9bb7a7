"""A byte stream's conversion: frames to decoders, epochs to the time axis, rows to topics, every
byte into the account.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import IO

import numpy as np

from spoofbench.arrays import Times
from spoofbench.conversion import Item, Rejects, SourceMetadata, Used
from spoofbench.errors import ConversionError
from spoofbench_converters.serial.contract import EpochRows, Epochs, FrameDecoder, SerialOptions
from spoofbench_converters.serial.demux import PIECE_BYTES, Piece, demultiplex
from spoofbench_converters.serial.gaps import RejectedBytes
from spoofbench_converters.serial.host_timestamps import HostTimestamps
from spoofbench_converters.serial.rows import TimedEpochs, TopicRows
from spoofbench_converters.serial.time_axis import HORIZON, REASONS, TIMED, TimeAxis, Verdicts

UBX_NOT_ASKED_FOR = "UBX frame: not asked for"


@dataclass(slots=True)
class _RunningDecoder:
    """A decoder at work.

    Attributes:
        waiting: epochs whose times are not all known.
        first: number of the first of them among all of the decoder's.
        time_ns, verdicts: of the first of them, int64 and uint8, as far as known.
    """

    decoder: FrameDecoder
    waiting: list[Epochs] = field(default_factory=list)
    first: int = 0
    time_ns: Times = field(default_factory=lambda: np.zeros(0, np.int64))
    verdicts: Verdicts = field(default_factory=lambda: np.zeros(0, np.uint8))

    def timed(self, time_ns: Times, verdicts: Verdicts) -> Iterator[TimedEpochs]:
        """Take the times of the next epochs; yield the epochs of which all times are known."""
        self.time_ns = np.append(self.time_ns, time_ns)
        self.verdicts = np.append(self.verdicts, verdicts)
        while self.waiting and self.time_ns.size >= self.waiting[0].offset.size:
            epochs = self.waiting.pop(0)
            count = epochs.offset.size
            yield TimedEpochs(epochs, self.time_ns[:count], self.verdicts[:count], self.first)
            self.first += count
            self.time_ns, self.verdicts = self.time_ns[count:], self.verdicts[count:]


class SerialConversion:
    """One log's conversion by the decoders of one or two protocols."""

    def __init__(self, decoders: Sequence[FrameDecoder], options: SerialOptions) -> None:
        self._decoders = [_RunningDecoder(decoder) for decoder in decoders]
        self._options = options
        self._axis = TimeAxis(options, tuple(decoder.protocol.upper() for decoder in decoders))
        self._timestamps = HostTimestamps(options.zone_is_utc)
        self._rejected = RejectedBytes()
        self._names: dict[tuple[int, str], str] = {}
        self._topics: dict[tuple[int, str, str], TopicRows] = {}

    def run(self, stream: IO[bytes], name: str, piece_bytes: int = PIECE_BYTES) -> Iterator[Item]:
        """Yield what a log holds.

        Raises:
            ConversionError: its times lack a date, or two receivers are interleaved in it.
        """
        for piece in demultiplex(stream, self._timestamps, self._options.checksum, piece_bytes):
            yield from self._take(piece)
            yield from self._settle(piece.end - HORIZON, last=False)
        for number, running in enumerate(self._decoders):
            yield from self._decoded(number, running.decoder.finish())
        yield from self._settle(np.iinfo(np.int64).max, last=True)
        for topic in self._topics.values():
            yield from topic.finish()
        if not self._topics and self._axis.dateless:
            raise ConversionError(
                f"the times in {name!r} have no date; say with --date YYYY-MM-DD which day the "
                "first one is of"
            )
        yield SourceMetadata(self._metadata())

    def _take(self, piece: Piece) -> Iterator[Item]:
        for rejects in piece.rejects:
            yield self._rejected.take(rejects)
        for number, running in enumerate(self._decoders):
            frames = piece.ubx if running.decoder.protocol == "ubx" else piece.nmea
            yield from self._decoded(number, running.decoder.push(frames))
        if piece.ubx.starts.size and all(
            running.decoder.protocol != "ubx" for running in self._decoders
        ):
            yield self._rejected.take(
                Rejects(piece.ubx.offsets(), piece.ubx.used, UBX_NOT_ASKED_FOR)
            )

    def _decoded(self, number: int, items: Iterator[Epochs | Rejects]) -> Iterator[Item]:
        for item in items:
            if isinstance(item, Rejects):
                yield self._rejected.take(item)
            elif item.offset.size:
                self._decoders[number].waiting.append(item)
                self._axis.push(number, item)

    def _settle(self, limit: int, last: bool) -> Iterator[Item]:
        """Yield the rows of the epochs whose times are known."""
        ready = [
            (number, timed)
            for number, times in self._axis.advance(limit, last).items()
            for timed in self._decoders[number].timed(*times)
        ]
        self._name_sources(ready)
        yield from self._refused([timed for _, timed in ready])
        for number, timed in ready:
            for rows in timed.epochs.rows:
                topic = self._topic(number, rows)
                if topic:
                    yield from topic.push(rows, timed)
            # one account for all topics, which share the bytes of an epoch
            yield Used(int(timed.epochs.used[timed.verdicts == TIMED].sum()))
        undecided = [running.waiting[0].offset[0] for running in self._decoders if running.waiting]
        self._rejected.forget(int(min(undecided, default=limit)))

    def _refused(self, ready: Sequence[TimedEpochs]) -> Iterator[Rejects]:
        """Reject the epochs that get no time."""
        for verdict, reason in REASONS.items():
            refused = [
                (timed.epochs, timed.verdicts == verdict)
                for timed in ready
                if np.any(timed.verdicts == verdict)
            ]
            if refused:
                offsets = np.concatenate([epochs.offset[which] for epochs, which in refused])
                lengths = np.concatenate([epochs.used[which] for epochs, which in refused])
                order = np.argsort(offsets, kind="stable")
                yield from self._rejected.lay(offsets[order], lengths[order], reason)

    def _name_sources(self, ready: Sequence[tuple[int, TimedEpochs]]) -> None:
        """Name new sources in the order of the log: as their decoder does, or by the next free
        number.

        Of two protocols, the first receiver of the second one is the second receiver of the log.
        """
        found: list[tuple[int, int, str]] = []
        for number, timed in ready:
            for rows in timed.epochs.rows:
                has_time = timed.verdicts[rows.epoch] == TIMED
                if (number, rows.source) not in self._names and has_time.any():
                    first = timed.epochs.offset[rows.epoch[np.argmax(has_time)]]
                    found.append((int(first), number, rows.source))
        for _, number, source in sorted(found):
            if (number, source) not in self._names:
                prefix = source.rstrip("0123456789")
                wanted = int(source.removeprefix(prefix)) + (number if prefix == "gnss" else 0)
                while f"{prefix}{wanted}" in self._names.values():
                    wanted += 1
                self._names[number, source] = f"{prefix}{wanted}"

    def _topic(self, number: int, rows: EpochRows) -> TopicRows | None:
        """Return the topic of these rows; None if their source has no row with a time yet."""
        name = self._names.get((number, rows.source))
        if name is None:
            return None
        key = number, rows.source, rows.kind
        if key not in self._topics:
            self._topics[key] = TopicRows(name, rows.kind)
        return self._topics[key]

    def _metadata(self) -> dict[str, dict[str, str]]:
        recording = self._axis.about()
        if self._options.session:
            recording["session_id"] = self._options.session
        if self._timestamps.without_zone:
            recording["times_without_zone"] = str(self._timestamps.without_zone)
        records: dict[str, dict[str, str]] = {"recording": recording}
        for number, running in enumerate(self._decoders):
            protocol = running.decoder.protocol.upper()
            for source, about in running.decoder.about().items():
                if (number, source) in self._names:
                    name = f"source/{self._names[number, source]}"
                    records[name] = {"topic": protocol, **about}
                    if "leap_seconds" in about:
                        recording.setdefault("leap_seconds", about["leap_seconds"])
        for topic in self._topics.values():
            record = records.setdefault(f"source/{topic.source}", {})
            record.update({key: text for key, text in topic.about().items() if key not in record})
        receivers = [topic for topic in self._topics.values() if topic.is_pvt]
        if receivers:
            primary = min(receivers, key=lambda topic: topic.preference)
            records["primary"] = {"gnss/pvt": primary.source}
        return records
