"""The session of all messages that say by themselves what they hold: those of ROS, and those that a
mapping describes.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from spoofbench.conversion import Block, Columns, Reject, Rejects, SourceMetadata
from spoofbench.conversion.rows import take
from spoofbench_converters.rosbag import batches
from spoofbench_converters.rosbag.batches import BagTopic, TopicMessages
from spoofbench_converters.rosbag.clocks import DeviceClock, OffsetMeter, decide
from spoofbench_converters.rosbag.contract import DecodedMessages, Options, in_bag_order, refused
from spoofbench_converters.rosbag.fields import Fields
from spoofbench_converters.rosbag.layouts import Group
from spoofbench_converters.rosbag.messages import Spec
from spoofbench_converters.rosbag.planning import Plan
from spoofbench_converters.rosbag.rows import PairStream, RowStream, row_batch

_SETTLED_MESSAGES = 256  # of each device, before the clocks are decided
_HELD_ROWS = 262_144  # most that wait for it
_NOTHING = "it holds nothing that the schema has"

_TIMES = ("stamp_ns", "receive_time_ns", "record")

_Stream = RowStream | PairStream


@dataclass(slots=True, eq=False)
class _Device:
    """A device at work: its clock once it is decided, and the rows that wait for that."""

    name: str
    clock: DeviceClock | None = None
    held: list[tuple[_Stream, str, Columns]] = field(default_factory=list)
    meter: OffsetMeter = field(default_factory=OffsetMeter)
    messages: int = 0


class Sensors:
    """Messages of one bag that say what they hold.

    Attributes:
        numbers: of the topics that are taken.
    """

    def __init__(self, plan: Plan, specs: Mapping[int, Spec], options: Options) -> None:
        self.numbers = frozenset(plan.outputs)
        self._plan, self._specs = plan, specs
        self._by_recorder = options.time == "recorder"
        self._ahead_ns = 0
        self._decided = False
        self._devices: list[_Device] = []
        self._by_topic: dict[int, _Device] = {}
        self._streams: dict[tuple[int, str], _Stream] = {}
        self._of_source: dict[str, _Device] = {}
        pairs: dict[str, PairStream] = {}
        for topics in plan.devices:
            device = _Device(topics[0].name)
            self._devices.append(device)
            for topic in topics:
                self._by_topic[topic.number] = device
                for output in plan.outputs[topic.number]:
                    self._of_source[output.source] = device
                    stream: _Stream = RowStream(output.source, output.kind)
                    if output.paired:
                        stream = pairs.setdefault(output.source, PairStream(output.source))
                    self._streams[(topic.number, output.kind)] = stream

    def take(
        self, topic: BagTopic, groups: Sequence[Group], messages: TopicMessages
    ) -> Iterator[Block | Reject | Rejects]:
        """See :class:`spoofbench_converters.rosbag.contract.MessageReader`."""
        spec, device = self._specs[topic.number], self._by_topic[topic.number]
        pieces: dict[str, list[Columns]] = {}
        for group in groups:
            decoded = spec.read(Fields(group.rows))
            records, stamps = messages.records[group.index], messages.stamps_ns[group.index]
            kept, given = refused(decoded.refusals, records, topic.name)
            yield from given
            if decoded.stamp_ns is not None:
                decoded = replace(
                    decoded, stamp_ns=messages.appended(decoded.stamp_ns, group.index)
                )
            empty = _add(pieces, decoded, kept, records, stamps)
            if empty.any():
                yield batches.rejects(records[empty], f"{topic.name}: {_NOTHING}")
            device.messages += records.size
        for kind, parts in pieces.items():
            rows = in_bag_order(parts)
            if rows["record"].size:
                device.held.append(
                    (self._streams[(topic.number, kind)], spec.side or "position", rows)
                )
        if self._decided:
            yield from self._release(device)

    def settle(self) -> Iterator[Block | Reject | Rejects]:
        """See :class:`spoofbench_converters.rosbag.contract.MessageReader`."""
        held = sum(rows["record"].size for device in self._devices for _, _, rows in device.held)
        if held > _HELD_ROWS or all(
            device.messages >= _SETTLED_MESSAGES for device in self._devices
        ):
            yield from self._decide()
        for stream in dict.fromkeys(self._streams.values()):
            yield from stream.settle()

    def finish(self) -> Iterator[Block | Reject | Rejects | SourceMetadata]:
        """See :class:`spoofbench_converters.rosbag.contract.MessageReader`."""
        yield from self._decide()
        for stream in dict.fromkeys(self._streams.values()):
            yield from stream.finish()
        facts: dict[str, Mapping[str, str]] = {}
        for source, device in self._of_source.items():
            time = (
                {"time": device.clock.basis, **device.meter.about()}
                if device.clock and device.messages
                else {}
            )
            facts[f"source/{source}"] = {**self._plan.sources[source], **time}
        by_header = any(
            device.clock and device.clock.by_header and device.messages for device in self._devices
        )
        recording = {"clock": "sensor" if by_header else "recorder"}
        if self._ahead_ns:
            recording["recorder_offset_s"] = f"{-self._ahead_ns / 1e9:.6f}"
        if self._plan.primary:
            facts["primary"] = {"gnss/pvt": self._plan.primary}
        yield SourceMetadata({**facts, "recording": recording})

    def _decide(self) -> Iterator[Block | Rejects]:
        """Decide the clocks, and give what waited for it."""
        if self._decided:
            return
        self._decided = True
        seen = {device.name: _times(device) for device in self._devices}
        clocks, self._ahead_ns = decide(seen)
        if self._by_recorder:
            self._ahead_ns = 0
        for device in self._devices:
            device.clock = (
                DeviceClock(False, 0, "recorder's stamps, as asked for")
                if self._by_recorder
                else clocks[device.name]
            )
        for device in self._devices:
            yield from self._release(device)

    def _release(self, device: _Device) -> Iterator[Block | Rejects]:
        """Give a device's rows their times, and hand them on."""
        held, device.held = device.held, []
        for stream, side, rows in held:
            stamps, received = rows.pop("stamp_ns"), rows["receive_time_ns"]
            has_stamp = rows.pop("has_stamp")
            assert device.clock is not None
            rows["time_ns"] = device.clock.time_ns(stamps, received)
            counted = has_stamp & (rows["units"] > 0)
            device.meter.add(stamps[counted], received[counted])
            yield from stream.push(side, row_batch(stream.kind, rows))


