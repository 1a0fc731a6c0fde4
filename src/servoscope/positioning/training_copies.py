"""Training images and disturbed copies of them, prepared for features in several processes."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from servoscope.positioning.linear_features import prepare_images
from servoscope.processes import in_processes
from servoscope.scene.disturbances import Disturbances

_BLOCK = 50


def prepare_copies(
    images: NDArray[np.uint8],
    copies: Sequence[Disturbances | None],
    preparations: Sequence[str],
    *,
    seed: int = 0,
    n_jobs: int | None = -1,
    on_progress: Callable[[int], object] | None = None,
) -> dict[str, NDArray[np.float32]]:
    """What preparations make of copies of images.

    Parameters
    ----------
    images : ndarray of shape (n, height, width), uint8
    copies : sequence of Disturbances or None
        How each copy of an image is disturbed; None is the image itself.
    preparations : sequence of str
        Names in `PREPARATIONS`.
    seed : int
        Each copy of each image is drawn by itself, so that the result does not depend on the
        number of processes.
    n_jobs : int, optional
        Processes, as joblib counts them.
    on_progress : callable, optional
        Called with the number of images finished.

    Returns
    -------
    dict of ndarray of shape (n, n_copies, n_values), float32
        One for each preparation.

    Examples
    --------
    >>> images = np.zeros((3, 8, 8), np.uint8)
    >>> prepare_copies(images, [None, Disturbances()], ["grey"], n_jobs=1)["grey"].shape
    (3, 2, 64)
    """
    starts = range(0, len(images), _BLOCK)
    calls = (
        (images[start : start + _BLOCK], start, tuple(copies), tuple(preparations), seed)
        for start in starts
    )
    blocks: list[dict[str, NDArray[np.float32]]] = []
    for start, block in zip(starts, in_processes(_prepare_block, calls, n_jobs), strict=True):
        blocks.append(block)
        if on_progress is not None:
            on_progress(min(start + _BLOCK, len(images)))
    return {name: np.concatenate([block[name] for block in blocks]) for name in preparations}


def _prepare_block(
    images: NDArray[np.uint8],
    first: int,
    copies: Sequence[Disturbances | None],
    preparations: Sequence[str],
    seed: int,
) -> dict[str, NDArray[np.float32]]:
    disturbed = np.stack(
        [
            image if copy is None else copy.disturb(image, np.random.default_rng([seed, n, k]))
            for n, image in enumerate(images, start=first)
            for k, copy in enumerate(copies)
        ]
    )
    shape = len(images), len(copies), -1
    return {name: prepare_images(disturbed, name).reshape(shape) for name in preparations}
