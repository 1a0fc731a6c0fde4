"""Whether an image shows what a keyframe expects: a similarity, and the least of it."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.compiled import compiled
from servoscope.errors import ServoscopeWarning
from servoscope.keyframe import Keyframe
from servoscope.keyframe.fitting import evenly_spread
from servoscope.keyframe.levels import View
from servoscope.keyframe.rendering import JUMP, project
from servoscope.keyframe.warping import UNSEEN, sample
from servoscope.poses import inverse_transform
from servoscope.positioning.interfaces import Array, Image
from servoscope.positioning.reference_view import SIZE, similarity

LEAST_SIMILARITY = 0.75
"""The least similarity where too little is known to find one."""

_SIGMA = 0.7
_LEAST_CHANCE = 0.5
_WORST = 0.05
_N_FOREIGN = 8


class Recognition:
    """Compares images with what a keyframe expects at a displacement.

    Parameters
    ----------
    keyframe : Keyframe

    Notes
    -----
    The image is sampled where each pixel of the reference image would be seen, unless another
    surface hides it there, and compared with the reference image cell by cell. The median over
    the cells leaves out what is covered or lit otherwise.
    """

    def __init__(self, keyframe: Keyframe) -> None:
        height, width = keyframe.reference_image.shape
        width = min(max(1, round(SIZE * width / max(height, width))), width)
        self.view = View.of(keyframe.reference_image, width, _SIGMA)
        self.rays = keyframe.camera.rays(self.view.points)[0].astype(np.float32)
        self.depth = self.view.resize(keyframe.inverse_depth).ravel()
        smooth = self.view.resize(cv2.medianBlur(keyframe.inverse_depth, 5))
        self.surface = smooth.ravel().astype(float)
        self._keyframe = keyframe

    def similarity(self, image: Image, displacement: Array) -> float:
        """Median normalised correlation of the cells in view; 0 where too few are in view."""
        mount, values = self._keyframe.mount, self._keyframe.camera.values
        T = inverse_transform(mount) @ inverse_transform(displacement) @ mount
        view, seen = self.view, np.empty(len(self.depth), dtype=np.float32)
        prepared = view.prepare(image)
        sample(prepared, T, values, view.aspect, self.rays, self.depth, seen)
        shown = (seen > UNSEEN) & ~self._is_hidden(T, values)
        weights = shown.reshape(view.shape).astype(np.float32)
        seen = np.where(shown, seen, 0).reshape(view.shape)
        return similarity(seen, view.grey, weights)

    def _is_hidden(self, T: Array, values: Array) -> NDArray[np.bool_]:
        """Whether each point of the reference is behind another one, shape (n,)."""
        view = self.view
        points = np.empty((len(self.surface), 3))
        project(T, values, view.aspect, self.rays.astype(float), self.surface, points)
        hidden = np.empty(len(points), np.bool_)
        _write_hidden(points, view.aspect, np.zeros(view.shape), hidden)
        return hidden


@compiled(error_model="numpy")
def _write_hidden(
    points: NDArray[Any], aspect: float, nearest: NDArray[Any], hidden: NDArray[np.bool_]
) -> None:
    """Whether points (n, 3) from `project` are behind others, of which `nearest` takes note."""
    height, width = nearest.shape
    for decides in (False, True):
        for i in range(points.shape[0]):
            column = int(min(max((points[i, 0] + 0.5) * width, 0.0), width - 1.0))
            row = int(min(max((points[i, 1] / aspect + 0.5) * height, 0.0), height - 1.0))
            if decides:
                hidden[i] = points[i, 2] < (1.0 - JUMP) * nearest[row, column]
            else:
                nearest[row, column] = max(nearest[row, column], points[i, 2])


def recogniser(keyframe: Keyframe) -> Callable[[Image, Array], float]:
    """The function that finds the similarity of an image at a displacement."""
    return Recognition(keyframe).similarity


def chance_similarity(keyframe: Keyframe, images: NDArray[np.uint8], farthest: Array) -> float:
    """The greatest similarity of images that show something else.

    They are a few of the images themselves, evenly spread, turned by 90 and 180 degrees, which is
    more than any displacement within `farthest`; what is read beyond that is refused anyway.
    """
    recognition, (height, width) = Recognition(keyframe), keyframe.reference_image.shape
    found = [0.0]
    for image in images[evenly_spread(np.arange(len(images)), _N_FOREIGN)]:
        for quarters in (1, 2):
            turned = np.ascontiguousarray(np.rot90(image, quarters))
            if turned.shape != (height, width):
                turned = np.asarray(cv2.resize(turned, (width, height)), dtype=np.uint8)
            read = keyframe.align(turned)
            if (np.abs(read.delta_p) <= farthest).all():
                found.append(recognition.similarity(turned, read.displacement))
    return max(found)


def least_similarity(own: Array, chance: float) -> float:
    """The least similarity at which an image is taken for one of the part.

    Half way between what chance reaches and what nearly all images held out reach. Where chance
    reaches as much, images of something else may be taken for the part: no limit below
    `LEAST_SIMILARITY` is given then, and a warning.

    Parameters
    ----------
    own : ndarray of shape (n,)
        Similarities of images that were held out and read right.
    chance : float
        The greatest similarity of images that show something else.

    Examples
    --------
    >>> least_similarity(np.full(20, 0.98), 0.2), least_similarity(np.full(20, 0.96), 0.7)
    (0.74, 0.83)
    """
    if not len(own):
        return LEAST_SIMILARITY
    usual = float(np.quantile(own, _WORST))
    if usual <= chance:
        warnings.warn(
            "Images of something else may be taken for this part: turned by 90 or 180 degrees, its "
            f"own are as similar to what is expected ({chance:.2f}) as images held out "
            f"({usual:.2f}).",
            ServoscopeWarning,
            stacklevel=2,
        )
        return round(max(usual, LEAST_SIMILARITY), 4)
    return round(min(usual, (max(chance, _LEAST_CHANCE) + usual) / 2), 4)