def _times(device: _Device) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the headers' and the recorder's stamps of the messages that a device holds, in bag
    order.
    """
    parts = [
        [rows[name][rows["has_stamp"] & (rows["units"] > 0)] for name in _TIMES]
        for _, _, rows in device.held
    ]
    if not parts:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    stamps, received, records = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.argsort(records)
    return stamps[order], received[order]


def _add(
    pieces: dict[str, list[Columns]],
    decoded: DecodedMessages,
    kept: NDArray[np.bool_],
    records: NDArray[np.int64],
    received: NDArray[np.int64],
) -> NDArray[np.bool_]:
    """Add what messages of one layout say to the pieces by kind; return the messages that say
    nothing.

    The first row of each message, in its first part that has one, has ``units`` 1: it stands for
    the message in the ledger.
    """
    stamped = decoded.stamp_ns is not None
    stamps = decoded.stamp_ns if decoded.stamp_ns is not None else np.zeros(records.size, np.int64)
    waiting = kept.copy()
    for part in decoded.parts:
        message = np.arange(records.size) if part.message is None else part.message
        mine = kept[message]
        message = message[mine]
        first = np.append(True, message[1:] != message[:-1])[: message.size]
        units = (first & waiting[message]).astype(np.int64)
        waiting[message] = False
        rows = part.columns if mine.all() else take(part.columns, mine)
        about = {
            "record": records[message],
            "receive_time_ns": received[message],
            "stamp_ns": stamps[message],
            "units": units,
        }
        pieces.setdefault(part.kind, []).append(
            {**rows, **about, "has_stamp": np.full(message.size, stamped)}
        )
    return waiting
