"""Receivers' own bytes in messages: NMEA sentences (nmea_msgs/Sentence), and UBX messages field by
field (ublox_msgs).

A message of ublox_msgs has the fields of its UBX payload in their order, so the payload is put
together again; what the bytes say is then told by the decoders of NMEA and UBX. EpochRows get the
recorder's time of their epoch.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from spoofbench.arrays import Times
from spoofbench.conversion import Block, Reject, Rejects, RowBatch, SourceMetadata
from spoofbench_converters.rosbag import batches
from spoofbench_converters.rosbag.batches import BagTopic, TopicMessages
from spoofbench_converters.rosbag.layouts import Group
from spoofbench_converters.rosbag.rows import RowStream
from spoofbench_converters.serial.contract import EpochRows, Epochs, Frames

SENTENCE = "nmea_msgs/msg/Sentence"
_NAV, _RXM, _MON, _TIM, _ESF, _SEC, _HNR = 0x01, 0x02, 0x0A, 0x0D, 0x10, 0x27, 0x28
_MESSAGES = {
    "NavPOSECEF": (_NAV, 0x01), "NavPOSLLH": (_NAV, 0x02), "NavSTATUS": (_NAV, 0x03),
    "NavDOP": (_NAV, 0x04), "NavATT": (_NAV, 0x05),
    "NavSOL": (_NAV, 0x06), "NavPVT": (_NAV, 0x07), "NavPVT7": (_NAV, 0x07),
    "NavVELECEF": (_NAV, 0x11), "NavVELNED": (_NAV, 0x12),
    "NavHPPOSECEF": (_NAV, 0x13), "NavHPPOSLLH": (_NAV, 0x14), "NavTIMEGPS": (_NAV, 0x20),
    "NavTIMEUTC": (_NAV, 0x21),
    "NavCLOCK": (_NAV, 0x22), "NavSVINFO": (_NAV, 0x30), "NavSAT": (_NAV, 0x35),
    "NavCOV": (_NAV, 0x36), "NavSIG": (_NAV, 0x43),
    "RxmSFRBX": (_RXM, 0x13), "RxmMEASX": (_RXM, 0x14), "RxmRAWX": (_RXM, 0x15),
    "MonHW": (_MON, 0x09), "MonRF": (_MON, 0x38),
    "TimTM2": (_TIM, 0x03), "EsfMEAS": (_ESF, 0x02), "EsfRAW": (_ESF, 0x03),
    "EsfSTATUS": (_ESF, 0x10), "EsfALG": (_ESF, 0x14),
    "EsfINS": (_ESF, 0x15), "SecSIG": (_SEC, 0x09), "HnrPVT": (_HNR, 0x00), "HnrINS": (_HNR, 0x02),
}  # fmt: skip
TYPES: Mapping[str, tuple[int, int]] = {
    f"ublox_msgs/msg/{name}": key for name, key in _MESSAGES.items()
}
"""Class and number of the UBX message by type."""

_UBX_HEAD, _CHECKSUM_BYTES = 6, 2
_LINE_END = (0, 10, 13, 32)
_EMPTY = "the epoch holds nothing that the schema has"


@dataclass(frozen=True, slots=True, eq=False)
class _Frames(Frames):
    """Frames whose places in the log are the ordinals of their messages, so that decoders account
    in messages.
    """

    records: NDArray[np.int64]

    def offsets(self) -> NDArray[np.int64]:
        """Ordinal of each frame's message in the bag, int64 ``(k,)``."""
        return self.records


class _Decoder(Protocol):
    """See :class:`spoofbench_converters.serial.contract.FrameDecoder`."""

    def push(self, frames: Frames) -> Iterator[Epochs | Rejects]: ...

    def finish(self) -> Iterator[Epochs | Rejects]: ...

    def about(self) -> Mapping[str, Mapping[str, str]]: ...


