"""A detector that knows what a vehicle can do, and needs GNSS alone."""

from spoofbench_kinematics.envelope import Envelope

__all__ = ["Envelope"]
