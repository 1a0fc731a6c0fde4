"""First guesses of where an image was taken, learned from rendered and real images."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.kernels.gaussian import squared_distances
from servoscope.keyframe import Keyframe
from servoscope.keyframe.levels import evened
from servoscope.keyframe.rendering import continued
from servoscope.poses import displacements_from_poses, poses_from_displacements
from servoscope.positioning.interfaces import Array, Image
from servoscope.processes import one_blas_thread
from servoscope.scene.disturbances import Disturbances

Floats = NDArray[np.float32]

N_RENDERED = 2400
"""Rendered images that are learned from."""

N_COPIES = 5
"""Disturbed copies of each real image that are learned from."""

WINDOWS = (
    (0.0, 1.0, 0.0, 1.0),
    (0.2, 0.8, 0.2, 0.8),
    (0.0, 1.0, 0.0, 0.6),
    (0.0, 1.0, 0.4, 1.0),
    (0.0, 0.6, 0.0, 1.0),
    (0.4, 1.0, 0.0, 1.0),
)
"""Parts of the view, top, bottom, left and right as shares of it: what covers one of them leaves
another free."""

_SIZE = 32
_N_COMPONENTS, _RIDGE, _N_SCALE = 100, 0.01, 300
_JITTER = 0.5


@dataclass(frozen=True, eq=False)
class Window:
    """A kernel ridge regression on the principal components of one part of the view.

    Parameters
    ----------
    mean : ndarray of shape (n_pixels,)
    components : ndarray of shape (n_pixels, n_components)
    samples : ndarray of shape (n_samples, n_components)
        Images that were learned from; distances are in units of the kernel's length.
    weights : ndarray of shape (n_samples, 6)
        What each contributes to a displacement, in shares of the reach.
    """

    mean: Floats
    components: Floats
    samples: Floats
    weights: Floats

    @classmethod
    def fit(cls, pixels: Floats, shares: Array) -> Window:
        """Learn displacements, (n, 6) in shares of the reach, from pixels (n, n_pixels)."""
        mean = pixels.mean(axis=0)
        centred = (pixels - mean).astype(float)
        _, vectors = np.linalg.eigh(centred.T @ centred)
        components = vectors[:, ::-1][:, :_N_COMPONENTS]
        samples = centred @ components
        some = samples[:: max(1, len(samples) // _N_SCALE)]
        length = np.sqrt(max(float(np.median(squared_distances(some, some))), 1e-12))
        components, samples = components / length, samples / length
        K = np.exp(-squared_distances(samples, samples))
        K[np.diag_indices(len(K))] += _RIDGE
        weights = np.linalg.solve(K, shares)
        kept = (mean, components, samples, weights)
        return cls(*(array.astype(np.float32) for array in kept))

    def predict(self, pixels: Floats) -> Array:
        """A displacement in shares of the reach, (6,).

        In double precision: what samples contribute is large and of either sign, so that little of
        single precision would be left in the sum.
        """
        components, samples, squares, weights = self._doubled
        at = (pixels - self.mean).astype(float) @ components
        return np.asarray(np.exp(2 * (samples @ at) - squares - at @ at) @ weights)

    @cached_property
    def _doubled(self) -> tuple[Array, Array, Array, Array]:
        """Components, samples, squared lengths of these and weights, in double precision."""
        components, samples, weights = (
            array.astype(float) for array in (self.components, self.samples, self.weights)
        )
        return components, samples, np.einsum("ij,ij->i", samples, samples), weights


@dataclass(frozen=True, eq=False)
class FirstGuess:
    """Where an image may have been taken: an answer from each of several parts of the view.

    A keyframe shows what would be seen from anywhere, so that there are as many images to learn
    from as help. They are disturbed in light, gain, focus, noise and by what covers the view, and
    pixels are made even nearby, so that slow changes of light do not matter. Where a part of the
    view is covered, answers from the others are good.

    Parameters
    ----------
    windows : tuple of Window
        In the order of `WINDOWS`.
    reach : ndarray of shape (6,)
        [m] and [rad] about the pivot; 0 for dofs that are not read.
    pivot : float
        [m].
    """

    windows: tuple[Window, ...]
    reach: Array
    pivot: float

    @classmethod
    def train(
        cls,
        keyframe: Keyframe,
        reach: Array,
        images: NDArray[np.uint8],
        displacements: Array,
        *,
        n_rendered: int = N_RENDERED,
        seed: int = 0,
    ) -> FirstGuess:
        """Learn from what a keyframe shows, and from real images.

        Parameters
        ----------
        keyframe : Keyframe
        reach : ndarray of shape (6,)
            Largest displacements about the pivot, [m] and [rad]; 0 for dofs that are not read.
        images : ndarray of shape (n, height, width), uint8
            Real ones.
        displacements : ndarray of shape (n, 4, 4)
            Of the real images, ``inv(T_world_ref) @ T_world_cam``, [m].
        n_rendered : int
            Images to render: spread about the real ones and between them and the reference.
        seed : int
        """
        rng = np.random.default_rng(seed)
        real = displacements_from_poses(np.eye(4), displacements, keyframe.pivot)
        real[:, reach == 0] = 0
        near = rng.integers(len(real), size=n_rendered)
        drawn = np.sqrt(rng.random((n_rendered, 1))) * real[near]
        drawn += _JITTER * reach * rng.uniform(-1, 1, drawn.shape)
        drawn = drawn.clip(-reach, reach)
        shape = small_shape(images.shape[1:])
        width = min(images.shape[2], 2 * shape[1])
        seen = poses_from_displacements(np.eye(4), drawn, keyframe.pivot)
        rendered = [continued(*keyframe.render(D, width)) for D in seen]
        size = rendered[0].shape[::-1]
        small = [cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in images]
        disturbances = Disturbances()
        shown = [disturbances.disturb(image, rng) for image in rendered + small * N_COPIES]
        shares = np.concatenate([drawn, np.tile(real, (N_COPIES, 1))]) / np.where(reach, reach, 1)
        parts = zip(*(_parts(image, shape) for image in shown), strict=True)
        with one_blas_thread():
            windows = tuple(Window.fit(np.stack(part), shares) for part in parts)
        return cls(windows, np.asarray(reach), keyframe.pivot)

    def __call__(self, image: Image) -> Array:
        """Displacements, (n_windows, 4, 4), [m], of an image of any size."""
        parts = zip(self.windows, _parts(image, small_shape(image.shape)), strict=True)
        shares = np.stack([window.predict(pixels) for window, pixels in parts])
        return poses_from_displacements(np.eye(4), shares.clip(-1.2, 1.2) * self.reach, self.pivot)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """What was learned, as arrays of numbers."""
        return {
            f"{k}/{part.name}": getattr(window, part.name)
            for k, window in enumerate(self.windows)
            for part in fields(window)
        }

    @classmethod
    def from_arrays(
        cls,
        arrays: Mapping[str, NDArray[Any]],
        image_shape: tuple[int, ...],
        reach: Array,
        pivot: float,
    ) -> FirstGuess:
        """What `to_arrays` made them of, for images of a shape.

        Raises
        ------
        KeyError, ValueError
            If they are not arrays of first guesses for such images.
        """
        windows = []
        for k, bounds in enumerate(bounds_of(small_shape(image_shape))):
            kept = (arrays[f"{k}/{part.name}"] for part in fields(Window))
            window = Window(*(np.asarray(array, np.float32) for array in kept))
            height, width = (side.stop - side.start for side in bounds)
            n_samples, n_components = window.samples.shape
            expected = {
                "mean": (height * width,),
                "components": (height * width, n_components),
                "samples": (n_samples, n_components),
                "weights": (n_samples, 6),
            }
            if any(getattr(window, name).shape != shape for name, shape in expected.items()):
                raise ValueError(f"the arrays of window {k} do not agree with each other")
            windows.append(window)
        return cls(tuple(windows), reach, pivot)


def small_shape(shape: tuple[int, ...]) -> tuple[int, int]:
    """Height and width of the images that are compared, given those of full ones."""
    scale = min(1.0, _SIZE / max(shape))
    height, width = (max(1, round(scale * side)) for side in shape)
    return height, width


def bounds_of(shape: tuple[int, int]) -> list[tuple[slice, slice]]:
    """Rows and columns of each window."""
    height, width = shape
    return [
        (
            slice(round(top * height), max(round(bottom * height), 1)),
            slice(round(left * width), max(round(right * width), 1)),
        )
        for top, bottom, left, right in WINDOWS
    ]


def _parts(image: Image, shape: tuple[int, int]) -> list[Floats]:
    """Pixels of each window of an image that is made small and even."""
    grey = cv2.resize(image.astype(np.float32), shape[::-1], interpolation=cv2.INTER_AREA)
    small: Floats = (evened(np.asarray(grey, np.float32)) / 30).astype(np.float32)
    return [small[part].ravel() for part in bounds_of(shape)]
