"""
A folder of your own images
===========================

Which image features inform of which degree of freedom::

    .venv/bin/python examples/own_images.py FOLDER

FOLDER holds images taken around a reference pose and a ``poses.csv`` that gives the camera pose
of each; ``docs/importing.md`` describes it. Set OPTIONS to the conventions of your poses.
"""

# sphinx_gallery_thumbnail_path = "images/desk.png"

import sys

import numpy as np

import servoscope as sv
from servoscope.data import split_data

OPTIONS = sv.ImportOptions(direction="camera-to-world", units="m", axes="opencv", image_width=128)
N_SELECTED = 4


def main(folder: str) -> None:
    data = sv.read_folder(folder, OPTIONS)
    print(f"{len(data)} images around {data.source['reference']}")

    # Nothing but the training images may decide anything; the rest is for trying it afterwards.
    train = split_data(data).train
    images, delta_p = data.images[train], data.delta_p()[train]

    families = [sv.GeometricMoments(), sv.PoseImageCovariance(), sv.Eigenfeatures(n_components=8)]
    X = np.hstack([family.fit(images, delta_p).transform(images) for family in families])
    names = np.hstack([family.get_feature_names_out() for family in families])

    by_chance = 81 / (2 * len(train) * np.log(2))  # mean for unrelated variables in 10 x 10 bins
    print(f"{len(names)} features of {len(train)} training images, {by_chance:.2f} bits by chance")
    print(f"{'dof':5}{'largest':>10}{'best':>7} bits  features in the order of selection")
    for dof, target in zip(sv.DOFS, delta_p.T, strict=True):
        largest = np.abs(target).max()
        if largest < 1e-9:
            print(f"{dof:5}  does not move")
            continue
        selector = sv.MutualInfoSelector(n_features=N_SELECTED).fit(X, target)
        shown = f"{np.degrees(largest):.1f} deg" if dof[0] == "r" else f"{1e3 * largest:.1f} mm"
        chosen = ", ".join(names[selector.ranking_])
        print(f"{dof:5}{shown:>10}{selector.relevance_[0]:7.2f} bits  {chosen}")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(sys.argv[1])
