"""The connection between a worker and the process that started it: JSON records and raw bytes.

Nothing is unpickled that came from a worker, because a worker has run a plugin's code.
"""

import json
import re
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

MAX_RECORD_BYTES = 64 << 20
_REASON_LENGTH = 300
_FOLDERS = re.compile(r"/([\w.+~@-]+)/(?:[^\s/'\":,;()<>]+/)*")


class WorkerChannel:
    """One end of the connection."""

    def __init__(self, descriptor: int) -> None:
        self.connection = Connection(descriptor)

    def send(self, **record: Any) -> None:
        self.connection.send_bytes(json.dumps(record).encode())

    def receive(self) -> dict[str, Any]:
        """Return the next record.

        Raises:
            EOFError: the other side is gone.
            OSError, ValueError: it sent something else.
        """
        record = json.loads(self.connection.recv_bytes(MAX_RECORD_BYTES))
        if not isinstance(record, dict):
            raise ValueError(f"expected a record, got a {type(record).__name__}")
        return record

    def send_bytes(self, data: bytes) -> None:
        self.connection.send_bytes(data)

    def receive_bytes(self, size: int) -> bytes:
        """Return a message of that many bytes.

        Raises:
            EOFError, OSError, ValueError: as :meth:`receive`.
        """
        data = self.connection.recv_bytes(size)
        if len(data) != size:
            raise ValueError(f"expected {size} bytes, got {len(data)}")
        return data

    def close(self) -> None:
        self.connection.close()


def one_line(error: BaseException) -> str:
    """Return type and message of an error in one line, without the folders of this machine."""
    text = f"{type(error).__name__}: {error}"
    text = re.sub(r"[\s\x00-\x1f\x7f]+", " ", text).strip().removesuffix(":")
    text = _FOLDERS.sub(lambda match: "" if Path("/", match[1]).is_dir() else match[0], text)
    return text if len(text) <= _REASON_LENGTH else f"{text[: _REASON_LENGTH - 1]}…"
