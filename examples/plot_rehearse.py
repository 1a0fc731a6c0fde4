"""
A rehearsal before the robot moves
==================================

A keyframe can draw what its camera would see from anywhere near. So the loop can be tried on the
part itself, in images rendered of its own view, before a robot moves.
"""

# %%
# A model
# -------
# It is that of 24 images which ``small_model.py`` trains.

import matplotlib.pyplot as plt
import numpy as np
from small_model import head_model

from servoscope.rehearsal import Rehearsal

rehearsal = Rehearsal(head_model(), starts=5)

# %%
# Conditions
# ----------
# The same starts, as in training, with a tenth of the view covered, and with noise. Five starts
# keep this page quick; twenty are the default.

CONDITIONS = ("range_1.0", "covered_10", "noise_10")
results = {name: rehearsal.run(name, n_jobs=1) for name in CONDITIONS}
for name, result in results.items():
    print(f"{name}: {result['success']} of {result['trials']} arrive")

figure, axes = plt.subplots(
    2, 3, figsize=(9, 6), layout="constrained", gridspec_kw={"height_ratios": [2, 1.5]}
)
for (top, bottom), name in zip(axes.T, CONDITIONS, strict=True):
    top.imshow(rehearsal.first_image(name), cmap="gray", vmin=0, vmax=255)
    top.set_title(name)
    top.set_axis_off()
    ends = [start["end_mm"] for start in results[name]["starts"]]
    bottom.semilogy(np.arange(len(ends)), ends, "o", color="0.2")
    bottom.axhline(1.0, color="black", linestyle="--")
    bottom.set_ylim(1e-3, 3)
    bottom.set_xlabel("start")
axes[1, 0].set_ylabel("end of the loop [mm]")
figure.suptitle("What the camera sees at the first start; where each loop ends (dashed: 1 mm)")
