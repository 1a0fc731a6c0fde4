"""Images at one resolution, and the points of the reference image that are followed in them."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]

_FAINT = 8.0
"""Deviation that is small beside noise and shades, [grey]."""


def prepare(image: NDArray[np.generic], width: int, sigma: float) -> Floats:
    """The image at a width, its height in proportion, blurred by `sigma` of the new pixels."""
    height = level_height(image.shape, width)
    grey: NDArray[Any] = np.asarray(image, dtype=np.float32)
    if image.shape[1] != width:
        grey = cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA)
    if sigma > 0:
        grey = cv2.GaussianBlur(grey, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
    return np.ascontiguousarray(grey)


def evened(grey: Floats, share: float = 0.1) -> Floats:
    """What is finer than a share of the width, in units of its deviation nearby.

    It is free of light that varies slowly, and bounded, so that what covers a part of the view
    changes no more than that part. As large as grey levels: two deviations are 60.
    """
    sigma = share * grey.shape[1]
    fine = grey - cv2.GaussianBlur(grey, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
    square = cv2.GaussianBlur(fine * fine, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
    ratio = fine / (np.sqrt(square) + np.float32(_FAINT))
    return np.asarray(30 * ratio.clip(-2, 2), dtype=np.float32)


def level_height(shape: tuple[int, ...], width: int) -> int:
    """Height of an image of `shape` (height, width) when it is made `width` wide, [px]."""
    return max(2, round(width * shape[0] / shape[1]))


@dataclass(frozen=True, eq=False)
class View:
    """The reference image at one resolution.

    Parameters
    ----------
    grey : ndarray of shape (height, width), float32
    aspect : float
        Height over width of the full image.
    sigma : float
        Blur that other images are to be prepared with, [px].
    """

    grey: Floats
    aspect: float
    sigma: float
    width: int = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "width", self.grey.shape[1])

    @classmethod
    def of(cls, image: NDArray[np.generic], width: int, sigma: float) -> View:
        """The view of a full image."""
        return cls(prepare(image, width, sigma), image.shape[0] / image.shape[1], sigma)

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width, [px]."""
        return self.grey.shape[0], self.grey.shape[1]

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """Where the pixels are, [image widths] from the middle, shape (n, 2)."""
        height, width = self.shape
        x = (np.arange(width) + 0.5) / width - 0.5
        y = ((np.arange(height) + 0.5) / height - 0.5) * self.aspect
        return np.stack(np.broadcast_arrays(x, y[:, None]), axis=-1).reshape(-1, 2)

    @cached_property
    def slopes(self) -> Floats:
        """To the right and down, [grey / image width], shape (n, 2)."""
        down, right = np.gradient(self.grey)
        height, width = self.shape
        slopes = right * width, down * height / self.aspect
        return np.stack(slopes, axis=-1).reshape(-1, 2).astype(np.float32)

    @cached_property
    def laplacian(self) -> Floats:
        """[grey], shape (n,)."""
        bent = cv2.Laplacian(self.grey, cv2.CV_32F, borderType=cv2.BORDER_REPLICATE)
        return np.asarray(bent.ravel(), dtype=np.float32)

    def prepare(self, image: NDArray[np.generic]) -> Floats:
        """Another image at this resolution."""
        return prepare(image, self.width, self.sigma)

    def resize(self, field: NDArray[Any]) -> Floats:
        """A field over the reference image, brought to this resolution, shape (height, width)."""
        field = np.asarray(field, dtype=np.float32)
        if field.shape == self.shape:
            return field
        how = cv2.INTER_AREA if field.shape[1] > self.width else cv2.INTER_LINEAR
        resized = cv2.resize(field, self.shape[::-1], interpolation=how)
        return np.asarray(resized, dtype=np.float32)
