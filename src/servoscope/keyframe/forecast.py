"""How accurately a keyframe will read images, from groups of images that were held out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.keyframe.held_out import Readings
from servoscope.keyframe.keyframe import Keyframe
from servoscope.keyframe.motion import conjugate
from servoscope.poses import poses_from_displacements

Array = NDArray[np.float64]

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
    return np.array([max(keyframe._aligner.view_shift(t), 1e-3) for t in T])


def _std_at_reference(keyframe: Keyframe, rng: np.random.Generator) -> Array:
    """What is believed of readings at the reference, with the noise of an image."""
    shape = (_N_AT_END, *keyframe.reference_image.shape)
    noisy = keyframe.reference_image + keyframe.noise * rng.normal(size=shape)
    images = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    return np.median([keyframe.align(image, np.eye(4)).std for image in images], axis=0)
