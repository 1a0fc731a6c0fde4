"""What makes an image differ from those of training without the camera having moved."""

from __future__ import annotations

from dataclasses import dataclass, fields

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError
from servoscope.scene.strengths import added_noise, blur_image

_LIGHT_KNOTS = 3
_ASPECTS = (0.4, 2.5)


Strength = tuple[float, float, float]
"""How strong a disturbance is, evenly drawn between two bounds, and how probable it is."""


@dataclass(frozen=True)
class Disturbances:
    """Random changes of an image that have nothing to do with where the camera is.

    They are made in the order of light: defocus, the light and its gain and offset, what covers
    the view, noise. Any of them may be None, which is never made. What a strength means stands in
    `servoscope.scene.strengths`.

    Parameters
    ----------
    defocus : Strength, optional
        Standard deviation of a Gaussian blur, [px] in images 256 pixels wide; in proportion to
        the width in others.
    light : Strength, optional
        Standard deviation of the logarithm of a smooth field that the image is multiplied with.
    gain : Strength, optional
        Factor of all grey levels.
    offset : Strength, optional
        Added to all grey levels.
    covering : Strength, optional
        Share of the view behind a rectangle of one grey.
    noise : Strength, optional
        Standard deviation of what is added to each pixel by itself, [grey].

    Raises
    ------
    InvalidInputError
        If a strength or a probability is out of its range.

    Examples
    --------
    >>> image = np.full((64, 64), 100, np.uint8)
    >>> Disturbances.only(gain=0.8, offset=5).disturb(image, np.random.default_rng(0))[0, 0]
    np.uint8(85)
    >>> bool(Disturbances().disturb(image, np.random.default_rng(0)).std() > 1)
    True
    """

    defocus: Strength | None = (0.3, 2.5, 0.5)
    light: Strength | None = (0.0, 0.3, 0.9)
    gain: Strength | None = (0.6, 1.3, 0.9)
    offset: Strength | None = (-10.0, 10.0, 0.9)
    covering: Strength | None = (0.0, 0.25, 0.7)
    noise: Strength | None = (0.0, 14.0, 0.5)

    def __post_init__(self) -> None:
        for field in fields(self):
            strength = getattr(self, field.name)
            if strength is not None:
                _check(field.name, *strength)

    @classmethod
    def only(cls, **strengths: float) -> Disturbances:
        """Those that are named, always there and of the strength that is told."""
        absent: dict[str, Strength | None] = dict.fromkeys(field.name for field in fields(cls))
        unknown = set(strengths) - set(absent)
        if unknown:
            raise InvalidInputError(
                f"Disturbances are {', '.join(absent)}, got {', '.join(sorted(unknown))}."
            )
        return cls(**absent | {name: (at, at, 1.0) for name, at in strengths.items()})

    def disturb(self, image: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
        """The image with disturbances drawn from `rng`.

        Parameters
        ----------
        image : ndarray of shape (height, width), uint8
        rng : Generator
            The same state gives the same image.

        Returns
        -------
        ndarray of shape (height, width), uint8
        """
        grey = image.astype(np.float32)
        strength = {field.name: _draw(getattr(self, field.name), rng) for field in fields(self)}
        if strength["defocus"]:
            blur_image(grey, strength["defocus"])
        if strength["light"]:
            grey *= _light_field(grey.shape, strength["light"], rng)
        if strength["gain"] is not None:
            grey *= np.float32(strength["gain"])
        if strength["offset"] is not None:
            grey += np.float32(strength["offset"])
        if strength["covering"]:
            _cover(grey, strength["covering"], rng)
        if strength["noise"]:
            grey += added_noise(grey.shape, strength["noise"], rng)
        return np.rint(grey.clip(0, 255)).astype(np.uint8)


def _check(name: str, low: float, high: float, probability: float) -> None:
    least = -255.0 if name == "offset" else 0.0
    most = {"covering": 1.0, "light": 2.0, "gain": 100.0}.get(name, 255.0)
    if not least <= low <= high <= most or not 0 <= probability <= 1:
        raise InvalidInputError(
            f"The strength of {name} must be from {least:g} to {most:g}, the lower bound first, "
            f"and its probability from 0 to 1, got {(low, high, probability)}."
        )


def _draw(strength: Strength | None, rng: np.random.Generator) -> float | None:
    """A strength between the bounds, or None where the disturbance is not there."""
    if strength is None or rng.random() >= strength[2]:
        return None
    return float(rng.uniform(*strength[:2]))


def _light_field(
    shape: tuple[int, ...], deviation: float, rng: np.random.Generator
) -> NDArray[np.float32]:
    knots = rng.standard_normal((_LIGHT_KNOTS, _LIGHT_KNOTS), np.float32) * np.float32(deviation)
    field = cv2.resize(knots, shape[::-1], interpolation=cv2.INTER_CUBIC)
    return np.asarray(cv2.exp(field), dtype=np.float32)


def _cover(grey: NDArray[np.float32], share: float, rng: np.random.Generator) -> None:
    """Draw a rectangle of one grey; its height is rounded so that its area is that share."""
    rows, columns = grey.shape
    aspect = np.exp(rng.uniform(*np.log(_ASPECTS)))
    width = round(columns * float(np.clip(np.sqrt(share * aspect), share, 1)))
    height = min(rows, round(share * grey.size / max(width, 1)))
    u, v = rng.random(2)
    left, top = int(u * (columns - width + 1)), int(v * (rows - height + 1))
    grey[top : top + height, left : left + width] = rng.uniform(0, 255)


SINGLE_DISTURBANCES = {
    "gain": Disturbances.only(gain=0.8),
    "offset": Disturbances.only(offset=8.0),
    "light": Disturbances.only(light=0.2),
    "noise": Disturbances.only(noise=10.0),
    "defocus": Disturbances.only(defocus=2.0),
    "covering": Disturbances.only(covering=0.1),
}
"""One disturbance each, of a fixed strength, to measure with."""
