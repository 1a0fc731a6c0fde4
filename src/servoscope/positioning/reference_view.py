"""The reference image, and how an image compares with it cell by cell."""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.data.image_motion import shrink
from servoscope.errors import InvalidInputError

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

SIZE = 128
"""Pixels along the longer side of the images that are compared."""

N_CELLS = 8
"""Cells along each side."""

MATCH = 0.7
"""Normalised correlation of a cell that shows what the reference shows there."""

THUMBNAIL_SIZE = 64
"""Pixels along the longer side of a thumbnail."""

_BLUR, _LEAST_CONTRAST = 2.0, 1.0
_LEAST_CELL = 3
_SIGMA = 0.8
_SMOOTH = 2.0
_MOSTLY = 0.5
TEXTURED = 0.25
LEAST_UNCLIPPED = 0.5


class Comparison(NamedTuple):
    """How an image compares with the reference.

    Parameters
    ----------
    usable : float
        Share of the pixels that are clipped neither here nor in the reference, of those that are
        not clipped there.
    matched : float
        Share of the textured cells that show what the reference shows there: normalised
        correlation of at least `MATCH`, whatever the gain and the offset of each cell.
    shift : float
        Median displacement of the matched cells, as a share of the longer side of the image;
        infinite if there are none.
    significance : float
        How much of the difference from the reference a displacement of the whole view explains,
        relative to what it would explain of noise alone: about 1 at the reference, more
        elsewhere; infinite where the view does not match by more than half.
    difference : float
        Root mean square of the difference in grey levels, as they are, as a share of the
        reference's contrast.
    structure : float
        How much of the difference of the matched cells, but for gain and offset, is smooth,
        relative to what would be of noise: about 1 at the reference, more elsewhere and in another
        light.
    """

    usable: float
    matched: float
    shift: float
    significance: float
    difference: float
    structure: float


class ReferenceView:
    """The view to bring the camera back to.

    Parameters
    ----------
    image : ndarray of shape (height, width), uint8

    Raises
    ------
    InvalidInputError
        If there is nothing to be seen in it.

    Notes
    -----
    Displacements are one step of Lucas and Kanade (1981), "An iterative image registration
    technique", on grey levels normalised in each cell: of each cell by itself, and of the whole
    view by the eight parameters that a plane's image moves by. They say how far an image is from
    the reference without any model: at the reference they vanish.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> image = cv2.GaussianBlur(rng.integers(0, 256, (64, 64), dtype=np.uint8), (0, 0), 2)
    >>> view = ReferenceView(image)
    >>> view.compare(image)
    Comparison(usable=1.0, matched=1.0, shift=0.0, significance=0.0, difference=0.0, structure=0.0)
    >>> view.compare(np.roll(image, 1, axis=1)).significance > 10
    True
    """

    def __init__(self, image: NDArray[np.uint8]) -> None:
        self.image = image
        self._thumbnail = reference_thumbnail(image)
        self._unclipped = _unclipped(image)
        self._seen = _prepared(image)
        self._slopes = _slopes(self._seen)
        self._flows = _flows(*self._slopes)
        self._grid = CellGrid(self._seen.shape)

    def error(self, image: NDArray[np.uint8]) -> float:
        """One minus the normalised correlation of the whole images, small and blurred."""
        return image_error(thumbnail(image), self._thumbnail)

    def usable(self, image: NDArray[np.uint8]) -> float:
        """Share of the pixels that are clipped neither here nor in the reference."""
        unclipped = self._unclipped
        share = np.mean(_unclipped(image)[unclipped]) if unclipped.any() else 0.0
        return float(share)

    def shift(self, image: NDArray[np.uint8]) -> float:
        """`Comparison.shift` of an image of the same shape, in a third of the time."""
        return self._shift(*self._matched(image))

    def compare(self, image: NDArray[np.uint8]) -> Comparison:
        """How an image of the same shape compares."""
        usable = self.usable(image)
        seen, weights, cells = self._matched(image)
        matched = cells.matched
        share = float(matched.sum() / max(cells.textured.sum(), 1))
        difference = float(np.sqrt(np.mean((seen - self._seen) ** 2)) / self._seen.std())
        if not matched.any():
            return Comparison(usable, share, np.inf, np.inf, difference, np.inf)
        significance = np.inf
        where = weights * self._grid.spread(matched.astype(float))
        if share > _MOSTLY:
            significance = cells.significance(self._flows, where)
        structure = _structure(seen, self._seen, where)
        shift = self._shift(seen, weights, cells)
        return Comparison(usable, share, shift, significance, difference, structure)

    def _matched(self, image: NDArray[np.uint8]) -> tuple[Floats, Floats, _Matched]:
        """An image as it is compared, where it counts, and its cells."""
        both = (_unclipped(image) & self._unclipped).astype(np.uint8)
        weights = (shrink(both, SIZE) > 1 - 1e-3).astype(np.float32)
        seen = _prepared(image)
        return seen, weights, self._grid.match(seen, self._seen, weights)

    def _shift(self, seen: Floats, weights: Floats, cells: _Matched) -> float:
        if not cells.matched.any():
            return np.inf
        displaced = cells.displacements(self._slopes, weights)[cells.matched]
        return float(np.median(displaced)) / max(seen.shape)


