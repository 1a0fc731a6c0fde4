"""The sensor: from light to grey levels."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError


@dataclass(frozen=True)
class Sensor:
    """An 8-bit sensor with a linear response.

    Parameters
    ----------
    exposure : float
        Share of the full well that a pixel on the axis collects from radiance 1.
    gain : float
        Amplifies what was collected; grey 255 is a full well at gain 1.
    vignetting : float
        Loss of light in the corners of the image, 0 to 1; it grows with the square of the
        distance from the centre.
    blur : float
        Standard deviation of the point spread function, defocus included, [image widths].
    full_well : float
        Electrons at full exposure; fewer mean more shot noise.
    read_noise : float
        Standard deviation of the noise of reading out, [electrons].

    Raises
    ------
    InvalidInputError
        If a number is out of its range, or not finite.
    """

    exposure: float = 1.06
    gain: float = 1.0
    vignetting: float = 0.10
    blur: float = 0.5 / 256
    full_well: float = 12_000.0
    read_noise: float = 20.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not np.isfinite(value):
                raise InvalidInputError(f"{name} must be a finite number, got {value}.")
        for name in ("exposure", "gain", "full_well"):
            if not getattr(self, name) > 0:
                raise InvalidInputError(f"{name} must be positive, got {getattr(self, name)}.")
        for name in ("blur", "read_noise", "vignetting"):
            if not getattr(self, name) >= 0:
                raise InvalidInputError(f"{name} must not be negative, got {getattr(self, name)}.")
        if self.vignetting > 1:
            raise InvalidInputError(f"vignetting must be at most 1, got {self.vignetting}.")

    def read_out(
        self, radiance: NDArray[np.float32], rng: np.random.Generator | None = None
    ) -> NDArray[np.uint8]:
        """The image that radiance makes.

        Parameters
        ----------
        radiance : ndarray of shape (size, size), float32
        rng : Generator, optional
            Draws the shot and read noise; without it there is none.

        Returns
        -------
        ndarray of shape (size, size), uint8
        """
        size = len(radiance)
        sigma = self.blur * size
        light = cv2.GaussianBlur(radiance, (0, 0), sigma) if sigma > 0.1 else radiance
        signal = light * (self.exposure * self._vignette(size))
        if rng is not None:
            signal *= np.float32(self.full_well)
            noise = np.sqrt(signal + np.float32(self.read_noise**2))
            noise *= rng.standard_normal(signal.shape, dtype=np.float32)
            signal += noise
            signal /= np.float32(self.full_well)
        grey = signal * np.float32(255 * self.gain) + np.float32(0.5)
        return np.clip(grey, 0, 255).astype(np.uint8)

    def _vignette(self, size: int) -> NDArray[np.float32]:
        x = ((np.arange(size) + 0.5) / size - 0.5).astype(np.float32)
        return 1 - np.float32(2 * self.vignetting) * (x**2 + x[:, None] ** 2)