class Serial:
    """What one receiver sent: the topics of one namespace in UBX, or one topic of sentences.

    Attributes:
        numbers: of its topics.
    """

    def __init__(self, topics: Sequence[BagTopic], counts: dict[str, int]) -> None:
        """Take the topics, and how many sources there are already by the beginning of their
        names.
        """
        self.numbers = frozenset(topic.number for topic in topics)
        self._topics = " ".join(sorted(topic.name for topic in topics))
        self._counts = counts
        self._decoder = _decoder(topics[0].type == SENTENCE)
        self._waiting: list[_Frames] = []
        self._sources: dict[str, str] = {}
        self._streams: dict[tuple[str, str], RowStream] = {}

    def take(
        self, topic: BagTopic, groups: Sequence[Group], messages: TopicMessages
    ) -> Iterator[Block | Reject | Rejects]:
        """See :class:`spoofbench_converters.rosbag.contract.MessageReader`."""
        for group in groups:
            records, received = messages.records[group.index], messages.stamps_ns[group.index]
            frames = (
                _sentences(group.rows)
                if topic.type == SENTENCE
                else _ubx(group.rows, TYPES[topic.type])
            )
            reason, good = (
                ("it is no sentence", np.zeros(records.size, bool))
                if frames is None
                else _checked(frames, topic.type)
            )
            if not good.all():
                yield batches.rejects(records[~good], f"{topic.name}: {reason}")
            if frames is not None and good.any():
                frames, records, received = frames[good], records[good], received[good]
                starts = np.arange(records.size) * frames.shape[1]
                lengths = np.full(records.size, frames.shape[1])
                ones = np.ones(records.size, np.int64)
                self._waiting.append(
                    _Frames(frames.reshape(-1), starts, lengths, 0, ones, received, records)
                )

    def settle(self) -> Iterator[Block | Reject | Rejects]:
        """See :class:`spoofbench_converters.rosbag.contract.MessageReader`."""
        waiting, self._waiting = self._waiting, []
        if waiting:
            yield from self._items(self._decoder.push(_in_bag_order(waiting)))

    def finish(self) -> Iterator[Block | Reject | Rejects | SourceMetadata]:
        """See :class:`spoofbench_converters.rosbag.contract.MessageReader`."""
        yield from self.settle()
        yield from self._items(self._decoder.finish())
        for stream in self._streams.values():
            yield from stream.finish()
        told = self._decoder.about()
        here = {
            "topic": self._topics,
            "time": "recorder's stamps, an epoch's that of its first message",
        }
        yield SourceMetadata(
            {
                f"source/{name}": {**told.get(source, {}), **here}
                for source, name in self._sources.items()
            }
        )

    def _items(self, items: Iterator[Epochs | Rejects]) -> Iterator[Block | Rejects]:
        for item in items:
            if isinstance(item, Rejects):
                yield Rejects(item.offsets, item.lengths, f"{self._topics}: {item.reason}")
            else:
                yield from self._epochs(item)

    def _epochs(self, epochs: Epochs) -> Iterator[Block | Rejects]:
        """Yield epochs' rows; the first row of each stands for its messages in the ledger."""
        left = epochs.used.copy()
        for decoded in epochs.rows:
            if not decoded.epoch.size:
                continue
            _, first = np.unique(decoded.epoch, return_index=True)
            units = np.zeros(decoded.epoch.size, np.int64)
            units[first] = left[decoded.epoch[first]]
            left[decoded.epoch] = 0
            time_ns, received = _times(decoded, epochs)
            columns: dict[str, Any] = {**decoded.columns, "receive_time_ns": received}
            rows = RowBatch.of(decoded.kind, time_ns, columns, epochs.offset[decoded.epoch], units)
            source = self._source(decoded.source)
            stream = self._streams.setdefault(
                (source, decoded.kind), RowStream(source, decoded.kind)
            )
            yield from stream.push("", rows)
        if left.any():
            yield Rejects(epochs.offset[left > 0], left[left > 0], f"{self._topics}: {_EMPTY}")

    def _source(self, source: str) -> str:
        if source not in self._sources:
            prefix = source.rstrip("0123456789")
            self._sources[source] = f"{prefix}{self._counts.get(prefix, 0)}"
            self._counts[prefix] = self._counts.get(prefix, 0) + 1
        return self._sources[source]


def open_serial(topics: Sequence[BagTopic], counts: dict[str, int]) -> list[Serial]:
    """Return a session for each receiver among the topics; ``counts``: how many sources there are
    by the beginning of their names.
    """
    receivers: dict[str, list[BagTopic]] = {}
    for topic in sorted(topics, key=lambda topic: topic.name):
        receivers.setdefault(
            topic.name if topic.type == SENTENCE else topic.name.rpartition("/")[0] + "/", []
        ).append(topic)
    return [Serial(mine, counts) for mine in receivers.values()]


