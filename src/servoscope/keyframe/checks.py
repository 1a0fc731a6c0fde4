"""What a keyframe is fitted to, asked and restored from: shapes, types and ranges."""

from __future__ import annotations

from collections.abc import Mapping
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.arrays import as_numbers
from servoscope.errors import InvalidInputError
from servoscope.poses import is_rigid

Array = NDArray[np.float64]

LEAST_IMAGES = 6
"""Fewest images that a keyframe is fitted to."""

LEAST_DETAIL = 1.0
"""Least standard deviation of the grey levels of a reference image."""

LEAST_SIDE = 32
"""Fewest rows and columns of an image, [px]."""


def _describe(array: Any) -> str:
    return f"{getattr(array, 'dtype', type(array).__name__)} of shape {np.shape(array)}"


def check_images(images: NDArray[np.uint8], reference_image: NDArray[np.uint8]) -> None:
    """Raise InvalidInputError unless the images are enough, uint8, and alike in shape."""
    for name, array, n_axes in (("images", images, 3), ("reference_image", reference_image, 2)):
        if getattr(array, "ndim", 0) != n_axes or array.dtype != np.uint8:
            raise InvalidInputError(
                f"{name} must be a uint8 array with {n_axes} axes, got {_describe(array)}."
            )
    if images.shape[1:] != reference_image.shape or min(reference_image.shape) < LEAST_SIDE:
        raise InvalidInputError(
            f"Images must be as large as the reference image and at least {LEAST_SIDE} px a side, "
            f"got {images.shape[1:]} and {reference_image.shape}."
        )
    if reference_image.std() < LEAST_DETAIL:
        raise InvalidInputError(
            f"The reference image must show some detail, but its grey levels spread by "
            f"{reference_image.std():.2g}; look at something with edges or texture."
        )
    if len(images) < LEAST_IMAGES:
        raise InvalidInputError(
            f"A keyframe needs at least {LEAST_IMAGES} images, got {len(images)}; take some more."
        )


def rigid(name: str, T: ArrayLike, shape: tuple[int, ...] = (4, 4)) -> Array:
    """T as an array, if it holds rigid transforms of that shape."""
    array = as_numbers(T, name)
    if array.shape != shape or not np.isfinite(array).all() or not is_rigid(array):
        raise InvalidInputError(
            f"{name} must hold rigid transforms of shape {shape}, in metres, got "
            f"{_describe(array)}."
        )
    return array


def rigid_stack(name: str, T: ArrayLike) -> Array:
    """One rigid transform or more as an array of shape (n, 4, 4)."""
    array = as_numbers(T, name)
    if array.ndim == 3:
        return rigid(name, array, (max(1, len(array)), 4, 4))
    return rigid(name, array)[None]


def check_numbers(pivot: float, distance: float, pose_noise: tuple[float, float]) -> None:
    """Raise InvalidInputError unless the numbers are in their ranges."""
    if not _is_number(pivot) or not np.isfinite(pivot):
        raise InvalidInputError(f"pivot must be a finite distance in metres, got {pivot}.")
    if not _is_number(distance) or not 0 < distance < np.inf:
        raise InvalidInputError(f"distance must be positive, in metres, got {distance}.")
    deviations = as_numbers(pose_noise, "pose_noise")
    if deviations.shape != (2,) or not all(0 < s < np.inf for s in deviations):
        raise InvalidInputError(
            f"pose_noise must be two positive deviations, in metres and radians, got {pose_noise}."
        )


def checked_noise(noise: float) -> float:
    """The noise, if it is a deviation of grey levels."""
    if not _is_number(noise) or not noise > 0:
        raise InvalidInputError(f"noise must be positive, in grey levels, got {noise}.")
    return noise


def _is_number(value: Any) -> bool:
    return isinstance(value, Real)


def check_names(names: list[str], arrays: Mapping[str, Any]) -> None:
    """Raise InvalidInputError unless all arrays of a keyframe are there."""
    if missing := sorted(set(names) - set(arrays)):
        raise InvalidInputError(
            f"A keyframe consists of {', '.join(names)}; {', '.join(missing)} is missing."
        )


def check_arrays(values: dict[str, Any]) -> None:
    """Raise InvalidInputError unless the arrays fit together as those of a keyframe."""
    image, depth = values["reference_image"], values["inverse_depth"]
    n_fitted = len(values["displacements"]) if values["displacements"].ndim else 0
    shapes = {
        "camera": (5,), "mount": (4, 4), "trust": depth.shape, "covariance": (20, 20),
        "model_error": (6,),
        "displacements": (n_fitted, 4, 4), "pivot": (), "residual": (), "noise": (),
    }  # fmt: skip
    wrong = [name for name, shape in shapes.items() if values[name].shape != shape]
    wrong += [name for name in shapes if values[name].dtype.kind != "f"]
    wrong += [name for name in shapes if name not in wrong and not np.isfinite(values[name]).all()]
    is_image = image.dtype == np.uint8 and image.ndim == 2 and min(image.shape) >= LEAST_SIDE
    if not is_image or image.std() < LEAST_DETAIL:
        wrong.append("reference_image")
    is_field = depth.dtype == np.float32 and depth.ndim == 2 and depth.size > 0
    if not is_field or not (np.isfinite(depth) & (depth > 0)).all():
        wrong.append("inverse_depth")
    if not n_fitted:
        wrong.append("displacements")
    deviations = ("trust", "model_error", "residual", "noise")
    wrong += [n for n in deviations if n not in wrong and (values[n] < 0).any()]
    wrong += [n for n in ("trust", "noise") if n not in wrong and not (values[n] > 0).any()]
    wrong += [n for n in ("mount", "displacements") if n not in wrong and not is_rigid(values[n])]
    dofs = values["dofs"]
    if dofs.shape != (6,) or dofs.dtype != bool or not dofs.any():
        wrong.append("dofs")
    if wrong:
        raise InvalidInputError(
            f"These are not the arrays of a keyframe: {', '.join(dict.fromkeys(wrong))} "
            "has another type, shape or range; fit it again."
        )


def check_like(image: NDArray[np.uint8], reference_image: NDArray[np.uint8]) -> None:
    """Raise InvalidInputError unless an image is of the reference image's type and shape."""
    if getattr(image, "shape", None) != reference_image.shape or image.dtype != np.uint8:
        raise InvalidInputError(
            f"The image must be uint8 of shape {reference_image.shape}, like the "
            f"reference image, got {_describe(image)}."
        )
