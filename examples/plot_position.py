"""
A camera comes back
===================

The whole way: images around a reference view, a model, and the loop that brings a free simulated
camera back to the view.
"""

# %%
# Images and a model
# ------------------
# ``small_model.py`` takes 24 images of the cylinder head and trains a model on them.

import matplotlib.pyplot as plt
import numpy as np
from small_model import IMAGE_SIZE, head_model

import servoscope as sv
from servoscope.poses import pose_error
from servoscope.scoreboard.cell import robot_at_reference, robot_in_cell

PART = "cylinder_head"
model = head_model()
T_world_ref = robot_at_reference(PART, "free", IMAGE_SIZE).true_pose

# %%
# The loop
# --------
# Each start is drawn from the range of 25 mm and 15 degrees about the part, which carries the
# camera by up to 167 mm along an axis. The true poses are recorded beside the loop, which does not
# know them.

figure, axes = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
for start, marker in enumerate("os^"):
    cell = robot_in_cell(PART, 0, "free", "range_1.0", IMAGE_SIZE, seed=0, start=start)
    looks = []
    result = sv.Positioner(model).run(
        cell, cell, on_step=lambda step, image, cell=cell, looks=looks: looks.append(cell.true_pose)
    )
    poses = np.array([*looks, cell.true_pose])
    m, rad = pose_error(T_world_ref, poses)
    end = f"{1e3 * m[-1]:.3f} mm and {np.degrees(rad[-1]):.4f} deg away"
    print(f"start {start}: {result.status} after {result.moves} moves, {end}")
    offsets = 1e3 * (poses[:, :3, 3] - T_world_ref[:3, 3])
    grey = str(0.25 * start)
    axes[0].plot(offsets[:, 0], offsets[:, 1], color=grey, marker=marker, label=f"start {start}")
    axes[1].semilogy(1e3 * m, color=grey, marker=marker)
axes[0].plot(0, 0, "x", color="black", markersize=12)
axes[0].set_aspect("equal", "datalim")
axes[0].set_xlabel("x from the reference [mm]")
axes[0].set_ylabel("y from the reference [mm]")
axes[0].legend()
axes[1].set_xlabel("look")
axes[1].set_ylabel("distance of the camera from the reference [mm]")
axes[1].grid(alpha=0.3)
figure.suptitle("Three starts of a free camera")

# %%
# What the loop believes of its end is part of its result: the error that is left in each degree of
# freedom, about a point on the part. The camera is 550 mm away from there, where a hundredth of a
# degree is a tenth of a millimetre.

print(result.message)
for dof, believed in zip(sv.DOFS, result.predicted_error, strict=True):
    print(dof, f"{1e3 * believed:.4f} mm" if dof[0] == "t" else f"{np.degrees(believed):.4f} deg")
