"""What the images of a data set are like, before any feature is taken of them."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.data.image_motion import shrink
from servoscope.data.images import PoseImageSet
from servoscope.data.pixel_noise import estimate_pixel_noise

LONGER_SIDE = 128
"""The image is made this small first, [px]."""

ALIKE = 0.5
"""Correlation of the view with itself, shifted, from which it counts as repeating."""

_BACKGROUND = 12.0
_LOOKED_AT = 30
_LARGEST_SHARE = 0.45


@dataclass(frozen=True)
class Repetition:
    """The shift at which a view looks most like itself.

    Parameters
    ----------
    correlation : float
        Of the view with itself at that shift; 1 for a perfect repetition.
    shift : (float, float)
        Along x and y, [px] of the image that was given.
    """

    correlation: float
    shift: tuple[float, float]

    @property
    def repeats(self) -> bool:
        """Whether two views that far apart can be taken for each other."""
        return self.correlation >= ALIKE


@dataclass(frozen=True)
class ImageFacts:
    """What the images of a data set are like.

    Parameters
    ----------
    change : bool
        Whether any two of them differ.
    n_copies : int
        Images that are exact copies of an earlier one.
    noise : float
        Standard deviation of the noise of a pixel, [grey].
    repetition : Repetition
        Of the reference image.
    """

    change: bool
    n_copies: int
    noise: float
    repetition: Repetition


def describe_images(data: PoseImageSet) -> ImageFacts:
    """Look at the images of a data set; for the noise at up to 30 of them."""
    distinct = {hashlib.sha256(np.ascontiguousarray(image).data).digest() for image in data.images}
    some = data.images[:: -(-len(data) // _LOOKED_AT)]
    return ImageFacts(
        change=len(distinct) > 1,
        n_copies=len(data) - len(distinct),
        noise=float(np.median([estimate_pixel_noise(image) for image in some])),
        repetition=find_repetition(data.reference_image),
    )


def find_repetition(image: NDArray[np.uint8]) -> Repetition:
    """Whether a view repeats itself: the highest second peak of its autocorrelation.

    Parameters
    ----------
    image : ndarray of shape (height, width), uint8

    Notes
    -----
    The view is made small and its slow variation is taken away. The correlation at a shift is
    that of what the two views have in common, normalised by what each of them has there, so that
    a pattern that leaves the view at its edges still counts in full. A peak is where the
    correlation is higher than everywhere around it and has been under a third of it in between:
    the slope of the main peak is none, nor is one that goes on where the shifts end, at 45 % of
    each side.

    Examples
    --------
    >>> x = np.arange(128)
    >>> stripes = np.broadcast_to(128 + 100 * np.sin(2 * np.pi * x / 16), (128, 128))
    >>> found = find_repetition(stripes.astype(np.uint8))
    >>> found.repeats, abs(found.shift[0]) % 16
    (True, 0.0)
    """
    scale = LONGER_SIDE / max(image.shape)
    small = shrink(image, LONGER_SIDE).astype(np.float64)
    correlation = _autocorrelation(small - cv2.GaussianBlur(small, (0, 0), _BACKGROUND))
    at, height = _second_peak(correlation)
    back = (-1 if at[1] < 0 else 1) / min(scale, 1.0)  # a shift and its opposite are the same
    return Repetition(height, (float(at[1] * back), float(at[0] * back)))


def _autocorrelation(detail: NDArray[np.float64]) -> NDArray[np.float64]:
    """Correlation of the overlap at every shift up to a share of the sides, 0 in the middle."""
    rows, columns = detail.shape
    shape = 2 * rows, 2 * columns
    ones, spectrum = np.fft.rfft2(np.ones_like(detail), shape), np.fft.rfft2(detail, shape)
    energy = np.fft.rfft2(detail**2, shape)
    overlap = np.fft.irfft2(spectrum * spectrum.conj(), shape)
    first = np.fft.irfft2(energy * ones.conj(), shape)
    second = np.fft.irfft2(ones * energy.conj(), shape)
    floor = 1e-9 + 1e-3 * float(np.sum(detail**2))
    correlation = overlap / np.sqrt(np.maximum(first, floor) * np.maximum(second, floor))
    high, wide = int(_LARGEST_SHARE * rows), int(_LARGEST_SHARE * columns)
    centred = np.roll(correlation, (high, wide), axis=(0, 1))
    return np.asarray(centred[: 2 * high + 1, : 2 * wide + 1])


def _second_peak(correlation: NDArray[np.float64]) -> tuple[tuple[int, int], float]:
    """The highest local maximum outside the main peak, as a shift, and its height.

    The main peak is what hangs together with the centre above a third of the candidate's height.
    """
    centre = np.array(correlation.shape) // 2
    ring = cv2.dilate(correlation, np.ones((5, 5)))
    is_peak = (correlation == ring) & (correlation > 0)
    is_peak[[0, -1]] = is_peak[:, [0, -1]] = False  # what lies beyond may be higher
    peaks = np.argwhere(is_peak)
    heights = correlation[tuple(peaks.T)]
    for peak, height in sorted(zip(peaks.tolist(), heights.tolist(), strict=True), key=_height):
        if peak == centre.tolist():
            continue
        above = (correlation > height / 3).astype(np.uint8)
        _, labels = cv2.connectedComponents(above)
        if labels[tuple(peak)] != labels[tuple(centre)]:
            return (peak[0] - int(centre[0]), peak[1] - int(centre[1])), float(height)
    return (0, 0), 0.0


def _height(item: tuple[list[int], float]) -> float:
    return -item[1]
