"""What processes of a run say to each other: JSON records and raw arrays; nothing that a plugin
could make the other side execute.
"""

import json
import re
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from spoofbench.detector import Decisions

MAX_RECORD_BYTES = 64 << 20
_DECISION_BYTES = 17
_REASON_LENGTH = 300
_FOLDERS = re.compile(r"/([\w.+~@-]+)/(?:[^\s/'\":,;()<>]+/)*")


class Talk:
    """One end of a connection between two processes of a run."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection

    @classmethod
    def of(cls, descriptor: int) -> "Talk":
        return cls(Connection(descriptor))

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

    def send_decisions(self, decisions: Decisions) -> None:
        arrays = (decisions.time_ns, decisions.score, decisions.available)
        self.connection.send_bytes(b"".join(array.tobytes() for array in arrays))

    def receive_decisions(self, rows: Any) -> Decisions:
        """Return decisions, checked anew: the sender has run a plugin's code.

        Raises:
            EOFError, OSError, ValueError: as :meth:`receive`.
            PluginError: they are no decisions.
        """
        if not isinstance(rows, int) or rows < 0:
            raise ValueError(f"expected a number of decisions, got {rows!r}")
        data = self.connection.recv_bytes(rows * _DECISION_BYTES)
        if len(data) != rows * _DECISION_BYTES:
            raise ValueError(f"expected {rows} decisions, got {len(data)} bytes")
        time_ns = np.frombuffer(data, np.int64, rows)
        score = np.frombuffer(data, np.float64, rows, 8 * rows)
        return Decisions(time_ns, score, np.frombuffer(data, np.uint8, rows, 16 * rows) != 0)


def one_line(error: BaseException) -> str:
    """Return type and message of an error in one line, without the folders of this machine."""
    text = (
        re.sub(r"[\s\x00-\x1f\x7f]+", " ", f"{type(error).__name__}: {error}")
        .strip()
        .removesuffix(":")
    )
    text = _FOLDERS.sub(lambda match: "" if Path("/", match[1]).is_dir() else match[0], text)
    return text if len(text) <= _REASON_LENGTH else f"{text[: _REASON_LENGTH - 1]}…"
