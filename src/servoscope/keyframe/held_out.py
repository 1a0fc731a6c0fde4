"""How well keyframes read images that they were not fitted to."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.errors import InvalidInputError
from servoscope.keyframe.checks import rigid
from servoscope.keyframe.keyframe import Keyframe
from servoscope.keyframe.residuals import Residuals
from servoscope.poses import displacements_from_poses
from servoscope.processes import in_processes, one_blas_thread

Array = NDArray[np.float64]
SimilarityBy = Callable[[Keyframe], Callable[[NDArray[np.uint8], Array], float]]


@dataclass(frozen=True, eq=False)
class Readings:
    """What keyframes read of images that they were not fitted to.

    Parameters
    ----------
    errors : ndarray of shape (n, 6)
        What was read less what was reported, about the pivot, [m] and [rad], in `DOFS` order.
    std : ndarray of shape (n, 6)
        What was believed of it.
    similarity : ndarray of shape (n,)
    residuals : ndarray of shape (n, rows, columns), float32
        Of each image and pixel of the reference, [grey]; NaN where it is not seen.
    noise : float
        What of the images' noise is left in a residual, [grey]: the least that can be reached.
    """

    errors: Array
    std: Array
    similarity: Array
    residuals: NDArray[np.float32]
    noise: float

    @classmethod
    def of(
        cls,
        keyframe: Keyframe,
        images: NDArray[np.uint8],
        T_world_cam: Array,
        T_world_ref: ArrayLike,
        similarity_by: SimilarityBy | None = None,
    ) -> Readings:
        """What a keyframe reads of images in one look each, without a first guess.

        Parameters
        ----------
        keyframe : Keyframe
            Not fitted to them.
        images, T_world_cam, T_world_ref
            As for `Keyframe.fit`.
        similarity_by : callable, optional
            As for `read_held_out`.
        """
        residuals = Residuals(keyframe)
        with one_blas_thread():
            found = [keyframe.align(image) for image in images]
        similarity = [f.similarity for f in found]
        if similarity_by is not None:
            find = similarity_by(keyframe)
            similarity = [find(i, f.displacement) for i, f in zip(images, found, strict=True)]
        true = displacements_from_poses(T_world_ref, T_world_cam, keyframe.pivot)
        return cls(
            np.array([f.delta_p for f in found]) - true,
            np.array([f.std for f in found]),
            np.array(similarity),
            np.stack([residuals.of(image, f) for image, f in zip(images, found, strict=True)]),
            residuals.noise,
        )

    @cached_property
    def residual(self) -> Array:
        """Robust standard deviation of the residuals of each image, (n,), [grey]."""
        return deviation(self.residuals, axis=(1, 2)).astype(float)

    @cached_property
    def residual_map(self) -> NDArray[np.float32]:
        """The same of each pixel over the images that see it, [grey]; NaN where none does."""
        return deviation(self.residuals, axis=0)

    @property
    def residual_over_noise(self) -> float:
        """Median residual of an image, in multiples of the noise."""
        seen = self.residual[np.isfinite(self.residual)]
        return float(np.median(seen)) / self.noise if len(seen) else 0.0


def read_held_out(
    images: NDArray[np.uint8],
    T_world_cam: ArrayLike,
    reference_image: NDArray[np.uint8],
    T_world_ref: ArrayLike,
    groups: ArrayLike,
    *,
    similarity_by: SimilarityBy | None = None,
    n_jobs: int | None = 1,
    **options: Any,
) -> Readings:
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
        by default that of the alignment is taken. Of a module, if there are several processes.
    n_jobs : int, optional
        Processes, as joblib counts them; what is read does not depend on it.
    **options
        Of `Keyframe.fit`.

    Returns
    -------
    Readings

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
    calls = (
        (images, T_world_cam, reference_image, T_world_ref, group == k, similarity_by, options)
        for k in range(len(names))
    )
    parts = list(in_processes(_read, calls, n_jobs))
    order = np.argsort(np.argsort(group, kind="stable"), kind="stable")
    errors, std, similarity, residuals = (
        np.concatenate([getattr(part, name) for part in parts])[order]
        for name in ("errors", "std", "similarity", "residuals")
    )
    return Readings(errors, std, similarity, residuals, float(np.mean([p.noise for p in parts])))


def _read(
    images: NDArray[np.uint8],
    T_world_cam: Array,
    reference_image: NDArray[np.uint8],
    T_world_ref: ArrayLike,
    out: NDArray[np.bool_],
    similarity_by: SimilarityBy | None,
    options: dict[str, Any],
) -> Readings:
    """What a keyframe reads of the images that are held out of its fit."""
    keyframe = Keyframe.fit(
        images[~out], T_world_cam[~out], reference_image, T_world_ref, **options
    )
    return Readings.of(keyframe, images[out], T_world_cam[out], T_world_ref, similarity_by)


def deviation(residuals: NDArray[np.float32], axis: int | tuple[int, ...]) -> NDArray[np.float32]:
    """Robust standard deviation of those that are not NaN; NaN where all are."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.asarray(1.4826 * np.nanmedian(np.abs(residuals), axis=axis), np.float32)
