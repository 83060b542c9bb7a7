"""GNSS spoofing detection by comparing the acceleration of GNSS with an accelerometer (Lo et al.,
ION Pacific PNT 2017).
"""

from spoofbench_acceleration.monitor import AccelerationMonitor, ForceComparison

__all__ = ["AccelerationMonitor", "ForceComparison"]
