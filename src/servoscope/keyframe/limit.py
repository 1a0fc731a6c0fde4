"""The limit of the view: how accurate one look at the reference can be at best."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.poses import DISPLAY_FACTORS, DISPLAY_UNITS, DOFS

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ViewLimit:
    """The Cramer-Rao bound of one look at the reference.

    Parameters
    ----------
    covariance : ndarray of shape (6, 6)
        Smallest covariance of a displacement about the pivot that is estimated without bias from
        one image, [m] and [rad], in `DOFS` order. Gain and offset are unknown too.
    shares : ndarray of shape (6, height, width)
        What each pixel contributes to each dof; each sums to 1.
    noise : float
        Standard deviation of a pixel's noise, [grey].
    """

    covariance: Array
    shares: NDArray[np.float32]
    noise: float

    @property
    def std(self) -> Array:
        """Standard deviation of each dof, [m] and [rad], shape (6,)."""
        return np.sqrt(np.diag(self.covariance))

    def __str__(self) -> str:
        values = zip(DOFS, self.std * DISPLAY_FACTORS, DISPLAY_UNITS, strict=True)
        return ", ".join(f"{dof} {value:.2g} {unit}" for dof, value, unit in values)


def cramer_rao(jacobian: Array, noise: float, shape: tuple[int, int]) -> ViewLimit:
    """The bound for grey levels with independent noise.

    ``cov = sigma^2 (J^T J)^-1``; the least-squares estimate is ``(J^T J)^-1 J^T r``, so pixel i
    contributes the square of its column times sigma^2 to the variance.

    Parameters
    ----------
    jacobian : ndarray of shape (n, 6 + k)
        Derivatives of the grey levels by the six dofs and by what else is unknown.
    noise : float
        [grey].
    shape : tuple of 2 int
        Height and width.
    """
    unit = 1 / np.maximum(np.linalg.norm(jacobian, axis=0), 1e-12)
    scaled = jacobian * unit
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-12, hermitian=True) * unit * unit[:, None]
    covariance = noise**2 * inverse[:6, :6]
    response = jacobian @ inverse[:, :6]
    shares = response.T**2 / np.maximum((response**2).sum(axis=0)[:, None], 1e-300)
    return ViewLimit(covariance, shares.reshape(6, *shape).astype(np.float32), noise)


def pixel_noise(images: NDArray[np.uint8]) -> float:
    """Standard deviation of the noise in images, [grey]: from their smoothest blocks.

    The mask is Immerkaer's (CVIU 64(2), 1996), blind to planes of grey levels; of the blocks'
    deviations the fifth percentile is taken, since texture only adds. Rounding to whole grey
    levels is the least.
    """
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6
    block = 16
    found = []
    for image in images:
        answer = cv2.filter2D(image.astype(np.float32), -1, mask)[1:-1, 1:-1]
        clipped = (image <= 1) | (image >= 254)
        height, width = (n // block * block for n in answer.shape)
        if not height or not width:
            continue
        split = (height // block, block, width // block, block)
        squares = (answer[:height, :width] ** 2).reshape(split).mean(axis=(1, 3))
        bad = clipped[1:-1, 1:-1][:height, :width].reshape(split).any(axis=(1, 3))
        if (~bad).any():
            found.append(np.quantile(np.sqrt(squares[~bad]), 0.05))
    return max(float(np.median(found)) if found else 0.0, float(np.sqrt(1 / 12)))
