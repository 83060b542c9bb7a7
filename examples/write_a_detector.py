"""A detector in one class, held to the contract and tried on an attack.

    python examples/write_a_detector.py demo/drive.mcap

In a package of its own it would be an entry point of the group spoofbench.detectors: see "Add a
detector" in the README.
"""

import sys
from dataclasses import dataclass

import numpy as np

from spoofbench import api
from spoofbench.detector import Decisions
from spoofbench.recording import Recording
from spoofbench.testing import run_detector_checks


@dataclass(frozen=True)
class SpeedJump:
    """Alerts where the speed over ground changes faster than this vehicle can change it."""

    limit_mps2: float = 3.0
    requires = ("gnss/pvt",)
    uses = ()
    memory_s = 0.0

    def detect(self, recording: Recording) -> Decisions:
        pvt = recording.primary("gnss/pvt").last_per_time()
        speed_mps = np.hypot(pvt["vel_n_mps"], pvt["vel_e_mps"])
        interval_s = np.diff(pvt.time_ns, prepend=pvt.time_ns[:1] - 10**9) / 1e9
        change_mps2 = np.abs(np.diff(speed_mps, prepend=speed_mps[:1])) / interval_s
        return Decisions(pvt.time_ns, change_mps2 / self.limit_mps2, ~np.isnan(change_mps2))


if __name__ == "__main__":
    # The kit also runs the detector in a process that has nothing but a blind recording, and which
    # imports the class by name: a script alone has none.
    from write_a_detector import SpeedJump as Detector

    for check in run_detector_checks(Detector()):
        print(f"{'pass' if check.passed else 'FAIL'}  {check.name}")

    clean = api.read(sys.argv[1])
    variant = api.make_variant(clean, "replay", duration_s=60.0, delay_s=20.0, seed=2)
    scores = api.evaluate(SpeedJump(), variant, clean)
    print(f"detection {scores['detection_pct']:.1f} %, first after {scores['ttfd_s']} s")
