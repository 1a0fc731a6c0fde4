"""
A keyframe from twenty images
=============================

Twenty images at known displacements are enough to find how the camera sees, how it sits on the
robot, and how far away each pixel of the reference view is. Any other image is then read in one
look.
"""

# %%
# Twenty images
# -------------
# They are spread over 1.6 times the range of 25 mm and 15 degrees about a point 550 mm ahead.

from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np

import servoscope as sv

config = sv.AcquisitionConfig(schedule=[(20, 1.6), (1, 1.0)], image_size=96)
with TemporaryDirectory() as folder:
    data = sv.acquire(folder, config, n_jobs=1)
learned, other = data[:20], data[20:]

# %%
# The relief
# ----------
# Nothing is given but images and poses. The deck of the head comes out flat and near, the chambers
# and the sides deeper. The bare table shows nothing to measure by: its distance is a guess there,
# and does no harm, since its grey levels are alike. Trust says how well the images agree with each
# pixel; it is low along edges, which hide what lies behind them.

keyframe = sv.Keyframe.fit(
    learned.images, learned.T_world_cam, data.reference_image, data.T_world_ref, pivot=data.pivot
)
print(f"focal length {keyframe.camera.f:.3f} image widths")

figure, axes = plt.subplots(1, 3, figsize=(10, 3.6), layout="constrained")
axes[0].imshow(data.reference_image, cmap="gray")
axes[0].set_title("reference image")
shown = axes[1].imshow(1e3 / keyframe.inverse_depth, cmap="gray", vmin=540, vmax=620)
axes[1].set_title("distance of each pixel")
figure.colorbar(shown, ax=axes[1], label="distance [mm]", shrink=0.8, extend="max")
shown = axes[2].imshow(keyframe.trust, cmap="gray", vmin=0, vmax=1)
axes[2].set_title("trust")
figure.colorbar(shown, ax=axes[2], shrink=0.8)
for ax in axes:
    ax.set_axis_off()

# %%
# One look at another image
# -------------------------
# It was not learned from. :meth:`~servoscope.Keyframe.align` finds where it was taken, and
# :meth:`~servoscope.Keyframe.render` draws what is to be seen from there.

found = keyframe.align(other.images[0])
seen, known = keyframe.render(found.displacement)
truth = other.delta_p()[0]
for dof, reads, std, true in zip(sv.DOFS, found.delta_p, found.std, truth, strict=True):
    factor, unit = (1e3, "mm") if dof[0] == "t" else (np.degrees(1), "deg")
    print(f"{dof} {factor * reads:8.3f} +- {factor * std:.3f} {unit}, true {factor * true:8.3f}")

difference = np.where(known, seen.astype(float) - other.images[0], np.nan)
figure, axes = plt.subplots(1, 3, figsize=(10, 3.6), layout="constrained")
axes[0].imshow(other.images[0], cmap="gray", vmin=0, vmax=255)
axes[0].set_title("the image")
axes[1].imshow(np.where(known, seen, 0), cmap="gray", vmin=0, vmax=255)
axes[1].set_title("rendered where it was found")
shown = axes[2].imshow(difference, cmap="gray", vmin=-64, vmax=64)
axes[2].set_title("difference")
figure.colorbar(shown, ax=axes[2], label="grey levels", shrink=0.8)
for ax in axes:
    ax.set_axis_off()
