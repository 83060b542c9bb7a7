"""The codec: recordings to MCAP files and back, whole columns at a time.

A file has one channel per topic, encoded as protobuf with the full FileDescriptorSet, one message
per row; ``log_time`` and ``publish_time`` are the row's ``time_ns``. An absent value is not
written, zero is.
"""

from spoofbench.codec.compression import Compression
from spoofbench.codec.container import Limits
from spoofbench.codec.reading import read
from spoofbench.codec.validating import validate
from spoofbench.codec.writing import Writer, write

__all__ = ["Compression", "Limits", "Writer", "read", "validate", "write"]
