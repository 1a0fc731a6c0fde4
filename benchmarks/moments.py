"""Raw moments to order 3 of three intensity slices."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from skimage.measure import moments as skimage_moments

from benchmarks.scenery import displaced_images
from benchmarks.timing import Contender, Table, race
from servoscope.features.moments import ORDERS, PAPER_SLICES, compute_raw_moments


def tables(quick: bool) -> Iterator[Table]:
    """One table."""
    n_images, size = (200, 128) if quick else (1000, 256)
    images, _ = displaced_images(n_images, size)
    _check_agreement(images[0])
    yield Table(
        "Moments",
        f"10 moments of {len(PAPER_SLICES)} slices of {n_images} images of {size} x {size}",
        race(_contenders(images), repeats=3 if quick else 7),
    )


def _contenders(images: np.ndarray) -> list[Contender]:
    n_part = 40
    return [
        Contender("servoscope", lambda: compute_raw_moments(images, PAPER_SLICES)),
        Contender(
            "cv2.LUT + cv2.moments",
            lambda: [_by_opencv(image) for image in images],
            remark="equal to the last digit",
        ),
        Contender(
            "skimage.measure.moments",
            lambda: [_by_skimage(image) for image in images[:n_part]],
            len(images) / n_part,
        ),
    ]


def _by_opencv(image: np.ndarray) -> list[dict[str, float]]:
    return [cv2.moments(cv2.LUT(image, table)) for table in _SLICE_TABLES]


def _by_skimage(image: np.ndarray) -> list[np.ndarray]:
    return [skimage_moments(table[image], order=3) for table in _SLICE_TABLES]


_GREYS = np.arange(256)
_SLICE_TABLES = [
    np.where((lower <= _GREYS) & (upper > _GREYS), _GREYS, 0).astype(np.uint8)
    for lower, upper in PAPER_SLICES
]


def _check_agreement(image: np.ndarray) -> None:
    ours = compute_raw_moments(image[None], PAPER_SLICES)[0]
    opencv = [[m[f"m{i}{j}"] for i, j in ORDERS] for m in _by_opencv(image)]
    # scikit-image counts rows first.
    skimage = [[M[j, i] for i, j in ORDERS] for M in _by_skimage(image)]
    np.testing.assert_array_equal(opencv, ours)
    np.testing.assert_allclose(skimage, ours, rtol=1e-9)
