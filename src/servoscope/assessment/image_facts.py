"""What the images of a data set are like, before any feature is taken of them."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from servoscope.assessment.repetition import Repetition, find_repetition
from servoscope.data.images import PoseImageSet
from servoscope.data.pixel_noise import estimate_pixel_noise

_LOOKED_AT = 30


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
