"""Fourier features: magnitudes and phases of low spatial frequencies."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError
from servoscope.features.fixed_projection import (
    FixedProjection,
    check_whole_number,
    project_separably,
)
from servoscope.features.pixels import ImageShape

WINDOWS = ("none", "hann")

_PHASE_FLOOR = 0.1
"""Magnitude, as a share of the length of the image, below which a phase counts for less."""


class FourierFeatures(FixedProjection):
    """Magnitudes and phases of the low spatial frequencies of brightness-normalised images.

    Parameters
    ----------
    max_frequency : int
        Radius of the disc of frequencies, in waves along the side of the image.
    window : {"none", "hann"}
        What the image is multiplied with. Without one, the jump between opposite edges stands as
        a cross over all frequencies of the axes; with one, what is near the edges, where turns
        about x and y show most, counts for little.
    image_shape : (height, width), optional
        What flat images are; 1 x n_pixels by default.

    Attributes
    ----------
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
    ``F(u, v) = sum w(x, y) (f(x, y) - m) exp(-2 pi i (u x / width + v y / height))``, over the
    square root of ``sum w^2``, with x the column, y the row, f the grey level divided by the
    Euclidean length of the image, and m the mean of f under the window w, whose own spectrum
    would hide the lowest frequencies. Of each pair (u, v), (-u, -v) one stands.

    A shift of the picture turns the phases and leaves the magnitudes ``a``. An angle would jump
    by 2 pi where it wraps, and would mean nothing where the magnitude is 0; features are therefore
    the cosine ``c`` and the sine ``s`` of the phase, times ``a / sqrt(a^2 + 0.1^2)``, which goes
    to 1 where a frequency carries much of the image and to 0 where it carries nothing.

    Examples
    --------
    >>> waves = 1 + np.cos(2 * np.pi * (np.arange(16) / 16 - 0.25))
    >>> fourier = FourierFeatures(max_frequency=1, window="none")
    >>> fourier.fit_transform(np.tile(waves, (1, 8, 1))).round(2)
    array([[ 0.41,  0.  , -0.97,  0.  ,  0.  ,  0.  ]])
    >>> fourier.get_feature_names_out()
    array(['f_a_1_0', 'f_c_1_0', 'f_s_1_0', 'f_a_0_1', 'f_c_0_1', 'f_s_0_1'],
          dtype=object)
    """

    def __init__(
        self,
        max_frequency: int = 3,
        window: str = "none",
        image_shape: ImageShape | None = None,
    ) -> None:
        self.max_frequency = max_frequency
        self.window = window
        self.image_shape = image_shape

    def _prepare(self) -> None:
        check_whole_number("max_frequency", self.max_frequency, 1)
        if self.window not in WINDOWS:
            raise InvalidInputError(f"window must be one of {WINDOWS}, got {self.window!r}.")

    def _features(self, flat: NDArray[Any]) -> NDArray[np.float64]:
        rows, columns = (self._waves(n_pixels) for n_pixels in self.image_shape_)
        parts = [np.concatenate([waves.real, waves.imag]) for waves in (rows, columns)]
        spectra = _as_complex(project_separably(flat, self.image_shape_, *parts))
        # What the mean alone would give: the spectrum of the window.
        of_window = np.outer(rows.sum(axis=1), columns.sum(axis=1))
        zero = self.max_frequency
        means = spectra[:, zero, zero] / of_window[zero, zero]
        u, v = np.transpose(self._frequencies()) + zero
        spectra = spectra[:, v, u] - means[:, None] * of_window[v, u]
        magnitudes = np.abs(spectra)
        phasors = spectra / np.hypot(magnitudes, _PHASE_FLOOR)
        features = np.stack([magnitudes, phasors.real, phasors.imag], axis=-1)
        return features.reshape(len(flat), -1)

    def _feature_names(self) -> list[str]:
        return [f"f_{part}_{u}_{v}" for u, v in self._frequencies() for part in "acs"]

    def _frequencies(self) -> list[tuple[int, int]]:
        """Pairs (u, v), of each two that are opposite one, the lowest first."""
        waves = range(-self.max_frequency, self.max_frequency + 1)
        half = [(u, v) for v in waves for u in waves if v > 0 or (v == 0 and u > 0)]
        disc = [(u, v) for u, v in half if u**2 + v**2 <= self.max_frequency**2]
        return sorted(disc, key=lambda pair: (pair[0] ** 2 + pair[1] ** 2, pair[1], -pair[0]))

    def _waves(self, n_pixels: int) -> NDArray[np.complex128]:
        """Windowed waves of all frequencies, of shape (2 * max_frequency + 1, n_pixels)."""
        pixels = np.arange(n_pixels)
        frequencies = np.arange(-self.max_frequency, self.max_frequency + 1)
        waves = np.exp(-2j * np.pi * np.outer(frequencies, pixels) / n_pixels)
        window = np.ones(n_pixels)
        if self.window == "hann":
            window = np.sin(np.pi * (pixels + 0.5) / n_pixels) ** 2
        return waves * (window / np.linalg.norm(window))


def _as_complex(products: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Complex projections from those onto the real and the imaginary parts of waves."""
    n_rows, n_columns = products.shape[1] // 2, products.shape[2] // 2
    (cc, cs), (sc, ss) = (
        np.split(half, [n_columns], axis=2) for half in np.split(products, [n_rows], axis=1)
    )
    return (cc - ss) + 1j * (cs + sc)
