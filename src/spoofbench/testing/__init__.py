"""The public conformance kit: what a plugin must keep, as tests that its author runs.

Three lines hold a detector to its contract::

    from spoofbench.testing import check_detector

    @check_detector("my-detector", threshold=3.0)
    def test_conformance(check): check()

:func:`check_attack` does the same for an attack, :func:`check_converter` for a converter and sample
logs. Without
pytest, :func:`run_detector_checks`, :func:`run_attack_checks` and :func:`run_converter_checks`
return the results of the same checks.
"""

from spoofbench.testing.attacks import check_attack, run_attack_checks
from spoofbench.testing.converters import check_converter, run_converter_checks
from spoofbench.testing.detectors import check_detector, run_detector_checks
from spoofbench.testing.kit import CheckFailed, CheckResult
from spoofbench.testing.recordings import drive, spoofed_drive

__all__ = [
    "CheckFailed",
    "CheckResult",
    "check_attack",
    "check_converter",
    "check_detector",
    "drive",
    "run_attack_checks",
    "run_converter_checks",
    "run_detector_checks",
    "spoofed_drive",
]
