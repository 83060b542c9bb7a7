"""An MCAP file to a recording, topic by topic as they are used."""

from collections import Counter
from collections.abc import Callable, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench.arrays import Ints
from spoofbench.codec.channels import TopicChannel, topic_channels
from spoofbench.codec.container import ReadLimits
from spoofbench.codec.decode import ChannelDecoder, Values, decode_categories, empty_categories
from spoofbench.codec.scan import McapFile, scan
from spoofbench.errors import FormatError, RecordingError
from spoofbench.recording import Recording
from spoofbench.schema import Field, Kind
from spoofbench.table import Column, Table


def read(path: Path, limits: ReadLimits = ReadLimits()) -> Recording:  # noqa: B008
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
    file = scan(Path(path), limits)
    channels, unread = topic_channels(file)
    by_topic: dict[str, dict[int, TopicChannel]] = {}
    for number, channel in channels.items():
        by_topic.setdefault(channel.topic, {})[number] = channel
    notes = {"unread": unread, "damage": file.damage}
    metadata = {
        **file.metadata,
        **{name: {**file.metadata.get(name, {}), **note} for name, note in notes.items() if note},
    }
    return Recording(
        {topic: _LazyTable(file, selected) for topic, selected in by_topic.items()}, metadata
    )


class _LazyTable:
    """A topic's table, read once; the file is let go afterwards."""

    def __init__(self, file: McapFile, channels: Mapping[int, TopicChannel]) -> None:
        self._load: Callable[[], Table] | None = lambda: _read_table(file, channels)
        self._table: Table | None = None

    def __call__(self) -> Table:
        if self._table is None and self._load is not None:
            self._table = self._load()
            self._load = None
        assert self._table is not None
        return self._table


def _read_table(file: McapFile, channels: Mapping[int, TopicChannel]) -> Table:
    """Read the table of a topic from its channels.

    Raises:
        FormatError: the file is damaged.
        LimitError: it holds more than the limits allow.
    """
    builder = _TableBuilder(next(iter(channels.values())).kind)
    decoders = {
        number: ChannelDecoder(channel, builder.categories) for number, channel in channels.items()
    }
    sections = [section for section in file.sections if not section.channels.isdisjoint(channels)]
    counts: Counter[int] = Counter()
    section_offset = 0
    for _, contents in file.unpacked(sections):
        for number, messages in contents.messages.by_channel():
            if number not in channels:
                continue
            counts[number] += messages.starts.size
            file.check_message_count(counts.total())
            builder.add(
                file.times_ns(messages),
                decoders[number].decode(messages, file.name),
                messages.starts + section_offset if len(channels) > 1 else None,
            )
        section_offset += contents.messages.buffer.size
    if file.statistics is not None and not file.damage:
        for number in channels:
            declared = file.statistics.channel_message_counts.get(number, 0)
            if declared != counts[number]:
                raise FormatError(
                    f"{file.name} declares {declared!r} messages of channel {number!r} and holds "
                    f"{counts[number]}"
                )
    return builder.table()


class _TableBuilder:
    """Takes a topic's rows in file order and makes the table of them.

    A column grows in a ``BytesIO``, whose value is taken as immutable bytes without another copy.

    Attributes:
        categories: of the rows so far; decoders add to them.
    """

    def __init__(self, kind: Kind) -> None:
        self._kind = kind.name
        self._fields: Mapping[str, Field] = kind.fields
        self.categories = empty_categories(kind)
        self._rows = 0
        self._times = BytesIO()
        self._positions: list[Ints] = []
        self._values: dict[str, BytesIO] = {}
        self._valid: dict[str, BytesIO] = {}

    def add(
        self,
        times_ns: Ints,
        values: dict[str, Values],
        positions: Ints | None = None,
    ) -> None:
        """Append rows; ``positions`` ``(n,)`` order them where the order of calls is not that of
        the file.
        """
        for name in values.keys() - self._values.keys():
            self._values[name], self._valid[name] = BytesIO(), BytesIO()
            self._append(self._fields[name], self._rows, None)
        for name in self._values:
            self._append(self._fields[name], times_ns.size, values.get(name))
        if positions is not None:
            self._positions.append(positions)
        _extend(self._times, times_ns)
        self._rows += times_ns.size

    def _append(self, field: Field, rows: int, given: Values | None) -> None:
        is_coded = field.name in self.categories
        absent = np.nan if field.category == "float" else -1 if is_coded else 0
        values, valid = given or (np.full(rows, absent, field.dtype), np.zeros(rows, bool))
        if field.category != "float" and not is_coded:
            _extend(self._valid[field.name], np.ones(rows, bool) if valid is None else valid)
        elif valid is not None:
            values = np.where(valid, values, np.array(absent, values.dtype))
        _extend(self._values[field.name], values)

    def table(self) -> Table:
        """Return the table, its rows in the order of time, those of one time in file order.

        Raises:
            FormatError: a text is not valid UTF-8.
        """
        times = np.frombuffer(self._times.getvalue(), np.int64)
        columns: dict[str, Column] = {}
        for name, field in self._fields.items():
            if name in self._values:
                values = np.frombuffer(self._values.pop(name).getvalue(), field.dtype)
                valid = np.frombuffer(self._valid[name].getvalue(), bool)
                words = None
                if name in self.categories:
                    words = decode_categories(field, self.categories[name])
                columns[name] = Column(values, None if valid.all() else valid, words)
        if self._positions or np.any(times[1:] < times[:-1]):
            order = (
                np.lexsort((np.concatenate(self._positions), times))
                if self._positions
                else np.argsort(times, kind="stable")
            )
            times = times[order]
            columns = {
                n: Column(
                    c.values[order], None if c.valid is None else c.valid[order], c.categories
                )
                for n, c in columns.items()
            }
        try:
            return Table(self._kind, times, columns)
        except RecordingError as error:
            raise FormatError(f"the file holds an invalid {self._kind} table: {error}") from error


def _extend(column: BytesIO, values: NDArray[Any]) -> None:
    column.write(np.ascontiguousarray(values).data)
