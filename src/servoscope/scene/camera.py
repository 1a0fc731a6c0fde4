"""The camera: its lens, its sensor, and what hangs before them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.errors import InvalidInputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Lens:
    """A lens with radial distortion before a square sensor.

    Everything is given in fractions of the sensor's width, so that images of every size show
    the same view.

    Parameters
    ----------
    focal_length : float
        [image widths]; 1.618 is an 8 mm lens before a sensor 4.94 mm wide, and sees 340 mm at
        a distance of 550 mm.
    principal_point : tuple of 2 floats
        Where the optical axis meets the image, from its left and top, [image widths].
    distortion : tuple of 2 floats
        k1 and k2: an ideal point at the distance r from the axis (at unit depth) is seen at
        ``r (1 + k1 r^2 + k2 r^4)``, as in OpenCV.

    Raises
    ------
    InvalidInputError
        If a number is not finite, the focal length not positive, or the distortion folds the
        image over.
    """

    focal_length: float = 1.618
    principal_point: tuple[float, float] = (0.504, 0.497)
    distortion: tuple[float, float] = (-0.12, 0.04)

    def __post_init__(self) -> None:
        for name in ("focal_length", "principal_point", "distortion"):
            if not np.isfinite(getattr(self, name)).all():
                raise InvalidInputError(f"{name} must be finite, got {getattr(self, name)}.")
        if not self.focal_length > 0:
            raise InvalidInputError(f"focal_length must be positive, got {self.focal_length}.")
        k1, k2 = self.distortion
        reach = np.hypot(*np.maximum(self.principal_point, 1 - np.array(self.principal_point)))
        r2 = np.linspace(0, (1.2 * reach / self.focal_length) ** 2, 200)
        if (1 + 3 * k1 * r2 + 5 * k2 * r2**2).min() <= 0:
            raise InvalidInputError(
                f"distortion {self.distortion} folds the image over within the view; use smaller "
                "coefficients or a longer focal_length."
            )

    def camera_matrix(self, image_size: int) -> Array:
        """The 3 x 3 matrix K for images of a size, [px]; pixel centres at whole numbers.

        Examples
        --------
        >>> Lens(principal_point=(0.5, 0.5)).camera_matrix(256)[0].tolist()
        [414.208, 0.0, 127.5]
        """
        f = self.focal_length * image_size
        cx, cy = np.array(self.principal_point) * image_size - 0.5
        return np.array([[f, 0.0, cx], [0.0, f, cy], [0.0, 0.0, 1.0]])

    def project(self, points: ArrayLike, image_size: int) -> Array:
        """Pixels (column, row) where points (..., 3) in camera coordinates are seen, (..., 2)."""
        points = np.asarray(points, dtype=float)
        ideal = points[..., :2] / points[..., 2:]
        r2 = (ideal**2).sum(axis=-1, keepdims=True)
        k1, k2 = self.distortion
        K = self.camera_matrix(image_size)
        return ideal * (1 + k1 * r2 + k2 * r2**2) * K[0, 0] + K[:2, 2]

    def rays(self, pixels: ArrayLike, image_size: int) -> Array:
        """Directions (..., 3), in camera coordinates, whose light falls on pixels (column, row).

        Their third coordinate is 1.
        """
        K = self.camera_matrix(image_size)
        seen = (np.asarray(pixels, dtype=float) - K[:2, 2]) / K[0, 0]
        r_seen = np.linalg.norm(seen, axis=-1, keepdims=True)
        r = r_seen.copy()
        k1, k2 = self.distortion
        for _ in range(8):  # Newton's method; each step doubles the digits
            r2 = r * r
            r -= (r * (1 + k1 * r2 + k2 * r2**2) - r_seen) / (1 + 3 * k1 * r2 + 5 * k2 * r2**2)
        scale = np.divide(r, r_seen, out=np.ones_like(r), where=r_seen > 0)
        return np.concatenate([seen * scale, np.ones_like(r)], axis=-1)


@lru_cache(maxsize=4)
def pixel_rays(lens: Lens, image_size: int) -> NDArray[np.float32]:
    """Where what each pixel's middle sees lies at unit depth, shape (size, size, 2)."""
    grid = np.stack(np.meshgrid(*2 * [np.arange(image_size)]), axis=-1)
    return np.ascontiguousarray(lens.rays(grid, image_size)[..., :2], dtype=np.float32)


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
        """The image, uint8, that radiance makes; without `rng` there is no shot and read noise."""
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


_ASPECTS = (0.6, 1.7)
"""Least and largest width over height."""

_RADIANCES = (0.1, 0.9)


@dataclass(frozen=True)
class Covering:
    """An opaque rectangle of one grey, fixed in the image, that hides a share of it from 0 to 1.

    The seed draws its place, its form and its grey.

    Examples
    --------
    >>> Covering(share=0.25, seed=1).cover(np.full((8, 8), -1.0)).clip(0).astype(bool).sum()
    np.int64(16)
    """

    share: float
    seed: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.share <= 1:
            raise InvalidInputError(f"share must be from 0 to 1, got {self.share}.")
        if not isinstance(self.seed, int | np.integer) or self.seed < 0:
            raise InvalidInputError(f"seed must be a whole number from 0, got {self.seed!r}.")

    def cover(self, radiance: NDArray[np.floating]) -> NDArray[np.floating]:
        """The light that is left, (size, size); less than half a row is missing of the share."""
        covered = radiance.copy()
        rng = np.random.default_rng(self.seed)
        place = draw_rectangle(covered.shape, self.share, _ASPECTS, rng)
        covered[place] = rng.uniform(*_RADIANCES)
        return covered


def draw_rectangle(
    shape: tuple[int, ...], share: float, aspects: tuple[float, float], rng: np.random.Generator
) -> tuple[slice, slice]:
    """Where in an image a rectangle of a share of its area lies, to half a row.

    `aspects` are its least and largest width over height, in an image as high as wide.
    """
    rows, columns = shape
    aspect = np.exp(rng.uniform(*np.log(aspects)))
    width = round(columns * float(np.clip(np.sqrt(share * aspect), share, 1)))
    height = min(rows, round(share * (rows * columns) / max(width, 1)))
    u, v = rng.random(2)
    left, top = int(u * (columns - width + 1)), int(v * (rows - height + 1))
    return slice(top, top + height), slice(left, left + width)
