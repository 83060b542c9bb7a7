"""Converter of ROS bags: ROS 1, and ROS 2 in SQLite or MCAP; split and compressed ones, folders and
lone files.

What messages say is told by families: ASPN-23, the types of ROS itself, receivers' own bytes, and
types that a mapping describes (see :mod:`spoofbench_converters.table.mapping`). Messages of other
types are counted as skipped. All rows are on one clock (see
:mod:`spoofbench_converters.rosbag.clocks`).
"""

from collections.abc import Iterator
from typing import Literal

from spoofbench.conversion import Item, Reject, SizeHint, Source, SourceMetadata
from spoofbench_converters.rosbag.bag import Bag
from spoofbench_converters.rosbag.contract import Options
from spoofbench_converters.rosbag.conversion import Conversion
from spoofbench_converters.rosbag.locating import confidence, locate

__all__ = ["UNIT", "VERSION", "Options", "convert", "sniff"]

VERSION = "3"
UNIT: Literal["records"] = "records"


def sniff(source: Source) -> float:
    """Return 1 for a bag of any kind, less for an archive with one or an MCAP file of unsaid origin
    with ROS messages, else 0.
    """
    return confidence(source)


def convert(source: Source, options: Options) -> Iterator[Item]:
    """Yield what a bag holds; see :class:`spoofbench.conversion.Converter`."""
    log = Bag(locate(source))
    try:
        conversion = Conversion(log.topics, options)
        yield SizeHint(log.expected)
        for item in log.batches(conversion.wanted):
            if isinstance(item, Reject):
                yield item
            else:
                yield from conversion.take(item)
        yield from conversion.finish()
        if log.expected > log.records:
            yield Reject(
                log.records, log.expected - log.records, "declared by the bag but not in it"
            )
        if log.unverified:
            yield SourceMetadata({"recording": {"unverified_chunks": str(log.unverified)}})
        if options.session:
            yield SourceMetadata({"recording": {"session_id": options.session}})
    finally:
        log.close()
