"""Geometric moment descriptors of intensity slices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.compiled import compiled
from servoscope.errors import InvalidInputError
from servoscope.features.image_transformer import ImageShape, ImageTransformer

ORDERS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3))
"""The orders (i, j) of x and y, of every moment to order 3."""

_CHUNK = 128
_U = np.arange(_CHUNK, dtype=np.int16) - np.int16(_CHUNK // 2)
_U_SQUARED = _U**2


def compute_raw_moments(
    images: NDArray[np.uint8], slices: Sequence[tuple[int, int]]
) -> NDArray[np.int64]:
    """Raw moments to order 3 of every intensity slice of every image, exactly:

    (n_images, n_slices, 10), int64. They are ``m_ij`` in `ORDERS`, [grey px^(i + j)], of uint8
    images; a pixel is in a slice if ``lower <= grey < upper``. An image so large that a moment
    might not fit in 64 bits is refused.

    Notes
    -----
    Eq. 1 of the paper, ``m_ij = sum x^i y^j f(x, y)`` with x the column, y the row and f the grey
    level inside the slice, 0 outside.

    Examples
    --------
    >>> images = np.zeros((1, 4, 6), np.uint8)
    >>> images[0, 2, 5] = 10
    >>> compute_raw_moments(images, [(0, 50)])[0, 0]
    array([  10,   50,   20,  250,  100,   40, 1250,  500,  200,   80])
    """
    _check_size(*images.shape[1:])
    bounds = np.array(slices, dtype=np.int16).reshape(-1, 2)
    moments = np.empty((len(images), len(bounds), len(ORDERS)), dtype=np.int64)
    _sum_moments(np.ascontiguousarray(images), bounds, moments)
    return moments


def largest_raw_moment(height: int, width: int) -> int:
    """The largest raw moment to order 3 that an 8-bit image of this size can have.

    Examples
    --------
    >>> largest_raw_moment(2048, 2048) < 2**63
    True
    """
    sums = [[sum(k**order for k in range(side)) for order in range(4)] for side in (width, height)]
    return max(255 * sums[0][i] * sums[1][j] for i, j in ORDERS)


def _check_size(height: int, width: int) -> None:
    if max(height, width) > 2048 and largest_raw_moment(height, width) >= 2**63:
        raise InvalidInputError(
            f"Moments of images of {height} x {width} (height x width) might not fit in 64 bits; "
            "resize them to at most 2048 pixels a side, or say the image_shape of flat ones."
        )


@compiled()
def _sum_moments(
    images: NDArray[Any], bounds: NDArray[Any], moments: NDArray[Any]
) -> None:  # pragma: no cover
    n_images, height, _ = images.shape
    for n in range(n_images):
        moments[n] = 0
        for y in range(height):
            for s in range(bounds.shape[0]):
                m0, m1, m2, m3 = _row_moments(images[n, y], bounds[s, 0], bounds[s, 1])
                m = moments[n, s]
                m[0] += m0
                m[1] += m1
                m[2] += y * m0
                m[3] += m2
                m[4] += y * m1
                m[5] += y * y * m0
                m[6] += m3
                m[7] += y * m2
                m[8] += y * y * m1
                m[9] += y * y * y * m0


@compiled()
def _row_moments(row: NDArray[Any], lower: Any, upper: Any) -> Any:  # pragma: no cover
    m0 = m1 = m2 = m3 = np.int64(0)
    for start in range(0, len(row), _CHUNK):
        # A whole chunk has a length that the compiler knows, and unrolls.
        if start + _CHUNK <= len(row):
            c0, c1, c2, c3 = _chunk_moments(row, start, _CHUNK, lower, upper)
        else:
            c0, c1, c2, c3 = _chunk_moments(row, start, len(row) - start, lower, upper)
        x = np.int64(start + _CHUNK // 2)
        m0 += c0
        m1 += c1 + x * c0
        m2 += c2 + x * (2 * c1 + x * c0)
        m3 += c3 + x * (3 * c2 + x * (3 * c1 + x * c0))
    return m0, m1, m2, m3


@compiled()
def _chunk_moments(
    row: NDArray[Any], start: int, length: int, lower: Any, upper: Any
) -> Any:  # pragma: no cover
    # About the middle of 128 pixels, u f and u^2 fit in 16 bits, and the sum of u^3 f, at most
    # 255 (64 * 65 / 2)^2, in 32: the processor multiplies and adds 32 pixels at a time.
    c0 = c1 = c2 = c3 = np.int32(0)
    for k in range(length):
        grey = np.int16(row[np.uint64(start) + np.uint64(k)])
        f = grey if lower <= grey < upper else np.int16(0)
        uf = np.int16(_U[k] * f)
        c0 = np.int32(c0 + f)
        c1 = np.int32(c1 + uf)
        c2 = np.int32(c2 + np.int32(np.int32(_U_SQUARED[k]) * np.int32(f)))
        c3 = np.int32(c3 + np.int32(np.int32(_U_SQUARED[k]) * np.int32(uf)))
    return np.int64(c0), np.int64(c1), np.int64(c2), np.int64(c3)


DESCRIPTORS = ("x", "y", "theta", "r1", "r2", "m00", "sx", "sy")
"""The descriptors of one slice, in the order of the features."""

PAPER_SLICES = ((0, 50), (50, 100), (100, 150))
"""The intensity slices of the paper."""

Array = NDArray[np.float64]


class GeometricMoments(ImageTransformer):
    """Centroid, orientation, radii, mass and skewness of each intensity slice of an image.

    Parameters
    ----------
    slices : sequence of (lower, upper)
        A pixel is in the slice if ``lower <= grey < upper``, so a grey level that ends one slice
        and begins the next is counted once. An upper bound names the slice's features and must
        stand only once; 256 takes in white.
    image_shape : (height, width), optional
        What flat images are; 1 x n_pixels by default.

    Raises
    ------
    InvalidInputError
        If a slice is empty or out of range.

    Notes
    -----
    Eq. 1-7 of the paper, with x the column and y the row, [px], and f the grey level inside the
    slice and 0 outside. Black pixels, of grey level 0, therefore weigh nothing in the slice 0-50.
    Images that are not uint8 are rounded and clipped to 0..255; grey levels on another scale,
    0 to 1 or 0 to 65535, must be brought to this one first.

    - ``x``, ``y`` (eq. 2): centroid. The middle of the image for an empty slice.
    - ``theta`` (eq. 6): angle of the major axis from x towards y, in (-pi/2, pi/2], by the
      two-argument arctangent; the one-argument form as printed gives the axis nearest to x. It
      jumps by pi where the axis crosses the vertical. 0 if no axis is the longer one.
    - ``r1``, ``r2`` (eq. 3 and 5): radii of inertia along the major and the minor axis. The sign
      of the off-diagonal in eq. 3 has no bearing on them.
    - ``m00`` (eq. 1): sum of the grey levels.
    - ``sx``, ``sy`` (eq. 7): skewness along x and y, as printed; that is, without the factor
      ``sqrt(m00)`` that would make it independent of the mass. 0 for a slice with no extent in
      that direction.

    All of them except the centroid are 0 for an empty slice, and all except the centroid and the
    mass for a single pixel. Nothing is ever NaN.

    Examples
    --------
    >>> images = np.full((1, 20, 20), 255, np.uint8)
    >>> images[0, 5:10, 2:14] = 30
    >>> moments = GeometricMoments().set_output(transform="pandas")
    >>> moments.fit_transform(images)[["x_50", "y_50", "m00_50"]].to_numpy()
    array([[   7.5,    7. , 1800. ]])
    """

    _levels_matter = True

    def __init__(
        self,
        slices: Sequence[tuple[int, int]] = PAPER_SLICES,
        image_shape: ImageShape | None = None,
    ) -> None:
        self.slices = slices
        self.image_shape = image_shape

    def _check_parameters(self) -> None:
        _check_slices(self.slices)

    def _learn(self, flat: NDArray[Any], targets: Any) -> None:
        """Nothing is learned."""

    def _features(self, flat: NDArray[Any]) -> Array:
        images = _grey_levels(flat).reshape(-1, *self.image_shape_)
        raw = compute_raw_moments(images, self.slices)
        return compute_descriptors(raw, self.image_shape_).reshape(len(images), -1)

    def _feature_names(self) -> list[str]:
        return [f"{name}_{upper}" for _, upper in self.slices for name in DESCRIPTORS]


def compute_descriptors(raw: NDArray[np.int64], image_shape: ImageShape) -> Array:
    """The descriptors (..., 8) of eq. 2-7 from raw moments (..., 10); see `GeometricMoments`."""
    height, width = image_shape
    m00, m10, m01, m20, m11, m02, m30, _, _, m03 = np.moveaxis(raw, -1, 0)
    empty, mass = m00 == 0, np.maximum(m00, 1)
    # Exact moments about the pixel nearest to the centroid leave nothing to cancel in floats.
    x0, y0 = (2 * m10 + mass) // (2 * mass), (2 * m01 + mass) // (2 * mass)
    x1, x2, x3 = _shifted(m00, m10, m20, m30, x0)
    y1, y2, y3 = _shifted(m00, m01, m02, m03, y0)
    x1y1 = m11 - x0 * m01 - y0 * m10 + x0 * y0 * m00
    mu20, mu11, mu02 = x2 - x1 * x1 / mass, x1y1 - x1 * y1 / mass, y2 - y1 * y1 / mass
    dx, dy = x1 / mass, y1 / mass
    theta = 0.5 * np.arctan2(2 * mu11, mu20 - mu02)
    middle, spread = (mu20 + mu02) / 2, np.hypot((mu20 - mu02) / 2, mu11)
    return np.stack(
        [
            np.where(empty, (width - 1) / 2, x0 + dx),
            np.where(empty, (height - 1) / 2, y0 + dy),
            theta,
            np.sqrt((middle + spread) / mass),
            np.sqrt(np.maximum(middle - spread, 0) / mass),
            m00.astype(np.float64),
            _skewness(x3 - 3 * dx * x2 + 2 * dx**2 * x1, mu20),
            _skewness(y3 - 3 * dy * y2 + 2 * dy**2 * y1, mu02),
        ],
        axis=-1,
    )


def _shifted(
    m0: NDArray[np.int64], m1: NDArray[Any], m2: NDArray[Any], m3: NDArray[Any], a: NDArray[Any]
) -> tuple[NDArray[np.int64], ...]:
    """Moments of orders 1 to 3 along one axis, about the integer `a` instead of 0.

    Intermediate sums may wrap around in 64 bits; the results fit, so they are exact.
    """
    s1 = m1 - a * m0
    s2 = m2 - a * (m1 + s1)
    s3 = m3 - a * (m2 + s2 + (m2 - a * m1))
    return s1, s2, s3


def _skewness(third: Array, second: Array) -> Array:
    flat = second <= 0
    return np.where(flat, 0.0, third / np.where(flat, 1.0, second) ** 1.5)


def _grey_levels(pixels: NDArray[Any]) -> NDArray[np.uint8]:
    if pixels.dtype == np.uint8:
        return pixels
    return np.rint(np.clip(pixels, 0, 255)).astype(np.uint8)


def _check_slices(slices: Any) -> None:
    try:
        bounds = [(int(lower), int(upper)) for lower, upper in slices]
    except (TypeError, ValueError):
        bounds = []
    if not bounds or not all(0 <= lower < upper <= 256 for lower, upper in bounds):
        raise InvalidInputError(
            "slices must be pairs (lower, upper) of grey levels, 0 <= lower < upper <= 256, "
            f"got {slices!r}."
        )
    if len({upper for _, upper in bounds}) < len(bounds):
        raise InvalidInputError(
            f"Every slice must have an upper bound of its own, which names it, got {slices!r}."
        )
