"""The camera that a keyframe is seen by: a pinhole with radial distortion, for any image shape.

Points of an image are given in image widths from its middle, x to the right and y down, so that
images of every size show the same view.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.errors import InvalidInputError

Array = NDArray[np.float64]

N_CAMERA = 5
"""Parameters of a camera: ln f, cx, cy, k1, k2."""

_NEWTON_STEPS = 8
_WIDEST = 10.0
_LEAST_SLOPE = 0.15


@dataclass(frozen=True)
class CameraModel:
    """Where a camera sees the points before it.

    A point ``(x, y, 1)`` is seen at ``f d (x, y) + (cx, cy)`` with
    ``d = 1 + k1 r^2 + k2 r^4`` and ``r^2 = x^2 + y^2``, as in OpenCV.

    Parameters
    ----------
    f : float
        Focal length, [image widths].
    cx, cy : float
        Principal point from the middle of the image, [image widths].
    k1, k2 : float
        Radial distortion.

    Raises
    ------
    InvalidInputError
        If a number is not finite or the focal length is not positive.

    Examples
    --------
    >>> CameraModel.from_pixels(512.0, (319.5, 239.5), width=640, height=480)
    CameraModel(f=0.8, cx=0.0, cy=0.0, k1=0.0, k2=0.0)
    """

    f: float
    cx: float = 0.0
    cy: float = 0.0
    k1: float = 0.0
    k2: float = 0.0

    def __post_init__(self) -> None:
        if not np.isfinite(self.values).all() or not self.f > 0:
            raise InvalidInputError(
                "A camera must have a positive focal length and finite numbers, in image widths, "
                f"got {self}."
            )

    @classmethod
    def from_pixels(
        cls,
        f: float,
        principal_point: tuple[float, float],
        *,
        width: int,
        height: int,
        distortion: tuple[float, float] = (0.0, 0.0),
    ) -> CameraModel:
        """The camera of a focal length and principal point in pixels, as OpenCV counts them.

        Parameters
        ----------
        f : float
            [px].
        principal_point : tuple of 2 floats
            Column and row, (0, 0) being the middle of the first pixel, [px].
        width, height : int
            Of the images that the numbers are for, [px].
        distortion : tuple of 2 floats
            k1 and k2.
        """
        cx, cy = principal_point
        middle = (cx + 0.5) / width - 0.5, (cy + 0.5 - height / 2) / width
        return cls(f / width, *middle, *distortion)

    @property
    def values(self) -> Array:
        """f, cx, cy, k1, k2."""
        return np.array([self.f, self.cx, self.cy, self.k1, self.k2], dtype=float)

    def moved(self, step: ArrayLike) -> CameraModel:
        """The camera after a step of its parameters (ln f, cx, cy, k1, k2)."""
        ln_f, *others = np.asarray(step, dtype=float)
        rest = self.values[1:] + others
        return CameraModel(self.f * float(np.exp(ln_f)), *map(float, rest))

    def rays(self, points: ArrayLike) -> tuple[Array, Array]:
        """Directions that are seen at points, and how they change with the camera.

        Parameters
        ----------
        points : array of shape (n, 2)
            [image widths] from the middle.

        Returns
        -------
        rays : ndarray of shape (n, 2)
            x and y at unit depth.
        by_camera : ndarray of shape (n, 2, 5)
            Derivatives by ln f, cx, cy, k1, k2.
        """
        seen = (np.asarray(points, dtype=float) - [self.cx, self.cy]) / self.f
        rays = self._undistort(seen)
        r2 = (rays**2).sum(axis=1)
        scale = 1 + self.k1 * r2 + self.k2 * r2**2
        slope = 2 * (self.k1 + 2 * self.k2 * r2)
        right = np.zeros((len(rays), 2, N_CAMERA))
        right[:, :, 0] = -seen
        right[:, 0, 1] = right[:, 1, 2] = -1 / self.f
        right[:, :, 3] = -rays * r2[:, None]
        right[:, :, 4] = -rays * (r2**2)[:, None]
        # the derivative by the ray is scale I + slope r r': its inverse by Sherman and Morrison
        along = np.einsum("ni,nij->nj", rays, right) * (slope / (scale + slope * r2))[:, None]
        by_camera = (right - rays[:, :, None] * along[:, None, :]) / scale[:, None, None]
        return rays, by_camera

    def _undistort(self, seen: Array) -> Array:
        """Ideal points by Newton's method on the radius; where distortion folds, the nearest."""
        r_seen = np.linalg.norm(seen, axis=1)
        r = r_seen.copy()
        for _ in range(_NEWTON_STEPS):
            r2 = r * r
            slope = np.maximum(1 + 3 * self.k1 * r2 + 5 * self.k2 * r2**2, _LEAST_SLOPE)
            r -= (r * (1 + self.k1 * r2 + self.k2 * r2**2) - r_seen) / slope
            r = np.clip(r, 0, _WIDEST)
        return seen * np.divide(r, r_seen, out=np.ones_like(r), where=r_seen > 1e-12)[:, None]
