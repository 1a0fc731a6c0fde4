"""The limit of the view: how accurate one look at the reference can be at best."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.keyframe.camera import CameraModel
from servoscope.keyframe.levels import PRIOR, View
from servoscope.keyframe.warping import N_ALIGNED, linearise
from servoscope.poses import DISPLAY_FACTORS, DISPLAY_UNITS, DOFS

Array = NDArray[np.float64]

WIDEST = 1024
"""Wider images are averaged over squares of pixels, with as much less noise, [px]."""

_SLOPE = np.array([-1, 9, -45, 0, 45, -9, 1]) / 60
_BLURS = 0.0, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0
"""[px]: the first is taken that leaves noise little; none if it is noise alone."""

_MOST_BLUR = 0.025
"""[image widths]: what is left after more is too little to differ from noise."""

_MOST_BLURRED, _MOST_NOISE = 0.2, 0.5
"""Shares of the squares of slopes that are noise: of a blurred image, and in what is read."""


@dataclass(frozen=True, eq=False)
class ViewLimit:
    """The Cramer-Rao bound of one look at the reference.

    Parameters
    ----------
    covariance : ndarray of shape (6, 6)
        Smallest covariance of a displacement about the pivot that is estimated without bias from
        one image, [m] and [rad], in `DOFS` order. Gain and offset are unknown too.
    shares : ndarray of shape (6, rows, columns)
        What each pixel contributes to each dof; each sums to 1. Pixels are those of the reference
        image, or squares of them where it is wider than `WIDEST`.
    noise : float
        Standard deviation of the noise of such a pixel, [grey].
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


def view_limit(
    image: NDArray[np.uint8],
    camera: CameraModel,
    inverse_depth: NDArray[np.float32],
    by_twist: Array,
    noise: float,
    read: NDArray[np.bool_] | None = None,
) -> ViewLimit:
    """The limit of a look at an image that is noisy itself.

    Slopes of a noisy image are steeper than those of what it shows. So it is blurred until its
    noise makes little of them, and that little is taken off.

    Parameters
    ----------
    image : ndarray of shape (height, width), uint8
        The reference image.
    camera : CameraModel
    inverse_depth : ndarray of shape (rows, columns), float32
    by_twist : ndarray of shape (6, 6)
        Derivative of the displacement by a twist of the camera.
    noise : float
        Standard deviation of a pixel's noise in the look, [grey].
    read : ndarray of shape (6,), bool, optional
        Which dofs are unknown; all by default. The others are known: their bound is 0.
    """
    read = np.ones(6, dtype=bool) if read is None else read
    pixels = -(-image.shape[1] // WIDEST)  # of the image along a side of one that is used
    width = image.shape[1] // pixels
    own = pixel_noise(image[None]) / pixels
    for blur in (*(b for b in _BLURS if b <= _MOST_BLUR * width), 0.0):
        view = View.of(image, width, blur)
        slopes, spread = _slopes(view), own**2 * _slopes_of_noise(view)
        share = np.trace(spread) / max(float(np.mean(slopes**2)) * 2, 1e-12)
        if share <= _MOST_BLURRED:
            break
    A = _by_slopes(view, camera, inverse_depth) @ np.linalg.inv(by_twist) * read
    J = np.einsum("knd,nk->nd", A, slopes)
    spurious = np.einsum("knd,kl,lne->de", A, spread, A, optimize=True)
    light = np.stack([view.grey.ravel(), np.ones(view.grey.size)], axis=1)
    limit = cramer_rao(np.hstack([J, light]), noise / pixels, view.shape, spurious)
    return replace(limit, covariance=np.where(np.outer(read, read), limit.covariance, 0.0))


def _slopes(view: View) -> Array:
    """To the right and down, [grey / image width], (n, 2), of sixth order: sharp edges count."""
    height, width = view.shape
    right, down = (
        cv2.filter2D(view.grey, -1, mask, borderType=cv2.BORDER_REPLICATE)
        for mask in (_SLOPE[None], _SLOPE[:, None])
    )
    slopes = right.ravel() * width, down.ravel() * height / view.aspect
    return np.stack(slopes, axis=1).astype(float)


def _slopes_of_noise(view: View) -> Array:
    """Covariance of the two slopes of a pixel of the view, of unit noise, (2, 2)."""
    one = np.zeros(view.shape, np.float32)
    one[view.shape[0] // 2, view.shape[1] // 2] = 1
    slopes = _slopes(View(view.prepare(one), view.aspect, view.sigma))
    return np.asarray(slopes.T @ slopes)


def _by_slopes(
    view: View, camera: CameraModel, inverse_depth: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Derivatives of grey levels by a twist, for slopes of one to the right and down, (2, n, 6)."""
    rays, by_camera = (x.astype(np.float32) for x in camera.rays(view.points))
    depth, points = view.resize(inverse_depth).ravel(), view.points.astype(np.float32)
    blank, none, one = np.zeros(view.shape, np.float32), np.zeros_like(depth), np.ones_like(depth)
    found = np.empty((2, len(depth), N_ALIGNED), np.float32)
    for k, slope in enumerate(np.eye(2, dtype=np.float32)):
        linearise(
            blank, np.eye(4), camera.values, view.aspect, points, rays, by_camera, depth, none,
            one, none, np.tile(slope, (len(depth), 1)), True, found[k],
            np.empty_like(depth), np.empty_like(depth),
        )  # fmt: skip
    return found


def cramer_rao(
    jacobian: Array, noise: float, shape: tuple[int, int], spurious: Array | None = None
) -> ViewLimit:
    """The bound for grey levels with independent noise.

    ``cov = sigma^2 (J^T J)^-1``; the least-squares estimate is ``(J^T J)^-1 J^T r``, so pixel i
    contributes the square of its column times sigma^2 to the variance. Directions in which noise
    makes most of J are not read; nothing is less accurate than is believed before, `PRIOR`.

    Parameters
    ----------
    jacobian : ndarray of shape (n, 6 + k)
        Derivatives of the grey levels by the six dofs and by what else is unknown.
    noise : float
        [grey].
    shape : tuple of 2 int
        Height and width.
    spurious : ndarray of shape (6, 6), optional
        What noise in J adds to ``J^T J`` of the six dofs.
    """
    light = np.linalg.qr(jacobian[:, 6:])[0]
    J = jacobian[:, :6] * PRIOR
    J = J - light @ (light.T @ J)
    w, V = np.linalg.eigh(J.T @ J)
    root = np.sqrt(np.maximum(w, 1e-12))
    added = np.zeros((6, 6)) if spurious is None else PRIOR[:, None] * spurious * PRIOR
    share, U = np.linalg.eigh((V / root).T @ added @ (V / root))
    R = V * root @ U
    kept = np.where(share <= _MOST_NOISE, 1 - share, 0.0)
    w, V = np.linalg.eigh(R * kept @ R.T)
    inverse = V / np.maximum(w, noise**2) @ V.T * PRIOR
    covariance = noise**2 * PRIOR[:, None] * inverse
    response = J @ inverse
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
