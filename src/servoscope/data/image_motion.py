"""Images made small, how they shift against each other, and which camera motion that fits."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from servoscope.poses import inverse_transform

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_LOW_PASS = 0.15  # cycles per pixel
_KEPT = 0.8

_PAIRS = 64
"""Pairs of images whose spectra are in memory at once."""


def shrink(image: NDArray[Any], size: int) -> NDArray[np.float32]:
    """An image whose longer side is `size` pixels, or as it is if that is less, float32.

    Examples
    --------
    >>> shrink(np.full((20, 40), 7, np.uint8), 10).shape
    (5, 10)
    """
    shape, whole = shrunk_shape(image.shape, size), image.astype(np.float32)
    return np.asarray(cv2.resize(whole, shape[::-1], interpolation=cv2.INTER_AREA))


def shrunk_shape(shape: tuple[int, ...], size: int) -> tuple[int, int]:
    """Height and width of what `shrink` makes of an image of a shape."""
    scale = min(1.0, size / max(shape))
    height, width = (max(1, round(scale * side)) for side in shape)
    return height, width


def shrink_all(images: NDArray[np.uint8], size: int) -> NDArray[np.float32]:
    """Images whose longer side is `size` pixels, or as they are if that is less."""
    height, width = shrunk_shape(images.shape[1:], size)
    small = [cv2.resize(i, (width, height), interpolation=cv2.INTER_AREA) for i in images]
    return np.stack(small).astype(np.float32)


def image_shifts(before: NDArray[np.float32], after: NDArray[np.float32]) -> Array:
    """By how much images are shifted against others, (n, 2), [px].

    Notes
    -----
    The peak of the correlation of windowed images, whitened by half: whole whitening, as in phase
    correlation, brings out the noise of smooth images.

    Examples
    --------
    >>> image = np.random.default_rng(0).normal(size=(1, 32, 32)).astype(np.float32)
    >>> image_shifts(image[:, 4:28, 4:28], image[:, 3:27, 6:30]).round().tolist()
    [[-2.0, 1.0]]
    """
    if len(before) > _PAIRS:
        parts = [slice(start, start + _PAIRS) for start in range(0, len(before), _PAIRS)]
        return np.concatenate([image_shifts(before[part], after[part]) for part in parts])
    n, height, width = before.shape
    window = np.outer(np.hanning(height), np.hanning(width)).astype(np.float32)
    first, second = (
        np.fft.rfft2((part - part.mean(axis=(1, 2), keepdims=True)) * window)
        for part in (before, after)
    )
    cross = second * first.conj()
    cross /= np.sqrt(np.abs(cross)) + 1e-6
    squared = np.fft.fftfreq(height)[:, None] ** 2 + np.fft.rfftfreq(width) ** 2
    correlation = np.fft.irfft2(cross * np.exp(-squared / (2 * _LOW_PASS**2)), (height, width))
    y, x = np.divmod(correlation.reshape(n, -1).argmax(axis=1), width)
    every = np.arange(n)
    shift_x = x + parabola_vertex(*(correlation[every, y, (x + k) % width] for k in (-1, 0, 1)))
    shift_y = y + parabola_vertex(*(correlation[every, (y + k) % height, x] for k in (-1, 0, 1)))
    shift_x[shift_x > width / 2] -= width
    shift_y[shift_y > height / 2] -= height
    return np.column_stack([shift_x, shift_y])


def camera_motions(T_world_cam: Array, first: Indices, second: Indices) -> Array:
    """Motions between poses in the first one's camera frame: translation, rotation vector, (n, 6).

    [m] and [rad].
    """
    D = inverse_transform(T_world_cam[first]) @ T_world_cam[second]
    return np.hstack([D[:, :3, 3], Rotation.from_matrix(D[:, :3, :3]).as_rotvec()])


def nearest_pairs(p: Array, n_pairs: int) -> tuple[Indices, Indices]:
    """Pairs of rows that are nearest to each other."""
    k = min(3, len(p) - 1)
    distances, neighbours = KDTree(p).query(p, k=k + 1)
    order = np.argsort(distances[:, 1:].ravel(), kind="stable")[:n_pairs]
    return np.repeat(np.arange(len(p)), k)[order], neighbours[:, 1:].ravel()[order]


def explained_by_any(motions: Array, shifts: Array) -> float:
    """Share of the squared shifts that is linear in the motions, whatever the camera's mount."""
    coefficients = np.linalg.lstsq(motions, shifts, rcond=None)[0]
    left = np.square(shifts - motions @ coefficients).sum()
    return float(1 - left / max(np.square(shifts).sum(), 1e-12))


def explained_by_camera(motions: Array, shifts: Array) -> float:
    """Share of the squared shifts that a camera with these motions must see.

    A camera that turns by (rx, ry) and moves by (tx, ty) sees a scene at a distance Z shift by
    ``f (-ry - tx / Z, rx - ty / Z)``. f and Z are fitted and not negative; a fifth of the values
    may be anything.
    """
    tx, ty, _, rx, ry, _ = motions.T
    A = np.concatenate([np.column_stack([-ry, -tx]), np.column_stack([rx, -ty])])
    y = shifts.T.ravel()
    kept = np.ones(len(y), dtype=bool)
    for _ in range(3):
        residuals = np.abs(y - A @ nnls(A[kept], y[kept])[0])
        kept = residuals <= np.quantile(residuals, _KEPT)
    return float(1 - np.square(residuals[kept]).sum() / max(np.square(y[kept]).sum(), 1e-12))


def parabola_vertex(before: Array, at: Array, after: Array) -> Array:
    """Where the parabola through three values at -1, 0 and 1 is highest."""
    curvature = before - 2 * at + after
    flat = np.abs(curvature) < 1e-12
    return np.where(flat, 0.0, 0.5 * (before - after) / np.where(flat, 1.0, curvature))
