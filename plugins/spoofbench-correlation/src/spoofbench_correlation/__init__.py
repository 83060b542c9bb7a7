"""Does the motion that GNSS claims agree with the motion that an IMU feels?

After D. Borio, *An Experimental Evaluation of GNSS/INS Verification Strategies for Vehicular
Applications*. GNSS and IMU are not coupled: both give accelerations and angular rates per GNSS
epoch, and their correlation over a window is the statistic. A vehicle at rest gives nothing to
correlate; there the two are asked whether they stand still at the same times.
"""

from spoofbench_correlation.correlation import Correlation
from spoofbench_correlation.zero_velocity import ZeroVelocity

__all__ = ["Correlation", "ZeroVelocity"]
