"""How well keyframes read images that they were not fitted to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.errors import InvalidInputError
from servoscope.keyframe.checks import rigid
from servoscope.keyframe.keyframe import Keyframe
from servoscope.poses import displacements_from_poses

Array = NDArray[np.float64]
SimilarityBy = Callable[[Keyframe], Callable[[NDArray[np.uint8], Array], float]]


@dataclass(frozen=True, eq=False)
class HeldOutLooks:
    """One look at every image, by a keyframe that was fitted without the image's group.

    Parameters
    ----------
    errors : ndarray of shape (n, 6)
        What was read less what was reported, about the pivot, [m] and [rad], in `DOFS` order.
    std : ndarray of shape (n, 6)
        What was believed of it.
    similarity : ndarray of shape (n,)
    """

    errors: Array
    std: Array
    similarity: Array


def held_out_looks(
    images: NDArray[np.uint8],
    T_world_cam: ArrayLike,
    reference_image: NDArray[np.uint8],
    T_world_ref: ArrayLike,
    groups: ArrayLike,
    similarity_by: SimilarityBy | None = None,
    **options: Any,
) -> HeldOutLooks:
    """Fit a keyframe without each group of images in turn, and read that group.

    Nothing of a group is in what reads it: each fit starts from nothing.

    Parameters
    ----------
    images, T_world_cam, reference_image, T_world_ref
        As for `Keyframe.fit`.
    groups : array of shape (n,)
        Images that are not independent of each other, such as neighbours in a sequence, are of
        one group.
    similarity_by : callable, optional
        Makes of a keyframe the function of an image and a displacement that finds its similarity;
        by default that of the alignment is taken.
    **options
        Of `Keyframe.fit`.

    Returns
    -------
    HeldOutLooks

    Raises
    ------
    InvalidInputError
        If there are fewer than two groups, or what `Keyframe.fit` raises.
    """
    names, group = np.unique(np.asarray(groups), return_inverse=True)
    if len(names) < 2 or group.shape != (len(images),):
        raise InvalidInputError(
            f"groups must be one label an image, of two groups or more, got {len(names)} groups "
            f"of shape {group.shape} for {len(images)} images."
        )
    T_world_cam = rigid("T_world_cam", T_world_cam, (len(images), 4, 4))
    n = len(images)
    errors, std, similarity = np.empty((n, 6)), np.empty((n, 6)), np.empty(n)
    for k in range(len(names)):
        out = group == k
        keyframe = Keyframe.fit(
            images[~out], T_world_cam[~out], reference_image, T_world_ref, **options
        )
        found = [keyframe.align(image) for image in images[out]]
        true = displacements_from_poses(T_world_ref, T_world_cam[out], keyframe.pivot)
        errors[out] = np.array([f.delta_p for f in found]) - true
        std[out] = [f.std for f in found]
        if similarity_by is None:
            similarity[out] = [f.similarity for f in found]
        else:
            find = similarity_by(keyframe)
            similarity[out] = [
                find(image, f.displacement) for image, f in zip(images[out], found, strict=True)
            ]
    return HeldOutLooks(errors, std, similarity)
