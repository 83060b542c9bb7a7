"""Convert a raw log and plot its track and speed.

python examples/convert_and_plot.py drive.ubx
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt

from spoofbench import api

log = Path(sys.argv[1])
recording_path = log.with_suffix(".mcap")

# The ledger says what became of every byte of the log.
ledger = api.convert(log, recording_path)
print(ledger.as_text())

pvt = api.to_pandas(api.read(recording_path).primary("gnss/pvt"))
figure, (track, speed) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
track.plot(pvt["lon_deg"], pvt["lat_deg"])
track.set(xlabel="longitude, deg", ylabel="latitude, deg")
if "vel_n_mps" in pvt:
    speed.plot(pvt.index, pvt[["vel_n_mps", "vel_e_mps"]], label=["north", "east"])
speed.set(xlabel="time, UTC", ylabel="velocity, m/s")
speed.legend()
figure.savefig(log.with_suffix(".png"))
print(f"plot: {log.with_suffix('.png')}")