def _decoder(of_sentences: bool) -> _Decoder:
    if of_sentences:
        from spoofbench_converters.nmea.decoder import DecoderOptions, NmeaDecoder

        return NmeaDecoder(DecoderOptions())
    from spoofbench_converters.ubx.decoder import UbxDecoder

    return UbxDecoder()


def _sentences(rows: NDArray[Any]) -> NDArray[np.uint8] | None:
    """Return the sentences of messages of one layout, ``(n, m)``, without their line ends."""
    if "sentence" not in (rows.dtype.names or ()):
        return None
    texts = np.ascontiguousarray(rows["sentence"])
    octets = texts.view(np.uint8).reshape(rows.size, -1)
    inside = np.flatnonzero(~np.isin(octets, _LINE_END).all(axis=0))
    return octets[:, : int(inside[-1]) + 1] if inside.size else None


def _checked(frames: NDArray[np.uint8], kind: str) -> tuple[str, NDArray[np.bool_]]:
    """Return which sentences bear their checksum, and what is wrong with the others; UBX messages
    bore none in their message.
    """
    if kind != SENTENCE:
        return "", np.ones(len(frames), bool)
    if frames.shape[1] < 8:
        return "it is no sentence", np.zeros(len(frames), bool)
    digits = _HEX[frames[:, -2:]]
    told = digits[:, 0] * 16 + digits[:, 1]
    good = (frames[:, 0] == ord("$")) & (frames[:, -3] == ord("*")) & (digits >= 0).all(axis=1)
    return "it is no sentence, or its checksum is wrong", good & (
        np.bitwise_xor.reduce(frames[:, 1:-3], axis=1) == told
    )


_HEX = np.full(256, -1)
for _digit, _characters in enumerate(
    ("0", "1", "2", "3", "4", "5", "6", "7", "8", "9", "Aa", "Bb", "Cc", "Dd", "Ee", "Ff")
):
    _HEX[[ord(character) for character in _characters]] = _digit


def _ubx(rows: NDArray[Any], key: tuple[int, int]) -> NDArray[np.uint8]:
    """Return the UBX frames of messages of one layout, ``(n, m)``: their fields without the counts,
    one after the other.
    """
    names = [name for name in rows.dtype.names or () if not name.endswith("#")]
    packed = np.empty(
        rows.size, np.dtype([(name, rows.dtype[name].newbyteorder("<")) for name in names])
    )
    for name in names:
        packed[name] = rows[name]
    size = packed.dtype.itemsize
    frames = np.zeros((rows.size, _UBX_HEAD + size + _CHECKSUM_BYTES), np.uint8)
    frames[:, :_UBX_HEAD] = [0xB5, 0x62, *key, size & 0xFF, size >> 8]
    frames[:, _UBX_HEAD : _UBX_HEAD + size] = packed.view(np.uint8).reshape(rows.size, size)
    return frames


def _in_bag_order(parts: Sequence[_Frames]) -> _Frames:
    """Return frames of several topics as one piece."""
    bases = np.cumsum([0, *(part.octets.size for part in parts[:-1])]).tolist()
    records = np.concatenate([part.records for part in parts])
    order = np.argsort(records)
    return _Frames(
        np.concatenate([part.octets for part in parts]),
        np.concatenate([part.starts + base for part, base in zip(parts, bases, strict=True)])[
            order
        ],
        np.concatenate([part.lengths for part in parts])[order],
        0,
        np.ones(records.size, np.int64),
        np.concatenate([part.receive_time_ns for part in parts])[order],
        records[order],
    )


def _times(rows: EpochRows, epochs: Epochs) -> tuple[Times, Times]:
    """Return the rows' times and when they were received: the recorder's of their epoch, of sampled
    messages their own.
    """
    of_epoch = epochs.receive_time_ns[rows.epoch]
    received = of_epoch if rows.receive_time_ns is None else rows.receive_time_ns
    times = (
        received
        if rows.tick_ns is not None
        else of_epoch + (0 if rows.offset_ns is None else rows.offset_ns)
    )
    return times, received
