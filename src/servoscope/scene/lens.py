"""The lens: which ray of light falls on which pixel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

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
        """Pixels (column, row) at which points in camera coordinates are seen.

        Parameters
        ----------
        points : array of shape (..., 3)
            [m], before the camera.
        image_size : int
            [px].

        Returns
        -------
        ndarray of shape (..., 2)
            [px].
        """
        points = np.asarray(points, dtype=float)
        ideal = points[..., :2] / points[..., 2:]
        r2 = (ideal**2).sum(axis=-1, keepdims=True)
        k1, k2 = self.distortion
        K = self.camera_matrix(image_size)
        return ideal * (1 + k1 * r2 + k2 * r2**2) * K[0, 0] + K[:2, 2]

    def rays(self, pixels: ArrayLike, image_size: int) -> Array:
        """Directions, in camera coordinates, whose light falls on the pixels (column, row).

        Parameters
        ----------
        pixels : array of shape (..., 2)
            [px].
        image_size : int
            [px].

        Returns
        -------
        ndarray of shape (..., 3)
            The third coordinate is 1.
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
