"""The public conformance kit: what a plugin must keep, as tests that its author runs.

Three lines hold a detector to its contract::

    from spoofbench.testing import detector_checks

    @detector_checks("my-detector", threshold=3.0)
    def test_conformance(check): check()

:func:`attack_checks` does the same for an attack. Without pytest, :func:`run_checks` and :func:`run_attack_checks`
return the same checks' results.
"""

from spoofbench.testing.attacks import attack_checks, run_attack_checks
from spoofbench.testing.checking import CheckFailed, CheckResult
from spoofbench.testing.detectors import detector_checks, run_checks
from spoofbench.testing.recordings import drive, spoofed_drive

__all__ = ["CheckFailed", "CheckResult", "attack_checks", "detector_checks", "drive", "run_attack_checks", "run_checks", "spoofed_drive"]
