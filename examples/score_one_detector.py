"""Score one detector on one attack in one call.

python examples/score_one_detector.py demo/drive.mcap correlation
"""

import sys

from spoofbench import api

clean, detector = api.read(sys.argv[1]), sys.argv[2]
variant = api.make_variant(clean, "extrapolate", duration_s=60.0, seed=3)

scores = api.evaluate(detector, variant, clean)
false_alerts = api.evaluate(detector, clean)
print(f"{detector}: detected {scores['detection_pct']} % of the spoofed epochs")
print(f"first alert after {scores['ttfd_s']} s, position error then "
      f"{scores['position_error_at_detection_m']} m")  # fmt: skip
print(f"false alerts: {false_alerts['far_per_hour']} per hour, 95 % interval "
      f"{false_alerts['far_per_hour_lo']} to {false_alerts['far_per_hour_hi']}")  # fmt: skip
