"""What a check says."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from spoofbench.recording import Recording

Severity = Literal["info", "warning", "error"]
SEVERITIES: tuple[Severity, ...] = ("info", "warning", "error")


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is not as it should be, or that whoever uses the recording has to know.

    Attributes:
        code: stable name of the check's outcome.
        severity: ``error``: what the rows say is wrong; ``warning``: some rows are, or it has to be
            looked at; ``info``: to be known.
        topic: where; empty for the whole recording.
        text: one sentence: what was measured.
        advice: what to do.
        count: how many rows, intervals or units; None where that makes no sense.
        start_ns, end_ns: the first time and the last one; None for all of the topic.
    """

    code: str
    severity: Severity
    topic: str
    text: str
    advice: str
    count: int | None = None
    start_ns: int | None = None
    end_ns: int | None = None


def where(times: NDArray[np.int64]) -> dict[str, int | None]:
    """Return ``count``, ``start_ns`` and ``end_ns`` of these rows' times, int64 ``(n,)``."""
    if not times.size:
        return {"count": 0, "start_ns": None, "end_ns": None}
    return {"count": int(times.size), "start_ns": int(times.min()), "end_ns": int(times.max())}


def facts(recording: Recording, name: str) -> dict[str, str]:
    """Return a metadata record, empty where there is none."""
    return dict(recording.metadata.get(name, {}))
