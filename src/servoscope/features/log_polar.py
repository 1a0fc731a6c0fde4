"""Log-polar features: an image about its centre, as waves of angle and of scale."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError
from servoscope.features.fixed_projection import FixedProjection, check_whole_number
from servoscope.features.pixel_blocks import project_images
from servoscope.features.pixels import ImageShape


class LogPolarFeatures(FixedProjection):
    """Waves of angle and of log radius in brightness-normalised images, about their centre.

    Parameters
    ----------
    max_turns : int
        Highest number of waves around a circle.
    max_scales : int
        Highest number of waves from the inner to the outer radius, either way wound.
    inner_radius : float
        Share of the outer radius, half the shorter side; nothing nearer to the centre counts.
    image_shape : (height, width), optional
        What flat images are; 1 x n_pixels by default, too thin for a ring: all features are 0.

    Attributes
    ----------
    components_ : ndarray of shape (n_features, n_pixels)
        What images are projected onto.
    image_shape_ : (height, width)
    n_features_in_ : int
        Pixels of an image.

    Raises
    ------
    InvalidInputError
        If a parameter is out of range, an image is not of the size seen in `fit`, or a pixel is
        not finite.

    Notes
    -----
    The Fourier-Mellin transform [1]_ ``M(m, k) = sum f(x, y) exp(-i m theta - 2 pi i k rho)``
    over the pixels of the ring, over the root of their number, with f the grey level divided by
    the Euclidean length of the image, theta the angle from x towards y, and rho the log radius, 0
    at the outer radius and -1 at the inner. Features are the real part ``c`` and the imaginary
    part ``s``. Nothing is resampled: as functions of the pixels, the waves are taken where the
    pixels are, and all pixels count the same.

    A picture that turns by ``alpha`` about the centre turns the phase of ``M(m, k)`` by
    ``-m alpha``; one that is enlarged by ``a``, by ``-2 pi k ln(a) / ln(1 / inner_radius)``,
    and has its magnitude times ``a``, as far as it stays within the ring.

    References
    ----------
    .. [1] F. Ghorbel, "A complete invariant description for gray-level images by the harmonic
       analysis approach", Pattern Recognition Letters 15 (1994), 1043-1051.

    Examples
    --------
    >>> images = np.random.default_rng(0).integers(0, 256, (20, 8, 8), dtype=np.uint8)
    >>> log_polar = LogPolarFeatures(max_turns=1, max_scales=1).fit(images)
    >>> log_polar.get_feature_names_out()[:6]
    array(['l_c_0_0', 'l_c_0_1', 'l_s_0_1', 'l_c_1_-1', 'l_s_1_-1', 'l_c_1_0'],
          dtype=object)
    """

    components_: NDArray[np.float64]

    def __init__(
        self,
        max_turns: int = 4,
        max_scales: int = 2,
        inner_radius: float = 1 / 16,
        image_shape: ImageShape | None = None,
    ) -> None:
        self.max_turns = max_turns
        self.max_scales = max_scales
        self.inner_radius = inner_radius
        self.image_shape = image_shape

    def _prepare(self) -> None:
        check_whole_number("max_turns", self.max_turns, 0)
        check_whole_number("max_scales", self.max_scales, 0)
        if not 0 < self.inner_radius < 1:
            raise InvalidInputError(
                f"inner_radius must be between 0 and 1, got {self.inner_radius!r}."
            )
        theta, rho = _log_polar(self.image_shape_, self.inner_radius)
        ring = (rho >= -1) & (rho < 0)
        weight = 1 / np.sqrt(max(int(ring.sum()), 1))
        self.components_ = np.zeros((len(self._waves()), ring.size))
        for component, (part, m, k) in zip(self.components_, self._waves(), strict=True):
            phase = -m * theta[ring] - 2 * np.pi * k * rho[ring]
            component[ring] = weight * (np.cos(phase) if part == "c" else np.sin(phase))

    def _features(self, flat: NDArray[Any]) -> NDArray[np.float64]:
        return project_images(flat, np.zeros(flat.shape[1]), self.components_)

    def _feature_names(self) -> list[str]:
        return [f"l_{part}_{m}_{k}" for part, m, k in self._waves()]

    def _waves(self) -> list[tuple[str, int, int]]:
        """Part and numbers of waves of each feature; opposite waves are the same two."""
        turns, scales = range(self.max_turns + 1), range(-self.max_scales, self.max_scales + 1)
        pairs = [(m, k) for m in turns for k in scales if m > 0 or k > 0]
        return [("c", 0, 0), *((part, m, k) for m, k in pairs for part in "cs")]


def _log_polar(
    image_shape: ImageShape, inner_radius: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Angle, and log radius from -1 (inner) to 0 (half the shorter side), of every pixel."""
    height, width = image_shape
    rows, columns = np.indices(image_shape).reshape(2, -1)
    x, y = columns - (width - 1) / 2, rows - (height - 1) / 2
    radius = np.hypot(x, y) / (min(height, width) / 2)
    # The pixel at the very centre, if there is one, is left out by any inner radius.
    log_radius = np.log(np.where(radius > 0, radius, inner_radius / 2))
    return np.arctan2(y, x), log_radius / np.log(1 / inner_radius)
