"""Detectors that a detector must beat: those that know nothing, and the receiver's own word."""

from spoofbench_baselines.ignorant import Always, Never, Periodic, Random
from spoofbench_baselines.receiver import ReceiverFlag

__all__ = ["Always", "Never", "Periodic", "Random", "ReceiverFlag"]
