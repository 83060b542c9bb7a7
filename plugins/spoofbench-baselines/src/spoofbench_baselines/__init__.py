"""Detectors that a detector must beat: those that know nothing, the receiver's own word, and the
simplest check.
"""

from spoofbench_baselines.detectors import (
    Always,
    Bursts,
    Never,
    Periodic,
    Random,
    ReceiverFlag,
)
from spoofbench_baselines.jump import Jump

__all__ = ["Always", "Bursts", "Jump", "Never", "Periodic", "Random", "ReceiverFlag"]