def _structure(image: Floats, expected: Floats, where: Array) -> float:
    """Variance that smoothing leaves of a difference, relative to what it leaves of noise."""
    w = (where > 0).astype(np.float32)
    n = max(float(w.sum()), 1.0)
    a, b = (w * (x - float(np.vdot(w, x)) / n) for x in (image, expected))
    left = a - b * (float(np.vdot(a, b)) / max(float(np.vdot(b, b)), 1e-12))
    smooth = w * cv2.GaussianBlur(left, (0, 0), _SMOOTH)
    of_noise = _SIGMA**2 / (_SIGMA**2 + _SMOOTH**2)
    return float(np.vdot(smooth, smooth) / max(float(np.vdot(left, left)) * of_noise, 1e-9))


def similarity(image: Floats, expected: Floats, weights: Floats | None = None) -> float:
    """Median normalised correlation of the cells in which `expected` shows something.

    `weights` are 1 where `expected` is known, and 0 elsewhere.

    Examples
    --------
    >>> expected = np.random.default_rng(0).normal(size=(32, 32)).astype(np.float32)
    >>> round(similarity(3 * expected + 5, expected), 6), round(similarity(-expected, expected), 6)
    (1.0, -1.0)
    """
    weights = np.ones_like(image) if weights is None else weights
    cells = CellGrid(image.shape).match(image, expected, weights)
    found = cells.correlation[cells.textured]
    return float(np.median(found)) if found.size else 0.0


class CellGrid:
    """A grid of cells over images of one shape."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.rows, self.columns = (self._members(n) for n in shape)

    @staticmethod
    def _members(n: int) -> Array:
        """Which of n pixels along a side are in each cell, (n_cells, n), 1 or 0."""
        k = min(max(n // _LEAST_CELL, 1), N_CELLS)
        return np.repeat(np.eye(k), np.diff(np.arange(k + 1) * n // k), axis=1)

    def sum(self, values: NDArray[Any]) -> Array:
        """The sum over each cell, of one field or of several."""
        return np.asarray(self.rows @ values @ self.columns.T)

    def spread(self, values: Array) -> Array:
        """The value of its cell for every pixel."""
        return np.asarray(self.rows.T @ values @ self.columns)

    def match(self, image: Floats, expected: Floats, weights: Floats) -> _Matched:
        """Compare two images cell by cell, whatever the gain and the offset of each cell."""
        area, n = self.sum(np.ones_like(weights)), self.sum(weights)
        one = np.maximum(n, 1.0)
        a, b = (part - self.spread(self.sum(weights * part) / one) for part in (image, expected))
        aa, bb, ab = (self.sum(weights * x * y) for x, y in ((a, a), (b, b), (a, b)))
        contrast = np.sqrt(bb / one)
        enough = max(TEXTURED * _quantile(contrast, 0.9), 1e-6)
        textured = (contrast >= enough) & (n >= LEAST_UNCLIPPED * area)
        correlation = ab / np.sqrt(np.maximum(aa * bb, 1e-12))
        left = a * self.spread(np.sqrt(bb / np.maximum(aa, 1e-12))) - b
        return _Matched(self, correlation, textured, left)


def _quantile(values: Array, share: float) -> float:
    """As `numpy.quantile` has it, in a twentieth of the time."""
    ordered = np.sort(values, axis=None)
    low, rest = divmod(share * (len(ordered) - 1), 1)
    a, b = ordered[int(low)], ordered[min(int(low) + 1, len(ordered) - 1)]
    return float(a + rest * (b - a))


class _Matched(NamedTuple):
    """Cells of two images compared, each array of the shape of the grid.

    `left` is their difference after gain and offset, of the shape of the images.
    """

    grid: CellGrid
    correlation: Array
    textured: NDArray[np.bool_]
    left: Array

    @property
    def matched(self) -> NDArray[np.bool_]:
        """Cells that show what is expected, as far as anything is."""
        return self.textured & (self.correlation >= MATCH)

    def displacements(self, slopes: tuple[Floats, Floats], weights: Floats) -> Array:
        """How far each cell is displaced, [px], by the slopes of what is expected."""
        gx, gy = slopes
        pairs = ((gx, gx), (gx, gy), (gy, gy), (gx, self.left), (gy, self.left))
        xx, xy, yy, xe, ye = (self.grid.sum(weights * u * v) for u, v in pairs)
        ridge = 0.01 * (xx + yy) + 1e-9
        xx, yy = xx + ridge, yy + ridge
        return np.hypot(yy * xe - xy * ye, xx * ye - xy * xe) / (xx * yy - xy * xy)

    def significance(self, flows: Array, weights: Array) -> float:
        """How much one displacement of the whole view explains, relative to noise.

        `flows` are what `_flows` gives of the reference. The mean of each cell does not count.
        Noise that was smoothed by a Gaussian counts as one value in ``4 pi sigma^2``.
        """
        one = np.maximum(self.grid.sum(weights), 1.0).ravel()
        weighted = weights * flows
        sums = self.grid.sum(weighted).reshape(len(flows), -1)
        left, n = np.asarray(self.left, dtype=float), len(flows)
        A = weighted.reshape(n, -1) @ flows.reshape(n, -1).T - (sums / one) @ sums.T
        rest = self.grid.sum(weights * left).ravel()
        scores = weighted.reshape(n, -1) @ left.ravel() - (sums / one) @ rest
        explained = float(scores @ np.linalg.pinv(A, rcond=1e-9, hermitian=True) @ scores)
        total = float(np.vdot(weights * left, left))
        noise = max(total - explained, 1e-12) / max(float(weights.sum()), 1.0)
        return explained / (n * 4 * np.pi * _SIGMA**2 * noise)


def _flows(slope_x: Floats, slope_y: Floats) -> Array:
    """Changes of an image of these slopes by the eight parameters that a plane's image moves by."""
    gx, gy = slope_x.astype(float), slope_y.astype(float)
    height, width = gx.shape
    x, y = np.linspace(-1, 1, width)[None, :], np.linspace(-1, 1, height)[:, None]
    outward = gx * x + gy * y
    return np.stack([gx, gx * x, gx * y, gy, gy * x, gy * y, outward * x, outward * y])


