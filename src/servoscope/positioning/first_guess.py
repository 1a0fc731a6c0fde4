"""First guesses of where an image was taken, learned from rendered and real images."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.features.shrinking import shrink
from servoscope.kernels.gaussian import squared_distances
from servoscope.keyframe import Keyframe
from servoscope.keyframe.rendering import continued
from servoscope.keyframe.views import evened
from servoscope.poses import displacements_from_poses, poses_from_displacements
from servoscope.positioning.disturbances import Disturbances
from servoscope.positioning.interfaces import Array, Image
from servoscope.processes import one_blas_thread

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

_SIZE, _RENDERED_WIDTH = 32, 64
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
        """A displacement in shares of the reach, (6,)."""
        at = (pixels - self.mean) @ self.components
        squares = np.square(self.samples - at).sum(axis=1)
        return (np.exp(-squares) @ self.weights).astype(float)


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
        [m] and [rad] about the pivot.
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
            Largest displacements about the pivot, [m] and [rad].
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
        near = rng.integers(len(real), size=n_rendered)
        drawn = np.sqrt(rng.random((n_rendered, 1))) * real[near]
        drawn += _JITTER * reach * rng.uniform(-1, 1, drawn.shape)
        drawn = drawn.clip(-reach, reach)
        height, width = images.shape[1:]
        width = min(width, round(_RENDERED_WIDTH * min(1.0, width / height)))
        seen = poses_from_displacements(np.eye(4), drawn, keyframe.pivot)
        rendered = [continued(*keyframe.render(D, width)) for D in seen]
        small = [shrink(image, max(rendered[0].shape)).astype(np.uint8) for image in images]
        disturbances = Disturbances()
        shown = [disturbances.disturb(image, rng) for image in rendered + small * N_COPIES]
        shares = np.concatenate([drawn, np.tile(real, (N_COPIES, 1))]) / reach
        parts = zip(*map(_parts, shown), strict=True)
        with one_blas_thread():
            windows = tuple(Window.fit(np.stack(part), shares) for part in parts)
        return cls(windows, np.asarray(reach), keyframe.pivot)

    def __call__(self, image: Image) -> Array:
        """Displacements, (n_windows, 4, 4), [m], of an image of any size."""
        parts = zip(self.windows, _parts(image), strict=True)
        shares = np.stack([window.predict(pixels) for window, pixels in parts])
        return poses_from_displacements(np.eye(4), shares.clip(-1.2, 1.2) * self.reach, self.pivot)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """What was learned, as arrays of numbers."""
        return {
            f"{k}/{name}": array
            for k, window in enumerate(self.windows)
            for name, array in vars(window).items()
        }

    @classmethod
    def from_arrays(
        cls, arrays: Mapping[str, NDArray[Any]], reach: Array, pivot: float
    ) -> FirstGuess:
        """What `to_arrays` made them of.

        Raises
        ------
        KeyError, ValueError
            If they are not arrays of first guesses.
        """
        windows = []
        for k in range(len(WINDOWS)):
            names = ("mean", "components", "samples", "weights")
            window = Window(*(np.asarray(arrays[f"{k}/{name}"], np.float32) for name in names))
            n_pixels, n_components = window.components.shape
            n_samples = len(window.samples)
            shapes = (n_pixels,), (n_samples, n_components), (n_samples, 6)
            if (window.mean.shape, window.samples.shape, window.weights.shape) != shapes:
                raise ValueError(f"the arrays of window {k} do not agree")
            windows.append(window)
        return cls(tuple(windows), reach, pivot)


def _parts(image: Image) -> list[Floats]:
    """Pixels of each window of an image that is made small and even."""
    small: Floats = evened(shrink(image, _SIZE)) / np.float32(30)
    height, width = small.shape
    return [
        small[
            round(top * height) : round(bottom * height), round(left * width) : round(right * width)
        ].ravel()
        for top, bottom, left, right in WINDOWS
    ]
