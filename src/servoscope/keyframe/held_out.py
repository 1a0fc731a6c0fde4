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
from servoscope.keyframe.alignment import Alignment
from servoscope.keyframe.checks import rigid
from servoscope.keyframe.keyframe import Keyframe
from servoscope.keyframe.levels import Guess, Level, View
from servoscope.keyframe.motion import conjugate
from servoscope.keyframe.warping import UNSEEN
from servoscope.poses import displacements_from_poses, inverse_transform, poses_from_displacements
from servoscope.processes import in_processes, one_blas_thread

Floats = NDArray[np.float32]

WIDTH, SIGMA = 128, 1.0
"""Width at which images are compared, and the blur that they get there, [px]."""

_N_NODES = 8


class Residuals:
    """Residuals of images over the pixels of a keyframe, at the resolution of its relief.

    Parameters
    ----------
    keyframe : Keyframe
    """

    def __init__(self, keyframe: Keyframe) -> None:
        width = min(WIDTH, keyframe.reference_image.shape[1])
        self.view = View.of(keyframe.reference_image, width, SIGMA)
        depth = self.view.resize(keyframe.inverse_depth)
        self._level = Level(self.view, keyframe.camera, depth, np.ones_like(depth), _N_NODES)
        self._mount = keyframe.mount
        noise = np.random.default_rng(0).normal(size=keyframe.reference_image.shape)
        self.noise = keyframe.noise * float(self.view.prepare(noise.astype(np.float32)).std())
        """Standard deviation of the noise that is left at this resolution, [grey]."""

    def of(self, image: NDArray[np.uint8], found: Alignment) -> Floats:
        """The image less what the keyframe expects, [grey]; NaN where a pixel is not seen.

        Parameters
        ----------
        image : ndarray of shape (height, width), uint8
        found : Alignment
            Of the image to the keyframe.

        Returns
        -------
        ndarray of shape (rows, columns), float32
        """
        T = inverse_transform(conjugate(self._mount, found.displacement))
        grey = self._level.prepare(image)
        guess = Guess(T, found.light.resized(_N_NODES))
        _, residuals, _, _ = self._level.linearise(grey, guess)
        shown = np.empty(self.view.grey.size, np.float32)
        shown[self._level.used] = np.where(residuals > UNSEEN, residuals, np.float32(np.nan))
        return shown.reshape(self.view.shape)


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


MEDIAN = 0.6745
"""Median of the absolute value of a normal variable of unit variance."""

_N_OVER_RANGE = 500
_N_AT_END = 5
_LEAST_SHARE = 0.25


@dataclass(frozen=True, eq=False)
class AccuracyForecast:
    """Median absolute errors to be expected, by dof, [m] and [rad], in `DOFS` order.

    Parameters
    ----------
    look : ndarray of shape (6,)
        Of one look from anywhere in the range.
    end : ndarray of shape (6,)
        Of one look at the reference, where the loop ends.
    limit : ndarray of shape (6,)
        Of the best look at the reference that the view allows (the Cramer-Rao bound).
    """

    look: Array
    end: Array
    limit: Array


def forecast_accuracy(
    keyframe: Keyframe,
    readings: Readings,
    delta_p: ArrayLike,
    reach: ArrayLike,
    *,
    n_groups: int = 3,
    pose_noise: tuple[float, float] = (3e-4, 5e-4),
    random_state: int | np.random.Generator = 0,
) -> AccuracyForecast:
    """The accuracy that a keyframe will have over a range.

    Errors of images held out grow with how far the view is shifted; their robust deviation per
    radian is carried to displacements drawn from the range. What the noise of the reported poses
    explains is taken off, at most three quarters of the square. Errors fall with the square root
    of the number of images, of which the keyframe has more than those that read the groups.

    Parameters
    ----------
    keyframe : Keyframe
        Fitted to all images.
    readings : Readings
    delta_p : array of shape (n, 6)
        Where the images that were held out were taken, as reported, about the pivot.
    reach : array of shape (6,)
        The range: largest displacements about the pivot, [m] and [rad].
    n_groups : int
        In which the images were held out.
    pose_noise : tuple of 2 floats
        Standard deviations of the reported poses, [m] and [rad].
    random_state : int or Generator
        Draws displacements from the range, and noise.

    Returns
    -------
    AccuracyForecast
    """
    rng = np.random.default_rng(random_state)
    sigma_t, sigma_r = pose_noise
    about = abs(keyframe.pivot) * sigma_r
    poses = np.array([np.hypot(sigma_t, about)] * 2 + [sigma_t] + [sigma_r] * 3)
    shifts = _view_shifts(keyframe, np.asarray(delta_p, dtype=float))
    squares = np.maximum(
        readings.errors**2 - (MEDIAN * poses) ** 2, _LEAST_SHARE * readings.errors**2
    )
    growth = np.sqrt(np.median(squares / shifts[:, None] ** 2, axis=0) * (1 - 1 / n_groups))
    end = MEDIAN * _std_at_reference(keyframe, rng)
    drawn = rng.uniform(-1, 1, (_N_OVER_RANGE, 6)) * np.asarray(reach, dtype=float)
    look = np.hypot(growth * np.median(_view_shifts(keyframe, drawn)), end)
    return AccuracyForecast(look, end, MEDIAN * keyframe.limit().std)


def _view_shifts(keyframe: Keyframe, delta_p: Array) -> Array:
    """How far displacements shift what is seen, roughly, [rad], (n,)."""
    D = poses_from_displacements(np.eye(4), delta_p, keyframe.pivot)
    T = conjugate(keyframe.mount, D)
    return np.array([max(keyframe.aligner.view_shift(t), 1e-3) for t in T])


def _std_at_reference(keyframe: Keyframe, rng: np.random.Generator) -> Array:
    """What is believed of readings at the reference, with the noise of an image."""
    shape = (_N_AT_END, *keyframe.reference_image.shape)
    noisy = keyframe.reference_image + keyframe.noise * rng.normal(size=shape)
    images = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    return np.median([keyframe.align(image, np.eye(4)).std for image in images], axis=0)
