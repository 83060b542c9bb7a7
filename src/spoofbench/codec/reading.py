"""An MCAP file to a recording, topic by topic as they are used."""

import os
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from spoofbench.codec.columns import Gathering
from spoofbench.codec.container import LOG_TIME, Limits, Messages, gather, groups
from spoofbench.codec.protobuf import Reading, is_derived, reading_of
from spoofbench.codec.survey import Survey, survey
from spoofbench.codec.unpacking import Decoder
from spoofbench.errors import FormatError, LimitError
from spoofbench.recording import Recording
from spoofbench.table import Table

_THREADS = min(4, os.cpu_count() or 1)

Item = TypeVar("Item")
Result = TypeVar("Result")


def read(path: Path, limits: Limits = Limits()) -> Recording:  # noqa: B008
    """Open a recording; a topic's rows are read when it is first used, which checks their
    checksums.

    Topics of the schema are found by name or by the message ``spoofbench.schema.v1.*`` of their
    channel, in files of any writer. What else the file holds is listed in the metadata record
    ``unread``: the topic, and what its messages are. A file that was cut off gives its complete
    chunks and a metadata record ``damage``.

    Args:
        path: of the file; while topics are unread it stays open.
        limits: on what the file may ask for.

    Raises:
        FormatError: the file cannot be read, is no MCAP file, or is damaged; also when a topic is
            first used.
        LimitError: it asks for more than the limits allow.
    """
    found = survey(Path(path), limits)
    readings, unread = readings_of(found)
    by_topic: dict[str, dict[int, Reading]] = {}
    for channel, reading in readings.items():
        by_topic.setdefault(reading.topic, {})[channel] = reading
    notes = {"unread": unread, "damage": found.damage}
    metadata = {
        **found.metadata,
        **{name: {**found.metadata.get(name, {}), **note} for name, note in notes.items() if note},
    }
    return Recording(
        {topic: _Lazy(found, channels, limits) for topic, channels in by_topic.items()}, metadata
    )


def readings_of(found: Survey) -> tuple[dict[int, Reading], dict[str, str]]:
    """Return what each channel of ours is, by id, and what the others are, by topic.

    Raises:
        FormatError: a channel's schema is missing, or messages belong to no channel.
    """
    readings, unread = {}, {}
    for channel in found.channels.values():
        schema = found.schemas.get(channel.schema_id)
        if schema is None and channel.schema_id:
            raise FormatError(
                f"channel {channel.topic!r} of {str(found.path)!r} has no schema "
                f"{channel.schema_id!r}"
            )
        reading = reading_of(channel, schema)
        if reading is not None:
            readings[channel.id] = reading
        elif not is_derived(channel, schema):
            unread[channel.topic] = (
                f"{schema.name if schema else 'no schema'} ({channel.message_encoding})"
            )
    for section in found.sections:
        strangers = section.channels - found.channels.keys()
        if strangers:
            raise FormatError(
                f"{str(found.path)!r} has messages of channel {min(strangers)!r}, which it does "
                "not define"
            )
    return readings, unread


class _Lazy:
    """A topic's table, read once; the file is let go afterwards."""

    def __init__(self, found: Survey, readings: Mapping[int, Reading], limits: Limits) -> None:
        self._load: Callable[[], Table] | None = lambda: load(found, readings, limits)
        self._table: Table | None = None

    def __call__(self) -> Table:
        if self._table is None and self._load is not None:
            self._table = self._load()
            self._load = None
        assert self._table is not None
        return self._table


def load(found: Survey, readings: Mapping[int, Reading], limits: Limits) -> Table:
    """Read the table of a topic from its channels.

    Raises:
        FormatError: the file is damaged.
        LimitError: it holds more than the limits allow.
    """
    kind = next(iter(readings.values())).kind
    gathered = Gathering(kind)
    decoders = {channel: Decoder(reading, gathered.words) for channel, reading in readings.items()}
    sections = [section for section in found.sections if not section.channels.isdisjoint(readings)]
    counts: Counter[int] = Counter()
    place = 0
    for messages in ahead(found.messages, sections):
        for channel, part in by_channel(messages):
            if channel not in readings:
                continue
            counts[channel] += part.starts.size
            check_count(found, counts.total(), limits)
            values = decoders[channel].decode(part, repr(str(found.path)))
            gathered.add(
                times_of(found, part), values, part.starts + place if len(readings) > 1 else None
            )
        place += messages.buffer.size
    if found.statistics is not None and not found.damage:
        for channel in readings:
            declared = found.statistics.channel_message_counts.get(channel, 0)
            if declared != counts[channel]:
                raise FormatError(
                    f"{str(found.path)!r} declares {declared!r} messages of channel {channel!r} "
                    f"and holds {counts[channel]}"
                )
    return gathered.table()


def check_count(found: Survey, messages: int, limits: Limits) -> None:
    """Raise LimitError where these are more messages than the limits allow."""
    if messages > limits.messages:
        raise LimitError(
            f"{str(found.path)!r} holds more than the {limits.messages} messages that are allowed"
        )


def times_of(found: Survey, messages: Messages) -> NDArray[np.int64]:
    """Return the log times, ``(n,)``.

    Raises:
        FormatError: one is beyond the year 2262.
    """
    times: NDArray[np.int64] = gather(messages.buffer, "<u8", messages.starts + LOG_TIME).view(
        np.int64
    )
    if times.size and times.min() < 0:
        raise FormatError(
            f"{str(found.path)!r} holds a message that is stamped "
            f"{int(times.view(np.uint64).max())!r} ns, beyond the year 2262"
        )
    return times


def by_channel(messages: Messages) -> Iterator[tuple[int, Messages]]:
    """Part messages by channel, each part in file order."""
    for channel, rows in groups(messages.channels):
        if rows is None:
            yield channel, messages
        else:
            yield (
                channel,
                Messages(
                    messages.buffer,
                    messages.starts[rows],
                    messages.sizes[rows],
                    messages.channels[rows],
                ),
            )


def ahead(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Map in order, a few items ahead in threads, so that unpacking overlaps with what is done with
    the results.
    """
    with ThreadPoolExecutor(_THREADS) as pool:
        under_way: deque[Future[Result]] = deque()
        try:
            for item in items:
                under_way.append(pool.submit(function, item))
                if len(under_way) > _THREADS + 1:
                    yield under_way.popleft().result()
            while under_way:
                yield under_way.popleft().result()
        finally:
            for future in under_way:
                future.cancel()
