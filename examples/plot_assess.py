"""
What each degree of freedom will reach
======================================

An assessment answers before a model is trained: how accurate one look will be, where the loop will
end, and what the view allows at all. It is the Python side of ``servoscope assess``.
"""

# %%
# A small set of images
# ---------------------
# Sixty images of the cylinder head. A few hundred are better: see the intervals below.

from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np

import servoscope as sv
from servoscope.assessment import as_json, assess
from servoscope.dofs import parse_tolerances

config = sv.AcquisitionConfig(n_images=60, image_size=96)
with TemporaryDirectory() as folder:
    data = sv.acquire(folder, config, n_jobs=1)

# %%
# The question
# ------------
# Two families of features are tried. The tolerances are what the application needs.

assessment = assess(data, families=["moments", "intensity"], n_jobs=1)
found = as_json(assessment, parse_tolerances("t=0.5mm,r=0.1deg"), {})
print(found["conclusion"])

# %%
# The answer, dof by dof
# ----------------------
# A logarithmic axis, since features, one look of a keyframe and the end of the loop are orders of
# magnitude apart.

rows = found["dofs"]
x = np.arange(3)
figure, axes = plt.subplots(1, 2, figsize=(9, 4), sharey=False, layout="constrained")
for ax, dofs, unit in zip(axes, (sv.DOFS[:3], sv.DOFS[3:]), ("mm", "deg"), strict=True):
    features = [rows[dof]["reached_rms"] for dof in dofs]
    look = [rows[dof]["one_look"]["rms"] for dof in dofs]
    end = [rows[dof]["loop"]["end_rms"] for dof in dofs]
    ax.plot(x, features, "s", color="0.6", markersize=9, label="features, one look")
    ax.plot(x, look, "o", color="0.3", markersize=8, label="best of all, one look")
    ax.plot(x, end, "v", color="black", markersize=8, label="end of the loop")
    ax.hlines([rows[dof]["tolerance"] for dof in dofs], x - 0.3, x + 0.3, "black", "--")
    ax.set_yscale("log")
    ax.set_xticks(x, dofs)
    ax.set_xlim(-0.5, 2.5)
    ax.set_ylabel(f"RMS error [{unit}]")
axes[0].legend(fontsize="small")
figure.suptitle("Errors about the pivot; dashed: the tolerance that was asked for")

# %%
# What would help is part of the answer.

for dof, row in rows.items():
    print(f"{dof}: limited by {row['limited_by']}. {' '.join(row['advice'])}")
