"""Detectors that a detector must beat: those that know nothing, and the receiver's own word."""

from spoofbench_baselines.detectors import Always, Never, Periodic, Random, ReceiverFlag

__all__ = ["Always", "Never", "Periodic", "Random", "ReceiverFlag"]
