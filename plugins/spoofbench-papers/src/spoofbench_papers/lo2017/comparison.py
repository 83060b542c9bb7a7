"""Lo et al.'s comparison on a recording with GNSS and IMU: what the axes, pitch and the receiver's
lag do.

    python -m spoofbench_papers.lo2017.comparison drive.mcap [--lag-s 0.34] [--json]

The paper's flights are not public; its Table 1 has, after 5 s of exponential averaging,
correlations of 0.93 and 0.96 on the vertical axis of an aircraft. A car is another case: along the
track, and with pitch from the velocity. The lag is a property of the receiver: 0.34 s is that of
the drive of the demo. The alerts are those of the multi-condition monitor with the published
thresholds.
"""

import argparse
import json
import sys
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
from spoofbench_acceleration import AccelerationMonitor
from spoofbench_acceleration.monitor import AccelerationSource, ComparedAxis

from spoofbench import codec
from spoofbench.detector import detect
from spoofbench.errors import SpoofbenchError
from spoofbench.recording import Recording
from spoofbench_papers.lo2017.recordings import agreement


def comparison(monitor: AccelerationMonitor, recording: Recording) -> dict[str, Any]:
    """Return what the monitor is told, how the two specific forces agree, and its alerts."""
    return {
        "axis": monitor.axis,
        "pitch": monitor.pitch,
        "from": monitor.acceleration_from,
        "lag_s": monitor.lag_s,
        **agreement(monitor, recording),
        "alerts": int(detect(monitor, recording).alert.sum()),
    }


def measure(recording: Recording, lag_s: float) -> list[dict[str, Any]]:
    """One row per axis, pitch, source of the acceleration and lag; the mean difference along the
    track is the IMU's mounting.
    """
    axes: tuple[ComparedAxis, ...] = ("along_track", "vertical")
    sources: tuple[AccelerationSource, ...] = ("velocity", "position")
    rows = [
        comparison(
            AccelerationMonitor(axis=axis, pitch=pitch, acceleration_from=source, lag_s=lag),
            recording,
        )
        for axis, pitch, source, lag in product(axes, (False, True), sources, (0.0, lag_s))
    ]
    car = AccelerationMonitor(axis="along_track", pitch=True, lag_s=lag_s)
    offset = comparison(car, recording)["mean_mps2"]
    levelled = replace(
        car, mounting_pitch_deg=float(np.degrees(np.arcsin(offset / car.gravity_mps2)))
    )
    return [*rows, comparison(levelled, recording)]


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m spoofbench_papers.lo2017.comparison",
        description=(__doc__ or "").partition("\n")[0],
    )
    parser.add_argument("recording", help="converted recording (.mcap)")
    parser.add_argument(
        "--lag-s", type=float, default=0.34, help="how late the receiver's velocities are"
    )
    parser.add_argument("--json", action="store_true", help="print for machines")
    arguments = parser.parse_args()
    try:
        rows = measure(codec.read(arguments.recording), arguments.lag_s)
    except (SpoofbenchError, OSError) as error:
        sys.exit(f"comparison: {error}")
    if arguments.json:
        sys.stdout.write(json.dumps(rows) + "\n")
        return
    lines = [
        "".join(f"{key:>21}" for key in rows[0]),
        *(
            "".join(
                f"{value:>21.4f}" if isinstance(value, float) else f"{value!s:>21}"
                for value in row.values()
            )
            for row in rows
        ),
        "last row: with the IMU's mounting pitch taken out",
    ]
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
