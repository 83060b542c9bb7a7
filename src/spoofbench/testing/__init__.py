"""The public conformance kit: what a plugin must keep, as tests that its author runs.

Three lines hold a detector to its contract::

    from spoofbench.testing import detector_checks

    @detector_checks("my-detector", threshold=3.0)
    def test_conformance(check): check()

Without pytest, :func:`run_checks` returns the same checks' results.
"""

from spoofbench.testing.detectors import CheckResult, detector_checks, run_checks
from spoofbench.testing.recordings import drive, spoofed_drive
from spoofbench.testing.subject import CheckFailed

__all__ = ["CheckFailed", "CheckResult", "detector_checks", "drive", "run_checks", "spoofed_drive"]
