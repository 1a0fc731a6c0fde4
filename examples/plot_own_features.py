"""
A feature of your own, beside those that are built in
=====================================================

A family of features is an object with ``fit`` and ``transform``. Here the centre of brightness,
three numbers an image, is forecast beside the families that are built in. An entry point brings the
same class to the command line: see the page on plug-ins.
"""

# %%
# The feature
# -----------

from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np

import servoscope as sv
from servoscope.pipeline import forecast
from servoscope.poses import DISPLAY_FACTORS


class BrightnessCentre:
    """Row and column of the centre of brightness of an image, and its mean grey level."""

    is_learned = False

    def fit(self, images, displacements=None):
        return self

    def transform(self, images):
        grey = np.asarray(images, dtype=float)
        total = grey.sum(axis=(1, 2)) + 1.0
        rows, columns = np.arange(grey.shape[1]), np.arange(grey.shape[2])
        centre_row = grey.sum(axis=2) @ rows / total
        centre_column = grey.sum(axis=1) @ columns / total
        return np.column_stack([centre_row, centre_column, grey.mean(axis=(1, 2))])

    def get_feature_names_out(self, input_features=None):
        return np.array(["centre_row", "centre_column", "mean_grey"], dtype=object)


# %%
# The forecast
# ------------
# Each image is predicted from the others, for every family and every degree of freedom.

with TemporaryDirectory() as folder:
    data = sv.acquire(folder, sv.AcquisitionConfig(n_images=200, image_size=64), n_jobs=1)
delta_p = data.delta_p()
families = ["moments", "intensity", BrightnessCentre()]
table = sv.FeatureTable.fit(data.images, delta_p, families, n_folds=5, n_jobs=1)

mean = delta_p.std(axis=0) * DISPLAY_FACTORS
errors = {"the mean": mean}
for name in dict.fromkeys(table.families):
    errors[name] = forecast(table, delta_p, None, sv.Recipe(name)).rms * DISPLAY_FACTORS

# %%
# How much each family tells
# --------------------------
# By itself the centre of brightness says where the part is in the view, and little else.

x = np.arange(6)
figure, ax = plt.subplots(figsize=(9, 4), layout="constrained")
styles = (("0.95", ""), ("0.75", "//"), ("0.5", ""), ("0.2", ".."))
for k, ((name, rms), (colour, hatch)) in enumerate(zip(errors.items(), styles, strict=True)):
    ax.bar(
        x + 0.2 * (k - 1.5),
        rms / mean,
        0.2,
        color=colour,
        hatch=hatch,
        edgecolor="black",
        label=name,
    )
units = ("mm", "mm", "mm", "deg", "deg", "deg")
ax.set_xticks(
    x, [f"{dof}\n1 = {m:.1f} {u}" for dof, m, u in zip(sv.DOFS, mean, units, strict=True)]
)
ax.set_ylabel("forecast RMS error, share of that of the mean")
ax.set_ylim(0, 1.25)
ax.legend(ncols=4, loc="upper center", fontsize="small")
