"""Drag a receiver off its track and look at what it would report.

python examples/attack_and_look.py demo/drive.mcap
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt

from spoofbench import api

path = Path(sys.argv[1])
clean = api.read(path)
variant = api.make_variant(clean, "drag-off", duration_s=60.0, seed=1, rate_mps=0.5)

# The truth says when; positions differ from then on.
truth = api.to_pandas(variant["/truth/attack"])
print(truth[["attack", "class", "start_ns", "end_ns"]].to_string())

before = api.to_pandas(clean.primary("gnss/pvt"))
after = api.to_pandas(variant.primary("gnss/pvt"))
north_m = (after["lat_deg"] - before["lat_deg"]) * 111_200  # metres per degree of latitude, about
figure, axes = plt.subplots(figsize=(8, 3), layout="constrained")
axes.plot(north_m.index, north_m)
axes.set(xlabel="time, UTC", ylabel="error to the north, m")
figure.savefig(path.with_name("drag-off.png"))
print(f"plot: {path.with_name('drag-off.png')}")
