"""A bag being converted: which session has which topic, and what nobody has."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from spoofbench.conversion import Item, Reject, SourceMetadata
from spoofbench.errors import ConversionError
from spoofbench_converters.rosbag import aspn23, batches, definitions, mapped
from spoofbench_converters.rosbag.batches import BagTopic, MessageBatch, TopicMessages
from spoofbench_converters.rosbag.clocks import RecorderJumps
from spoofbench_converters.rosbag.contract import MessageReader, Options
from spoofbench_converters.rosbag.definitions import Definitions
from spoofbench_converters.rosbag.layouts import ENCODINGS, Decoder
from spoofbench_converters.rosbag.messages import STANDARD, Spec
from spoofbench_converters.rosbag.planning import NOT_ASKED, plan
from spoofbench_converters.rosbag.sensors import Sensors
from spoofbench_converters.rosbag.serial import SENTENCE, TYPES, open_serial


class Conversion:
    """Takes a bag's messages, and hands each topic's to the session that has it."""

    def __init__(self, topics: Sequence[BagTopic], options: Options) -> None:
        """Give the topics to sessions.

        Raises:
            ConversionError: the definitions or the mapping that the options name cannot be read, or
                there is no such source.
        """
        if options.source is not None and options.source not in {topic.name for topic in topics}:
            raise ConversionError(
                f"the bag has no topic {options.source!r}; it has "
                f"{sorted(topic.name for topic in topics)[:30]}"
            )
        self._topics = {topic.number: topic for topic in topics}
        self._sessions: dict[int, MessageReader] = {}
        self._decoders: dict[int, Decoder] = {}
        self._declined: dict[int, str] = {}
        self._unknown: dict[int, tuple[int, int]] = {}
        self._steps = RecorderJumps(options.append_clock)
        readable = [topic for topic in topics if topic.encoding in ENCODINGS]
        given = (
            {}
            if options.definitions is None
            else definitions.read_folder(
                Path(options.definitions), [topic.type for topic in topics]
            )
        )
        types = {topic.number: _types_of(topic, given) for topic in readable}
        self._undefined = frozenset(
            topic.number for topic in readable if topic.type not in types[topic.number]
        )
        readable = [topic for topic in readable if topic.number not in self._undefined]
        mine = [topic for topic in readable if topic.type in aspn23.TYPES]
        if mine:
            session = aspn23.open(mine, options)
            self._sessions |= dict.fromkeys((topic.number for topic in mine), session)
        specs: dict[int, Spec] = {
            topic.number: STANDARD[topic.type] for topic in readable if topic.type in STANDARD
        }
        specs |= mapped.specs(
            [topic for topic in readable if topic not in mine], types, options.mapping
        )
        planned = plan(readable, specs, options)
        if planned.outputs:
            sensors = Sensors(planned, specs, options)
            self._sessions |= dict.fromkeys(sensors.numbers, sensors)
        self._declined |= planned.declined
        counts = Counter(source.rstrip("0123456789") for source in planned.sources)
        serials = [topic for topic in readable if topic.type == SENTENCE or topic.type in TYPES]
        left_out = {
            topic.number
            for topic in serials
            if "gnss" in planned.asked and topic.name != options.source
        }
        self._declined |= dict.fromkeys(left_out, NOT_ASKED)
        for serial in open_serial(
            [topic for topic in serials if topic.number not in left_out], counts
        ):
            self._sessions |= dict.fromkeys(serial.numbers, serial)
        for number in self._sessions:
            topic = self._topics[number]
            self._decoders[number] = Decoder(topic.type, types[number], topic.encoding)

    @property
    def wanted(self) -> frozenset[int]:
        """Numbers of the topics that are understood."""
        return frozenset(self._sessions)

    def take(self, batch: MessageBatch) -> Iterator[Item]:
        """Yield what a batch's messages say."""
        yield from batch.rejects
        for number, messages in sorted(self._steps.take(batch.wanted).items()):
            yield from self._messages(self._topics[number], messages)
        for session in dict.fromkeys(self._sessions.values()):
            yield from session.settle()
        for number, (count, first) in batch.others.items():
            before, first = self._unknown.get(number, (0, first))
            self._unknown[number] = (before + count, first)

    def finish(self) -> Iterator[Item]:
        """Yield what the sessions still hold, and what was not understood."""
        yield SourceMetadata({"recording": {"clock": "recorder"}})  # unless a session knows better
        for session in dict.fromkeys(self._sessions.values()):
            yield from session.finish()
        if steps := self._steps.about():
            yield SourceMetadata({"recording": steps})
        for number, (count, first) in sorted(self._unknown.items()):
            yield Reject(first, count, self._why_not(number))

    def _why_not(self, number: int) -> str:
        topic = self._topics.get(number)
        if topic is None:
            return "the topic is not declared"
        if number in self._declined:
            return f"topic {topic.name!r}: {self._declined[number]}"
        if number in self._undefined:
            return (
                f"topic {topic.name!r}: the bag has no definition of {topic.type!r}; give one with "
                "-p definitions=FOLDER"
            )
        return f"topic {topic.name!r} of type {topic.type!r} ({topic.encoding}) is not understood"

    def _messages(self, topic: BagTopic, messages: TopicMessages) -> Iterator[Item]:
        """Decode one topic's messages and hand them over."""
        groups, failures = self._decoders[topic.number].decode(
            messages.octets, messages.starts, messages.lengths
        )
        by_reason: dict[str, list[int]] = {}
        for place, reason in failures:
            by_reason.setdefault(reason, []).append(place)
        for reason, places in by_reason.items():
            yield batches.rejects(messages.records[places], f"{topic.name}: {reason}")
        yield from self._sessions[topic.number].take(topic, groups, messages)


def _types_of(topic: BagTopic, given: Definitions) -> Definitions:
    """Return the definitions for a topic: the user's, else the bag's, else those that are known
    here, else those of ROS.
    """
    generation = 1 if topic.encoding == "ros1" else 2
    known: Mapping[str, Any] = {
        **definitions.of_ros(generation),
        **definitions.known(),
        **aspn23.definitions(),
    }
    return {
        **known,
        **definitions.of_bag(topic.definition, topic.type, topic.definition_format),
        **given,
    }