def _slopes(image: Floats) -> tuple[Floats, Floats]:
    """Change of the grey level for each pixel to the right, and downwards."""
    gx, gy = (
        cv2.Sobel(image, cv2.CV_32F, *axis, ksize=3, scale=1 / 8) for axis in ((1, 0), (0, 1))
    )
    return np.asarray(gx, dtype=np.float32), np.asarray(gy, dtype=np.float32)


def _unclipped(image: NDArray[np.uint8]) -> NDArray[np.bool_]:
    return (image > 0) & (image < 255)


def _prepared(image: NDArray[np.uint8]) -> Floats:
    return np.asarray(cv2.GaussianBlur(shrink(image, SIZE), (0, 0), _SIGMA), dtype=np.float32)


def thumbnail(image: NDArray[np.uint8]) -> Floats:
    """The image small and blurred, in which neither noise nor fine texture counts.

    Its longer side is `THUMBNAIL_SIZE` pixels, or that of a smaller image.

    Examples
    --------
    >>> thumbnail(np.zeros((256, 128), np.uint8)).shape
    (64, 32)
    """
    small = cv2.GaussianBlur(shrink(image, THUMBNAIL_SIZE), (0, 0), _BLUR)
    return np.asarray(small, dtype=np.float32)


def image_error(small: Floats, small_reference: Floats) -> float:
    """One minus the zero-mean normalised cross-correlation of two thumbnails, 0 to 2.

    Neither gain nor offset of the image change it. A covered part of the view adds to it, but
    about as much at every pose, so that its rise and fall keep their meaning.

    Examples
    --------
    >>> small = np.arange(12, dtype=np.float32).reshape(3, 4)
    >>> round(image_error(0.5 * small + 7, small), 6), round(image_error(-small, small), 6)
    (0.0, 2.0)
    """
    a, b = (np.ravel(part - part.mean(dtype=float)) for part in (small, small_reference))
    length = float(np.linalg.norm(a) * np.linalg.norm(b))
    return 1.0 - float(a @ b) / length if length > 0 else 1.0


def reference_thumbnail(reference_image: NDArray[np.uint8]) -> Floats:
    """The thumbnail of a reference image.

    Raises
    ------
    InvalidInputError
        If there is nothing to be seen in it.
    """
    small = thumbnail(reference_image)
    if small.std() < _LEAST_CONTRAST:
        raise InvalidInputError(
            f"The reference image must show something, but its grey levels differ by only "
            f"{small.std():.2f}; train on images in which the part is seen."
        )
    return small
