"""
What informs which degree of freedom
====================================

Each feature of an image shares some information with each degree of freedom of the camera. Mutual
information says how much, in bits, before anything is trained. Here it is estimated for the 24
geometric moments of 200 images of the simulated cylinder head.
"""

# %%
# Images at known displacements
# -----------------------------
# The simulated camera is displaced by up to 25 mm and 15 degrees about a point on the part.

from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np

import servoscope as sv

with TemporaryDirectory() as folder:
    data = sv.acquire(folder, sv.AcquisitionConfig(n_images=200, image_size=64), n_jobs=1)
delta_p = data.delta_p()
print(data.images.shape, "images,", delta_p.shape, "displacements")

# %%
# Bits of each pair
# -----------------
# A histogram of 10 x 10 bins shows some information where there is none: on average
# ``81 / (2 n ln 2)`` bits of n images. :func:`servoscope.information_test` takes that off and says
# which values are more than chance; here the mean level is drawn as a line.

moments = sv.GeometricMoments()
features = moments.fit_transform(data.images)
names = moments.get_feature_names_out()
bits = sv.mutual_information(features, delta_p)
by_chance = 81 / (2 * len(data) * np.log(2))

figure, axes = plt.subplots(2, 3, figsize=(9, 5), sharex=True, layout="constrained")
for ax, dof, column in zip(axes.flat, sv.DOFS, bits.T, strict=True):
    best = column.argsort()[-6:]
    ax.barh(names[best], column[best], color="0.6", edgecolor="0.2")
    ax.axvline(by_chance, color="black", linestyle="--", linewidth=1)
    ax.set_title(dof)
for ax in axes[1]:
    ax.set_xlabel("mutual information [bits]")
figure.suptitle("The six moments that inform each dof most; dashed: by chance")

# %%
# Informative, and repeating little
# ---------------------------------
# The best features by themselves often say the same thing. A criterion weighs what each one adds.

for dof, target in zip(sv.DOFS, delta_p.T, strict=True):
    selector = sv.MutualInfoSelector(n_features=4, criterion="jmi").fit(features, target)
    print(dof, *names[selector.ranking_])
