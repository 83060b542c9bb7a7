"""The codec: recordings to MCAP files and back, whole columns at a time.

A file has one channel per topic, encoded as protobuf with the full FileDescriptorSet, one message
per row; ``log_time`` and ``publish_time`` are the row's ``time_ns``. An absent value is not
written, zero is.

A file is read by ``container`` (records and chunks), ``scan`` (what a file holds), ``channels``
(which of it is ours), ``decode`` (messages to columns) and ``reader``; it is written by ``encode``
(columns to messages) and ``writer``.
"""

from spoofbench.codec.container import ReadLimits
from spoofbench.codec.reader import read
from spoofbench.codec.validation import validate
from spoofbench.codec.writer import Compression, Writer, write

__all__ = ["Compression", "ReadLimits", "Writer", "read", "validate", "write"]
