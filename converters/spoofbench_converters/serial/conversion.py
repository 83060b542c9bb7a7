"""A byte stream's conversion: frames to decoders, epochs to the axis, rows to topics, every byte
into the account.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import IO

import numpy as np

from spoofbench.arrays import Ints
from spoofbench.conversion import Item, Rejects, SourceMetadata, Used
from spoofbench.errors import ConversionError
from spoofbench_converters.serial.contract import EpochRows, Epochs, FrameDecoder, SerialOptions
from spoofbench_converters.serial.demux import PIECE_BYTES, Piece, demultiplex
from spoofbench_converters.serial.gaps import RejectedBytes
from spoofbench_converters.serial.host_timestamps import HostTimestamps
from spoofbench_converters.serial.rows import TimedEpochs, TopicRows
from spoofbench_converters.serial.time_axis import HORIZON, REASONS, TIMED, TimeAxis

UBX_NOT_ASKED_FOR = "UBX frame: not asked for"


@dataclass(slots=True)
class _RunningDecoder:
    """A decoder at work: epochs that wait for their times, the running number of the first, and the
    times known so far.
    """

    decoder: FrameDecoder
    waiting: list[Epochs] = field(default_factory=list)
    first: int = 0
    times: Ints = field(default_factory=lambda: np.zeros(0, np.int64))
    verdicts: "np.ndarray[tuple[int], np.dtype[np.uint8]]" = field(
        default_factory=lambda: np.zeros(0, np.uint8)
    )


class SerialConversion:
    """One log's conversion by the decoders of one or two protocols."""

    def __init__(self, decoders: Sequence[FrameDecoder], options: SerialOptions) -> None:
        self._courses = [_RunningDecoder(decoder) for decoder in decoders]
        self._options = options
        self._axis = TimeAxis(options, tuple(decoder.protocol.upper() for decoder in decoders))
        self._stamps = HostTimestamps(options.zone_is_utc)
        self._ground = RejectedBytes()
        self._names: dict[tuple[int, str], str] = {}
        self._topics: dict[tuple[int, str, str], TopicRows] = {}

    def run(self, stream: IO[bytes], name: str, piece_bytes: int = PIECE_BYTES) -> Iterator[Item]:
        """Yield what a log holds.

        Raises:
            ConversionError: its times lack a date, or two receivers are interleaved in it.
        """
        for piece in demultiplex(stream, self._stamps, self._options.checksum, piece_bytes):
            yield from self._take(piece)
            yield from self._settle(piece.end - HORIZON, last=False)
        for number, course in enumerate(self._courses):
            yield from self._decoded(number, course.decoder.finish())
        yield from self._settle(np.iinfo(np.int64).max, last=True)
        for topic in self._topics.values():
            yield from topic.finish()
        if not self._topics and self._axis.dateless:
            raise ConversionError(
                f"the times in {name!r} have no date; say with --date YYYY-MM-DD which day the "
                "first one is of"
            )
        yield SourceMetadata(self._facts())

    def _take(self, piece: Piece) -> Iterator[Item]:
        for rejects in piece.rejects:
            yield self._ground.take(rejects)
        for number, course in enumerate(self._courses):
            frames = piece.ubx if course.decoder.protocol == "ubx" else piece.nmea
            yield from self._decoded(number, course.decoder.push(frames))
        if (
            all(course.decoder.protocol != "ubx" for course in self._courses)
            and piece.ubx.starts.size
        ):
            yield self._ground.take(Rejects(piece.ubx.offsets(), piece.ubx.used, UBX_NOT_ASKED_FOR))

    def _decoded(self, number: int, items: Iterator[Epochs | Rejects]) -> Iterator[Item]:
        for item in items:
            if isinstance(item, Rejects):
                yield self._ground.take(item)
            elif item.offset.size:
                self._courses[number].waiting.append(item)
                self._axis.push(number, item)

    def _settle(self, limit: int, last: bool) -> Iterator[Item]:
        """Give the rows of the epochs whose times are known."""
        ready = []
        for number, (times, verdicts) in self._axis.advance(limit, last).items():
            course = self._courses[number]
            course.times, course.verdicts = (
                np.append(course.times, times),
                np.append(course.verdicts, verdicts),
            )
            while course.waiting and course.times.size >= course.waiting[0].offset.size:
                epochs = course.waiting.pop(0)
                count = epochs.offset.size
                ready.append(
                    (
                        number,
                        TimedEpochs(
                            epochs, course.times[:count], course.verdicts[:count], course.first
                        ),
                    )
                )
                course.first += count
                course.times, course.verdicts = course.times[count:], course.verdicts[count:]
        self._name(ready)
        yield from self._refused([timed for _, timed in ready])
        for number, timed in ready:
            used = int(timed.epochs.used[timed.verdicts == TIMED].sum())
            for rows in timed.epochs.rows:
                topic = self._topic(number, rows)
                if topic:
                    yield from topic.push(rows, timed)
            yield Used(used)  # one account for all topics, which share the bytes of an epoch
        undecided = [course.waiting[0].offset[0] for course in self._courses if course.waiting]
        self._ground.forget(int(min(undecided, default=limit)))

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
                yield from self._ground.lay(offsets[order], lengths[order], reason)

    def _name(self, ready: Sequence[tuple[int, TimedEpochs]]) -> None:
        """Name new sources in the order of the log: as their decoder does, or by the next free
        number.

        Of two protocols, the first receiver of the second one is the second receiver of the log.
        """
        found: list[tuple[int, int, str]] = []
        for number, timed in ready:
            for rows in timed.epochs.rows:
                kept = timed.verdicts[rows.epoch] == TIMED
                if (number, rows.source) not in self._names and kept.any():
                    found.append(
                        (int(timed.epochs.offset[rows.epoch[np.argmax(kept)]]), number, rows.source)
                    )
        for _, number, source in sorted(found):
            if (number, source) not in self._names:
                prefix, count = source.rstrip("0123456789"), len(source.rstrip("0123456789"))
                wanted = int(source[count:]) + (number if prefix == "gnss" else 0)
                while f"{prefix}{wanted}" in self._names.values():
                    wanted += 1
                self._names[number, source] = f"{prefix}{wanted}"

    def _topic(self, number: int, rows: EpochRows) -> TopicRows | None:
        """Return the topic of these rows; None if their source has no row with a time yet."""
        name = self._names.get((number, rows.source))
        if name is None:
            return None
        if (number, rows.source, rows.kind) not in self._topics:
            self._topics[number, rows.source, rows.kind] = TopicRows(name, rows.kind)
        return self._topics[number, rows.source, rows.kind]

    def _facts(self) -> dict[str, dict[str, str]]:
        recording = self._axis.about()
        if self._options.session:
            recording["session_id"] = self._options.session
        if self._stamps.without_zone:
            recording["times_without_zone"] = str(self._stamps.without_zone)
        facts: dict[str, dict[str, str]] = {"recording": recording}
        for number, course in enumerate(self._courses):
            protocol = course.decoder.protocol.upper()
            for source, told in course.decoder.about().items():
                if (number, source) in self._names:
                    facts[f"source/{self._names[number, source]}"] = {"topic": protocol, **told}
                    if "leap_seconds" in told:
                        recording.setdefault("leap_seconds", told["leap_seconds"])
        for topic in self._topics.values():
            record = facts.setdefault(f"source/{topic.source}", {})
            record.update({key: text for key, text in topic.about().items() if key not in record})
        receivers = sorted(
            (topic for topic in self._topics.values() if topic.is_pvt),
            key=lambda topic: topic.preference,
        )
        if receivers:
            facts["primary"] = {"gnss/pvt": receivers[0].source}
        return facts
