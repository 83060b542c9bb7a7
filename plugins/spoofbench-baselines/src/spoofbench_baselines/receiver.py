"""The receiver's own word on spoofing."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from spoofbench.detector import Decisions
from spoofbench.recording import Recording
from spoofbench.schema.v1 import gnss_pb2

SCORES = {
    gnss_pb2.SPOOFING_STATE_NONE: 0.0,
    gnss_pb2.SPOOFING_STATE_INDICATED: 2.0,
    gnss_pb2.SPOOFING_STATE_CONFIRMED: 3.0,
}


@dataclass(frozen=True)
class ReceiverFlag:
    """Alerts where the receiver indicates or confirms spoofing; where it says nothing, unavailable.

    Decisions stand at the rows of the primary ``gnss/integrity``. How long receivers hold their
    flags is not known.
    """

    requires: ClassVar[tuple[str, ...]] = ("gnss/integrity",)
    uses: ClassVar[tuple[str, ...]] = ()
    memory_s: ClassVar[float] = 0.0

    def detect(self, recording: Recording) -> Decisions:
        """Score 0 for none, 2 for indicated, 3 for confirmed; of several rows at one time the last
        counts.
        """
        table = recording.primary("gnss/integrity").last_per_time()
        states = table["spoofing"]  # 0, unknown, where it is absent
        score = np.full(states.size, np.nan)
        for state, value in SCORES.items():
            score[states == state] = value
        return Decisions(table.time_ns, score, ~np.isnan(score))
