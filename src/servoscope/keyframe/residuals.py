"""What an image shows other than the keyframe expects, pixel by pixel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from servoscope.keyframe.alignment import Alignment
from servoscope.keyframe.keyframe import Keyframe
from servoscope.keyframe.levels import Guess, Level
from servoscope.keyframe.motion import conjugate
from servoscope.keyframe.views import View
from servoscope.keyframe.warping import UNSEEN
from servoscope.poses import inverse_transform

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
        grey = self.view.prepare(image)
        guess = Guess(T, found.light.resized(_N_NODES))
        _, residuals, _, _ = self._level.linearise(grey, guess)
        shown = np.empty(self.view.grey.size, np.float32)
        shown[self._level.used] = np.where(residuals > UNSEEN, residuals, np.float32(np.nan))
        return shown.reshape(self.view.shape)
