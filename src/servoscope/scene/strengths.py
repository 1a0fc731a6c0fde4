"""What the strength of a disturbance means: one thing for every image size and every use.

A blur is given in pixels of an image `REFERENCE_WIDTH` wide, and is on top of what there is: the
same share of the view in images of every size. A gain is a factor of all that is there. Noise is
the standard deviation of what is added to each pixel by itself, in grey levels of the image, on
top of what there is; whatever the size, so that making an image smaller lowers it.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.scene.sensor import Sensor

REFERENCE_WIDTH = 256
"""Width of the images that pixels are given for, [px]."""


def as_widths(px: float) -> float:
    """A length in pixels of an image `REFERENCE_WIDTH` wide, [image widths].

    Examples
    --------
    >>> as_widths(2.0) * 128
    1.0
    """
    return px / REFERENCE_WIDTH


def defocused(sensor: Sensor, px: float) -> Sensor:
    """The sensor behind a lens that blurs by a standard deviation more, [px of 256]."""
    return replace(sensor, blur=float(np.hypot(sensor.blur, as_widths(px))))


def amplified(sensor: Sensor, gain: float) -> Sensor:
    """The sensor with so many times its gain; its noise is amplified as well."""
    return replace(sensor, gain=gain * sensor.gain)


def noisier(sensor: Sensor, grey: float) -> Sensor:
    """The sensor with noise of a standard deviation on top of its own, [grey]."""
    electrons = grey / (255 * sensor.gain) * sensor.full_well
    return replace(sensor, read_noise=float(np.hypot(sensor.read_noise, electrons)))


def blur_image(grey: NDArray[np.float32], px: float) -> None:
    """Blur an image in place by a standard deviation, [px of 256]."""
    sigma = as_widths(px) * grey.shape[1]
    cv2.GaussianBlur(grey, (0, 0), sigma, dst=grey, borderType=cv2.BORDER_REPLICATE)


def added_noise(
    shape: tuple[int, ...], grey: float, rng: np.random.Generator
) -> NDArray[np.float32]:
    """White noise of a standard deviation, to be added to an image, [grey]."""
    return np.float32(grey) * rng.standard_normal(shape, np.float32)
